//! The entry of each function: it returns a status, and no panic leaves it.

use crate::status::{BCAP_OK, Status};

/// Runs the body of a function of the header and returns its status. A panic becomes a status.
pub(crate) fn guard(body: impl FnOnce() -> Result<(), Status>) -> Status {
    catch(body).err().unwrap_or(BCAP_OK)
}

#[cfg(feature = "hosted")]
fn catch(body: impl FnOnce() -> Result<(), Status>) -> Result<(), Status> {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    catch_unwind(AssertUnwindSafe(body)).unwrap_or(Err(crate::status::BCAP_E_PANIC))
}

/// On a board nothing panics, and nothing unwinds.
#[cfg(not(feature = "hosted"))]
fn catch(body: impl FnOnce() -> Result<(), Status>) -> Result<(), Status> {
    body()
}
