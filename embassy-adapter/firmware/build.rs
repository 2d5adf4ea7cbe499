//! Writes the linker script with the memory layout of the chosen board.

use std::env;
use std::error::Error;
use std::fs;
use std::path::PathBuf;

/// The memory sizes of a small board; the emulator offers more.
const FLASH: u32 = 256 * 1024;
const RAM: u32 = 96 * 1024;
/// The part of the memory that the stack uses.
const STACK: u32 = 12 * 1024;

fn main() -> Result<(), Box<dyn Error>> {
    let (flash, ram) = match env::var_os("CARGO_FEATURE_MPS2_AN505") {
        Some(_) => (0x1000_0000, 0x3800_0000_u32),
        None => (0, 0x2000_0000),
    };
    let (data, data_len) = (ram + STACK, RAM - STACK);
    // the stack is at the lowest addresses and grows away from the data, so an overflow faults
    let layout = format!(
        "MEMORY
{{
  FLASH : ORIGIN = {flash:#010x}, LENGTH = {FLASH}
  STACK : ORIGIN = {ram:#010x}, LENGTH = {STACK}
  RAM : ORIGIN = {data:#010x}, LENGTH = {data_len}
}}
_stack_start = ORIGIN(STACK) + LENGTH(STACK);
_stack_end = ORIGIN(STACK);
"
    );
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("memory.x"), layout)?;
    println!("cargo::rustc-link-search={}", out.display());
    // not in RUSTFLAGS: a variable of that name, even an empty one, would replace them and link an image without code
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    Ok(())
}
