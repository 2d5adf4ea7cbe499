//! Runs a target on files: `cargo run --no-default-features --example replay -- TARGET FILE...`.

use std::fs;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let name = args.next().ok_or("usage: replay TARGET FILE...")?;
    let (_, body) = bcap_fuzz::TARGETS.iter().find(|target| target.0 == name).ok_or("unknown target")?;
    for path in args {
        body(&fs::read(&path)?);
        println!("{path}: passed");
    }
    Ok(())
}
