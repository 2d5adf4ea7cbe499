//! The empty image, whose size is subtracted from the sizes of the others.
#![no_std]
#![no_main]

use bcap_sizes::{Memory, entry};

entry!(run);

fn run(memory: &mut Memory) {
    core::hint::black_box(memory);
}
