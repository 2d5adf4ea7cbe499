//! Passes the linker its scripts.
fn main() {
    let folder = env!("CARGO_MANIFEST_DIR");
    let has_updates = std::env::var_os("CARGO_FEATURE_UPDATES").is_some();
    // in folders, because the linker looks into the current one first
    println!("cargo::rustc-link-search={folder}/{}", if has_updates { "updates" } else { "plain" });
    // not in RUSTFLAGS: a variable of that name would replace them and link an image without code
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    // the second-stage boot code; with updates, the boot loader contains it
    if !has_updates {
        println!("cargo::rustc-link-arg-bins=-Tlink-rp.x");
    }
    println!("cargo::rerun-if-changed=plain/memory.x");
    println!("cargo::rerun-if-changed=updates/memory.x");
}
