//! Writes the linker script with the memory layout of the chosen board.

use std::env;
use std::error::Error;
use std::fs;
use std::path::PathBuf;

/// The memory sizes of a small board; the emulator offers more.
const FLASH: u32 = 256 * 1024;
const RAM: u32 = 96 * 1024;
/// The parts of the memory that the stacks of the program and of the exception handlers use.
const STACK: u32 = 12 * 1024;
const HANDLER_STACK: u32 = 2 * 1024;

fn main() -> Result<(), Box<dyn Error>> {
    let (flash, ram) = match env::var_os("CARGO_FEATURE_MPS2_AN505") {
        Some(_) => (0x1000_0000, 0x3800_0000_u32),
        None => (0, 0x2000_0000),
    };
    let handlers = ram + STACK;
    let data = handlers + HANDLER_STACK;
    let data_len = RAM - STACK - HANDLER_STACK;
    // the program's stack is at the lowest addresses and grows away from the data, so an overflow faults; the handler of
    // that fault has a stack of its own
    let layout = format!(
        "MEMORY
{{
  FLASH : ORIGIN = {flash:#010x}, LENGTH = {FLASH}
  STACK : ORIGIN = {ram:#010x}, LENGTH = {STACK}
  HANDLERS : ORIGIN = {handlers:#010x}, LENGTH = {HANDLER_STACK}
  RAM : ORIGIN = {data:#010x}, LENGTH = {data_len}
}}
_stack_start = ORIGIN(HANDLERS) + LENGTH(HANDLERS);
_stack_end = ORIGIN(HANDLERS);
_program_stack_start = ORIGIN(STACK) + LENGTH(STACK);
_program_stack_end = ORIGIN(STACK);
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
