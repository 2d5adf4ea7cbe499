//! Provokes faults, so that tests can check how the board recovers.
#![expect(unsafe_code, reason = "a fault is provoked by an access that Rust does not allow")]

use core::hint::black_box;

use crate::lan9118;

/// Provokes the fault of a letter; other bytes are ignored.
///
/// | letter | fault                                                    |
/// |--------|----------------------------------------------------------|
/// | `s`    | an overflow of the stack                                 |
/// | `b`    | a read of an address without memory                      |
/// | `p`    | a panic                                                  |
/// | `h`    | a task that never yields                                 |
/// | `e`    | an Ethernet controller that is switched off              |
/// | `E`    | one that stays off after it was initialised again        |
pub fn provoke(letter: u8) {
    match letter {
        b's' => {
            black_box(recurse(black_box(0)));
        }
        b'b' => {
            // SAFETY: the read faults before it has a value
            black_box(unsafe { core::ptr::with_exposed_provenance::<u32>(0xf000_0000).read_volatile() });
        }
        b'p' => panic!("provoked"),
        b'h' => loop {
            black_box(());
        },
        b'e' => lan9118::switch_off(false),
        b'E' => lan9118::switch_off(true),
        _ => {}
    }
}

/// Recurses until the stack is exhausted.
#[inline(never)]
#[expect(unconditional_recursion, reason = "this is what overflows the stack")]
fn recurse(depth: u32) -> u32 {
    let words = black_box([depth; 32]);
    let deeper = recurse(black_box(depth.wrapping_add(1)));
    words.iter().fold(deeper, |sum, word| sum.wrapping_add(*word))
}
