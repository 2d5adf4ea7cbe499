//! Links the images at the addresses of a board; the linker drops all code that their entry point does not reach.

fn main() {
    for argument in ["--gc-sections", "--nmagic", "-estart", "-Ttext=0x100", "-Tdata=0x20000000"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
    println!("cargo::rerun-if-changed=build.rs");
}
