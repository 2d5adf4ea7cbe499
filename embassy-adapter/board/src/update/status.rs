//! The outcome of the last update, and its record in the flash.
//!
//! ```text
//!  version that was installed last LF  number of the state  version that was rolled back  reason
//! ```
//!
//! A roll-back adds the second line. It is valid while the boot loader's state has that number ([`StateFlash`]). So the next
//! update can be recorded before it is marked, and a power cut between the two leaves this line valid.
//!
//! [`StateFlash`]: super::StateFlash

use core::fmt::{self, Write};
use core::ops::Range;
use core::str;

use embedded_storage::nor_flash::NorFlash;
use heapless::String;

use super::error::UpdateError;
use crate::identity::Identity;
use crate::slots::Slots;

/// The size of the record.
const RECORD: usize = 160;

/// The outcome of the last update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Phase {
    /// The image that runs was confirmed, or no update was ever installed.
    Confirmed,
    /// An update waits for a restart.
    Installed,
    /// The image that runs is an update, and must serve a request to be confirmed.
    OnTrial,
    /// The last update was not confirmed, and the earlier image runs.
    RolledBack,
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Confirmed => "confirmed",
            Self::Installed => "installed",
            Self::OnTrial => "on trial",
            Self::RolledBack => "rolled back",
        })
    }
}

/// The version that runs, and what became of the last update.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    pub(super) identity: Identity,
    /// The outcome of the last update.
    pub phase: Phase,
    pub(super) history: String<RECORD>,
}

impl Status {
    /// Returns the board, and the version that runs.
    #[must_use]
    pub const fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Returns the version of the last update, and why it was rolled back; empty texts without either. After a power cut during
    /// the installation it can be a version that was never installed.
    #[must_use]
    pub fn last_update(&self) -> (&str, &str) {
        match (self.phase, rolled_back(&self.history)) {
            (Phase::RolledBack, Some((_, version, reason))) => (version, reason),
            _ => (installed(&self.history), ""),
        }
    }
}

impl fmt::Display for Status {
    /// Writes the board, its version and the phase, such as `w5500-evb-pico 0.1.0 confirmed`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { identity, phase, .. } = self;
        write!(f, "{} {} ", identity.board(), identity.version())?;
        let (version, reason) = self.last_update();
        match phase {
            Phase::Confirmed | Phase::OnTrial => phase.fmt(f),
            Phase::Installed => write!(f, "runs; a restart swaps in {version}"),
            Phase::RolledBack => write!(f, "confirmed; {version} was rolled back: {reason}"),
        }
    }
}

/// Reads the record; empty without one.
pub(super) fn history<F: NorFlash>(flash: &mut F, slots: &Range<u32>) -> Result<String<RECORD>, UpdateError<F::Error>> {
    let mut memory = [0; RECORD];
    let text = Slots::new(flash, slots.clone())?.read_start(&mut memory)?;
    let text = text.and_then(|text| str::from_utf8(text).ok()).unwrap_or_default();
    Ok(String::try_from(text).unwrap_or_default())
}

/// Returns the version that was installed last.
fn installed(history: &str) -> &str {
    history.lines().next().unwrap_or_default()
}

/// Returns the number of the state, the version and the reason of the last roll-back.
fn rolled_back(history: &str) -> Option<(u32, &str, &str)> {
    let mut words = history.lines().nth(1)?.splitn(3, ' ');
    Some((words.next()?.parse().ok()?, words.next()?, words.next()?))
}

/// Records a version that is about to be installed; the last roll-back remains.
pub(super) fn record_version<F: NorFlash>(
    flash: &mut F,
    slots: &Range<u32>,
    version: &str,
) -> Result<(), UpdateError<F::Error>> {
    let last = history(flash, slots)?;
    let mut new: String<RECORD> = String::new();
    let note = last.lines().nth(1);
    let _ = write!(Cut(&mut new), "{version}{}{}", if note.is_some() { "\n" } else { "" }, note.unwrap_or_default());
    Ok(Slots::new(flash, slots.clone())?.write(new.as_bytes())?)
}

/// Adds the reason of a roll-back to the record, at the first start after it: the boot loader's state has this number.
pub(super) fn keep_reason<F: NorFlash>(
    flash: &mut F,
    slots: &Range<u32>,
    sequence: u32,
    reason: &dyn fmt::Display,
) -> Result<(), UpdateError<F::Error>> {
    let last = history(flash, slots)?;
    if rolled_back(&last).is_some_and(|(number, ..)| number == sequence) {
        return Ok(());
    }
    let (mut new, version) = (String::<RECORD>::new(), installed(&last));
    // a longer reason is cut
    let _ = write!(Cut(&mut new), "{version}\n{sequence} {version} {reason}");
    Ok(Slots::new(flash, slots.clone())?.write(new.as_bytes())?)
}

/// Writes what fits.
struct Cut<'a>(&'a mut String<RECORD>);

impl Write for Cut<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        text.chars().try_for_each(|c| self.0.push(c).map_err(|_| fmt::Error))
    }
}
