//! Packs and unpacks the corpora: `cargo run --no-default-features --example corpora -- pack|unpack [FOLDER]`.
//!
//! `unpack` writes each archive into `FOLDER/TARGET` and leaves other files there alone. `pack` replaces the archive of
//! each target that has such a folder by the files in it. Without FOLDER it is `fuzz/corpus`, where cargo-fuzz looks.

use std::path::PathBuf;

use bcap_fuzz::{TARGETS, corpus};

fn main() -> Result<(), String> {
    let mut args = std::env::args().skip(1);
    let action = args.next();
    let folder = args.next().map_or_else(corpus::folder, PathBuf::from);
    for (target, _) in TARGETS {
        let count = match action.as_deref() {
            Some("unpack") => corpus::unpack(target, &folder),
            Some("pack") if !folder.join(target).is_dir() => continue,
            Some("pack") => corpus::pack(target, &folder),
            _ => return Err("usage: corpora pack|unpack [FOLDER]".into()),
        };
        let count = count.map_err(|e| format!("{target}: {e}"))?;
        println!("{target}: {count} inputs");
    }
    Ok(())
}
