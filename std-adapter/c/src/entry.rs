//! The entry of each function: it returns a status, and no panic leaves it.

use crate::status::{BCAP_OK, Status};

/// Runs the body of a function of the header and returns its status. A panic becomes a status; on a board there are no panics.
pub(crate) fn guard(body: impl FnOnce() -> Result<(), Status>) -> Status {
    #[cfg(feature = "hosted")]
    let body =
        || std::panic::catch_unwind(std::panic::AssertUnwindSafe(body)).unwrap_or(Err(crate::status::BCAP_E_PANIC));
    body().err().unwrap_or(BCAP_OK)
}
