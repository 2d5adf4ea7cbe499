//! Updates of the image in the field, over embassy-boot: two partitions, a swap at the start, and a roll-back.
//!
//! ```text
//!  begin, block, block ... ─► other partition ─► install ─► restart: the boot loader swaps the partitions
//!                                                               │
//!  confirmed ◄── a request was served ── new image on trial ◄───┘
//!                                           └── any reset ─► the boot loader swaps back: rolled back
//! ```
//!
//! With a key in the image ([`signature`](crate::signature)) only signed images are received, and no older images. The boot
//! loader checks the signature again before the swap ([`check_pending`]).
//!
//! A power cut at any moment leaves the earlier image or the new one in the active partition, complete. The other partition is
//! erased and written while the gateway runs, a sector at a time.

mod download;
mod error;
mod partitions;
mod record;
mod request;
#[cfg(all(feature = "embassy", feature = "health"))]
pub(crate) mod shown;
mod state;
mod status;
mod updater;

pub use self::error::UpdateError;
pub use self::partitions::Partitions;
pub use self::record::check_pending;
pub(crate) use self::request::perform;
pub use self::state::{StateError, StateFlash};
pub use self::status::{Phase, Status};
pub use self::updater::{Updater, Updates};
