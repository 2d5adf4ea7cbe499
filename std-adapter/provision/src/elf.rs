//! The bytes that an ELF file puts into the flash.

use std::collections::BTreeMap;

/// The maximum size of an image; a wrong address in a file must not allocate gigabytes.
const MOST: u32 = 64 << 20;

/// Returns whether a file is an ELF file.
#[must_use]
pub fn is_elf(file: &[u8]) -> bool {
    file.starts_with(b"\x7fELF")
}

/// Returns whether an ELF file is for RISC-V.
#[must_use]
pub fn is_riscv(file: &[u8]) -> bool {
    half(file, 18) == Some(243)
}

/// Returns the segments of a little-endian ELF file with 32 bits as one binary, and its address; gaps are `ff`, as in erased flash. `None`
/// if the file is damaged, or another kind of ELF.
#[must_use]
pub fn flatten(file: &[u8]) -> Option<(u32, Vec<u8>)> {
    // 32 bits, little-endian
    if file.get(4..6)? != [1, 1] {
        return None;
    }
    let table = usize::try_from(word(file, 28)?).ok()?;
    let [size, count] = [half(file, 42)?, half(file, 44)?].map(usize::from);
    let mut segments = BTreeMap::new();
    for number in 0..count {
        let header = file.get(table.checked_add(number * size)?..)?;
        let [kind, offset, _, address, len] = [0, 4, 8, 12, 16].map(|at| word(header, at));
        let (offset, len) = (usize::try_from(offset?).ok()?, usize::try_from(len?).ok()?);
        // segments that are loaded; memory without contents has no bytes in the file
        if kind? == 1 && len > 0 {
            segments.insert(address?, file.get(offset..offset.checked_add(len)?)?);
        }
    }
    joined(segments)
}

/// Joins several binaries with their addresses into one. `None` if they overlap, are far apart, or have the same address.
#[must_use]
pub fn join(parts: Vec<(u32, Vec<u8>)>) -> Option<(u32, Vec<u8>)> {
    let count = parts.len();
    let parts: BTreeMap<_, _> = parts.into_iter().collect();
    (parts.len() == count).then(|| joined(parts))?
}

fn joined(parts: BTreeMap<u32, impl AsRef<[u8]>>) -> Option<(u32, Vec<u8>)> {
    let first = *parts.first_key_value()?.0;
    let mut image = Vec::new();
    for (address, bytes) in parts {
        let at = usize::try_from(Some(address - first).filter(|at| *at < MOST)?).ok()?;
        if at < image.len() {
            return None;
        }
        image.resize(at, 0xff);
        image.extend_from_slice(bytes.as_ref());
    }
    Some((first, image))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|bytes| u32::from_le_bytes(*bytes))
}

fn half(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|bytes| u16::from_le_bytes(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a file with these segments: kind, address, contents.
    fn file(segments: &[(u32, u32, &[u8])]) -> Vec<u8> {
        let mut header = b"\x7fELF\x01\x01".to_vec();
        header.resize(52, 0);
        header[28] = 52;
        header[42] = 32;
        header[44] = u8::try_from(segments.len()).unwrap();
        let mut contents = Vec::new();
        for (kind, address, bytes) in segments {
            let offset = 52 + 32 * segments.len() + contents.len();
            let len = u32::try_from(bytes.len()).unwrap();
            for field in [*kind, u32::try_from(offset).unwrap(), 0x2000_0000, *address, len, len, 5, 1] {
                header.extend(field.to_le_bytes());
            }
            contents.extend_from_slice(bytes);
        }
        [header, contents].concat()
    }

    #[test]
    fn loaded_segments_are_put_at_their_addresses() {
        let file = file(&[(1, 0x1001_0008, b"second"), (1, 0x1001_0000, b"first"), (1, 9, b""), (6, 0, b"no segment")]);
        assert!(is_elf(&file));
        let flat = (0x1001_0000, b"first\xff\xff\xffsecond".to_vec());
        assert_eq!(flatten(&file).unwrap(), flat);
        assert!(!is_riscv(&file));
        let joined = join(vec![flat.clone(), (0x1000_fffe, b"x".to_vec())]).unwrap();
        assert_eq!(joined, (0x1000_fffe, b"x\xfffirst\xff\xff\xffsecond".to_vec()));
        assert_eq!(join(vec![flat.clone(), flat.clone()]), None, "twice the same");
        assert_eq!(join(vec![flat, (0x1000_fffe, b"xyz".to_vec())]), None, "overlap");
    }

    #[test]
    fn an_invalid_file_has_no_image() {
        let good = file(&[(1, 0, b"bytes")]);
        assert!((0..good.len()).all(|len| flatten(&good[..len]).is_none()), "cut off");
        assert_eq!(flatten(&file(&[(1, 0, b"bytes"), (1, 4, b"overlap")])), None);
        assert_eq!(flatten(&file(&[(1, 0, b"a"), (1, MOST, b"b")])), None);
        assert_eq!(flatten(&file(&[])), None);
    }
}
