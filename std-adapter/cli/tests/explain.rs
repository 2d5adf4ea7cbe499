//! `bcap explain`: codes by name and by number, and the page of the book with all codes.

use crate::common::bcap;
use serde_json::Value;

#[test]
fn a_code_is_explained_by_its_name_and_by_each_way_to_write_its_number() {
    let expected = "\
0x83500121 (E_SLVMODE_OFF), decimal -2091908831, a failure
  meaning      slvMove was sent while slave mode was not selected.
  level        3 of 0 to 5: motions stop and the motor goes off, unless the error only refuses a call
  part         controller software
  cause        Slave Mode was never selected, or an error or another command ended it.
  what to do   read with GetCurErrorInfo which error ended Slave Mode, ClearError, turn the motor on, then slvChangeMode again
  returned by  Robot_Execute slvMove
  source       named by an older client of the vendor
";
    for code in ["E_SLVMODE_OFF", "e_slvmode_off", "0x83500121", "83500121", "-2091908831", "2203058465"] {
        let run = bcap(&["explain", code]);
        assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (expected, "", 0), "{code}");
    }
}

#[test]
fn codes_without_a_name_have_the_facts_of_their_range() {
    let run = bcap(&["explain", "84204043", "80910068", "0x800B0000"]);
    assert!(run.out.contains("over its limit.\n  axis         3\n  level        4 of 0 to 5: "), "{}", run.out);
    assert!(run.out.contains("\n  system       error 104 of the operating system"), "{}", run.out);
    assert!(
        run.out.contains("0x800b0000, decimal -2146762752, a failure\n  no source gives its meaning"),
        "{}",
        run.out
    );
    let run = bcap(&["explain", "--json", "84204043"]);
    let line: Value = serde_json::from_str(&run.out).unwrap();
    assert_eq!((&line["hex"], &line["axis"], &line["level"]), (&"0x84204043".into(), &3.into(), &4.into()));
    assert_eq!((&line["name"], &line["cause"]), (&Value::Null, &Value::Null));
}

#[test]
fn an_error_with_the_reserved_bit_is_the_same_error() {
    let facts = |code: &str| {
        let out = bcap(&["explain", code]).out;
        out.lines()
            .filter(|line| line.starts_with("  ") && !line.contains("same as"))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    let expected = facts("0x84201486");
    assert!(expected.len() > 5);
    for code in ["0xC4201486", "c4201486", "-1004530554", "3290436742"] {
        assert_eq!(facts(code), expected, "{code}");
    }
    assert!(
        bcap(&["explain", "0xC4201486"]).out.contains("\n  same as      0x84201486 (E_COMMAND_POSITION_GEN_STOPPED)")
    );
    let line: Value = serde_json::from_str(&bcap(&["explain", "--json", "0xC4201486"]).out).unwrap();
    assert_eq!((&line["same_as"], &line["level"]), (&"0x84201486".into(), &4.into()));
}

#[test]
fn what_is_no_code_is_refused_with_similar_names() {
    let run = bcap(&["explain", "token"]);
    assert_eq!((run.out.as_str(), run.code), ("", 2));
    assert!(run.err.contains("names with this text: E_TOKEN_NOT_ETHERNET, E_TOKEN_ADDRESS"), "{}", run.err);
    assert_eq!(bcap(&["explain"]).code, 2);
    assert_eq!(bcap(&["explain", "0x123456789"]).code, 2);
}

#[test]
fn an_unknown_code_names_the_command_that_asks_the_controller() {
    let out = bcap(&["explain", "0x92345678"]).out;
    let (_, command) = out.split_once("ask the controller: bcap ").unwrap();
    let robot = crate::common::virtual_robot::Virtual::start(&[]);
    let run = robot.run(&command.split_whitespace().collect::<Vec<_>>());
    assert_eq!((run.code, run.out.is_empty()), (0, false), "{run:?}");
}
