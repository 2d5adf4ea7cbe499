//! Servers on free ports of this machine.

pub(crate) mod relay;

use bcap_conform::{Level, Link, Options, Report, Target, Verdict, run};
use bcap_sim::{Config, Controller, Profile};
use bcap_std::blocking;
use bcap_std::server::Limits;
use bcap_tests::served::Served;

/// Serves a virtual RC8 whose external speed is `ext_speed` percent.
pub(crate) fn rc8(ext_speed: f32) -> Served<Controller> {
    Served::of(Controller::new(Config { ext_speed, ..Config::new(Profile::Rc8) }), Limits::default())
}

pub(crate) fn options<H>(served: &Served<H>, link: Link, level: Level) -> Options {
    let address = if link == Link::Tcp { served.tcp } else { served.udp };
    let target = Target { bcap: Some((link, address)), rac: Some(served.rac) };
    Options { level, ..Options::new(target) }
}

/// Returns the external speed, whether the motor is on, and the joints.
pub(crate) fn state(served: &Served<Controller>) -> (f64, bool, Vec<f64>) {
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", served.tcp), &bcap_std::Settings::rc8()).unwrap();
    let mut robot = cell.robot().unwrap();
    let state = (
        robot.execute("CurExtSpd", ()).unwrap(),
        robot.read("@SERVO_ON").unwrap(),
        robot.execute("CurJnt", ()).unwrap(),
    );
    cell.close().unwrap();
    state
}

/// Asserts that speed and motor are unchanged, and the joints nearly so.
pub(crate) fn assert_restored(before: &(f64, bool, Vec<f64>), served: &Served<Controller>, text: &str) {
    let after = state(served);
    assert_eq!((after.0, after.1), (before.0, before.1), "{text}");
    let has_moved = before.2.iter().zip(&after.2).any(|(before, after)| (before - after).abs() > 0.001);
    assert!(!has_moved, "{before:?} {after:?}");
}

/// The provider of a model.
pub(crate) fn provider(profile: Profile) -> String {
    match profile {
        Profile::Rc9 | Profile::CobottaPro => "CaoProv.DENSO.VRC9".into(),
        _ => "CaoProv.DENSO.VRC".into(),
    }
}

/// Runs the cases, and prints the failures and the skips.
pub(crate) fn report(options: &Options) -> Report {
    let report = run(
        options,
        |result| {
            if result.verdict != Verdict::Pass {
                println!("{}", result.text())
            }
        },
        || false,
    );
    let mut slow: Vec<_> = report.results.iter().map(|result| (result.milliseconds, &result.name)).collect();
    slow.sort();
    println!("{}; slowest: {:?}", report.summary(), &slow[slow.len().saturating_sub(12)..]);
    report
}
