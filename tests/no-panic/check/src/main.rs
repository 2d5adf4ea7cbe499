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

/// Panic paths of other crates that the text image is known to have, by source file, and why none can be taken.
const KNOWN: &[(&str, &str)] = &[
    (
        "minimal-lexical-0.2.1/src/bellerophon.rs",
        "the index is an exponent, which was found not to be negative, modulo the length of the table",
    ),
    (
        "minimal-lexical-0.2.1/src/slow.rs",
        "its integers hold 4000 bits; of the at most 500 characters of a number no more than 2500 bits can come",
    ),
];

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
        // the error says what was found, whether or not its lines are known
        let _ = print_sites(&binary, repository);
        return Err(format!("the binary image can panic: {}", found.join(", ")));
    }
    contains_the_core(&binary)?;
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
    println!("text: {} bytes of code, {} panic symbols", text.code_size, text.panic_symbols().len());
    contains_the_core(&text)?;
    print_sites(&text, repository)?;
    echoes(&images.join("text"), TEXTS.as_bytes())?;
    echoes(&images.join("text"), LINES.as_bytes())
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

/// Runs an image, which must return what it reads.
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

/// Lists the panic paths by the crate that they come from; fails when one is the core's or is not known.
fn print_sites(image: &Image, repository: &Path) -> Outcome<()> {
    let mut sites = image.sites(repository)?;
    sites.sort();
    sites.dedup();
    let mut faults = 0;
    for site in &sites {
        let file = site.place.split(':').next().unwrap_or(&site.place);
        let known = KNOWN.iter().find(|(known, _)| *known == file && site.origin != Origin::Core);
        let why = known.map_or("NOT KNOWN: it must go, or be shown to be out of reach", |(_, why)| why);
        println!("  {:<24} {} -> {}\n{:27}{why}", site.origin.to_string(), site.place, site.target, "");
        faults += usize::from(known.is_none());
    }
    if faults > 0 {
        return Err(format!("{faults} panic paths of {} are not known to be out of reach", image.name()));
    }
    Ok(())
}
