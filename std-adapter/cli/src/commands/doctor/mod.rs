//! `bcap doctor`: checks what a program needs before it can move a robot, and says how to fix each failure.
//!
//! ```text
//!   tcp ─┬─ provider ─ version ─ permission ─ mode ─ token ─ errors ─ emergency stop ─ arm ─ motor ─ licence ─ formats
//!   udp ─┘
//! ```
//!
//! A check that depends on a failed one is skipped, so only causes are reported as failures. A check with an inconclusive
//! answer is untested, which is not a success.
//!
//! While a client streams in Slave Mode, the checks after the version are skipped: SysState, GetCurErrorCount and TakeArm would
//! end the stream. The command calls slvGetMode before each of them; a stream that begins in between can still be ended.
//!
//! Nothing moves and no variable is written. TakeArm is the only way to check that the arm is free, so the arm is taken and
//! immediately released (Keep 1, so that speeds, tool and work coordinates stay). slvChangeMode checks the licence; without the
//! arm it cannot enter Slave Mode. The formats are set for this session only, and only while no client is in Slave Mode.
//!
//! A refusal is an error of the controller, which refuses calls of other clients until it is cleared. So the refusals of
//! TakeArm and slvChangeMode are cleared immediately, but only if the controller had no error before, and has no other error
//! now.

mod report;
pub(crate) mod scan;
pub(crate) mod status;

use std::time::{Duration, Instant};

use bcap_core::bcap::{FunctionId, StreamState};
use bcap_core::hresult::HResult;
use bcap_core::procedure::SysState;
use bcap_core::variant::{Encode, OwnedVariant as Value};
use bcap_std::{Examination, ObjectPath, Protocol};
use clap::Args;

use self::report::{Finding, Report};
use crate::commands::robot::errors::{described, present};
use crate::failure::{Failure, hint_of, with_finding};
use crate::link::LinkArgs;
use crate::session::Session;
use crate::session::budget::Budget;
use crate::session::variables::{get_one, short_type, shown};
use bcap_live::stream::StreamCheck;

/// Checks what a program needs before it can move the robot, and says how to fix each failure
///
/// Checks reachability over TCP and UDP, provider, version, mode, executable token, errors, emergency stop, arm, motor,
/// and the licence and formats of Slave Mode. Each result is ok, FAILED, ? (the controller's answer is inconclusive)
/// or - (skipped, because another check failed). With --json a line is
/// {"check":"mode","result":"failed","detail":"..","hint":".."}, with the results passed, failed, untested and skipped.
/// The first FAILED or ? result determines the exit code. The command moves nothing and writes nothing; it takes the
/// arm for a moment if the arm is free.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap doctor --robot tcp:192.168.0.1
  bcap doctor --robot tcp:192.168.0.1 --provider CaoProv.DENSO.VRC9 --json")]
pub(crate) struct Doctor {
    /// The port of b-CAP over TCP [default: the port of --robot]
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) tcp_port: Option<u16>,

    /// The port of b-CAP over UDP [default: the port of --robot]
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) udp_port: Option<u16>,
}

const PROVIDERS: [&str; 2] = ["CaoProv.DENSO.VRC", "CaoProv.DENSO.VRC9"];
/// The time limit of Service_Start over UDP, where a port without a server does not answer.
const UDP_TIMEOUT: Duration = Duration::from_secs(2);

/// The checks after the links, in this order.
const CHECKS: [&str; 11] = [
    "provider",
    "version",
    "permission",
    "mode",
    "token",
    "errors",
    "emergency stop",
    "arm",
    "motor",
    "licence",
    "formats",
];

/// Runs `bcap doctor`.
pub(crate) fn doctor(args: &Doctor, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let mut report = Report::new(json);
    let done = checked(args, link, &mut report);
    with_finding(done, report.end())
}

/// Makes all checks.
fn checked(args: &Doctor, link: &LinkArgs, report: &mut Report) -> Result<(), Failure> {
    let tcp = reach(report, Protocol::Tcp, args, link)?;
    let udp = reach(report, Protocol::Udp, args, link)?;
    let (session, other) = if tcp.is_some() { (tcp, udp) } else { (udp, None) };
    drop(other);
    let Some(mut session) = session else {
        return CHECKS.into_iter().try_for_each(|check| report.note(check, Finding::skipped("there is no connection")));
    };
    session.set_budget(Budget::start(link));
    examine(&mut session, link, report)
}

/// Returns the arguments of a connection over a protocol.
fn over(protocol: Protocol, args: &Doctor, link: &LinkArgs) -> Result<LinkArgs, Failure> {
    let mut target = link.network_target()?;
    target.protocol = protocol;
    let port = match protocol {
        Protocol::Tcp => args.tcp_port,
        Protocol::Udp => args.udp_port,
    };
    target.port = port.unwrap_or(target.port);
    // the checks try each provider
    Ok(link.at(&target.to_string()).with_provider(link.provider()))
}

/// Starts a session over a protocol; `None` if that fails.
fn reach(report: &mut Report, protocol: Protocol, args: &Doctor, link: &LinkArgs) -> Result<Option<Session>, Failure> {
    let (link, began) = (&over(protocol, args, link)?, Instant::now());
    let (check, budget) = match protocol {
        Protocol::Tcp => ("tcp", Budget::start(link)),
        Protocol::Udp => ("udp", Budget::start(link).answer_within(UDP_TIMEOUT)),
    };
    let mut session = Session::new(link);
    let reached = session.open_connection().and_then(|()| {
        session.set_budget(budget);
        session.start(link)
    });
    match reached {
        Ok(()) => {
            let took = began.elapsed().as_secs_f64() * 1000.0;
            report
                .note(check, Finding::Passed(format!("{} answers, Service_Start took {took:.1} ms", link.target()?)))?;
            Ok(Some(session))
        }
        Err(failure) => {
            report.unreachable(check, failure)?;
            Ok(None)
        }
    }
}

/// Runs the checks of the controller.
fn examine(session: &mut Session, link: &LinkArgs, report: &mut Report) -> Result<(), Failure> {
    let Some(controller) = provider(session, link, report)? else {
        let rest = CHECKS.into_iter().skip(1);
        return rest.into_iter().try_for_each(|check| report.note(check, Finding::skipped("it needs the provider")));
    };
    let version = version(session)?;
    report.note("version", version)?;
    // no function returns it (b-CAP specification for RC9, section 3.1), and this command writes nothing
    report.note("permission", Finding::skipped(PERMISSION))?;
    let mut examined = Examined { session, stream: StreamCheck::default(), controller, robot: 0 };
    examined.robot = match examined.session.object(&"robot".parse()?) {
        Ok(robot) => robot,
        Err(failure) if failure.leaves_the_session_alive() => {
            let hint = "check with `bcap names` that the controller has a robot";
            return report.note("arm", Finding::failed(failure.to_string(), hint));
        }
        Err(failure) => return Err(failure),
    };
    examined.state(report)
}

/// Connects to the provider of the command line, or otherwise to the known ones.
fn provider(session: &mut Session, link: &LinkArgs, report: &mut Report) -> Result<Option<i32>, Failure> {
    let requested = link.provider();
    let mut refusals = Vec::new();
    for provider in [requested].into_iter().chain(PROVIDERS.into_iter().filter(|other| *other != requested)) {
        provider.clone_into(&mut session.provider);
        match session.controller() {
            Ok(controller) => {
                let kind = variable(session, "@TYPE")?.map(|kind| short_type(&shown(&kind))).unwrap_or_default();
                let is_rc9 = provider.to_ascii_lowercase().ends_with("vrc9") || kind.eq_ignore_ascii_case("RC9");
                let family = if is_rc9 { "RC9" } else { "RC8" };
                let kind = if kind.is_empty() || kind == family { String::new() } else { format!(", it is a {kind}") };
                report.note(
                    "provider",
                    if provider == requested || link.has_default_provider() {
                        Finding::Passed(format!("{provider} ({family}){kind}"))
                    } else {
                        Finding::failed(
                            format!("{requested} is refused, {provider} ({family}) is accepted{kind}"),
                            format!("give --provider {provider}"),
                        )
                    },
                )?;
                return Ok(Some(controller));
            }
            Err(Failure::Refused { code, .. }) => refusals.push(format!("{provider} is refused with {code}")),
            Err(failure) => return Err(failure),
        }
    }
    let hint = "check --provider, and that the controller has finished starting";
    report.note("provider", Finding::failed(refusals.join(", "), hint))?;
    Ok(None)
}

fn version(session: &mut Session) -> Result<Finding, Failure> {
    let (version, serial) = (variable(session, "@VERSION")?, variable(session, "@SERIAL_NO")?);
    Ok(match version {
        Some(version) => {
            let serial = serial.map(|serial| format!(", serial number {}", shown(&serial))).unwrap_or_default();
            Finding::Passed(format!("{}{serial}", shown(&version)))
        }
        None => Finding::failed(
            "@VERSION cannot be read",
            "allow reading in the controller's communication permission, with the teach pendant",
        ),
    })
}

/// Reads a variable of the controller; `None` if it is refused.
fn variable(session: &mut Session, name: &str) -> Result<Option<Value>, Failure> {
    match get_one(session, &ObjectPath::variable(name)?) {
        Err(failure) if !failure.leaves_the_session_alive() => Err(failure),
        read => Ok(read.ok().filter(|value| !value.as_variant().is_empty())),
    }
}

/// The controller and the robot that are examined.
struct Examined<'a> {
    session: &'a mut Session,
    stream: StreamCheck,
    controller: i32,
    robot: i32,
}

impl Examined<'_> {
    /// Executes a command of the robot, and returns its code.
    fn robot(&mut self, command: &str, parameter: &dyn Encode) -> Result<HResult, Failure> {
        Ok(self.session.execute(FunctionId::ROBOT_EXECUTE, self.robot, command, Value::new(parameter)?)?.0)
    }

    fn clear_error(&mut self) -> Result<HResult, Failure> {
        let function = FunctionId::CONTROLLER_EXECUTE;
        Ok(self.session.execute(function, self.controller, "ClearError", Value::default())?.0)
    }

    /// Returns why a command must not be executed now; `None` if it may.
    fn skip(&mut self, function: FunctionId, command: &str) -> Result<Option<String>, Failure> {
        self.stream.skip(self.session, function, Some(command))
    }

    /// Skips the checks that would end a stream of Slave Mode.
    fn streaming(&mut self, report: &mut Report, why: &str) -> Result<(), Failure> {
        let state = self.stream.ask(self.session)?;
        for check in CHECKS.into_iter().skip(3) {
            let finding = match (check, state) {
                ("arm", StreamState::Runs) => {
                    Finding::failed("a client is in Slave Mode, so it owns the arm", ARM_HINT)
                }
                ("licence", StreamState::Unknown(code)) => {
                    Finding::Untested(format!("slvGetMode returns no mode ({code}), so a client may be in Slave Mode"))
                }
                _ => Finding::skipped(why),
            };
            report.note(check, finding)?;
        }
        Ok(())
    }

    /// Checks the state of the controller and the robot.
    fn state(&mut self, report: &mut Report) -> Result<(), Failure> {
        if let Some(why) = self.skip(FunctionId::CONTROLLER_EXECUTE, "SysState")? {
            return self.streaming(report, &why);
        }
        let state = self.session.with(|controller| controller.robot()?.examine())?;
        let Some(bits) = state.state else {
            // a stream may have begun since
            if let Some(why) = self.skip(FunctionId::CONTROLLER_EXECUTE, "SysState")? {
                return self.streaming(report, &why);
            }
            report.note(
                "mode",
                Finding::failed("SysState is refused", "check that the controller has finished starting"),
            )?;
            let rest = CHECKS.into_iter().skip(4);
            return rest.into_iter().try_for_each(|check| report.note(check, Finding::skipped("it needs SysState")));
        };
        let (auto, outside, stopped) = (bits.is_auto(), bits.has_outside_token(), bits.is_emergency_stopped());
        let errors = match stopped {
            true => Finding::skipped("the emergency stop causes errors"),
            false => errors(bits, &state),
        };
        let emergency = emergency_stop(bits, state.torque_off);
        let ready = auto && outside && !errors.has_failed() && !emergency.has_failed() && !stopped;
        let (token, arm) = if ready { self.take_arm()? } else { (None, Finding::skipped("it needs all of the above")) };
        let ready = ready && token.is_none();

        report.note("mode", mode(auto))?;
        report.note("token", token.unwrap_or_else(|| token_finding(outside)))?;
        report.note("errors", errors)?;
        report.note("emergency stop", emergency)?;
        report.note("arm", arm)?;
        report.note("motor", motor(bits.motor_is_on(), ready))?;
        let (licence, formats) =
            if ready { self.slave_mode()? } else { both("it needs all of the above but the motor") };
        report.note("licence", licence)?;
        report.note("formats", formats)
    }

    /// Checks the licence and the formats of Slave Mode, unless a client is in Slave Mode.
    fn slave_mode(&mut self) -> Result<(Finding, Finding), Failure> {
        let function = FunctionId::ROBOT_EXECUTE;
        let (code, mode) = self.session.execute(function, self.robot, StreamState::COMMAND, Value::default())?;
        let mut answers = vec![(StreamState::COMMAND, code)];
        let Some(number) = mode.filter(|_| code.is_ok()).and_then(|mode| mode.as_variant().as_i32()) else {
            let why = format!("slvGetMode returns no mode ({code}), so a client may be in Slave Mode");
            return Ok(match code {
                HResult::E_NO_LICENSE => (licence(&answers), Finding::skipped("it needs the licence")),
                _ => (Finding::Untested(why.clone()), Finding::Untested(why)),
            });
        };
        if number != 0 {
            return Ok(both("a client is in Slave Mode"));
        }
        let formats = self.formats(&mut answers)?;
        // without the arm, the controller refuses this even with a licence
        let code = self.robot("slvChangeMode", &0x202_i32)?;
        if code.is_ok() {
            // a controller that accepts it is in Slave Mode now
            self.robot("slvChangeMode", &0_i32)?;
        }
        self.clear_own(code)?;
        answers.push(("slvChangeMode", code));
        Ok((licence(&answers), formats))
    }

    /// Takes and releases the arm; also returns a finding about the token, if TakeArm is refused for it.
    fn take_arm(&mut self) -> Result<(Option<Finding>, Finding), Failure> {
        if let Some(why) = self.skip(FunctionId::ROBOT_EXECUTE, "TakeArm")? {
            return Ok((None, Finding::Skipped(why)));
        }
        let taken = self.robot("TakeArm", &[0_i32, 1])?;
        if taken.is_ok() {
            self.robot("GiveArm", &())?;
            return Ok((None, Finding::Passed("free".into())));
        }
        self.clear_own(taken)?;
        if [HResult::E_TOKEN_ADDRESS, HResult::E_TOKEN_NOT_ETHERNET].contains(&taken) {
            let token = Finding::failed(format!("TakeArm is refused with {taken}"), TOKEN_HINT);
            return Ok((Some(token), Finding::skipped("it needs the token")));
        }
        Ok((None, Finding::failed(format!("TakeArm is refused with {taken}"), ARM_HINT)))
    }

    /// Clears the error that a refusal of this command has left, if it is the only one.
    fn clear_own(&mut self, refusal: HResult) -> Result<(), Failure> {
        if refusal.level().is_none() {
            return Ok(());
        }
        let is_own = match present(self.session, &mut self.stream) {
            Err(failure) if !failure.leaves_the_session_alive() => return Err(failure),
            present => present.is_ok_and(|errors| matches!(errors.as_slice(), [(code, _)] if *code == refusal)),
        };
        if is_own && self.clear_error()? == HResult::E_MANUAL_RESET_UNPREPARED {
            self.robot("ManualResetPreparation", &())?;
            self.clear_error()?;
        }
        Ok(())
    }

    /// Sets all formats, the default ones last; adds the refusals of the formats that Slave Mode needs to `answers`.
    fn formats(&mut self, answers: &mut Vec<(&'static str, HResult)>) -> Result<Finding, Failure> {
        const SEND: [(i32, &str); 4] = [(0x200, "user IO"), (0x100, "MiniIO"), (0x20, "HandIO"), (0, "the pose alone")];
        const RECEIVE: [(i32, &str); 8] = [
            (0x202, "user IO"),
            (0x102, "MiniIO"),
            (0x22, "HandIO"),
            (0x42, "current"),
            (0x12, "time stamps"),
            (1, "P"),
            (3, "T"),
            (2, "J"),
        ];
        let mut missing = Vec::new();
        let mut refused = None;
        for (command, way, formats) in
            [("slvSendFormat", "sending", &SEND[..]), ("slvRecvFormat", "receiving", &RECEIVE)]
        {
            for (format, name) in formats {
                let code = match command {
                    "slvRecvFormat" => self.robot(command, &[*format, 0]),
                    _ => self.robot(command, format),
                }?;
                let needed = *format <= 3;
                if code.is_err() && needed {
                    answers.push((command, code));
                    refused.get_or_insert(format!("{command} {format:#x} ({name}) is refused with {code}"));
                } else if code.is_err() {
                    missing.push(format!("{way} {name}"));
                }
            }
        }
        Ok(match (refused, missing.as_slice()) {
            (Some(refused), _) => {
                Finding::failed(refused, "update the controller's software: Slave Mode needs this format")
            }
            (None, []) => Finding::Passed("all".into()),
            (None, missing) => Finding::Passed(format!("all but {}", missing.join(", "))),
        })
    }
}

/// Concludes from the answers to the commands of Slave Mode whether there is a licence.
///
/// slvChangeMode is the last command. Only its refusal with E_ARM_NOT_TAKEN shows that there is a licence, and only if the
/// controller has the other commands; these may refuse a format that it does not support. A controller may return any other
/// error before it checks the licence.
fn licence(answers: &[(&str, HResult)]) -> Finding {
    let is = |wanted: HResult| answers.iter().find(|(_, code)| *code == wanted);
    if let Some((command, code)) = is(HResult::E_NO_LICENSE) {
        let hint = "enter the licence key of \"b-CAP Slave\" on the teach pendant; the key is free and bound to the serial \
                    number of the controller";
        return Finding::failed(format!("{command} is refused with {code}"), hint);
    }
    let is_conclusive = |(command, code): &&(&str, HResult)| match *code {
        HResult::E_ARM_NOT_TAKEN => *command == "slvChangeMode",
        HResult::E_INVALIDARG | HResult::E_INVALIDARGTYPE => *command != "slvChangeMode",
        code => code.is_ok(),
    };
    match answers.iter().find(|answer| !is_conclusive(answer)) {
        None => Finding::Passed("present: slvChangeMode is refused only because the arm is not taken".into()),
        Some((command, code)) => {
            Finding::Untested(format!("{command} is refused with {code}, possibly before the check of the licence"))
        }
    }
}

/// Skips both the licence and the formats.
fn both(why: &str) -> (Finding, Finding) {
    (Finding::skipped(why), Finding::skipped(why))
}

const PERMISSION: &str = "reading is allowed; only a write shows whether writing is";

const ARM_HINT: &str =
    "end the program that owns the arm: its last call gives the arm back, or over TCP the end of its connection";

const TOKEN_HINT: &str =
    "on the teach pendant, set the executable token to Ethernet with the address of this machine, or to Any";

fn mode(auto: bool) -> Finding {
    if auto {
        return Finding::Passed("Auto".into());
    }
    Finding::failed(
        "Manual or teach check",
        "switch the controller to Auto: clients can move the robot only in this mode",
    )
}

fn errors(bits: SysState, state: &Examination) -> Finding {
    let Some(first) = state.errors().first() else {
        return match bits.has_error() {
            false => Finding::Passed("none".into()),
            true => Finding::failed("the controller does not list them", "check the errors on the teach pendant"),
        };
    };
    let hint = hint_of(*first)
        .map_or_else(|| "`bcap errors` shows all; remove the first cause".into(), |hint| hint.to_string());
    let what = format!("{}, the first cause is {}", state.error_count, described(*first, ""));
    Finding::failed(what, format!("{hint} (`bcap recover`)"))
}

fn emergency_stop(bits: SysState, torque_off: Option<bool>) -> Finding {
    match (bits.is_emergency_stopped(), bits.is_protectively_stopped(), torque_off) {
        (true, ..) => {
            Finding::failed("pressed", "make sure that no person is in danger, release it, then `bcap recover`")
        }
        (_, true, _) => Finding::failed("protective stop", "close the guard, then `bcap recover`"),
        (.., Some(true)) => Finding::failed("released, but the torque is still off", "`bcap recover` restores it"),
        _ => Finding::Passed("released".into()),
    }
}

fn token_finding(outside: bool) -> Finding {
    if outside {
        return Finding::Passed("available: the teach pendant does not have it".into());
    }
    Finding::failed("the teach pendant has it", TOKEN_HINT)
}

fn motor(on: bool, ready: bool) -> Finding {
    match (on, ready) {
        (true, _) => Finding::Passed("on".into()),
        (false, false) => Finding::skipped("off, and it needs all of the above"),
        (false, true) => Finding::Passed(
            "off; `bcap move` and `bcap slave` switch it on, and so does `bcap recover --keep`, which prepares a COBOTTA first"
                .into(),
        ),
    }
}
