//! Panic paths in a linked program: its symbols, and the calls that lead to those that panic.
//!
//! A call belongs to the innermost source line that is not the standard library's: where a bounds check was inlined, the
//! indexing expression is named and not `core::slice`. A function of the standard library that panics and was not
//! inlined counts as a panic itself, so that its callers are named.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::Outcome;

/// A linked program.
pub(crate) struct Image {
    path: PathBuf,
    /// Bytes of its `.text`.
    pub(crate) code_size: u64,
    /// Its symbols, demangled.
    symbols: Vec<String>,
}

/// The origin of code.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Origin {
    /// The crate that may not panic.
    Core,
    /// Another crate, with its version.
    Crate(String),
    /// The standard library's own code, reached through a function pointer only.
    Library,
    /// The image itself.
    Image,
}

/// The source lines of an address, inlined functions first.
type Lines = BTreeMap<String, Vec<String>>;

/// A call that ends in a panic.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Site {
    /// Whose code it is.
    pub(crate) origin: Origin,
    /// The file and line, or the function where these are unknown.
    pub(crate) place: String,
    /// The called function.
    pub(crate) target: String,
}

/// A call or jump from one function to another.
struct Call {
    /// The addresses of the call: its own address, or the addresses of the jumps to it when the compiler has merged
    /// several calls into one that has no source line.
    addresses: Vec<String>,
    caller: String,
    target: String,
}

impl Image {
    /// Reads the symbols of a program.
    pub(crate) fn load(path: &Path) -> Outcome<Self> {
        let symbols = tool("nm", &["--demangle", &path.to_string_lossy()])?;
        let symbols = symbols.lines().filter_map(|line| line.splitn(3, ' ').nth(2)).map(str::to_owned).collect();
        let sections = tool("objdump", &["--section-headers", &path.to_string_lossy()])?;
        let text = sections.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
        let size = text.into_iter().find(|fields| fields.get(1) == Some(&".text"));
        let size = size.and_then(|fields| u64::from_str_radix(fields.get(2)?, 16).ok());
        let code_size = size.ok_or_else(|| format!("no .text in {}", path.display()))?;
        Ok(Self { path: path.to_owned(), code_size, symbols })
    }

    /// Returns the name of its file.
    pub(crate) fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Returns the symbols that only a program that can panic has.
    pub(crate) fn panic_symbols(&self) -> Vec<&str> {
        self.symbols.iter().map(String::as_str).filter(|symbol| panics(symbol)).collect()
    }

    /// Finds the calls that end in a panic.
    pub(crate) fn sites(&self, repository: &Path) -> Outcome<Vec<Site>> {
        let (calls, lines) = self.calls()?;
        let mut panicking: BTreeSet<&str> =
            calls.iter().map(|call| call.target.as_str()).filter(|t| panics(t)).collect();
        let mut sites = Vec::new();
        // functions of the standard library join until there are no more
        loop {
            sites.clear();
            let mut joined = BTreeSet::new();
            for call in calls.iter().filter(|call| panicking.contains(call.target.as_str()) && !panics(&call.caller)) {
                for address in &call.addresses {
                    let frames = lines.get(address).map(Vec::as_slice).unwrap_or_default();
                    match frames.iter().find(|frame| !frame.contains("/library/") && !frame.starts_with('?')) {
                        Some(frame) => sites.push(Site {
                            origin: origin(frame, repository),
                            place: shorten(frame, repository),
                            target: call.target.clone(),
                        }),
                        None => drop(joined.insert(call.caller.as_str())),
                    }
                }
            }
            let before = panicking.len();
            panicking.extend(joined);
            if panicking.len() == before {
                break;
            }
        }
        let called: BTreeSet<&str> = calls.iter().map(|call| call.target.as_str()).collect();
        let by_pointer = panicking.iter().filter(|function| !called.contains(*function));
        sites.extend(by_pointer.map(|function| Site {
            origin: Origin::Library,
            place: (*function).to_owned(),
            target: "called through a pointer".to_owned(),
        }));
        Ok(sites)
    }

    /// Disassembles the program and returns every call and every jump between functions, with source lines.
    fn calls(&self) -> Outcome<(Vec<Call>, Lines)> {
        let listing = tool("objdump", &["-d", "--demangle", "--no-show-raw-insn", &self.path.to_string_lossy()])?;
        let mut calls = Vec::new();
        // the jumps inside of functions, by the address that they lead to
        let mut jumps = BTreeMap::<&str, Vec<String>>::new();
        let mut caller = "";
        for line in listing.lines() {
            if let Some((_, name)) = line.strip_suffix(">:").and_then(|line| line.split_once(" <")) {
                caller = name;
                continue;
            }
            let Some((address, instruction)) = line.split_once(":\t") else { continue };
            if !instruction.starts_with("call") && !instruction.starts_with('j') {
                continue;
            }
            let Some((head, target)) = instruction.strip_suffix('>').and_then(|i| i.split_once(" <")) else { continue };
            let address = address.trim().to_owned();
            if target == caller || target.contains("+0x") {
                jumps.entry(head.rsplit(' ').next().unwrap_or(head)).or_default().push(address);
            } else {
                calls.push(Call { addresses: vec![address], caller: caller.to_owned(), target: target.to_owned() });
            }
        }
        let mut lines = self.lines(calls.iter().flat_map(|call| &call.addresses))?;
        for call in &mut calls {
            let merged =
                lines.get(&call.addresses[0]).is_none_or(|frames| frames.iter().all(|frame| frame.ends_with('?')));
            if merged && let Some(sources) = jumps.get(call.addresses[0].as_str()) {
                call.addresses.clone_from(sources);
            }
        }
        let unknown: Vec<_> = calls.iter().flat_map(|c| &c.addresses).filter(|a| !lines.contains_key(*a)).collect();
        lines.extend(self.lines(unknown.into_iter())?);
        Ok((calls, lines))
    }

    /// Looks up the source lines of addresses, inlined functions first.
    fn lines<'a>(&self, addresses: impl Iterator<Item = &'a String>) -> Outcome<Lines> {
        let mut lines = Lines::new();
        for some in addresses.collect::<Vec<_>>().chunks(200) {
            let path = self.path.to_string_lossy();
            let mut args = vec!["--addresses", "--inlines", "--functions", "-e", &*path];
            args.extend(some.iter().map(|address| address.as_str()));
            let mut address = String::new();
            // for each address: itself, then a function and its line for every level of inlining
            let mut is_line = false;
            for line in tool("addr2line", &args)?.lines() {
                if let Some(hex) = line.strip_prefix("0x") {
                    hex.trim_start_matches('0').clone_into(&mut address);
                    is_line = false;
                    continue;
                }
                if is_line {
                    let line = line.split(" (discriminator").next().unwrap_or(line);
                    lines.entry(address.clone()).or_default().push(line.to_owned());
                }
                is_line = !is_line;
            }
        }
        Ok(lines)
    }
}

/// Returns whether a function is where panics go.
fn panics(symbol: &str) -> bool {
    symbol.contains("core::panicking") || symbol.contains("rust_begin_unwind") || symbol == "panicked"
}

/// Names the crate that a source file belongs to.
fn origin(frame: &str, repository: &Path) -> Origin {
    if let Some(inside) = Path::new(frame).strip_prefix(repository).ok().and_then(|path| path.to_str()) {
        return if inside.starts_with("core/") { Origin::Core } else { Origin::Image };
    }
    match frame.split_once("/registry/src/").and_then(|(_, rest)| rest.split('/').nth(1)) {
        Some(name) => Origin::Crate(name.to_owned()),
        None => Origin::Image,
    }
}

/// Leaves out of a path what differs between machines.
fn shorten(frame: &str, repository: &Path) -> String {
    if let Some((_, rest)) = frame.split_once("/registry/src/") {
        return rest.split_once('/').map_or(rest, |(_, path)| path).to_owned();
    }
    let inside = Path::new(frame).strip_prefix(repository).map(|path| path.display().to_string());
    inside.unwrap_or_else(|_| frame.to_owned())
}

/// Runs a program of binutils and returns its output.
fn tool(name: &str, args: &[&str]) -> Outcome<String> {
    let output = Command::new(name).args(args).output();
    let output = output.map_err(|e| format!("cannot run {name}: {e} (on Debian: apt-get install binutils)"))?;
    if !output.status.success() {
        return Err(format!("{name} failed: {}", String::from_utf8_lossy(&output.stderr)));
    }
    String::from_utf8(output.stdout).map_err(|_| format!("{name} printed what is no UTF-8"))
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Core => f.write_str("bcap-core"),
            Self::Crate(name) => f.write_str(name),
            Self::Library => f.write_str("the standard library"),
            Self::Image => f.write_str("the image"),
        }
    }
}
