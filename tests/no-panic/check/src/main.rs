//! Builds the freestanding images and searches them for panic paths.
//!
//! ```text
//! cargo run --manifest-path tests/no-panic/Cargo.toml        # needs nm, objdump and addr2line (binutils)
//! ```
//!
//! 1. `binary`, all of b-CAP, must not have any symbol of `core::panicking`, nor the function where a panic ends.
//! 2. `text`, the text of values and RAC, must not either; findings are listed by crate.
//! 3. The first image with a planted panic path must have one, which shows that the check detects it.
//! 4. Both are run, which shows that the searched images work.

mod disassembly;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use disassembly::Image;

type Outcome<T> = Result<T, String>;

/// Minimum size of the code of an image with all of the core in it; less means that it was optimised away.
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
    cannot_panic(&binary, repository)?;
    let frames = vectors(repository)?;
    echoes(&images.join("binary"), &frames)?;

    let planted =
        Image::load(&build(workspace, "planted", &["--features", "planted", "--bin", "binary"])?.join("binary"))?;
    let found = planted.panic_symbols();
    println!("binary with a planted panic: {} panic symbols, as it must have", found.len());
    if found.is_empty() {
        return Err("a planted panic path was not found, so this check is blind".into());
    }

    let text = Image::load(&images.join("text"))?;
    cannot_panic(&text, repository)?;
    echoes(&images.join("text"), TEXTS.as_bytes())?;
    echoes(&images.join("text"), LINES.as_bytes())
}

/// Builds the images into a separate directory below the target directory, and returns it.
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

/// Fails when the image is too small to contain all parts.
fn contains_the_core(image: &Image) -> Outcome<()> {
    if image.code_size < LEAST_CODE {
        return Err(format!("{} bytes of code are too few to hold the core; was it optimised away?", image.code_size));
    }
    Ok(())
}

/// Reads the frames of the specifications, one behind the other.
fn vectors(repository: &Path) -> Outcome<Vec<u8>> {
    let mut frames = Vec::new();
    for file in ["bcap-rc8-guide.jsonl", "bcap-rc9-spec.jsonl"] {
        let path = repository.join("tests/vectors").join(file);
        let text = std::fs::read_to_string(&path).map_err(|e| format!("cannot read {}: {e}", path.display()))?;
        for hex in text.lines().filter_map(|line| line.split_once("\"hex\": \"")?.1.split('"').next()) {
            let bytes = (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16));
            frames.extend(bytes.collect::<Result<Vec<u8>, _>>().map_err(|e| format!("{file}: {e}"))?);
        }
    }
    Ok(frames)
}

/// Values that have a text, one a line.
const TEXTS: &str =
    "3,-123\n8196,1,2.5,-0.125\n8204,(8,Sample),(2,100),(8204,(5,0.1))\n12,(8,Sample)\n0,\n7,2026/11/21 04:00:00\n";

/// Lines of RAC, as they are written.
const LINES: &str = "GET:RC8:10:I:\rPUT:RC8:10:P:8196,1,2,3,4,5,6,-1\r0,8,Test\r-2147024809\rGET:RC8:1:IO:\r";

/// Runs an image, which must echo its input.
fn echoes(program: &Path, input: &[u8]) -> Outcome<()> {
    let output = feed(program, input)?;
    let name = program.file_name().unwrap_or_default().to_string_lossy();
    if output != input {
        let output = String::from_utf8_lossy(&output);
        return Err(format!("{name} was given {} bytes and returned others: {output:?}", input.len()));
    }
    println!("{name}: run, and {} bytes came back as they went in", input.len());
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

/// Fails if an image can panic, and lists the panic paths by crate.
fn cannot_panic(image: &Image, repository: &Path) -> Outcome<()> {
    let found = image.panic_symbols();
    println!("{}: {} bytes of code, {} panic symbols", image.name(), image.code_size, found.len());
    if found.is_empty() {
        return contains_the_core(image);
    }
    // the error names the finding, even without its source lines
    let mut sites = image.sites(repository).unwrap_or_default();
    sites.sort();
    sites.dedup();
    for site in &sites {
        println!("  {:<24} {} -> {}", site.origin.to_string(), site.place, site.target);
    }
    Err(format!("the image {} can panic: {}", image.name(), found.join(", ")))
}
