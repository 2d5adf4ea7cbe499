//! The text of values, and RAC.
#![no_std]
#![no_main]

use no_panic_image::{entry, read_all};

entry!(main);

fn main() -> i32 {
    let mut input = [0; 512];
    let input = read_all(&mut input);
    let mut x = [0; 32];
    let mut d = core::hint::black_box(5.0f64);
    if let Ok(s) = core::str::from_utf8(input) {
        if let Ok(f) = s.parse::<f64>() {
            d = f;
        }
        let _ = x[..s.len()].copy_from_slice(&input[..s.len()]);
    }
    i32::from(d > 1.0)
}
