//! `bcap decode` on the command line.

use crate::common;
use crate::common::{bcap, bcap_with, frames};
use serde_json::{Value, json};

const FRAME: &str = "011e000000040000006500000001000a0000000300010000000300000004";

#[test]
fn a_frame_decodes_to_the_documented_line_and_encodes_back() {
    let run = bcap(&["decode", "--json", FRAME]);
    let line = r#"{"serial":4,"reserved":0,"code":101,"name":"VariableGetValue","args":[{"vt":3,"v":3}]}"#;
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (format!("{line}\n").as_str(), "", 0));
    let run = bcap(&["decode", "--reverse", line]);
    assert_eq!((run.out.trim_end(), run.code), (FRAME, 0));
}

#[test]
fn all_frames_of_the_vectors_are_decoded_and_encoded() {
    let frames = frames();
    assert_eq!(frames.len(), 108);
    for role in ["request", "response"] {
        let of_role: Vec<&Value> = frames.iter().filter(|frame| frame["kind"] == role).collect();
        let hex: Vec<&str> = of_role.iter().map(|frame| frame["hex"].as_str().unwrap()).collect();
        assert!(hex.len() > 40);
        let input = hex.join("\n") + "\n";

        let decoded = bcap_with(&["decode", "--json", "--as", role, "-"], input.as_bytes());
        assert_eq!((decoded.code, decoded.err.as_str()), (0, ""));
        assert_eq!(decoded.out.lines().count(), hex.len());
        for (line, frame) in decoded.out.lines().zip(&of_role) {
            let line: Value = serde_json::from_str(line).unwrap();
            assert_eq!((&line["serial"], &line["code"]), (&frame["serial"], &frame["code"]), "{frame}");
            if frame.get("args").is_some() {
                assert_eq!((&line["reserved"], &line["args"]), (&frame["reserved"], &frame["args"]), "{frame}");
            }
            // the guide lists a reply with code 0 as a request; there is no function 0
            assert_eq!(line["name"].is_null(), role == "request" && line["code"] == 0, "{line}");
        }

        let encoded = bcap_with(&["decode", "--reverse", "--as", role, "-"], decoded.out.as_bytes());
        assert_eq!((encoded.code, encoded.err.as_str()), (0, ""));
        assert_eq!(encoded.out, input);
    }
}

#[test]
fn all_values_of_the_vectors_are_decoded_and_encoded() {
    // every argument of every frame, located by its length
    let mut values = Vec::new();
    for frame in frames() {
        let hex = frame["hex"].as_str().unwrap();
        let mut rest = &hex[30..hex.len() - 2];
        while !rest.is_empty() {
            let digits: Vec<&str> = (0..4).rev().map(|i| &rest[2 * i..2 * i + 2]).collect();
            let length = usize::from_str_radix(&digits.concat(), 16).unwrap();
            values.push(rest[8..8 + 2 * length].to_owned());
            rest = &rest[8 + 2 * length..];
        }
    }
    assert!(values.len() > 100);
    let input = values.join("\n") + "\n";
    let decoded = bcap_with(&["decode", "--variant", "--json", "-"], input.as_bytes());
    assert_eq!((decoded.code, decoded.err.as_str()), (0, ""));
    let encoded = bcap_with(&["decode", "--reverse", "--variant", "-"], decoded.out.as_bytes());
    assert_eq!((encoded.code, encoded.out), (0, input));
}

#[test]
fn an_invalid_line_is_reported_in_order_and_the_others_are_converted() {
    let input = format!("{FRAME}\n02{}\nzz\n\n{FRAME}", &FRAME[2..]);
    let run = bcap_with(&["decode", "--json", "-"], input.as_bytes());
    assert_eq!(run.code, 2);
    let lines: Vec<Value> = run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 5);
    assert_eq!(lines[0], lines[4]);
    assert_eq!(lines[1], json!({"error": "a frame starts with 0x01, found 0x02 at byte 0", "offset": 0}));
    assert_eq!(lines[2]["offset"], 0);
    assert_eq!(lines[3]["offset"], 0);
    assert!(run.err.contains("3 of the lines"), "{}", run.err);

    let run = bcap_with(&["decode", "--reverse", "-"], b"{\"code\":2}\n{\"code\":\"x\"}\n\xff\n{\"code\":2}\n");
    let lines: Vec<&str> = run.out.lines().collect();
    assert_eq!((run.code, lines.len()), (2, 4));
    assert_eq!((lines[0], lines[3]), ("01100000000100000002000000000004", "01100000000100000002000000000004"));
    for line in &lines[1..3] {
        let line: Value = serde_json::from_str(line).unwrap();
        assert!(line["error"].is_string() && line["offset"].is_number(), "{line}");
    }
}

#[test]
fn an_invalid_argument_exits_with_2() {
    let run = bcap(&["decode", &FRAME[..40]]);
    assert_eq!((run.out.as_str(), run.code), ("", 2));
    assert_eq!(run.err, "error: the input ends inside a frame of 30 bytes at byte 20\n");
    let run = bcap(&["decode", "--json", &FRAME[..40]]);
    assert_eq!(run.code, 2);
    assert_eq!(serde_json::from_str::<Value>(&run.out).unwrap()["offset"], 20);
    for args in [&["decode", "--as", "answer", "00"][..], &["decode", "--com", "--variant", "00"], &["frobnicate"], &[]]
    {
        assert_eq!(bcap(args).code, 2, "{args:?}");
    }
}

#[test]
fn frames_of_serial_lines_carry_a_crc() {
    let run = bcap(&["decode", "--com", "--json", "011200000001000100020000000000893a04"]);
    assert_eq!(run.out.trim_end(), r#"{"serial":1,"reserved":1,"code":2,"name":"ServiceStop","args":[]}"#);
    let back = bcap(&["decode", "--reverse", "--com", run.out.trim_end()]);
    assert_eq!(back.out, "011200000001000100020000000000893a04\n");
    let run = bcap(&["decode", "--com", "011200000001000100020000000000893b04"]);
    assert_eq!(run.code, 2);
    assert!(run.err.contains("CRC"), "{}", run.err);
}

#[test]
fn a_response_names_its_hresult() {
    let run = bcap(&["decode", "--as", "response", "--json", "0110000000030000000009008000000004"]);
    assert_eq!(run.code, 2, "17 bytes where the length says 16");
    let run = bcap(&["decode", "--as", "response", "--json", "01100000000300000000090080000004"]);
    assert_eq!(run.out.trim_end(), r#"{"serial":3,"reserved":0,"code":-2147481344,"name":"E_TIMEOUT","args":[]}"#);
    for line in [r#"{"serial":3,"code":2147485952}"#, r#"{"serial":3,"name":"E_TIMEOUT"}"#] {
        assert_eq!(bcap(&["decode", "--reverse", "--as", "response", line]).out, "01100000000300000000090080000004\n");
    }
    let unknown = bcap(&["decode", "--as", "response", "--json", "01100000000300000078563412000004"]);
    assert!(unknown.out.contains(r#""code":305419896,"name":null"#), "{}", unknown.out);
    assert_eq!(bcap(&["decode", "--reverse", "--as", "response", unknown.out.trim_end()]).code, 0);
}

#[test]
fn text_output_has_every_field_with_its_bytes() {
    let run = bcap(&["decode", "01 1e 00 00 00", "0400 0000 65000000", "0x0100", "0a0000000300010000000300000004"]);
    assert_eq!(run.code, 0);
    let expected = "\
offset  bytes                          field
     0  01                             SOH
     1  1e 00 00 00                    length 30
     5  04 00                          serial 4
     7  00 00                          reserved
     9  65 00 00 00                    function 101 Variable_GetValue
    13  01 00                          1 argument
    15  0a 00 00 00                    10 bytes of argument 1
    19  03 00 01 00 00 00 03 00 00 00  variable: I4(3)
    29  04                             EOT
";
    assert_eq!(run.out, expected);
    let run = bcap_with(&["decode", "-"], FRAME.as_bytes());
    assert_eq!(run.out, "#4 Variable_GetValue(variable: I4(3))\n");
    let run =
        bcap_with(&["decode", "--as", "response"], b"011e000000010000000000000001000a0000000300010000000200000004");
    assert_eq!(run.out, "#1 0x00000000 (S_OK): I4(2)\n");
}

#[test]
fn a_sequence_of_frames_is_decoded() {
    let two = format!("{FRAME}01100000000500000002000000000004");
    let run = bcap(&["decode", "--json", &two]);
    let codes: Vec<Value> =
        run.out.lines().map(|l| serde_json::from_str::<Value>(l).unwrap()["code"].clone()).collect();
    assert_eq!((codes, run.code), (vec![json!(101), json!(2)], 0));
    assert_eq!(bcap(&["decode", &two]).out.matches("SOH").count(), 2);
    // an error after the first frame has its offset in the whole input
    let run = bcap(&["decode", "--json", &format!("{FRAME}ff")]);
    assert_eq!((run.code, serde_json::from_str::<Value>(&run.out).unwrap()["offset"].clone()), (2, json!(30)));
    let run = bcap(&["decode", "--json", &two[..two.len() - 2]]);
    assert_eq!((run.code, serde_json::from_str::<Value>(&run.out).unwrap()["offset"].clone()), (2, json!(45)));
    // a line has exactly one frame
    assert_eq!(bcap_with(&["decode", "-"], two.as_bytes()).code, 2);
}

#[test]
fn lenient_decoding_accepts_trailing_bytes_and_unknown_types() {
    // a VT_I1 (16), which is not a type of b-CAP, and a byte after the last argument
    let hex = "011c00000001000000650000000100070000001000010000007fff04";
    assert_eq!(bcap(&["decode", hex]).code, 2);
    let run = bcap(&["decode", "--lenient", "--json", hex]);
    assert_eq!((run.code, run.out.contains(r#""args":[{"vt":16,"opaque":"010000007f"}]"#)), (0, true), "{run:?}");
    assert_eq!(bcap(&["decode", "--lenient", hex]).code, 0);
    let back = bcap(&["decode", "--reverse", run.out.trim_end()]);
    assert!(back.code == 2 && back.err.contains("opaque"), "{back:?}");
}

#[test]
fn the_completions_of_each_shell_call_the_command() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let run = bcap(&["generate", "completions", shell]);
        assert!(run.code == 0 && run.out.contains("bcap") && run.out.contains("COMPLETE"), "{shell}: {run:?}");
    }
}

#[test]
fn help_shows_examples_and_exit_codes() {
    let run = bcap(&["--help"]);
    assert!(run.code == 0 && run.out.contains("Exit codes"), "{run:?}");
    for command in ["decode", "generate", "proxy", "replay"] {
        let run = bcap(&[command, "--help"]);
        assert!(run.code == 0 && run.out.contains("Examples:\n  bcap "), "{run:?}");
    }
    assert_eq!(bcap(&["--version"]).out, format!("bcap {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn colour_obeys_the_environment() {
    let forced = common::command(&["decode", "zz"]).env("CLICOLOR_FORCE", "1").output().unwrap();
    assert!(forced.stderr.contains(&0x1b));
    let without = common::command(&["decode", "zz"]).env("CLICOLOR_FORCE", "1").env("NO_COLOR", "1").output().unwrap();
    assert!(!without.stderr.contains(&0x1b), "{}", String::from_utf8_lossy(&without.stderr));
}
