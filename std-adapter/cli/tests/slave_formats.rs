//! `bcap slave` with IO, receive formats, extended joints and a start from a variable, against a virtual controller in the
//! test.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::common::{Run, bcap};
use bcap_core::variant::{Variant, VariantBuf};
use bcap_sim::{Config, Controller, Profile, VariableKind};
use bcap_std::server::Limits;
use bcap_tests::real_time::repeated;
use bcap_tests::served::Served;
use bcap_tests::slowed::Slowed;

/// A controller with a slow clock, and two extended joints.
fn controller() -> Served<Slowed> {
    let motor_on_delay = Duration::from_millis(1);
    let config = Config { motor_on_delay, extended_axes: 2, ..Config::new(Profile::Rc8) };
    Served::of(Slowed(Controller::new(config)), Limits::default())
}

fn run(sim: &Served<Slowed>, args: &[&str]) -> Run {
    bcap(&[args, &["--robot", &format!("tcp:{}", sim.tcp)]].concat())
}

#[track_caller]
fn slave(sim: &Served<Slowed>, args: &[&str]) {
    let run = run(sim, &[&["slave"], args, &["--yes"]].concat());
    assert_eq!((run.code, run.err.as_str()), (0, ""), "{run:?}");
}

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn file(name: &str, text: &str) -> String {
    let path = path(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Returns the IO that are on.
fn on(sim: &Served<Slowed>, range: std::ops::Range<u32>) -> Vec<u32> {
    let is_on = |index: &u32| {
        let value: VariantBuf<64> = sim.application().0.variable(VariableKind::Io, *index).unwrap();
        value.as_variant() == Variant::Bool(true)
    };
    range.filter(is_on).collect()
}

#[test]
fn outputs_of_the_command_line_are_set_by_slv_move() {
    repeated(|| {
        let sim = controller();
        let cosine = ["cosine", "--seconds", "0.2", "--amplitude", "1"];
        let more = ["--send-format", "mini,hand", "--mini-io", "0x50000", "--hand-io", "0x30000"];
        slave(&sim, &[&cosine[..], &more].concat());
        // bit 0 of MiniIO is IO0, bit 0 of HandIO is IO48
        assert_eq!((on(&sim, 16..32), on(&sim, 64..72)), (vec![16, 18], vec![64, 65]));
        let more = ["--send-format", "user:136:2", "--user-io", "0x8001"];
        slave(&sim, &[&cosine[..], &more].concat());
        assert_eq!(on(&sim, 128..160), [136, 151]);
    });
}

#[test]
fn outputs_of_a_file_change_along_the_path_and_are_in_the_replies() {
    repeated(|| {
        let sim = controller();
        let received = path("received.csv");
        let mut text = "J1,J2,J3,J4,J5,J6,MINI,HAND\n".to_owned();
        for line in 0..30 {
            text += &format!("0,45,90,0,45,0,{},0\n", if (10..20).contains(&line) { "0x10000" } else { "0" });
        }
        let poses = file("outputs.csv", &text);
        let formats = ["--send-format", "mini,hand", "--recv-format", "PJ,time-us,mini,hand,current"];
        slave(&sim, &[&["play", &poses, "--received", received.to_str().unwrap()], &formats[..]].concat());
        assert!(on(&sim, 16..32).is_empty());
        let mut reader = csv::Reader::from_path(&received).unwrap();
        let header: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
        let expected = "t TIME_us X Y Z RX RY RZ FIG J1 J2 J3 J4 J5 J6 J7 J8 MINI HAND CURRENT1 CURRENT2 CURRENT3 CURRENT4 CURRENT5 \
                        CURRENT6 CURRENT7 CURRENT8";
        assert_eq!(header.join(" "), expected);
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert!(rows.len() >= 30, "{}", rows.len());
        let mini: Vec<&str> = rows.iter().map(|row| &row[17]).collect();
        let changes: Vec<&&str> = mini
            .iter()
            .enumerate()
            .filter(|(n, bits)| *n == 0 || mini[n - 1] != **bits)
            .map(|(_, bits)| bits)
            .collect();
        assert_eq!(changes, [&"0x0", &"0x10000", &"0x0"]);
        let times: Vec<i64> = rows.iter().map(|row| row[1].parse().unwrap()).collect();
        assert!(times.windows(2).all(|pair| pair[0] <= pair[1]) && times[0] < times[times.len() - 1], "{times:?}");
        assert_eq!((&rows[0][10], &rows[0][11]), ("45", "90"));
    });
}

#[test]
fn user_io_is_sent_and_received() {
    repeated(|| {
        let sim = controller();
        let received = path("received-user.csv");
        let formats = ["--send-format", "user:128:1", "--user-io", "5", "--recv-format", "J,user:128:2"];
        let cosine = ["cosine", "--seconds", "0.2", "--amplitude", "1", "--received", received.to_str().unwrap()];
        slave(&sim, &[&cosine[..], &formats].concat());
        assert_eq!(on(&sim, 128..160), [128, 130]);
        let text = fs::read_to_string(received).unwrap();
        assert!(text.lines().last().unwrap().ends_with(",0x5"), "{text}");
    });
}

#[test]
fn extended_joints_follow_the_file() {
    repeated(|| {
        let sim = controller();
        let mut text = "J1,J2,J3,J4,J5,J6,J7,J8\n".to_owned();
        for line in 0..=20 {
            text += &format!("0,45,90,0,45,0,{0},{0}\n", f64::from(line) * 0.01);
        }
        let poses = file("extended.csv", &text);
        let [seven, eight] = [6, 7];
        let joints = |sim: &Served<Slowed>| {
            let last = sim.application().0.slave_record().last().unwrap();
            [seven, eight].map(|axis: usize| last.axes[axis])
        };
        slave(&sim, &["play", &poses, "--extended", "7"]);
        let at = joints(&sim);
        assert!((at[0] - 0.2).abs() < 1e-9 && at[1].abs() < 1e-9, "{at:?}");
        // a cosine holds them
        slave(&sim, &["cosine", "--seconds", "0.2", "--amplitude", "1", "--extended", "7,8"]);
        let at = joints(&sim);
        assert!((at[0] - 0.2).abs() < 1e-9 && at[1].abs() < 1e-9, "{at:?}");
    });
}

/// The sample program of the specification: mode 0, one period of a cosine from J1.
#[test]
fn a_stream_starts_from_a_variable() {
    repeated(|| {
        let sim = controller();
        assert_eq!(run(&sim, &["put", "J1", "5,45,90,0,45,0,0,0"]).code, 0);
        slave(
            &sim,
            &["cosine", "--from", "J1", "--mode", "0", "--seconds", "0.4", "--amplitude", "2", "--speed", "50"],
        );
        let joints = sim.application().0.joints();
        let record: Vec<_> = sim.application().0.slave_record().collect();
        assert!((joints[0] - 5.0).abs() < 1e-6, "{joints:?}");
        let highest = record.iter().map(|cycle| cycle.axes[0]).fold(f64::MIN, f64::max);
        assert!((highest - 7.0).abs() < 1e-3, "{highest}");
        let controller = &sim.application().0;
        assert_eq!((controller.slave_mode(), controller.arm_owner(), controller.errors().count()), (0, None, 0));
    });
}

#[test]
fn nothing_moves_with_formats_that_do_not_fit() {
    let sim = controller();
    let hand = file("hand.csv", "J1,HAND\n0,1\n1,0x100000000\n");
    for (args, part) in [
        (&["cosine", "--plot", "x.svg", "--recv-format", "P"][..], "--plot needs the type of the stream"),
        (&["cosine", "--send-format", "mini,user:128:1"], "exclude each other"),
        (&["cosine", "--recv-format", "user:129:1"], "cannot begin at port 129"),
        (&["cosine", "--mini-io", "0"], "--mini-io: slvMove does not carry it; add mini to --send-format"),
        (&["cosine", "--send-format", "mini", "--user-io", "1"], "--user-io: slvMove does not carry it"),
        (
            &["cosine", "--send-format", "user:128:1", "--user-io", "0x100"],
            "--user-io: 0x100 does not fit the 8 bits of user:PORT:BYTES in --send-format",
        ),
        (&["play", &hand], "column HAND: slvMove does not carry it; add hand to --send-format"),
        (&["play", &hand, "--send-format", "hand"], "column HAND: 0x100000000 does not fit the 32 bits of hand"),
        (&["cosine", "--speed", "20"], "--from"),
    ] {
        let run = run(&sim, &[&["slave"], args].concat());
        assert!(run.code == 2 && run.err.contains(part), "{args:?}: {run:?}");
    }
    let refused = run(&sim, &["slave", "cosine", "--from", "J999999", "--yes"]);
    assert!(refused.code != 0 && !refused.err.is_empty(), "{refused:?}");
    assert_eq!(sim.application().0.slave_record().count(), 0);
}
