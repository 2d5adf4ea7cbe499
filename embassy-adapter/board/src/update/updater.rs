//! The board's side of updates: it receives an image, lets the boot loader swap it in, and confirms it.

use core::fmt;
use core::ops::Range;

use embassy_boot::{BlockingFirmwareState, FirmwareUpdaterError, State};
use embedded_storage::nor_flash::NorFlash;
use heapless::String;

use super::download::Download;
use super::error::UpdateError;
use super::partitions::Partitions;
use super::state::StateFlash;
use super::status::{self, Phase, Status};
use crate::identity::{BLOCK, Identity};
use crate::signature::{PublicKey, SIGNATURE, is_older};

/// The largest unit in which a flash is written, in bytes.
const UNIT: usize = 32;

/// The partitions and the identity of an image with updates.
pub type Updates = (Partitions, &'static Identity);

/// Receives images, and confirms or rejects the image that runs.
///
/// The flash is an argument of each method, because the settings are in the same flash.
#[derive(Debug)]
pub struct Updater {
    partitions: Partitions,
    identity: &'static Identity,
    phase: Phase,
    /// Checks images, if the board takes signed ones only.
    key: Option<PublicKey>,
    download: Option<Download>,
}

impl Updater {
    /// Reads the action of the boot loader before this start; call it once after each start.
    ///
    /// # Errors
    ///
    /// An [`UpdateError`] when the partitions do not fit the flash, or the flash fails. The image runs on without updates.
    pub fn start<F: NorFlash>(
        flash: &mut F,
        partitions: Partitions,
        identity: &'static Identity,
        last_reset: &dyn fmt::Display,
    ) -> Result<Self, UpdateError<F::Error>> {
        let len = |range: &Range<u32>| range.end.checked_sub(range.start).ok_or(UpdateError::Partitions);
        let sector = u32::try_from(F::ERASE_SIZE).map_err(|_| UpdateError::Partitions)?;
        let Partitions { active, other, signature, .. } = &partitions;
        let edges = [active.start, active.end, other.start, other.end, signature.start, signature.end];
        let is_aligned = edges.iter().all(|at| at.is_multiple_of(sector));
        let has_units = BLOCK.is_multiple_of(F::WRITE_SIZE) && BLOCK.is_multiple_of(F::READ_SIZE);
        let has_blocks = F::ERASE_SIZE.is_multiple_of(BLOCK);
        let is_inside =
            usize::try_from(active.end.max(other.end).max(signature.end)).is_ok_and(|end| end <= flash.capacity());
        if !(is_aligned && has_units && has_blocks && is_inside)
            || len(other)? < len(active)? + sector
            || len(signature)? < sector
        {
            return Err(UpdateError::Partitions);
        }
        let mut updater = Self { partitions, identity, phase: Phase::Confirmed, key: None, download: None };
        updater.phase = match updater.boot_state(flash)? {
            State::Swap => Phase::OnTrial,
            State::Revert => Phase::RolledBack,
            State::Boot | State::DfuDetach => Phase::Confirmed,
        };
        let state = StateFlash::new(&mut *flash, updater.partitions.state.clone())?;
        let (sequence, is_refused) = (state.sequence().unwrap_or_default(), state.is_refused());
        if is_refused {
            updater.phase = Phase::RolledBack;
        }
        if updater.phase == Phase::RolledBack {
            let reason: &dyn fmt::Display =
                if is_refused { &"the boot loader found no valid signature" } else { last_reset };
            status::keep_reason(flash, &updater.partitions.history, sequence, reason)?;
        }
        Ok(updater)
    }

    /// Takes only images that are signed with this key, if there is one.
    #[must_use]
    pub fn with_key(self, key: Option<PublicKey>) -> Self {
        Self { key, ..self }
    }

    /// Returns the phase of the last update.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Returns the running version, and the outcome of the last update.
    ///
    /// # Errors
    ///
    /// [`UpdateError::Flash`] when the flash cannot be read.
    pub fn status<F: NorFlash>(&self, flash: &mut F) -> Result<Status, UpdateError<F::Error>> {
        Ok(Status {
            identity: *self.identity,
            phase: self.phase,
            history: status::history(flash, &self.partitions.history)?,
        })
    }

    /// Begins to receive an image of `len` bytes with this CRC-32. Nothing is erased yet. A board with a key takes an older
    /// image only if it `may_be_older`.
    ///
    /// # Errors
    ///
    /// [`UpdateError::OtherBoard`], [`UpdateError::Older`], [`UpdateError::Size`] or [`UpdateError::Busy`]; earlier blocks remain.
    pub fn begin<E>(
        &mut self,
        board: &str,
        version: &str,
        len: u32,
        crc: u32,
        may_be_older: bool,
    ) -> Result<(), UpdateError<E>> {
        let most = self.partitions.active.end - self.partitions.active.start;
        if board != self.identity.board() {
            return Err(UpdateError::OtherBoard { board: self.identity.board() });
        }
        let running = self.identity.version();
        if self.key.is_some() && !may_be_older && is_older(version, running) {
            return Err(UpdateError::Older { running });
        }
        if len == 0 || len > most {
            return Err(UpdateError::Size { most });
        }
        if matches!(self.phase, Phase::OnTrial | Phase::Installed) {
            return Err(UpdateError::Busy);
        }
        // the host has read the version from a block of an image, which has room for no more
        let version = String::try_from(version).unwrap_or_default();
        self.download = Some(Download::new(version, len, crc));
        Ok(())
    }

    /// Takes the SHA-512 and the signature of the image that was begun, before its first block.
    ///
    /// # Errors
    ///
    /// [`UpdateError::NotBegun`], [`UpdateError::NoKey`] or [`UpdateError::Signature`].
    pub fn sign<E>(&mut self, digest: &[u8; SIGNATURE], signature: &[u8; SIGNATURE]) -> Result<(), UpdateError<E>> {
        let download = self.download.as_mut().ok_or(UpdateError::NotBegun)?;
        let key = self.key.ok_or(UpdateError::NoKey)?;
        download.sign(self.identity.board(), &key, digest, signature)
    }

    /// Writes a block of [`BLOCK`] bytes; the last block of an image can have fewer. Blocks have the numbers 0, 1, 2 and so on.
    ///
    /// `crc` is the CRC-32 of the number (u32, little-endian) and the data. The last block can be repeated, because its answer
    /// can be lost.
    ///
    /// # Errors
    ///
    /// [`UpdateError::Damaged`] or [`UpdateError::Sequence`]: send the expected block. Others: the block is not in the flash.
    pub fn block<F: NorFlash>(
        &mut self,
        flash: &mut F,
        number: u32,
        crc: u32,
        data: &[u8],
    ) -> Result<(), UpdateError<F::Error>> {
        let download = self.download.as_mut().ok_or(UpdateError::NotBegun)?;
        if self.key.is_some() && !download.is_signed() {
            return Err(UpdateError::Unsigned);
        }
        download.block(flash, &self.partitions.other, number, crc, data)
    }

    /// Checks the image, and lets the boot loader swap it in at the next start.
    ///
    /// # Errors
    ///
    /// An [`UpdateError`]; the running image stays.
    pub fn install<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), UpdateError<F::Error>> {
        let download = self.download.as_ref().ok_or(UpdateError::NotBegun)?;
        download.check(flash, &self.partitions.other)?;
        if self.key.is_some() {
            download.keep_signature(flash, &self.partitions)?;
        }
        let version = download.version().clone();
        status::record_version(flash, &self.partitions.history, &version)?;
        self.change_state(flash, |state| state.mark_updated())?;
        (self.phase, self.download) = (Phase::Installed, None);
        Ok(())
    }

    /// Confirms the image that runs, if it is on trial.
    ///
    /// # Errors
    ///
    /// An [`UpdateError`]; the image stays on trial.
    pub fn confirm<F: NorFlash>(&mut self, flash: &mut F) -> Result<(), UpdateError<F::Error>> {
        if self.phase == Phase::OnTrial {
            self.change_state(flash, |state| state.mark_booted())?;
            self.phase = Phase::Confirmed;
        }
        Ok(())
    }

    fn boot_state<F: NorFlash>(&self, flash: &mut F) -> Result<State, UpdateError<F::Error>> {
        self.change_state(flash, |state| state.get_state())
    }

    /// Calls embassy-boot.
    fn change_state<F: NorFlash, T>(
        &self,
        flash: &mut F,
        change: impl FnOnce(&mut BlockingFirmwareState<'_, StateFlash<&mut F>>) -> Result<T, FirmwareUpdaterError>,
    ) -> Result<T, UpdateError<F::Error>> {
        let state = StateFlash::new(flash, self.partitions.state.clone())?;
        let mut word = [0; UNIT];
        let word = word.get_mut(..F::WRITE_SIZE).ok_or(UpdateError::Partitions)?;
        // its error does not contain the error of the flash
        change(&mut BlockingFirmwareState::new(state, word)).map_err(|_| UpdateError::NotWritten)
    }
}
