//! An image that is being received.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;
use heapless::String;

use super::error::UpdateError;
use super::partitions::Partitions;
use super::record::{self, Signed};
use crate::crc::Crc32;
use crate::identity::{BLOCK, VERSION};
use crate::signature::{Manifest, PublicKey, SIGNATURE};
use crate::vectors;

#[derive(Debug)]
pub(super) struct Download {
    version: String<VERSION>,
    len: u32,
    crc: u32,
    /// The digest and the signature of the image, which are valid together.
    signed: Option<([u8; SIGNATURE], [u8; SIGNATURE])>,
    /// The number of the expected block.
    expected: u32,
}

impl Download {
    pub(super) const fn new(version: String<VERSION>, len: u32, crc: u32) -> Self {
        Self { version, len, crc, signed: None, expected: 0 }
    }

    pub(super) const fn version(&self) -> &String<VERSION> {
        &self.version
    }

    /// Records the signature, if it is by this key.
    pub(super) fn sign<E>(
        &mut self,
        board: &str,
        key: &PublicKey,
        digest: &[u8; SIGNATURE],
        signature: &[u8; SIGNATURE],
    ) -> Result<(), UpdateError<E>> {
        let manifest = Manifest { board, version: &self.version, len: self.len, digest: *digest };
        self.signed = key.accepts(&manifest, signature).then_some((*digest, *signature));
        if self.signed.is_some() { Ok(()) } else { Err(UpdateError::Signature) }
    }

    pub(super) const fn is_signed(&self) -> bool {
        self.signed.is_some()
    }

    /// Checks the digest of the received image, and keeps the signature for the boot loader.
    pub(super) fn keep_signature<F: NorFlash>(
        &self,
        flash: &mut F,
        partitions: &Partitions,
    ) -> Result<(), UpdateError<F::Error>> {
        let Some((digest, signature)) = self.signed else { return Err(UpdateError::Unsigned) };
        if record::digest(flash, partitions.other.start, self.len).map_err(UpdateError::Flash)? != digest {
            return Err(UpdateError::Signature);
        }
        let mut version = [0; VERSION];
        version.iter_mut().zip(self.version.bytes()).for_each(|(to, from)| *to = from);
        Signed { len: self.len, version, signature }.write(flash, partitions.signature.start)
    }

    /// Writes a block; erases each sector before its first block.
    pub(super) fn block<F: NorFlash>(
        &mut self,
        flash: &mut F,
        partition: &Range<u32>,
        number: u32,
        crc: u32,
        data: &[u8],
    ) -> Result<(), UpdateError<F::Error>> {
        let offset = number.checked_mul(size()).filter(|offset| *offset < self.len);
        let expected_len = offset.map(|offset| (self.len - offset).min(size()));
        let found = Crc32::new().and(&number.to_le_bytes()).and(data).value();
        if found != crc || expected_len.and_then(|len| usize::try_from(len).ok()) != Some(data.len()) {
            return Err(UpdateError::Damaged);
        }
        let expected = self.expected;
        if number.checked_add(1) == Some(expected) {
            return Ok(());
        }
        let Some(offset) = offset.filter(|_| number == expected) else {
            return Err(UpdateError::Sequence { expected });
        };
        let (start, sector) = (partition.start + offset, F::ERASE_SIZE);
        if usize::try_from(start).is_ok_and(|start| start.is_multiple_of(sector)) {
            let end = start + u32::try_from(sector).unwrap_or_default();
            flash.erase(start, end).map_err(UpdateError::Flash)?;
        }
        let mut block = [0xff; BLOCK];
        block.iter_mut().zip(data).for_each(|(to, from)| *to = *from);
        flash.write(start, &block).map_err(UpdateError::Flash)?;
        let mut written = [0; BLOCK];
        flash.read(start, &mut written).map_err(UpdateError::Flash)?;
        if written != block {
            return Err(UpdateError::NotWritten);
        }
        self.expected += 1;
        Ok(())
    }

    /// Checks that the flash has the whole image, and that it starts with a vector table.
    pub(super) fn check<F: NorFlash>(
        &self,
        flash: &mut F,
        partition: &Range<u32>,
    ) -> Result<(), UpdateError<F::Error>> {
        let expected = self.expected;
        if expected < self.len.div_ceil(size()) {
            return Err(UpdateError::Incomplete { expected });
        }
        let mut crc = Crc32::new();
        let mut block = [0; BLOCK];
        let mut left = usize::try_from(self.len).unwrap_or(usize::MAX);
        for start in (partition.start..partition.start + self.len).step_by(BLOCK) {
            flash.read(start, &mut block).map_err(UpdateError::Flash)?;
            crc = crc.and(block.get(..left).unwrap_or(&block));
            left = left.saturating_sub(BLOCK);
        }
        if crc.value() != self.crc {
            return Err(UpdateError::Crc);
        }
        flash.read(partition.start, &mut block).map_err(UpdateError::Flash)?;
        if vectors::is_table(&block) { Ok(()) } else { Err(UpdateError::NoVectors) }
    }
}

/// Returns the size of a block, as a part of an offset.
fn size() -> u32 {
    u32::try_from(BLOCK).unwrap_or_default()
}
