//! Ranges of variables, and several writes in one command.

use crate::common::bcap;
use crate::common::fake::{Fake, usual, value};
use crate::common::robot::Robot;
use bcap_core::bcap::FunctionId;
use bcap_core::rac::VariableKind;
use bcap_core::variant::Variant;

#[test]
fn get_reads_ranges_and_whole_kinds() {
    let robot = Robot::start();
    for index in 0..100 {
        robot.set(VariableKind::I, index, &Variant::I4(i32::try_from(index).unwrap() * 3));
    }
    robot.set(VariableKind::Io, 129, &Variant::Bool(true));
    let run = robot.run(&["get", "I1-I3", "IO128-130", "@MODE"]);
    let shown = "I1 = 3\nI2 = 6\nI3 = 9\nIO128 = false\nIO129 = true\nIO130 = false\n@MODE = 3\n";
    assert_eq!((run.out.as_str(), run.code), (shown, 0), "{run:?}");
    let run = robot.run(&["get", "I*"]);
    let all: String = (0..100).map(|n| format!("I{n} = {}\n", n * 3)).collect();
    assert_eq!((run.out, run.code), (all, 0));
    let run = robot.run(&["watch", "I1-I2", "--count", "1"]);
    assert_eq!(run.out.lines().count(), 2, "{run:?}");
    // an index that does not exist is refused, and the others are read
    let run = robot.run(&["get", "I98-I101"]);
    assert_eq!((run.out.as_str(), run.code), ("I98 = 294\nI99 = 297\n", 1));
    assert!(run.err.contains("2 of 4 were refused"), "{}", run.err);
    let run = bcap(&["rac", "--robot", &robot.served.rac.to_string(), "get", "I1-I2"]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 3\nI2 = 6\n", 0), "{run:?}");
}

#[test]
fn a_wrong_range_is_refused_before_connecting() {
    for (word, part) in [("I5-I1", "above the last"), ("I1-J3", "one kind")] {
        let run = bcap(&["get", word, "--robot", "tcp:127.0.0.1:1"]);
        assert!(run.code == 2 && run.err.contains(part), "{run:?}");
    }
    let run = bcap(&["rac", "--robot", "127.0.0.1:1", "get", "I*"]);
    assert!(run.code == 2 && run.err.contains("RAC does not tell"), "{run:?}");
}

#[test]
fn put_writes_several_variables() {
    let robot = Robot::start();
    let run = robot.run(&["put", "I1=5", "I2=-7", "V1=-1,2,3", "S1=a=b"]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 5\nI2 = -7\nV1 = -1,2,3\nS1 = a=b\n", 0), "{run:?}");
    // an option after the pairs is an option
    let run = bcap(&["put", "I3=9", "--robot", &robot.tcp]);
    assert_eq!((run.out.as_str(), run.code), ("I3 = 9\n", 0), "{run:?}");
    let run = robot.run(&["put", "S2", "x=y"]);
    assert_eq!((run.out.as_str(), robot.i(3)), ("S2 = x=y\n", 9), "{run:?}");
    let run = robot.run(&["put", "--typed", "I4=3,8", "D1=5,2.5"]);
    assert_eq!((run.out.as_str(), robot.i(4)), ("I4 = 8\nD1 = 2.5\n", 8), "{run:?}");
}

#[test]
fn put_writes_a_value_to_a_range() {
    let robot = Robot::start();
    let run = robot.run(&["put", "I1-I3", "7"]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 7\nI2 = 7\nI3 = 7\n", 0), "{run:?}");
    let run = robot.run(&["put", "I2-3=8", "F1=2.5"]);
    assert_eq!((run.out.as_str(), run.code), ("I2 = 8\nI3 = 8\nF1 = 2.5\n", 0), "{run:?}");
    let run = robot.run(&["put", "I*", "0"]);
    assert_eq!((run.out.lines().count(), run.code, robot.i(1)), (100, 0, 0), "{run:?}");
    // the whole range is checked before the first write
    let run = robot.run(&["put", "I98-I101", "1"]);
    assert_eq!((run.out.as_str(), run.code, robot.i(98)), ("", 1, 0), "{run:?}");
    let run = robot.run(&["put", "P1", "1", "2", "3"]);
    assert!(run.code == 2 && run.err.contains("write commas between the elements: P1 1,2,3"), "{run:?}");
}

#[test]
fn more_variables_than_a_session_may_open_go_in_groups() {
    let robot = Robot::start();
    // of each answer
    let limit = &["--attempt-timeout", "6s"][..];
    // a session has 1,000 objects
    let pairs = ["IO*=true", "I*=9", "F*=1.0", "D*=1.0", "S*=a", "V*=1,2,3"];
    let run = robot.run(&[&["put"], &pairs[..], limit].concat());
    assert_eq!((run.out.lines().count(), run.code, robot.i(99)), (1012, 0, 9), "{}", run.err);
    let kinds = pairs.map(|pair| pair.split_once('=').unwrap().0);
    let run = robot.run(&[&["watch", "--count", "1"], &kinds[..], limit].concat());
    assert_eq!((run.out.lines().count(), run.code), (1012, 0), "{}", run.err);
    let values = robot.run(&[&["get", "--json"], &kinds[..], limit].concat()).out.replace("\"v\":9", "\"v\":8");
    let run = robot.run_with(&[&["put", "--from", "-"], limit].concat(), &values);
    assert_eq!((run.out.lines().count(), run.code, robot.i(99)), (1012, 0, 8), "{}", run.err);
    // a wrong value of the last group is reported before the first write
    let run = robot.run(&["put", "IO*=false", "I*=7", "F*=1.0", "D*=1.0", "S*=a", "V*=1,2"]);
    assert_eq!((run.out.as_str(), run.code, robot.i(99)), ("", 2, 8), "{}", run.err);
}

#[test]
fn nothing_is_written_if_one_value_is_wrong() {
    let robot = Robot::start();
    for (words, part) in [
        (&["I1=5", "I2=2,7"][..], "I2: 2,7: this could be TYPE,DATA"),
        (&["I1=5", "I2=x"], "I2: x: "),
        (&["I1=5", "I100=1"], "I100"),
        (&["I1", "5", "I2", "7"], "write several variables as NAME=VALUE, such as I1=5 I2=7"),
        (&["I1=5", "7"], "7: write several"),
        (&["I1"], "the value is missing"),
    ] {
        let run = robot.run(&[&["put"], words].concat());
        assert!(run.code != 0 && run.err.contains(part) && run.out.is_empty(), "{words:?}: {run:?}");
    }
    assert_eq!(robot.i(1), 0);
}

#[test]
fn put_stops_at_the_first_refusal_and_says_how_many_are_written() {
    let robot = Robot::start();
    let run = robot.run(&["put", "I1=5", "@MODE=2", "I2=7"]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 5\n", 1), "{run:?}");
    assert!(run.err.contains("(1 of 3 are written)"), "{}", run.err);
    assert_eq!([robot.i(1), robot.i(2)], [5, 0]);
}

#[test]
fn what_get_prints_as_json_can_be_written_back() {
    let robot = Robot::start();
    robot.run(&["put", "I1=5", "P1=400,0,300.5,180,0,180,5", "S1=hello, 'world'", "IO200=true", "D1=-0.1"]);
    let saved = robot.run(&["get", "--json", "I0-I9", "P1", "S1", "IO200", "D1"]).out;
    let other = Robot::start();
    let run = other.run_with(&["put", "--from", "-"], &saved);
    assert_eq!((run.out.lines().count(), run.code), (14, 0), "{run:?}");
    assert_eq!(other.run(&["get", "--json", "I0-I9", "P1", "S1", "IO200", "D1"]).out, saved);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("values.jsonl");
    std::fs::write(&file, "{\"name\":\"I1\",\"vt\":3,\"v\":6}\n{\"name\":\"I2\",\"vt\":3,\"v\":1.5}\n").unwrap();
    let path = file.to_str().unwrap();
    let run = other.run(&["put", "--from", path]);
    assert!(run.code == 2 && run.err.contains(&format!("{path}, line 2: 1.5 is not an integer")), "{run:?}");
    assert_eq!(other.i(1), 5);
    let run = other.run(&["put", "--from", path, "I1"]);
    assert_eq!(run.code, 2, "{run:?}");
}

#[test]
fn a_controller_that_cannot_be_reached_does_not_empty_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("earlier.csv");
    std::fs::write(&file, "t,I1\n").unwrap();
    for option in ["--csv", "--mcap"] {
        // nothing listens there, and no other test will
        let run = bcap(&["watch", "I1", option, file.to_str().unwrap(), "--robot", "tcp:127.0.0.1:1"]);
        assert_eq!((run.code, std::fs::read_to_string(&file).unwrap().as_str()), (3, "t,I1\n"), "{run:?}");
    }
}

#[test]
fn watch_writes_a_table() {
    let robot = Robot::start();
    robot.run(&["put", "I1=5", "V1=1.5,-2,3", "S1=a, b"]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("table.csv");
    let path = file.to_str().unwrap();
    let run = robot.run(&["watch", "I1-I2", "V1", "S1", "--interval", "1ms", "--count", "3", "--csv", path]);
    assert_eq!((run.out.as_str(), run.code), ("", 0), "{run:?}");
    let text = std::fs::read_to_string(&file).unwrap();
    let rows: Vec<(&str, &str)> = text.lines().map(|row| row.split_once(',').unwrap()).collect();
    assert_eq!(rows[0], ("t", "I1,I2,V1.1,V1.2,V1.3,S1"));
    assert_eq!(rows.len(), 4);
    assert!(rows[1..].iter().all(|(_, row)| *row == "5,0,1.5,-2,3,\"a, b\""), "{text}");
    let times: Vec<f64> = rows[1..].iter().map(|(time, _)| time.parse().unwrap()).collect();
    assert!(times.is_sorted(), "{text}");
    // only the first round has a changed value
    let run = robot.run(&["watch", "I1", "--changes", "--interval", "1", "--count", "3", "--csv", "-"]);
    assert_eq!(run.out.lines().count(), 2, "{run:?}");
    let run = robot.run(&["watch", "I1", "--interval", "soon"]);
    assert!(run.code == 2 && run.err.contains("500ms"), "{run:?}");
}

#[test]
fn a_controller_cannot_claim_endless_variables() {
    for count in [i32::MAX, -1, 65_537] {
        let fake = Fake::tcp(move |request| match request.function() {
            FunctionId::VARIABLE_GET_VALUE => value(count),
            _ => usual(request),
        });
        let run = bcap(&["get", "I*", "--robot", &fake.address]);
        assert!(run.code == 3 && run.err.contains("not a number from 0 to 65536"), "{run:?}");
    }
}
