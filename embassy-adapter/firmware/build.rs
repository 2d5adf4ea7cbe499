//! Writes the linker scripts with the memory layout of the chosen board.

#[expect(dead_code, reason = "the layout of the whole flash, of which the linker needs the active partition only")]
#[path = "src/flash/layout.rs"]
mod layout;

use std::env;
use std::error::Error;
use std::fs;
use std::path::PathBuf;

/// The memory sizes of a small board; the emulator offers more.
const FLASH: u32 = 256 * 1024;
const RAM: u32 = 96 * 1024;
/// The parts of the memory that the stacks of the program and of the exception handlers use.
const STACK: u32 = 12 * 1024;
/// The same for an image with updates: the check of a signature takes 8 KiB more.
const UPDATE_STACK: u32 = 20 * 1024;
const HANDLER_STACK: u32 = 2 * 1024;
/// The end of the memory, with the cause of the last reset: at the same address in the boot loader and in all its images.
const RECORD: u32 = 32;
/// The memory that stands for a flash on the boards with updates.
const EXTERNAL: u32 = 0x2100_0000;

fn main() -> Result<(), Box<dyn Error>> {
    let (flash, ram) = match env::var_os("CARGO_FEATURE_MPS2_AN505") {
        Some(_) => (0x1000_0000, 0x3800_0000),
        None => (0, 0x2000_0000),
    };
    let has_updates = env::var_os("CARGO_FEATURE_UPDATE").is_some();
    let partition = layout::ACTIVE.end - layout::ACTIVE.start;
    let folder = PathBuf::from(env::var("OUT_DIR")?);
    for image in ["bare", "boot", "gateway", "node", "rtic", "serial", "slave"] {
        let layout = match has_updates && image == "gateway" {
            true => memory(EXTERNAL + layout::ACTIVE.start, partition, ram, UPDATE_STACK),
            false => memory(flash, FLASH, ram, STACK),
        };
        // RTIC has one stack
        let main = if image == "rtic" { "STACK" } else { "HANDLERS" };
        let layout = format!("{layout}_stack_start = ORIGIN({main}) + LENGTH({main});\n");
        let folder = folder.join(image);
        fs::create_dir_all(&folder)?;
        fs::write(folder.join("memory.x"), layout)?;
        println!("cargo::rustc-link-arg-bin={image}=-L{}", folder.display());
    }
    // not in RUSTFLAGS: a variable of that name, even an empty one, would replace them and link an image without code
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/flash/layout.rs");
    Ok(())
}

/// Returns the linker script of an image whose code is at `flash`.
fn memory(flash: u32, flash_len: u32, ram: u32, stack: u32) -> String {
    let handlers = ram + stack;
    let data = handlers + HANDLER_STACK;
    let record = ram + RAM - RECORD;
    let data_len = record - data;
    // the program's stack is at the lowest addresses and grows away from the data, so an overflow faults; the handler
    // of that fault has a separate stack
    format!(
        "MEMORY
{{
  FLASH : ORIGIN = {flash:#010x}, LENGTH = {flash_len}
  STACK : ORIGIN = {ram:#010x}, LENGTH = {stack}
  HANDLERS : ORIGIN = {handlers:#010x}, LENGTH = {HANDLER_STACK}
  RAM : ORIGIN = {data:#010x}, LENGTH = {data_len}
  RECORD : ORIGIN = {record:#010x}, LENGTH = {RECORD}
}}
_stack_end = ORIGIN(HANDLERS);
_program_stack_start = ORIGIN(STACK) + LENGTH(STACK);
_program_stack_end = ORIGIN(STACK);

SECTIONS {{
  .record (NOLOAD) : {{ KEEP(*(.uninit.record)) }} > RECORD
}} INSERT BEFORE .uninit;
"
    )
}
