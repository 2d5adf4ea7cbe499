//! `bcap --robot serial:PATH` against a virtual controller at the other end of a pair of pseudo-terminals.
#![cfg(unix)]

mod common;

use bcap_sim::{Config, Controller, Profile};
use bcap_tests::pty::Line;
use common::bcap;

#[test]
fn variables_are_written_and_read_over_a_serial_line() {
    let Some(line) = Line::to(Controller::new(Config::new(Profile::Rc8)), 1, 0) else { return };
    let robot = line.address();
    let [put, get, doctor] = [["put", "I1", "42"].as_slice(), &["get", "I1"], &["doctor"]]
        .map(|command| bcap(&[command, &["--robot", &robot]].concat()));
    assert_eq!((put.code, get.code), (0, 0), "{put:?} {get:?}");
    assert!(get.out.contains("42"), "{get:?}");
    assert!(doctor.code != 0 && doctor.err.contains("serial lines are not supported by this command"), "{doctor:?}");
}

#[test]
fn a_device_that_does_not_exist_is_named_with_a_hint() {
    let run = bcap(&["get", "I1", "--robot", "serial:/dev/no-such-line"]);
    assert!(run.err.contains("cannot open serial:/dev/no-such-line?baud=115200: No such file"), "{run:?}");
    assert!(run.err.contains("check the name and the permissions of the device"), "{run:?}");
}
