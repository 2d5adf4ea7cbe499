//! Sets a cfg with the ARM architecture; Rust has no stable condition for that.

use std::env;

fn main() {
    let target = env::var("TARGET").unwrap_or_default();
    if target.starts_with("thumbv6m") {
        println!("cargo::rustc-cfg=armv6m");
    } else if target.starts_with("thumbv8m") {
        println!("cargo::rustc-cfg=armv8m");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
