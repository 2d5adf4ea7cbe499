//! The text of values, and RAC: reads lines from standard input, and writes those again that were understood.
#![no_std]
#![no_main]

use bcap_core::variant::VariantBuf;
use no_panic_image::{entry, read_all, write_all};

entry!(main);

fn main() -> i32 {
    let mut input = [0; 16 * 1024];
    for line in read_all(&mut input).split(|byte| *byte == b'\n') {
        values(line);
    }
    0
}

/// Parses a line as a value and prints it again.
fn values(line: &[u8]) {
    let mut buffer = [0; 1024];
    let value = VariantBuf::<512>::parse_text(line);
    if let Ok(value) = value
        && let Ok(text) = value.as_variant().to_text(&mut buffer)
    {
        write_all(text.as_bytes());
        write_all(b"\n");
    }
}
