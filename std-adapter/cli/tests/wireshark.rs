//! `bcap generate wireshark`: the dissector has the tables of the core, and tshark decodes with it.
//!
//! `BLESS=1` writes the golden files again.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use crate::common::capture::{BCAP, Capture, Flow, From, RAC, bstr, i4, list, numbered, r8, unhex, wrapped};
use crate::common::tshark::{DISSECTOR, has_tshark, selected, tshark};
use crate::common::{frames, vectors};
use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_fuzz::{TARGETS, corpus};

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

fn saved(capture: &Capture, folder: &tempfile::TempDir) -> PathBuf {
    let path = folder.path().join("capture.pcap");
    capture.save(&path);
    path
}

#[test]
fn the_dissector_has_every_function_and_code() {
    let functions = FunctionId::all().map(|function| format!("\"{function}\""));
    let codes = HResult::known().map(|code| format!("\"{}\"", code.name().unwrap()));
    let missing: Vec<_> = functions.chain(codes).filter(|name| !DISSECTOR.contains(name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
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
    if !has_tshark() {
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

fn page() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/wireshark.md")).unwrap()
}

#[test]
fn the_page_has_all_fields() {
    let page = page();
    let fields = DISSECTOR.lines().filter(|line| line.contains(" = ProtoField."));
    let names = fields.map(|line| line.split('"').nth(1).unwrap());
    let missing: Vec<_> = names.filter(|name| !page.contains(&format!("`{name}`"))).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn the_filters_and_colour_rules_of_the_page_are_valid() {
    if !has_tshark() {
        return;
    }
    let page = page();
    let rules = page.lines().filter(|line| line.starts_with("@b-CAP")).map(|line| line.split('@').nth(2).unwrap());
    let section = page.split("## ").find(|section| section.starts_with("Display filters")).unwrap();
    let rows = section.lines().filter(|line| line.starts_with("| `")).map(|line| line.split('`').nth(1).unwrap());
    let filters: Vec<_> = rules.chain(rows).map(|filter| format!("({filter})")).collect();
    assert!(filters.len() > 15, "{filters:?}");
    assert!(selected(&session(), &filters.join(" or ")) > 0);
}

/// A session of variables, motion, Slave Mode, errors and RAC; the test of captures with tcpdump writes it.
fn session() -> PathBuf {
    golden("session.pcap")
}

#[test]
fn a_recorded_session_is_linked_and_named() {
    if !has_tshark() {
        return;
    }
    let capture = session();
    let fields = ["-T", "fields", "-e", "frame.number", "-e", "_ws.col.Protocol", "-e", "_ws.col.Info"];
    assert_golden("session.txt", &tshark(&capture, &[&["-Y", "bcap || rac"], &fields[..]].concat()));
    for (filter, count) in [
        ("bcap.malformed || rac.malformed || bcap.cut", 0),
        ("bcap.unlinked || rac.unlinked || bcap.again", 0),
        ("bcap.request && !bcap.response_in", 0),
        ("rac.request && !rac.response_in", 0),
        ("bcap.refused", 2),
        ("bcap.hresult == 0x83501024", 1),
        ("bcap.function == 64 && bcap.command == \"slvMove\" && bcap.slave.mode == 0x202", 19),
        ("bcap.object == \"robot:Arm0/@CURRENT_ANGLE\" && bcap.value.float == 45", 1),
        ("rac.variable == \"S9\" && rac.hresult == 0", 1),
    ] {
        assert_eq!(selected(&capture, filter), count, "{filter}");
    }
}

/// A call of Robot_Execute on handle 5.
fn execute(serial: u8, command: &str, parameter: Vec<u8>) -> Vec<u8> {
    numbered(serial, 0, 64, &[i4(5), bstr(command), parameter])
}

/// A conversation with every feature that the dissector marks.
fn features() -> Capture {
    use From::{Client, Server};
    let mut capture = Capture::new();
    let mut flow = Flow::new(1, BCAP);
    let joints = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.0, 0.0];
    let bits = |number: u16| [&[3, 0, 1, 0, 0, 0][..], &u32::from(number).to_le_bytes()].concat();
    for (from, frame) in [
        (Client, numbered(1, 0, 7, &[i4(2), bstr("Arm0"), bstr("")])),
        (Server, numbered(1, 0, 0, &[i4(5)])),
        (Client, numbered(2, 0, 72, &[i4(5), i4(1), list(&[r8(&joints), i4(2), bits(0)]), bstr("")])),
        // still running, then done
        (Server, numbered(2, 0, 0x900, &[])),
        (Server, numbered(2, 0, 0, &[])),
        // MiniIO and HandIO are sent; a time stamp, position and joints, and the current are received
        (Client, execute(3, "slvSendFormat", bits(0x120))),
        (Server, numbered(3, 0, 0, &[])),
        (Client, execute(4, "slvRecvFormat", [&[3, 0x20, 2, 0, 0, 0, 0x54, 0, 0, 0, 1, 0, 0, 0][..]].concat())),
        (Server, numbered(4, 0, 0, &[])),
        (Client, execute(5, "slvChangeMode", bits(0x102))),
        (Server, numbered(5, 0, 0, &[])),
        (Client, execute(6, "slvMove", list(&[r8(&joints), i4(15), i4(3)]))),
        (Server, numbered(6, 0, 0x0f20_0501, &[list(&[i4(99), r8(&[0.5; 15]), r8(&joints)])])),
        (Server, numbered(6, 0, 0x8420_4043, &[])),
        (Client, numbered(7, 0, 200, &[])),
        (Server, numbered(9, 0, 0x8007_0057, &[])),
    ] {
        capture.tcp(&mut flow, from, &frame);
    }
    // two frames and a half in one segment, then the other half
    let frames = [numbered(10, 0, 1, &[]), numbered(11, 0, 2, &[]), numbered(12, 0, 21, &[i4(2)])].concat();
    let (most, rest) = frames.split_at(40);
    capture.tcp(&mut flow, Client, most);
    capture.tcp(&mut flow, Client, rest);
    // bytes between frames, a bad EOT, an unknown type
    let mut broken = numbered(13, 0, 21, &[i4(2)]);
    *broken.last_mut().unwrap() = 5;
    capture.tcp(&mut flow, Client, &[&b"noise"[..], &broken].concat());
    capture.tcp(&mut flow, Client, &numbered(14, 0, 21, &[vec![99, 0, 1, 0, 0, 0]]));

    let flow = Flow::new(2, BCAP);
    for serial in [20, 21, 22] {
        capture.udp(&flow, Client, &numbered(serial, 20, 101, &[i4(3)]));
    }
    capture.udp(&flow, Server, &numbered(22, 0, 0, &[i4(1)]));
    capture.udp(&flow, Server, &numbered(21, 0, 0, &[i4(1)]));
    capture.udp(&flow, Client, b"\x01\xff");
    let mut flow = Flow::new(3, RAC);
    capture.tcp(&mut flow, Client, b"GET:RC8:1:I:\r\nBYE\r");
    capture.tcp(&mut flow, Server, b"-2147024809\r\nwhat\r");
    capture
}

#[test]
fn retries_errors_formats_and_malformed_frames_have_golden_trees() {
    if !has_tshark() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = saved(&features(), &folder);
    assert_golden("features.txt", &trees(&path));
    for (filter, count) in
        [("bcap.retry", 2), ("bcap.executing", 1), ("bcap.again", 2), ("bcap.unlinked", 1), ("rac.malformed", 2)]
    {
        assert_eq!(selected(&path, filter), count, "{filter}");
    }
}

/// A value of an array with this count and these data.
fn array(kind: u8, count: usize, data: &[u8]) -> Vec<u8> {
    [&[kind, 0x20][..], &u32::try_from(count).unwrap().to_le_bytes(), data].concat()
}

/// Streams that are large, or that make a careless dissector search, recurse or count endlessly.
fn costly() -> Vec<Vec<u8>> {
    let nested = (0..2000).fold(i4(1), |inner, _| array(12, 1, &inner));
    let values = [
        array(17, 1 << 20, &vec![7; 1 << 20]),
        array(8, 100_000, &vec![0; 400_000]),
        array(12, 50_000, &i4(1).repeat(50_000)),
        array(0, 0xffff_ffff, &[]),
        array(8, 0xffff_ffff, &[0; 64]),
        nested,
    ];
    let frames = values.iter().map(|value| numbered(1, 0, 102, &[i4(3), value.clone()]));
    let small: Vec<u8> = (0..4000).flat_map(|_| numbered(1, 0, 2, &[])).collect();
    // every byte may begin a frame, with a length that is too short, too long, or missing
    frames
        .chain([small, vec![1; 100_000], [1, 0, 0, 0, 0].repeat(20_000), [1, 0xff, 0xff, 0, 0].repeat(20_000)])
        .collect()
}

#[test]
fn costly_streams_end() {
    if !has_tshark() {
        return;
    }
    let mut capture = Capture::new();
    for (number, bytes) in (0..).zip(costly()) {
        let mut flow = Flow::new(number, BCAP);
        capture.tcp(&mut flow, From::Client, &bytes);
        capture.tcp(&mut flow, From::Server, &bytes);
        capture.tcp(&mut Flow::new(number, RAC), From::Client, &bytes);
    }
    let folder = tempfile::tempdir().unwrap();
    let tree = trees(&saved(&capture, &folder));
    assert!(tree.contains("VARIANTs are nested too deeply"), "nesting");
    assert!(tree.contains("1048576 elements in all"), "a large array");
    assert!(tree.contains("50000 elements in all, of which not all are examined"), "many values");
    assert!(tree.contains("an array of 4294967295 EMPTY does not fit"), "a count without data");
}

#[test]
fn a_frame_of_1_200_000_values_has_a_bounded_tree() {
    if !has_tshark() {
        return;
    }
    let mut capture = Capture::new();
    let values = array(12, 1_200_000, &i4(7).repeat(1_200_000));
    capture.tcp(&mut Flow::new(1, BCAP), From::Client, &numbered(1, 0, 102, &[i4(3), values]));
    let folder = tempfile::tempdir().unwrap();
    let tree = trees(&saved(&capture, &folder));
    assert!(tree.contains("1200000 elements in all, of which not all are examined"), "the rest is said");
    assert!(tree.lines().count() < 25_000, "{} lines", tree.lines().count());
}

#[test]
fn each_fifth_input_of_a_corpus_gives_no_lua_error() {
    corpora(5);
}

#[test]
#[ignore = "needs a minute of processor time: `just nightly`"]
fn no_input_of_a_corpus_gives_a_lua_error() {
    corpora(1);
}

fn corpora(step: usize) {
    if !has_tshark() {
        return;
    }
    for (target, _) in TARGETS {
        let inputs: corpus::Inputs = corpus::read(target).unwrap().into_iter().step_by(step).collect();
        let capture = wrapped(&inputs);
        let folder = tempfile::tempdir().unwrap();
        // -V makes the texts of the whole tree
        let tree = tshark(&saved(&capture, &folder), &["-V"]);
        let errors = tree.matches("Lua Error").count();
        let trees = tree.lines().filter(|line| line.starts_with("DENSO ")).count();
        println!("{target}: {} inputs, {} packets, {trees} trees, {errors} Lua errors", inputs.len(), capture.packets);
        let example = tree.find("Lua Error").and_then(|at| tree.get(at.saturating_sub(2000)..at + 300));
        assert_eq!(errors, 0, "{}", example.unwrap_or_default());
        assert!(trees > 4 * inputs.len());
    }
}
