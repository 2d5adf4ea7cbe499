//! `bcap decode --rac` on the command line.

use crate::common::{bcap, bcap_with, vectors};
use serde_json::Value;

#[test]
fn text_is_converted_to_bytes_and_back() {
    let run = bcap(&["decode", "--rac", "--reverse", "8204,(8,Sample),(2,100)"]);
    let hex = "0c2002000000080001000000\
               0c000000530061006d0070006c0065000200010000006400";
    assert_eq!((run.out.trim_end(), run.code), (hex, 0));
    let run = bcap(&["decode", "--rac", hex]);
    assert_eq!((run.out.as_str(), run.code), ("8204,(8,Sample),(2,100)\n", 0));
    let run = bcap(&["decode", "--rac", "--reverse", "--json", "8196,1,-0,1e-7"]);
    assert_eq!(run.out, "{\"vt\":8196,\"v\":[1.0,-0.0,1e-7]}\n");
}

#[test]
fn all_values_of_the_vectors_round_trip() {
    let texts: Vec<String> = vectors("rac-spec.jsonl")
        .iter()
        .filter(|vector| vector["name"].as_str().unwrap().starts_with("rac_spec_eg"))
        .map(|vector| vector["text"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(texts.len(), 7);
    let input = texts.join("\n") + "\n";
    let hex = bcap_with(&["decode", "--rac", "--reverse", "-"], input.as_bytes());
    assert_eq!((hex.code, hex.err.as_str()), (0, ""));
    let back = bcap_with(&["decode", "--rac", "-"], hex.out.as_bytes());
    assert_eq!((back.code, back.out), (0, input));
}

#[test]
fn invalid_lines_are_reported_with_their_offset() {
    let run = bcap_with(&["decode", "--rac", "--reverse", "-"], b"3,1\n8194,1,x\n3,2\n");
    let lines: Vec<&str> = run.out.lines().collect();
    assert_eq!((run.code, lines.len()), (2, 3));
    assert_eq!((lines[0], lines[2]), ("03000100000001000000", "03000100000002000000"));
    let error: Value = serde_json::from_str(lines[1]).unwrap();
    assert_eq!((&error["error"], &error["offset"]), (&"not a digit of the number at column 8".into(), &7.into()));

    let run = bcap(&["decode", "--rac", "--reverse", "3,9999999999"]);
    assert_eq!((run.out.as_str(), run.code), ("", 2));
    assert!(run.err.starts_with("error: the number is out of the range"), "{}", run.err);

    // an empty array has no text
    let run = bcap_with(&["decode", "--rac", "-"], b"032000000000\n");
    let error: Value = serde_json::from_str(&run.out).unwrap();
    assert_eq!((run.code, &error["offset"]), (2, &0.into()));
}
