//! `bcap wireshark`: the dissector is current, and tshark decodes with it.
//!
//! The tests of the dissector need `tshark`; without it they print one line and pass. `BLESS=1` writes the golden files again.

#[path = "common/capture.rs"]
mod capture;
mod common;

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use bcap_fuzz::{TARGETS, corpus};
use capture::{BCAP, Capture, Flow, From, RAC, unhex, wrapped};
use common::{bcap, frames, vectors};

fn script() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/wireshark/bcap.lua")
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

/// Compares a text with its golden file, or writes the file if `BLESS` is set.
#[track_caller]
fn assert_golden(name: &str, text: &str) {
    let path = golden(name);
    if std::env::var_os("BLESS").is_some() {
        fs::write(&path, text).unwrap();
    }
    let expected = fs::read_to_string(&path).unwrap();
    for (number, (found, expected)) in text.lines().zip(expected.lines()).enumerate() {
        assert_eq!(found, expected, "line {} of {}", number + 1, path.display());
    }
    assert_eq!(text.lines().count(), expected.lines().count(), "{}", path.display());
}

fn has_tshark(test: &str) -> bool {
    let found = Command::new("tshark").arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok();
    if !found {
        println!("skipped {test}: there is no tshark; install the Debian package tshark");
    }
    found
}

/// Runs tshark with the dissector alone, without the user's settings, and returns its output.
fn tshark(capture: &Path, args: &[&str]) -> String {
    let home = tempfile::tempdir().unwrap();
    let output = Command::new("tshark")
        .args(["-n", "-2", "-r"])
        .arg(capture)
        .arg(format!("-Xlua_script:{}", script().display()))
        .args(args)
        .env("HOME", home.path())
        .env("XDG_CONFIG_HOME", home.path())
        .env("TZ", "UTC")
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !err.contains("Lua"), "{err}");
    String::from_utf8(output.stdout).map_err(|error| error.utf8_error()).expect("text of tshark in UTF-8")
}

fn saved(capture: &Capture, folder: &tempfile::TempDir) -> PathBuf {
    let path = folder.path().join("capture.pcap");
    capture.save(&path);
    path
}

#[test]
fn the_committed_dissector_is_current() {
    let run = bcap(&["wireshark"]);
    assert_eq!((run.code, run.err.as_str()), (0, ""));
    let committed = fs::read_to_string(script()).unwrap();
    assert!(run.out == committed, "run: cargo run -p bcap-cli -- wireshark >docs/wireshark/bcap.lua");
}

/// The trees that the dissector made.
#[track_caller]
fn trees(capture: &Path) -> String {
    let tree = tshark(capture, &["-V"]);
    assert!(!tree.contains("Lua Error"), "{tree}");
    own_trees(&tree)
}

fn own_trees(tree: &str) -> String {
    let mut out = String::new();
    let mut is_own = false;
    for line in tree.lines() {
        if !line.starts_with(' ') {
            is_own = line.starts_with("DENSO ") || line.starts_with("Frame ");
        }
        if is_own && !line.starts_with("    ") && line.starts_with("Frame ") {
            let number = line.split([' ', ':']).nth(1).unwrap_or_default();
            let _ = writeln!(out, "Frame {number}");
        } else if is_own && !out.is_empty() && !line.is_empty() && !is_of_frame(line) {
            let _ = writeln!(out, "{line}");
        }
    }
    out
}

/// Whether a line is of the tree that every packet has.
fn is_of_frame(line: &str) -> bool {
    [
        "Encapsulation",
        "Arrival",
        "[Time",
        "Epoch",
        "Frame ",
        "Capture Length",
        "[Frame",
        "[Protocols",
        "[Coloring",
        "[Time ",
    ]
    .iter()
    .any(|start| line.trim_start().starts_with(start) && !line.contains("since the"))
}

#[test]
fn the_frames_and_lines_of_the_specifications_have_golden_trees() {
    if !has_tshark("golden trees") {
        return;
    }
    let mut capture = Capture::new();
    let mut flow = Flow::new(1, BCAP);
    for frame in frames() {
        let from = if frame["kind"] == "request" { From::Client } else { From::Server };
        capture.tcp(&mut flow, from, &unhex(frame["hex"].as_str().unwrap()));
    }
    let mut flow = Flow::new(2, RAC);
    for line in vectors("rac-spec.jsonl") {
        let text = line["text"].as_str().unwrap();
        let is_request = text.starts_with("GET") || text.starts_with("PUT");
        if text.ends_with('\r') {
            capture.tcp(&mut flow, if is_request { From::Client } else { From::Server }, text.as_bytes());
        }
    }
    let folder = tempfile::tempdir().unwrap();
    assert_golden("vectors.txt", &trees(&saved(&capture, &folder)));
}

#[test]
fn no_input_of_a_corpus_gives_a_lua_error() {
    if !has_tshark("the corpora") {
        return;
    }
    for (target, _) in TARGETS {
        let inputs = corpus::read(target).unwrap();
        let capture = wrapped(&inputs);
        let folder = tempfile::tempdir().unwrap();
        let began = std::time::Instant::now();
        // -V makes the texts of the whole tree
        let tree = tshark(&saved(&capture, &folder), &["-V"]);
        let errors = tree.matches("Lua Error").count();
        let trees = tree.lines().filter(|line| line.starts_with("DENSO ")).count();
        println!(
            "{target}: {} inputs, {} packets, {trees} trees, {errors} Lua errors, {:.1} s",
            inputs.len(),
            capture.packets,
            began.elapsed().as_secs_f32()
        );
        let example = tree.find("Lua Error").and_then(|at| tree.get(at.saturating_sub(2000)..at + 300));
        assert_eq!(errors, 0, "{}", example.unwrap_or_default());
        assert!(trees > 4 * inputs.len());
    }
}
