//! The bodies of the fuzz targets: each takes arbitrary bytes and panics when a guarantee is broken.
//!
//! | target                | input                                        | guarantee                                              |
//! |-----------------------|----------------------------------------------|--------------------------------------------------------|
//! | [`frame`]             | bytes as a frame, unchanged or fixed up      | the oracle's verdict and values, strict within lenient |
//! | [`variant`]           | bytes as a value                             | the oracle's verdict and value; no accessor fails      |
//! | [`text`]              | bytes as the text of a value                 | the oracle's verdict and value; columns in the text    |
//! | [`rac_line`]          | bytes as lines, split into chunks            | the lines of a plain split; written requests read back |
//! | [`roundtrip_binary`]  | a generated value                            | encoded and decoded to the same value                  |
//! | [`roundtrip_text`]    | a generated value or float                   | the same bits, or no text and an error; std's floats   |
//! | [`stream`]            | bytes split into chunks, on all three links  | clients: the oracle's frames; servers: as unsplit      |
//! | [`rac_client`]        | requests, lines, time in any order           | requests end once and in time, with their own response |
//! | [`client`]            | calls, bytes, replies, time in any order     | calls end once and in time, with their own reply       |
//! | [`server`]            | bytes, calls, waits, time in any order       | valid replies, checked calls, no leaked handle         |
//! | [`gateway`]           | lines of PLCs, replies of a robot, any order | one answer a line; no PUT against the rules            |
//! | [`sim`]               | calls and events of the virtual controller   | its invariants, and the same run twice                 |
//! | [`slave`]             | replies, failures, poses, time in any order  | no motion after an error or over a limit; it ends      |
//!
//! They run under libFuzzer (`cargo fuzz run frame`), and as ordinary functions: `cargo test` replays the corpora
//! ([`corpus`]).

mod client;
pub mod corpus;
mod frame;
mod gateway;
mod input;
mod rac_client;
mod rac_line;
mod roundtrip;
mod server;
mod sim;
mod slave;
mod stream;
mod text;
mod variant;
pub mod world;

pub use self::client::client;
pub use self::frame::{frame, judge_frame};
pub use self::gateway::gateway;
pub use self::rac_client::rac_client;
pub use self::rac_line::rac_line;
pub use self::roundtrip::{frame_there_and_back, roundtrip_binary, roundtrip_text, text_there_and_back};
pub use self::server::server;
pub use self::sim::sim;
pub use self::slave::slave;
pub use self::stream::stream;
pub use self::text::text;
pub use self::variant::{judge_value, variant};

/// A target: its name and its body.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const TARGETS: [Target; 13] = [
    ("frame", frame),
    ("variant", variant),
    ("text", text),
    ("rac_line", rac_line),
    ("roundtrip_binary", roundtrip_binary),
    ("roundtrip_text", roundtrip_text),
    ("stream", stream),
    ("rac_client", rac_client),
    ("client", client),
    ("server", server),
    ("gateway", gateway),
    ("sim", sim),
    ("slave", slave),
];
