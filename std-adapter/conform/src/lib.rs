//! Conformance cases for b-CAP and RAC, the protocols of DENSO robot controllers.
//!
//! ```text
//!  cases    tables: requests, conditions, the section of the specification
//!  bench    runs one case on a separate connection, and undoes its changes
//!  reply    judges and words what came
//!  client   cases for clients
//!  report   results as text, JSON (serde) and JUnit
//! ```
//!
//! Most cases are of the specifications. The group `seen` has answers of real controllers that no specification describes: a
//! device that answers otherwise [differs](Verdict::Differs), and does not fail.
//!
//! [`run`] judges a device: a controller, a gateway, another implementation. No client logic is between a case and the
//! socket, so wrong frames can be sent, and nothing hides a wrong reply. Every wait has a time limit. [`ClientJudge`] is a
//! controller that judges its clients.
//!
//! # Examples
//!
//! ```no_run
//! use bcap_conform::{Link, Options, Target, Verdict, run};
//!
//! let target = Target { bcap: Some((Link::Tcp, "192.168.0.1:5007".parse()?)), rac: None };
//! let report = run(&Options::new(target), |result| println!("{}", result.text()), || false);
//! assert_eq!(report.count(Verdict::Fail), 0, "{:?}", report.failures().collect::<Vec<_>>());
//! # Ok::<(), std::net::AddrParseError>(())
//! ```

mod bench;
mod case;
mod cases;
mod client;
mod device;
mod edit;
mod language;
mod line;
mod reply;
mod report;
mod steps;
mod undo;

use std::cell::OnceCell;
use std::time::{Duration, Instant};

pub use bcap_testkit::wire::Link;
pub use case::{Case, Group, Level};
pub use client::{ClientJudge, client_cases};
pub use device::{Options, Target};
pub use report::{CaseResult, Report, Verdict};

use bcap_testkit::restart::Restarter;
use bcap_testkit::wire::Wire;
use bench::{Bench, REFUSAL_PAUSE, REFUSALS, Stop};
use language::Model;

/// Returns all cases for devices, by group.
#[must_use]
pub fn cases() -> &'static [Case] {
    cases::all()
}

/// Judges a device: runs the chosen cases sequentially, and passes each result to `each`.
///
/// Before each case it calls `ended`, which returns whether to end early; by then the arm is given back and variables are
/// restored. A case that moves an axis calls it before each motion, and is skipped if it returns true.
pub fn run(options: &Options, mut each: impl FnMut(&CaseResult), ended: impl Fn() -> bool) -> Report {
    let mut report = Report::default();
    // the next case restores values that this one could not restore
    let mut speed = None;
    let mut restarter = options.restart.as_deref().map(|command| Restarter::new(command, options.restarts));
    let model = OnceCell::new();
    for case in cases() {
        let name = case.name();
        let wanted = (options.groups.is_empty() || options.groups.contains(&case.group))
            && (options.cases.is_empty() || options.cases.contains(&name));
        if !wanted {
            continue;
        }
        if ended() {
            break;
        }
        let (mut result, mut unreachable) = judge(case, options, &model, &ended, &mut speed);
        // a device without RAC has not stopped
        let is_tried = |result: &CaseResult| result.group == Some(Group::Rac) && result.verdict != Verdict::Skip;
        if unreachable && (case.group != Group::Rac || report.results.iter().any(is_tried)) {
            // not a failure of this case: the device may have crashed in an earlier case
            let earlier = report.results.iter().rfind(|result| result.verdict != Verdict::Skip);
            report.crashes.extend(earlier.map(|result| result.name.clone()));
            if report.crashes.is_empty() || !returns(case, options, restarter.as_mut(), &ended) {
                report.unreachable = true;
                break;
            }
            (result, unreachable) = judge(case, options, &model, &ended, &mut speed);
            if unreachable {
                report.unreachable = true;
                break;
            }
        }
        each(&result);
        report.results.push(result);
    }
    report
}

/// Starts the device again if there is a command, and waits until a case reaches it; `false` if it stays unreachable, or the
/// command may not run any more.
fn returns(case: &Case, options: &Options, restarter: Option<&mut Restarter>, ended: &dyn Fn() -> bool) -> bool {
    if restarter.is_some_and(|restarter| !restarter.run().unwrap_or(false)) {
        return false;
    }
    let reaches = || match (case.group, options.target.rac, options.target.bcap) {
        (Group::Rac, Some(address), _) => Wire::connect_rac(address, options.timeout).is_ok(),
        (_, _, Some((Link::Udp, _))) => Bench::answers(options, Link::Udp),
        (_, _, Some((link, address))) => Wire::connect(link, address, options.timeout).is_ok(),
        (_, _, None) => false,
    };
    let until = Instant::now() + options.wait;
    while !ended() {
        if reaches() {
            return true;
        }
        if Instant::now() >= until {
            return false;
        }
        std::thread::sleep(RESTART_PAUSE);
    }
    false
}

/// The time between two attempts to reach a device that restarts.
const RESTART_PAUSE: Duration = Duration::from_millis(200);

/// Returns why a case does not apply.
fn inapplicable(case: &Case, options: &Options) -> Option<String> {
    if case.level > options.level {
        return Some(format!("needs --level {}", format!("{:?}", case.level).to_lowercase()));
    }
    if case.group == Group::Rac {
        return options.target.rac.is_none().then(|| "the address of RAC is not given".into());
    }
    match (options.target.bcap, case.only) {
        (None, _) => Some("the address of b-CAP is not given".into()),
        // the cases of copied calls over UDP also apply to a serial line
        (Some((Link::Serial, _)), Some(Link::Udp)) if case.group == Group::Udp => None,
        (Some((link, _)), Some(only)) if link != only => Some(match only {
            Link::Tcp => "a case of TCP".into(),
            Link::Udp => "a case of UDP".into(),
            Link::Serial => "a case of a serial line".into(),
        }),
        _ => None,
    }
}

/// Returns whether a case may run again because the device had no slot for it: it only reads, and no reply has arrived.
fn may_run_again(case: &Case, bench: &Bench<'_>) -> bool {
    case.level == Level::Read && bench.refused && !bench.has_reply && bench.repeats < REFUSALS
}

/// Returns the reason if a case with answers of other models does not apply.
fn of_another_model(case: &Case, device: Option<Model>) -> Option<String> {
    let Some(device) = device else { return Some("the type of the robot is not known".into()) };
    let models = case.models.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    (!case.models.contains(&device)).then(|| format!("seen on {models}; the device is an {device}"))
}

/// Runs a case; also returns whether the device did not accept its connection, or over UDP does not answer.
fn judge<'a>(
    case: &Case,
    options: &'a Options,
    model: &OnceCell<Option<Model>>,
    ended: &'a dyn Fn() -> bool,
    speed: &mut Option<[f64; 3]>,
) -> (CaseResult, bool) {
    let began = Instant::now();
    let link = options.target.bcap.map_or(Link::Tcp, |(link, _)| link);
    let new_bench = |speed| {
        let mut bench = Bench::new(options, link);
        (bench.speed, bench.is_interrupted) = (speed, Some(ended));
        bench
    };
    let mut bench = new_bench(*speed);
    let model = || *model.get_or_init(|| Bench::new(options, link).model());
    let inapplicable = inapplicable(case, options)
        .or_else(|| (case.group == Group::Seen).then(|| of_another_model(case, model())).flatten());
    let mut outcome = match inapplicable {
        Some(reason) => Err(Stop::Skip(reason)),
        None if case.group != Group::Rac && !Bench::answers(options, link) => {
            bench.unreachable = true;
            bench::fail("the device answers Service_Start", "nothing")
        }
        None => bench.run(case),
    };
    while matches!(outcome, Err(Stop::Fail { .. })) && may_run_again(case, &bench) {
        std::thread::sleep(REFUSAL_PAUSE);
        let mut again = new_bench(bench.speed);
        again.repeats = bench.repeats + 1;
        let repeated = again.run(case);
        if again.unreachable {
            // this case may have crashed the device
            break;
        }
        (bench, outcome) = (again, repeated);
    }
    *speed = bench.speed;
    let (verdict, reason, expected, came) = match outcome {
        Ok(()) => (Verdict::Pass, None, None, None),
        Err(Stop::Skip(reason)) => (Verdict::Skip, Some(reason), None, None),
        Err(Stop::Fail { expected, came }) => {
            let verdict = if case.group == Group::Seen { Verdict::Differs } else { Verdict::Fail };
            (verdict, None, Some(expected), Some(came))
        }
    };
    let result = CaseResult {
        name: case.name(),
        group: Some(case.group),
        level: Some(case.level),
        source: case.source,
        rule: case.rule,
        seen_on: (case.group == Group::Seen).then(model).flatten().map(|model| model.to_string()),
        verdict,
        reason,
        expected,
        came,
        exchange: std::mem::take(&mut bench.log),
        milliseconds: u64::try_from(began.elapsed().as_millis()).unwrap_or(u64::MAX),
    };
    // a case of RAC that cannot use b-CAP is skipped
    let is_lost = if case.group == Group::Rac { bench.has_no_line } else { bench.unreachable };
    let unreachable = is_lost && result.verdict != Verdict::Pass;
    (result, unreachable)
}

/// The examples of the crate's page.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
