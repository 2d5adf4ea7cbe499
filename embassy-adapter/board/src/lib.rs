//! The settings of a board: a block of text in its flash, which a host can write without building the image again.
//!
//! ```text
//!  "BCAPCONF"  key=value LF  key=value LF  ...  NUL up to 2048 bytes
//! ```
//!
//! The block is in the image as it is, ELF or binary. [`write`](image::write) finds the eight letters and writes the settings
//! after them. Host and board read the text with [`Settings::read`], so the board accepts every line that the host accepted.
//!
//! | key        | value                                | without it               |
//! |------------|--------------------------------------|--------------------------|
//! | `robot`    | `[tcp:\|udp:]ADDRESS:PORT`           | `tcp:10.0.2.2:5007`      |
//! | `provider` | the provider to connect to           | `CaoProv.DENSO.VRC9`     |
//! | `machine`  | the machine that it runs on          | `localhost`              |
//! | `option`   | the option of Controller_Connect     | none                     |
//! | `service`  | the option of Service_Start          | `WDT=400`                |
//! | `variable` | what the images `bare` and `node` read | `I1`                   |
//! | `dhcp`     | `yes`, `no`: ask the network for an address | `yes`             |
//! | `address`  | `ADDRESS/PREFIX`: the board's own, when the network gives none | `10.0.2.15/24` |
//! | `gateway`  | the router to other networks, with that address | `10.0.2.2`       |
//! | `mac`      | `02:00:00:bc:a9:03`: the hardware address | the image's         |
//! | `get`      | `KIND[/FIRST[-LAST]]`: what PLCs may read; can be repeated | everything |
//! | `put`      | `KIND[/FIRST[-LAST]][=MIN..MAX[,MIN..MAX]...]`: what they may write, with which values; can be repeated | nothing |
//! | `convert`  | `yes`, `no`: a PUT of another type is converted where nothing is lost | `no` |
//! | `rate`     | `PER_SECOND[/BURST]`: requests of each PLC | no limit           |
//! | `echo`     | a port that sends back the bytes that it receives, to compare with | none |
//!
//! An invalid line is skipped and reported. Then no PUT is allowed, whatever the other lines say: the invalid line may have
//! been one that forbids something.
#![no_std]

#[cfg(test)]
extern crate std;

mod error;
pub mod image;
mod rules;
mod settings;

pub use self::error::SettingError;
pub use self::rules::RuleMemory;
pub use self::settings::{Robot, Settings, Transport};

/// The letters that the block begins with.
pub const MAGIC: &[u8; 8] = b"BCAPCONF";

/// Bytes of the block, the letters included.
pub const BLOCK: usize = 2048;
