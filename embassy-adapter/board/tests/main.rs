//! The tests of this package, as one program. `cargo test -p bcap-board NAME::` runs one module.

mod configure;
mod console;
mod slots;
#[cfg(feature = "update")]
mod update;

/// The number of steps from one power cut to the next. With `UPDATE_CUTS=all`, as in the nightly run, the power is cut at each
/// one.
pub(crate) fn stride() -> usize {
    if std::env::var("UPDATE_CUTS").is_ok_and(|cuts| cuts == "all") { 1 } else { 5 }
}
