//! The rules of a server with many peers, without I/O: the servers of `bcap-std` and `bcap-embassy` and the gateway use them.
//!
//! | rule                                                      | type                                      |
//! |-----------------------------------------------------------|-------------------------------------------|
//! | which client gets a slot, and which one loses it          | [`Slots`]                                 |
//! | when a connection has exceeded a time limit               | [`StreamTimes`]                           |
//! | which datagrams get a session, and which ones an answer   | [`datagrams`]                             |
//! | the answer to a client without a slot                     | [`refusal`]                               |

mod admission;
pub mod datagrams;
mod refusal;
mod times;

pub use self::admission::{Admission, Holder, SlotState, Slots};
pub use self::refusal::{REFUSAL, refusal};
pub use self::times::{Exceeded, StreamTimes, TimeLimits};
