//! UF2: blocks of flash, which the boot ROMs of the RP2040 and the RP2350 take from a file on their drive.
//!
//! ```text
//!  "UF2\n" 9e5d5157  flags  address  payload size  number  count  family  payload, 476 bytes  0ab16f30
//! ```
//!
//! Each block has 512 bytes, and all numbers have 32 bits. The payload of these files has 256 bytes, a page of the flash.

/// The address of the flash in the processor's memory map.
const FLASH: u32 = 0x1000_0000;
/// The maximum flash size that both chips address.
const FLASH_SIZE: usize = 16 << 20;
const BLOCK: usize = 512;
const PAGE: usize = 256;
const PAYLOAD_AT: usize = 32;

const START: [u32; 2] = [0x0a32_4655, 0x9e5d_5157];
const END: u32 = 0x0ab1_6f30;
/// The block has a family, and is for the flash.
const HAS_FAMILY: u32 = 0x2000;
const IS_NOT_FOR_FLASH: u32 = 1;

/// The marker at the start of a block for the boot ROM of an RP2350, which searches the first 4 KiB for one.
const PICOBIN: u32 = 0xffff_ded3;
const PICOBIN_RANGE: usize = 4096;

/// Returns whether a file begins like a UF2 file.
pub(crate) fn is_uf2(file: &[u8]) -> bool {
    file.starts_with(&START[0].to_le_bytes())
}

/// A chip with a boot ROM that takes UF2 files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Chip {
    /// Two Cortex-M0+.
    Rp2040,
    /// Two Cortex-M33, or two RISC-V cores.
    Rp2350,
}

impl Chip {
    const ALL: [Self; 2] = [Self::Rp2040, Self::Rp2350];

    /// The family in the blocks.
    const fn family(self) -> u32 {
        match self {
            Self::Rp2040 => 0xe48b_ff56,
            // the ARM cores, in the secure state
            Self::Rp2350 => 0xe48b_ff59,
        }
    }

    /// The `Board-ID` in `INFO_UF2.TXT` of the drive.
    #[must_use]
    pub const fn board_id(self) -> &'static str {
        match self {
            Self::Rp2040 => "RPI-RP2",
            Self::Rp2350 => "RP2350",
        }
    }

    /// The name of the chip.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rp2040 => "RP2040",
            Self::Rp2350 => "RP2350",
        }
    }

    /// Returns the chip whose boot ROM starts these contents of the flash.
    fn that_starts(image: &[u8]) -> Option<Self> {
        let second_stage = image.first_chunk::<PAGE>().and_then(|page| page.split_last_chunk::<4>());
        if second_stage.is_some_and(|(code, sum)| checksum(code) == u32::from_le_bytes(*sum)) {
            return Some(Self::Rp2040);
        }
        let (words, _) = image.get(..PICOBIN_RANGE.min(image.len()))?.as_chunks::<4>();
        words.iter().any(|word| u32::from_le_bytes(*word) == PICOBIN).then_some(Self::Rp2350)
    }
}

/// Contents of the flash, and their target chip.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Image {
    /// The chip whose boot ROM starts the image.
    pub chip: Chip,
    /// The flash, from its first byte on.
    pub bytes: Vec<u8>,
}

impl Image {
    /// Checks that the boot ROM of a chip starts these bytes from the address of the flash.
    ///
    /// # Errors
    ///
    /// The reason why the boot ROM does not start them.
    pub fn new(start: u32, bytes: Vec<u8>) -> Result<Self, String> {
        if start != FLASH || bytes.len() > FLASH_SIZE {
            return Err(format!(
                "the image is for the addresses from {start:#010x} on, but the boot ROM starts the flash at {FLASH:#010x}: an image \
                 with updates needs its boot loader as well"
            ));
        }
        let Some(chip) = Chip::that_starts(&bytes) else {
            return Err(
                "no boot ROM starts the image: it has neither the second stage of an RP2040 (boot2) nor the image \
                        definition of an RP2350"
                    .into(),
            );
        };
        Ok(Self { chip, bytes })
    }

    /// Returns the file.
    #[must_use]
    pub fn to_file(&self) -> Vec<u8> {
        let count = self.bytes.len().div_ceil(PAGE);
        let number = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
        let mut file = Vec::with_capacity(count * BLOCK);
        for (at, page) in self.bytes.chunks(PAGE).enumerate() {
            let [first, second] = START;
            let address = FLASH + number(at * PAGE);
            let head =
                [first, second, HAS_FAMILY, address, number(PAGE), number(at), number(count), self.chip.family()];
            file.extend(head.iter().flat_map(|word| word.to_le_bytes()));
            file.extend_from_slice(page);
            // the rest of the last page as in erased flash, and the rest of the payload
            file.resize(at * BLOCK + PAYLOAD_AT + PAGE, 0xff);
            file.resize((at + 1) * BLOCK - 4, 0);
            file.extend(END.to_le_bytes());
        }
        file
    }

    /// Reads a file; each block must be as [`to_file`](Self::to_file) writes it.
    ///
    /// # Errors
    ///
    /// The reason, with the number of the block.
    pub fn of_file(file: &[u8]) -> Result<Self, String> {
        let (blocks, rest) = file.as_chunks::<BLOCK>();
        if blocks.is_empty() || !rest.is_empty() {
            return Err(format!("a UF2 file has blocks of {BLOCK} bytes, but this has {} bytes", file.len()));
        }
        let mut bytes = Vec::with_capacity(blocks.len() * PAGE);
        let mut found = None;
        for (number, block) in blocks.iter().enumerate() {
            let invalid = |reason: &str| format!("block {number} of the UF2 file: {reason}");
            let (family, payload) = page(block, number, blocks.len()).map_err(invalid)?;
            if *found.get_or_insert(family) != family {
                return Err(invalid("it is for another family of chips than the blocks before it"));
            }
            bytes.extend_from_slice(payload);
        }
        let family = found.unwrap_or_default();
        let chip = Chip::ALL.into_iter().find(|chip| chip.family() == family);
        let chip =
            chip.ok_or_else(|| format!("the UF2 file is for the family {family:#010x}, not for an RP2040 or RP2350"))?;
        let image = Self::new(FLASH, bytes)?;
        if image.chip != chip {
            return Err(format!(
                "the UF2 file is for an {}, but its image is for an {}",
                chip.name(),
                image.chip.name()
            ));
        }
        Ok(image)
    }
}

/// Returns the family and the payload of a block, which must be this one of `count`.
fn page(block: &[u8; BLOCK], number: usize, count: usize) -> Result<(u32, &[u8]), &'static str> {
    let (words, _) = block.as_chunks::<4>();
    let word = |at: usize| words.get(at).map_or(0, |word| u32::from_le_bytes(*word));
    let is = |at: usize, value: usize| u32::try_from(value).is_ok_and(|value| word(at) == value);
    if [word(0), word(1)] != START || word(BLOCK / 4 - 1) != END {
        return Err("its marks are not those of UF2, so the file is damaged");
    }
    if word(2) & HAS_FAMILY == 0 || word(2) & IS_NOT_FOR_FLASH != 0 {
        return Err("it has no family, or does not belong into the flash");
    }
    if !is(4, PAGE) || !is(5, number) || !is(6, count) {
        return Err("its number or size is wrong, so blocks are missing or mixed up");
    }
    if !is(3, FLASH as usize + number * PAGE) {
        return Err("its address does not follow the block before it");
    }
    Ok((word(7), block.get(PAYLOAD_AT..PAYLOAD_AT + PAGE).unwrap_or_default()))
}

/// Returns the CRC-32 that the boot ROM of an RP2040 computes of the second stage: the high bit first, without a final inversion.
fn checksum(bytes: &[u8]) -> u32 {
    bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(
            crc ^ (u32::from(*byte) << 24),
            |crc, _| {
                if crc >> 31 == 1 { crc << 1 ^ 0x04c1_1db7 } else { crc << 1 }
            },
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image with the second stage of an RP2040.
    fn rp2040(len: usize) -> Vec<u8> {
        let mut bytes: Vec<u8> = (0..len).map(|at| (at % 251) as u8).collect();
        let sum = checksum(&bytes[..252]);
        bytes[252..256].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    #[test]
    fn the_checksum_is_the_one_of_the_boot_rom() {
        // the check value of CRC-32/MPEG-2
        assert_eq!(checksum(b"123456789"), 0x0376_e6e7);
    }

    #[test]
    fn a_file_has_the_bytes_of_the_format() {
        let bytes = rp2040(600);
        let file = Image::new(FLASH, bytes.clone()).unwrap().to_file();
        assert_eq!(file.len(), 3 * 512);
        // offsets of the specification, read without the code under test
        for (number, block) in file.chunks(512).enumerate() {
            let word = |at: usize| u32::from_le_bytes(block[at..at + 4].try_into().unwrap());
            assert_eq!(&block[..4], b"UF2\n");
            assert_eq!((word(4), word(8), word(508)), (0x9e5d_5157, 0x2000, 0x0ab1_6f30));
            assert_eq!((word(12), word(16)), (0x1000_0000 + 256 * number as u32, 256));
            assert_eq!((word(20), word(24), word(28)), (number as u32, 3, 0xe48b_ff56));
            assert!(block[288..508].iter().all(|byte| *byte == 0));
        }
        let payload: Vec<u8> = file.chunks(512).flat_map(|block| block[32..288].to_vec()).collect();
        assert_eq!((&payload[..600], &payload[600..]), (&bytes[..], &[0xff; 168][..]));
        assert_eq!(Image::of_file(&file).unwrap().bytes, payload);
    }

    #[test]
    fn the_chip_is_found_from_the_image() {
        assert_eq!(Image::new(FLASH, rp2040(256)).unwrap().chip, Chip::Rp2040);
        let mut bytes = vec![0; 8192];
        bytes[4092..4096].copy_from_slice(&PICOBIN.to_le_bytes());
        let image = Image::new(FLASH, bytes.clone()).unwrap();
        assert_eq!(image.chip, Chip::Rp2350);
        assert_eq!(image.to_file()[28..32], 0xe48b_ff59_u32.to_le_bytes());
        bytes.copy_within(4092..4096, 4096);
        bytes[4092] = 0;
        let error = Image::new(FLASH, bytes).unwrap_err();
        assert!(error.contains("neither the second stage of an RP2040 (boot2) nor"), "{error}");
        let error = Image::new(FLASH + 0x1_0000, rp2040(256)).unwrap_err();
        assert!(error.contains("needs its boot loader as well"), "{error}");
    }

    #[test]
    fn a_damaged_file_is_refused() {
        let good = Image::new(FLASH, rp2040(600)).unwrap().to_file();
        let with = |at: usize, byte: u8| {
            let mut file = good.clone();
            file[at] = byte;
            file
        };
        let cases = [
            (good[..1000].to_vec(), "a UF2 file has blocks of 512 bytes, but this has 1000 bytes"),
            (good[..1024].to_vec(), "block 0 of the UF2 file: its number or size is wrong"),
            (with(512, 0), "block 1 of the UF2 file: its marks are not those of UF2"),
            (with(1024 + 508, 0), "block 2 of the UF2 file: its marks"),
            (with(512 + 8, 1), "block 1 of the UF2 file: it has no family, or does not belong"),
            (with(512 + 9, 0), "block 1 of the UF2 file: it has no family"),
            (with(512 + 13, 9), "block 1 of the UF2 file: its address does not follow"),
            (with(512 + 17, 2), "block 1 of the UF2 file: its number or size"),
            (with(512 + 20, 2), "block 1 of the UF2 file: its number or size"),
            (with(1024 + 28, 0x59), "block 2 of the UF2 file: it is for another family"),
            (with(40, 0x7f), "no boot ROM starts the image"),
        ];
        for (file, expected) in cases {
            let error = Image::of_file(&file).unwrap_err();
            assert!(error.starts_with(expected), "{error}: {expected}");
        }
        let mut other = good.clone();
        other.chunks_mut(512).for_each(|block| block[28] = 0x59);
        let error = Image::of_file(&other).unwrap_err();
        assert_eq!(error, "the UF2 file is for an RP2350, but its image is for an RP2040");
        other.chunks_mut(512).for_each(|block| block[31] = 0);
        let error = Image::of_file(&other).unwrap_err();
        assert_eq!(error, "the UF2 file is for the family 0x008bff59, not for an RP2040 or RP2350");
    }
}
