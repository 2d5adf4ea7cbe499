//! The vector table that an image of a Cortex-M starts with, for hosts and for the board.

/// The architecture's regions for code and for memory. Code can be in both: some boards have their images in external memory.
const CODE: core::ops::Range<u32> = 0x0000_0000..0x4000_0000;
const MEMORY: core::ops::Range<u32> = 0x2000_0000..0x4000_0000;

/// Returns whether an image starts with a vector table: the initial stack pointer and the reset vector, whose lowest bit is
/// set.
///
/// # Examples
///
/// ```
/// use bcap_board::vectors::is_table;
///
/// assert!(is_table(b"\x00\x20\x04\x20\xb5\x01\x01\x10"), "0x20042000 and 0x100101b5");
/// assert!(!is_table(b"UF2\nWQ]\x9e"), "a UF2 file");
/// ```
#[must_use]
pub fn is_table(image: &[u8]) -> bool {
    let ([stack, reset, ..], _) = image.as_chunks::<4>() else { return false };
    let (stack, reset) = (u32::from_le_bytes(*stack), u32::from_le_bytes(*reset));
    MEMORY.contains(&stack) && CODE.contains(&reset) && !reset.is_multiple_of(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stack_pointer_is_in_memory_and_the_reset_vector_is_odd_and_in_code() {
        for (stack, reset, expected) in [
            (0x2000_0000, 1, true),
            (0x2004_2000, 0x1001_01b5, true),
            (0x3fff_fff8, 0x3fff_ffff, true),
            (0x2000_3800, 0x2101_03cd, true),
            (0x2004_2000, 0x1001_01b4, false),
            (0x2004_2000, 0x4000_0001, false),
            (0x1fff_fff8, 0x1001_01b5, false),
            (0x4000_0000, 0x1001_01b5, false),
            (0xffff_ffff, 0xffff_ffff, false),
            // the second stage of the RP2040's boot ROM, and a UF2 file
            (0x4b32_b500, 0x6058_2021, false),
            (0x0a32_4655, 0x9e5d_5157, false),
        ] {
            let image: [[u8; 4]; 2] = [u32::to_le_bytes(stack), u32::to_le_bytes(reset)];
            assert_eq!(is_table(image.as_flattened()), expected, "{stack:#x} {reset:#x}");
            assert!(!is_table(&image.as_flattened()[..7]), "cut off");
        }
    }
}
