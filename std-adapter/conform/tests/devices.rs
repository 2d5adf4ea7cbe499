//! Correct devices pass: the virtual controllers over TCP and UDP, and the server of a small device.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use crate::common::{assert_restored, options, provider, rc8, report, state};
use bcap_conform::{Group, Level, Link, Options, Report, Target, Verdict, cases};
use bcap_core::device::{Device, DeviceVariable, assign};
use bcap_sim::{Config, Controller, Profile, Scenario};
use bcap_std::server::Limits;
use bcap_tests::serial::SerialServer;
use bcap_tests::served::Served;

/// Runs all cases against a virtual controller: none fails or differs, and only cases of other links, of other models and of
/// `absent` are skipped.
fn passes(profile: Profile, link: Link, absent: &[&str]) {
    // an RC8A takes more than a second
    let config = Config { motor_on_delay: Duration::from_millis(50), ..Config::new(profile) };
    let served = Served::of(Controller::new(config), Limits::default());
    let mut options = options(&served, link, Level::Motion);
    options.provider = provider(profile);
    let report = report(&options);
    assert_eq!(report.failures().collect::<Vec<_>>(), [""; 0]);
    assert_eq!(report.count(Verdict::Differs), 0);
    assert!(report.results.iter().any(|result| result.seen_on.is_some() && result.verdict == Verdict::Pass));
    let reasons = report.results.iter().filter_map(|result| Some((result.name.as_str(), result.reason.as_deref()?)));
    let skipped = reasons
        .filter(|(_, reason)| !reason.starts_with("a case of ") && !reason.starts_with("seen on "))
        .map(|(name, _)| name);
    assert_eq!(skipped.collect::<Vec<_>>(), absent);
}

#[test]
fn the_virtual_controllers_pass_over_tcp_and_udp() {
    let all = [
        (Profile::Rc8, Link::Tcp, &[][..]),
        (Profile::Rc8, Link::Udp, &[]),
        (Profile::Rc8a, Link::Tcp, &[]),
        (Profile::Rc9, Link::Tcp, &[]),
        (Profile::Rc9, Link::Udp, &[]),
        (Profile::Cobotta, Link::Tcp, &["slave/receive-hand-io"]),
        (Profile::Cobotta, Link::Udp, &["slave/receive-hand-io"]),
        (Profile::CobottaPro, Link::Tcp, &[]),
    ];
    // each waits most of the time
    thread::scope(|scope| {
        for (profile, link, absent) in all {
            let name = format!("{profile:?} over {link:?}");
            thread::Builder::new().name(name).spawn_scoped(scope, move || passes(profile, link, absent)).unwrap();
        }
    });
}

/// Each observed answer names its observations, which the tests of the virtual controller replay.
#[test]
fn answers_that_were_seen_name_their_observations() {
    let observations = include_str!("../../sim/tests/provider/observations.toml");
    for case in cases().iter().filter(|case| case.group() == Group::Seen) {
        let (_, names) = case.source().rsplit_once("; ").unwrap_or_else(|| panic!("{}", case.name()));
        for name in names.split(' ') {
            let (_, observation) = observations.split_once(&format!("[{name}]\n")).unwrap_or_else(|| panic!("{name}"));
            let observation = observation.split("\n\n").next().unwrap();
            assert!(observation.contains("\nplay = ") && !observation.contains("\ndiffers = "), "{name}");
        }
    }
}

/// A controller that answers otherwise than its model differs from the observations, and does not fail.
#[test]
fn a_controller_that_answers_otherwise_differs() {
    let fault = "[[fault]]\nwhen = { call = 1, of = 'CurFig' }\nthen = { refuse = '0x80004005' }";
    let mut controller = Controller::new(Config::new(Profile::Cobotta));
    controller.play(Scenario::parse(fault).unwrap());
    let served = Served::of(controller, Limits::default());
    let mut options = options(&served, Link::Tcp, Level::Read);
    options.groups = vec![Group::Seen];
    let report = report(&options);
    let differing: Vec<_> = report.results.iter().filter(|result| result.verdict == Verdict::Differs).collect();
    let [result] = differing[..] else { panic!("{differing:?}") };
    let text = result.text();
    assert!(
        text.starts_with("DIFF seen/figure: differs from what was seen on COBOTTA (haraisao/cobotta_client; P077)"),
        "{text}"
    );
    assert_eq!(report.failures().count(), 0);
    let summary = report.summary();
    assert!(
        summary.starts_with("0 cases: 0 passed, 0 failed, 0 skipped; ") && summary.ends_with("1 different"),
        "{summary}"
    );
    assert!(report.junit().contains("failures=\"0\""), "{}", report.junit());
}

#[test]
fn the_rc8_passes_over_a_serial_line() {
    let controller = Controller::new(Config::new(Profile::Rc8));
    let line = SerialServer::start(Arc::new(Mutex::new(controller)));
    let target = Target { bcap: Some((Link::Serial, line.address)), rac: None };
    let report = report(&Options { level: Level::Write, quiet: Duration::from_millis(100), ..Options::new(target) });
    assert_eq!(report.failures().collect::<Vec<_>>(), [""; 0], "{:?}", report.results);
    let passed = |group: &str| {
        let names = report.results.iter().filter(|result| result.verdict == Verdict::Pass);
        names.filter(|result| result.name.starts_with(group)).count()
    };
    let passed = ["udp/", "types/", "seen/", ""].map(passed);
    assert_eq!((passed, report.count(Verdict::Differs)), ([17, 28, 5, 552], 0), "{}", report.summary());
}

#[test]
fn a_motion_leaves_the_robot_as_it_was() {
    let served = rc8(40.0);
    let mut options = options(&served, Link::Tcp, Level::Motion);
    options.cases = vec!["timeouts/keep-alives-of-a-motion".into(), "slave/enter-2-j".into()];
    let before = state(&served);
    assert_eq!(report(&options).count(Verdict::Pass), 2);
    assert_eq!((before.0, before.1), (40.0, false));
    assert_restored(&before, &served, "");
}

#[derive(Default)]
struct Conveyor {
    parts: i32,
    speed: f32,
}

fn conveyor() -> Device<Conveyor, 2> {
    let parts = DeviceVariable::new("I1", |conveyor: &Conveyor, reply| reply.set(&conveyor.parts));
    let speed = DeviceVariable::new("F1", |conveyor: &Conveyor, reply| reply.set(&conveyor.speed));
    Device::new(Conveyor::default(), [parts, speed.writable(|conveyor, value| assign(&mut conveyor.speed, value))])
}

/// Returns the groups in which at least one case passed.
fn passed_groups(report: &Report) -> BTreeSet<Group> {
    let passed = report.results.iter().filter(|result| result.verdict == Verdict::Pass);
    passed.filter_map(|result| result.group).collect()
}

#[test]
fn the_server_of_a_device_passes_what_it_has() {
    for link in [Link::Tcp, Link::Udp] {
        let served = Served::of(conveyor(), Limits::default());
        let mut options = options(&served, link, Level::Motion);
        // F1 may be written
        options.scratch = 1;
        let report = report(&options);
        assert_eq!(report.failures().collect::<Vec<_>>(), [""; 0]);
        let passed = passed_groups(&report);
        for group in [
            Group::Frames,
            Group::Arguments,
            Group::Types,
            Group::Sessions,
            Group::Timeouts,
            Group::Handles,
            Group::Rac,
        ] {
            assert!(passed.contains(&group), "{group}");
        }
        let written = ["types/r4-tenth", "variables/write-f", "rac/put-f"];
        for name in written {
            let result = report.results.iter().find(|result| result.name == name).unwrap();
            assert_eq!(result.verdict, Verdict::Pass, "{}", result.text());
        }
    }
}

#[test]
fn case_names_differ() {
    let mut names: Vec<_> = cases().iter().map(|case| case.name()).collect();
    let count = names.len();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), count);
}
