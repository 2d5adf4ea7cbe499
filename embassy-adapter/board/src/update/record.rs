//! The signature of a received image, in its sector of the flash, for the boot loader.
//!
//! ```text
//!  "BCAPSIGN"  length, u32 little-endian  version, 20 bytes  signature, 64 bytes  CRC-32 of these, u32 little-endian
//! ```

use core::str;

use embedded_storage::nor_flash::NorFlash;

use super::error::UpdateError;
use super::partitions::Partitions;
use super::state::StateFlash;
use crate::crc::Crc32;
use crate::identity::{BLOCK, VERSION};
use crate::signature::{CAN_CHECK, Digest, Manifest, PublicKey, SIGNATURE, Sha512};

const MAGIC: &[u8; 8] = b"BCAPSIGN";
const CONTENT: usize = MAGIC.len() + 4 + VERSION + SIGNATURE;

/// A signed image in the flash.
#[derive(Clone, Debug)]
pub(super) struct Signed {
    pub(super) len: u32,
    pub(super) version: [u8; VERSION],
    pub(super) signature: [u8; SIGNATURE],
}

impl Signed {
    /// Writes it into its sector.
    pub(super) fn write<F: NorFlash>(&self, flash: &mut F, sector: u32) -> Result<(), UpdateError<F::Error>> {
        let mut block = [0xff; BLOCK];
        let (content, rest) = block.split_at_mut_checked(CONTENT).unwrap_or_default();
        let parts: [&[u8]; 4] = [MAGIC, &self.len.to_le_bytes(), &self.version, &self.signature];
        content.iter_mut().zip(parts.into_iter().flatten()).for_each(|(to, from)| *to = *from);
        let crc = Crc32::new().and(content).value().to_le_bytes();
        rest.iter_mut().zip(crc).for_each(|(to, from)| *to = from);
        let size = u32::try_from(F::ERASE_SIZE).map_err(|_| UpdateError::Partitions)?;
        flash.erase(sector, sector + size).map_err(UpdateError::Flash)?;
        flash.write(sector, &block).map_err(UpdateError::Flash)?;
        let mut written = [0; BLOCK];
        flash.read(sector, &mut written).map_err(UpdateError::Flash)?;
        if written == block { Ok(()) } else { Err(UpdateError::NotWritten) }
    }

    /// Reads it; `None` if the sector has no complete one.
    fn read<F: NorFlash>(flash: &mut F, sector: u32) -> Result<Option<Self>, F::Error> {
        let mut block = [0; BLOCK];
        flash.read(sector, &mut block)?;
        Ok(Self::parse(&block))
    }

    fn parse(block: &[u8; BLOCK]) -> Option<Self> {
        let (content, rest) = block.split_at_checked(CONTENT)?;
        let crc = u32::from_le_bytes(*rest.first_chunk()?);
        let fields = content.strip_prefix(MAGIC).filter(|_| Crc32::new().and(content).value() == crc)?;
        let (len, fields) = fields.split_first_chunk()?;
        let (version, signature) = fields.split_first_chunk()?;
        Some(Self { len: u32::from_le_bytes(*len), version: *version, signature: *signature.first_chunk()? })
    }

    /// Returns whether the image in a partition is the signed one.
    pub(super) fn fits<F: NorFlash>(
        &self,
        flash: &mut F,
        partition: u32,
        board: &str,
        key: &PublicKey,
    ) -> Result<bool, F::Error> {
        let digest = digest(flash, partition, self.len)?;
        let version = self.version.split(|byte| *byte == 0).next().unwrap_or_default();
        let Ok(version) = str::from_utf8(version) else { return Ok(false) };
        Ok(key.accepts(&Manifest { board, version, len: self.len, digest }, &self.signature))
    }
}

/// Returns the SHA-512 of an image in the flash.
pub(super) fn digest<F: NorFlash>(flash: &mut F, start: u32, len: u32) -> Result<[u8; SIGNATURE], F::Error> {
    if !CAN_CHECK {
        return Ok([0; SIGNATURE]);
    }
    let (mut hash, mut block) = (Sha512::new(), [0; BLOCK]);
    let mut left = usize::try_from(len).unwrap_or(usize::MAX);
    for at in (start..start.saturating_add(len)).step_by(BLOCK) {
        flash.read(at, &mut block)?;
        hash.update(block.get(..left).unwrap_or(&block));
        left = left.saturating_sub(BLOCK);
    }
    Ok(hash.finalize().into())
}

/// Cancels the update that waits for its swap unless it is signed; for boot loaders, before embassy-boot. Returns whether the
/// swap may be done, or continued.
///
/// A swap that has begun was checked before.
///
/// # Errors
///
/// An [`UpdateError`] when the flash fails or has no such partitions: start again.
pub fn check_pending<F: NorFlash>(
    flash: &mut F,
    partitions: &Partitions,
    board: &str,
    key: &PublicKey,
) -> Result<bool, UpdateError<F::Error>> {
    if !StateFlash::new(&mut *flash, partitions.state.clone())?.is_pending()? {
        return Ok(true);
    }
    let signed = Signed::read(flash, partitions.signature.start).map_err(UpdateError::Flash)?;
    let room = partitions.active.end - partitions.active.start;
    let is_valid = match signed.filter(|signed| signed.len <= room) {
        Some(signed) => signed.fits(flash, partitions.other.start, board, key).map_err(UpdateError::Flash)?,
        None => false,
    };
    if !is_valid {
        StateFlash::new(flash, partitions.state.clone())?.refuse()?;
    }
    Ok(is_valid)
}
