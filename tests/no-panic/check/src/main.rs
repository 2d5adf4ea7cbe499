//! Builds the freestanding images and searches them for panic paths.
//!
//! ```text
//! cargo run --manifest-path tests/no-panic/Cargo.toml        # needs nm, objdump and addr2line (binutils)
//! ```
//!
//! 1. `binary`, all of b-CAP, must not have any symbol of `core::panicking`, nor the place where a panic ends.
//! 2. The same image with a panic path planted must have one: the check sees what it looks for.
//! 3. `text`, which adds the text of values and RAC, may have panic paths of other crates; each is listed by the crate
//!    that it comes from, and one that comes from bcap-core fails the check.
//! 4. Both are run, to show that what was searched is what works.

mod disassembly;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use disassembly::{Image, Origin};

type Outcome<T> = Result<T, String>;

/// The least code that an image with all of the core in it has; less means that it was optimised away.
const LEAST_CODE: u64 = 12 * 1024;

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("no-panic: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Outcome<()> {
    if cfg!(not(all(target_os = "linux", target_arch = "x86_64"))) {
        println!("no-panic: skipped, the images are programs of x86-64 Linux");
        return Ok(());
    }
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().ok_or("this package has no workspace")?;
    let repository = workspace.ancestors().nth(2).ok_or("the workspace is not in tests/")?;
    let images = build(workspace, "images", &[])?;

    let binary = Image::load(&images.join("binary"))?;
    let found = binary.panic_symbols();
    println!("binary: {} bytes of code, {} panic symbols", binary.code_size, found.len());
    if !found.is_empty() {
        print_sites(&binary, repository)?;
        return Err(format!("the binary image can panic: {}", found.join(", ")));
    }
    contains_the_core(&binary)?;
    echoes_the_vectors(&images.join("binary"), repository)?;

    let planted =
        Image::load(&build(workspace, "planted", &["--features", "planted", "--bin", "binary"])?.join("binary"))?;
    let found = planted.panic_symbols();
    println!("binary with a planted panic: {} panic symbols, as it must have", found.len());
    if found.is_empty() {
        return Err("a planted panic path was not found, so this check is blind".into());
    }

    let text = Image::load(&images.join("text"))?;
    println!("text: {} bytes of code, {} panic symbols", text.code_size, text.panic_symbols().len());
    let ours = print_sites(&text, repository)?;
    if ours > 0 {
        return Err(format!("the text image has {ours} panic paths that come from bcap-core"));
    }
    Ok(())
}

/// Builds the images into a directory of their own below the target directory, which it returns.
fn build(workspace: &Path, name: &str, args: &[&str]) -> Outcome<PathBuf> {
    let target =
        std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace.join("target"), PathBuf::from).join(name);
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(workspace).args(["build", "--quiet", "--release", "--locked", "-p", "no-panic-image"]).args(args);
    let status = cargo.arg("--target-dir").arg(&target).status().map_err(|e| format!("cannot run cargo: {e}"))?;
    if !status.success() {
        return Err(format!("the images do not build: {status}"));
    }
    Ok(target.join("release"))
}

/// Fails when the image is too small to hold what it should.
fn contains_the_core(image: &Image) -> Outcome<()> {
    if image.code_size < LEAST_CODE {
        return Err(format!("{} bytes of code are too few to hold the core; was it optimised away?", image.code_size));
    }
    Ok(())
}

/// Sends all frames of the specifications through the image, which must return them.
fn echoes_the_vectors(program: &Path, repository: &Path) -> Outcome<()> {
    let mut frames = Vec::new();
    for file in ["bcap-rc8-guide.jsonl", "bcap-rc9-spec.jsonl"] {
        let path = repository.join("tests/vectors").join(file);
        let text = std::fs::read_to_string(&path).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
        for hex in text.lines().filter_map(|line| line.split_once("\"hex\": \"")?.1.split('"').next()) {
            let bytes = (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16));
            frames.extend(bytes.collect::<Result<Vec<u8>, _>>().map_err(|e| format!("{file}: {e}"))?);
        }
    }
    let output = feed(program, &frames)?;
    if output != frames {
        return Err(format!("the image returned {} bytes of {}, or other ones", output.len(), frames.len()));
    }
    println!("binary: run, and {} bytes of frames came back as they went in", frames.len());
    Ok(())
}

/// Runs a program with `input` and returns its output.
fn feed(program: &Path, input: &[u8]) -> Outcome<Vec<u8>> {
    let failed = |e| format!("cannot run {}: {e}", program.display());
    let mut child = Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(failed)?;
    // the images read all of their input before they write
    child.stdin.take().ok_or("no pipe")?.write_all(input).map_err(failed)?;
    let output = child.wait_with_output().map_err(failed)?;
    if !output.status.success() {
        return Err(format!("{} ended with {}", program.display(), output.status));
    }
    Ok(output.stdout)
}

/// Lists the panic paths by the crate that they come from, and returns how many come from bcap-core.
fn print_sites(image: &Image, repository: &Path) -> Outcome<usize> {
    let mut sites = image.sites(repository)?;
    sites.sort();
    sites.dedup();
    for site in &sites {
        println!("  {:<24} {} -> {}", site.origin.to_string(), site.place, site.target);
    }
    Ok(sites.iter().filter(|site| site.origin == Origin::Core).count())
}
