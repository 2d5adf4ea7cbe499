//! `examine`, `recover` and `prepare` against a controller whose state the calls change.

use core::cell::RefCell;
use core::ops::ControlFlow;

use super::*;
use crate::bcap::StreamState;

const HANDLES: Handles = Handles { controller: ControllerHandle(7), robot: RobotHandle(9) };
/// Auto mode, the token is outside.
const READY: i32 = 1 << 4 | 1 << 5;
const ERROR: i32 = 1 << 1;
const MOTOR: i32 = 1 << 2;
/// An error of a path, which ClearError ends.
const PATH: HResult = HResult::from_u32(0x8320_1501);

/// The state of the controller, and its answers where an idle RC8 answers otherwise.
#[derive(Clone, Debug)]
struct Peer {
    mode: Answer,
    state: i32,
    /// In reverse order, as GetCurErrorInfo has them.
    errors: Vec<HResult>,
    torque_off: Option<bool>,
    kind: &'static str,
    prepared: bool,
    owned: bool,
    other: Vec<(&'static str, Answer)>,
}

fn peer() -> Peer {
    let other = vec![];
    let mode = Answer::value(&0);
    Peer { mode, state: READY, errors: vec![], torque_off: None, kind: "VS087", prepared: false, owned: false, other }
}

fn failed(errors: &[HResult]) -> Peer {
    Peer { state: READY | ERROR, errors: errors.to_vec(), ..peer() }
}

fn cobotta() -> Peer {
    Peer { torque_off: Some(true), kind: "CVR038A1-NV6", ..failed(&[PATH]) }
}

impl Peer {
    fn answer(&mut self, call: &str) -> Answer {
        let command = command_of(call);
        if let Some((_, answer)) = self.other.iter().find(|(name, _)| *name == command) {
            return answer.clone();
        }
        let unknown = Answer::Refused(HResult::E_INVALID_CMD_NAME);
        match command {
            "slvGetMode" => self.mode.clone(),
            "SysState" => Answer::value(&self.state),
            "StoState" => self.torque_off.map_or(unknown, |off| Answer::value(&off)),
            "TakeArmState" => Answer::value(&i32::from(self.owned)),
            "GetRobotTypeName" => Answer::value(&self.kind),
            "GetMotionPreparationState" => Answer::value(&self.prepared),
            "GetCurErrorCount" => Answer::value(&i32::try_from(self.errors.len()).unwrap()),
            "GetCurErrorInfo" => {
                let index: usize = call.rsplit(", ").next().unwrap().trim_end_matches(')').parse().unwrap();
                Answer::value(&(self.errors[index].0, "text"))
            }
            "TakeArm" if !self.errors.is_empty() => Answer::Refused(HResult::E_ERROR_PRESENT),
            "ClearError" => {
                self.errors.clear();
                Answer::Empty
            }
            _ => Answer::Empty,
        }
    }
}

/// Returns the command of a call, or its function.
fn command_of(call: &str) -> &str {
    call.split('"').nth(1).filter(|command| !command.is_empty()).unwrap_or(call)
}

/// Returns the commands that change something, in order.
fn changes(calls: &[String]) -> Vec<&str> {
    let reads = ["slvGetMode", "SysState", "StoState", "TakeArmState", "GetRobotTypeName", "GetMotionPreparationState"];
    let is_read = |command: &&str| reads.contains(command) || command.starts_with("GetCurError");
    calls.iter().map(|call| command_of(call)).filter(|command| !is_read(command)).collect()
}

fn examined(mut peer: Peer) -> Examination {
    run(examine(HANDLES), |_, call, _| peer.answer(call)).result.unwrap()
}

const ALONE: RecoveryConfig = RecoveryConfig { is_alone: true, speed: None, agreed: None };

/// A recovery or a preparation, its result, its calls and its reports.
type Recovery = (Result<Recovered, NotRecovered>, Vec<String>, Vec<(RecoveryStep, Result<(), HResult>)>);

fn recovered(config: Option<RecoveryConfig>, mut peer: Peer) -> Recovery {
    answered(config, move |_, call| peer.answer(call), |_| ControlFlow::Continue(()))
}

/// Runs a recovery with a configuration, a preparation without.
fn answered(
    config: Option<RecoveryConfig>,
    mut answer: impl FnMut(usize, &str) -> Answer,
    flow: impl Fn(RecoveryStep) -> ControlFlow<()>,
) -> Recovery {
    let reports = RefCell::new(Vec::new());
    let observe = |step, result| {
        reports.borrow_mut().push((step, result));
        flow(step)
    };
    let peer = |number: usize, call: &str, _: Instant| answer(number, call);
    let done = match config {
        Some(config) => run(recover(HANDLES, config, observe), peer),
        None => run(prepare(HANDLES, observe), peer),
    };
    (done.result, done.calls, reports.into_inner())
}

#[test]
fn an_examination_reads_the_state_and_the_errors_and_changes_nothing() {
    let mut controller = failed(&[HResult::E_ERROR_PRESENT, PATH]);
    let done = run(examine(HANDLES), |_, call, _| controller.answer(call));
    assert_eq!(changes(&done.calls), [""; 0]);
    let state = done.result.unwrap();
    // the last error of the list is the first cause
    assert_eq!((state.errors(), state.error_count), (&[PATH, HResult::E_ERROR_PRESENT][..], 2));
    assert_eq!((state.state, state.torque_off, state.is_cobotta), (Some(SysState(READY | ERROR)), None, false));
    // slvGetMode precedes each call but StoState, which Slave Mode allows
    for (at, call) in done.calls.iter().enumerate() {
        let command = command_of(call);
        let asks = matches!(command, "slvGetMode" | "StoState");
        assert!(asks || done.calls[at - 1].contains("slvGetMode"), "{command}");
    }
    // a controller without Slave Mode is queried once
    let absent = Peer { mode: Answer::Refused(HResult::E_INVALID_CMD_NAME), ..peer() };
    let mut controller = absent;
    let done = run(examine(HANDLES), |_, call, _| controller.answer(call));
    assert_eq!(done.calls.iter().filter(|call| call.contains("slvGetMode")).count(), 1);
    assert_eq!(done.result.unwrap().stream, StreamState::Absent);
    // of many errors it has the oldest
    let many: Vec<HResult> = (0..20).map(|n| HResult(PATH.0 - n)).collect();
    let state = examined(failed(&many));
    assert_eq!((state.errors().len(), state.errors()[0], state.error_count), (8, many[19], 20));
}

#[test]
fn an_examination_interrupts_no_stream() {
    let code = HResult::E_ERROR_PRESENT;
    for (mode, expected) in
        [(Answer::value(&0x202), StreamState::Runs), (Answer::Refused(code), StreamState::Unknown(code))]
    {
        for before in 0..3 {
            let (mut controller, mut asked) = (failed(&[PATH]), 0);
            let done = run(examine(HANDLES), |_, call, _| {
                let is_mode = call.contains("slvGetMode");
                asked += usize::from(is_mode);
                if is_mode && asked > before { mode.clone() } else { controller.answer(call) }
            });
            assert!(done.calls.last().unwrap().contains("slvGetMode"), "nothing after it: {:?}", done.calls);
            let state = done.result.unwrap();
            assert_eq!((state.stream, state.state, state.error_count), (expected, None, 0));
        }
    }
}

#[test]
fn a_person_is_named_what_only_a_person_can_do() {
    let with = |state| examined(Peer { state, ..peer() });
    let obstacles = |state: Examination| state.obstacles().collect::<Vec<_>>();
    assert_eq!(obstacles(with(READY)), []);
    assert_eq!(obstacles(with(READY | 1 << 10)), [Obstacle::EmergencyStop]);
    assert_eq!(obstacles(with(READY | 1 << 12)), [Obstacle::ProtectiveStop]);
    assert_eq!(obstacles(with(READY | 1 << 20)), [Obstacle::Moves]);
    assert_eq!(obstacles(with(0)), [Obstacle::Mode, Obstacle::Token]);
    assert_eq!(obstacles(examined(Peer { owned: true, state: READY | 1 << 20, ..peer() })), []);
    // a fault of the controller, a code that only a restart ends, a code of no known list
    for code in [0x8550_0001, 0x8000_4005] {
        let code = HResult::from_u32(code);
        assert_eq!(obstacles(examined(failed(&[code, PATH]))), [Obstacle::Error(code)]);
    }
    let unknown = Peer { other: vec![("SysState", Answer::Refused(HResult::E_FAIL))], ..peer() };
    assert_eq!(obstacles(examined(unknown)), [Obstacle::StateUnknown]);
    for obstacle in [Obstacle::EmergencyStop, Obstacle::Mode, Obstacle::Token, Obstacle::Error(PATH)] {
        assert!(obstacle.to_string().contains(": "), "it says what to do: {obstacle}");
    }
}

#[test]
fn each_model_has_its_steps() {
    use RecoveryStep::{ClearError, ExtSpeed, ManualReset, ManualResetPreparation, MotionPreparation, Motor, TakeArm};
    let steps = |peer: Peer| examined(peer).steps(false).collect::<Vec<_>>();
    assert_eq!(steps(failed(&[PATH])), [ClearError, TakeArm, Motor]);
    assert_eq!(steps(Peer { torque_off: Some(true), ..failed(&[PATH]) }), [ClearError, TakeArm, ManualReset, Motor]);
    let all = [
        ManualResetPreparation,
        ClearError,
        TakeArm,
        ManualResetPreparation,
        ManualReset,
        ManualResetPreparation,
        MotionPreparation,
        Motor,
        ExtSpeed,
    ];
    assert_eq!(examined(cobotta()).steps(true).collect::<Vec<_>>(), all);
    assert_eq!(steps(Peer { torque_off: None, ..cobotta() }), all[..8], "an unknown torque");
    assert_eq!(steps(Peer { torque_off: Some(false), prepared: true, state: READY, ..cobotta() }), [TakeArm, Motor]);
    // a COBOTTA PRO is to a client like an RC9
    let pro = Peer { kind: "CVRB0609", torque_off: Some(false), ..failed(&[PATH]) };
    assert_eq!(steps(pro), [ClearError, TakeArm, Motor]);
    let ready = examined(Peer { state: READY | MOTOR, ..peer() });
    assert!(ready.is_ready() && !examined(peer()).is_ready() && !examined(cobotta()).is_ready());
    assert_eq!(ready.steps(false).collect::<Vec<_>>(), [TakeArm]);
}

#[test]
fn a_recovery_makes_its_steps_in_order_and_reports_each() {
    let (result, calls, reports) = recovered(Some(ALONE), failed(&[PATH]));
    assert_eq!(result, Ok(Recovered { motor_on: true }));
    // the first TakeArm queries the owner of the arm
    assert_eq!(changes(&calls), ["TakeArm", "ClearError", "TakeArm", "Motor"]);
    assert!(reports.iter().all(|(_, result)| result.is_ok()));
    assert_eq!(reports.iter().map(|(step, _)| step.name()).collect::<Vec<_>>(), ["ClearError", "TakeArm", "Motor"]);
    let last = calls.iter().rposition(|call| call.contains("slvGetMode")).unwrap();
    assert!(calls[last + 1].contains("TakeArm"), "with the arm no other client can stream");

    let (result, calls, _) = recovered(Some(RecoveryConfig { speed: Some(10.0), ..ALONE }), cobotta());
    assert_eq!(result, Ok(Recovered { motor_on: true }));
    let order = "TakeArm ManualResetPreparation ClearError TakeArm ManualResetPreparation ManualReset \
                 ManualResetPreparation MotionPreparation Motor ExtSpeed";
    assert_eq!(changes(&calls), order.split(' ').collect::<Vec<_>>());
    // a robot without errors, whose motor is on
    let (result, calls, _) = recovered(None, Peer { state: READY | MOTOR, ..peer() });
    assert_eq!((result, changes(&calls)), (Ok(Recovered { motor_on: false }), vec!["TakeArm"]));
    let (_, calls, _) = recovered(Some(ALONE), Peer { owned: true, ..failed(&[PATH]) });
    assert_eq!(changes(&calls), ["ClearError", "Motor"], "the arm is the session's");
}

#[test]
fn errors_stay_until_it_is_known_that_no_other_client_uses_the_robot() {
    let stopped = |config, peer| {
        let (result, calls, reports) = recovered(config, peer);
        assert!(!calls.iter().any(|call| call.contains("ClearError")), "{calls:?}");
        assert_eq!(reports, []);
        (result.unwrap_err(), changes(&calls).into_iter().map(String::from).collect::<Vec<_>>())
    };
    let unknown = Some(RecoveryConfig::default());
    // the controller does not say it
    let (error, calls) = stopped(unknown, failed(&[PATH]));
    assert_eq!((error.step, error.obstacle), (RecoveryStep::TakeArm, Some(Obstacle::OwnerUnknown)));
    assert_eq!((calls, error.error.undone), (vec!["TakeArm".into()], true));
    // it reports that another client owns the arm: nothing is cleared, even if the caller claims to be alone
    let taken = ("TakeArm", Answer::Refused(HResult::E_ARM_NOT_TAKEN));
    for config in [unknown, Some(ALONE)] {
        let (error, calls) = stopped(config, Peer { other: vec![taken.clone()], ..failed(&[PATH]) });
        assert_eq!((error.code(), error.step), (Some(HResult::E_ARM_NOT_TAKEN), RecoveryStep::TakeArm));
        assert_eq!(calls, ["TakeArm"]);
        let (error, calls) = stopped(config, Peer { mode: Answer::value(&0x202), ..failed(&[PATH]) });
        assert_eq!((error.obstacle, calls.len()), (Some(Obstacle::Stream), 0));
        let (error, calls) = stopped(config, Peer { state: READY | ERROR | 1 << 20, ..failed(&[PATH]) });
        assert_eq!((error.obstacle, calls.len()), (Some(Obstacle::Moves), 0));
    }
    let refused = Peer { mode: Answer::Refused(HResult::E_ERROR_PRESENT), ..failed(&[PATH]) };
    let (error, _) = stopped(unknown, refused.clone());
    assert_eq!(error.code(), Some(HResult::E_ERROR_PRESENT));
    assert_eq!((error.step, error.error.function), (RecoveryStep::Examine, FunctionId::ROBOT_EXECUTE));
    assert_eq!(changes(&recovered(Some(ALONE), refused).1), ["TakeArm", "ClearError", "TakeArm", "Motor"]);
}

#[test]
fn a_stream_that_begins_meanwhile_ends_the_recovery() {
    let modes = recovered(Some(ALONE), failed(&[PATH])).1.iter().filter(|call| call.contains("slvGetMode")).count();
    for at in 1..=modes {
        let (mut controller, mut asked) = (failed(&[PATH]), 0);
        let answer = |_: usize, call: &str| {
            asked += usize::from(call.contains("slvGetMode"));
            if asked == at { Answer::value(&0x202) } else { controller.answer(call) }
        };
        let (result, calls, _) = answered(Some(ALONE), answer, |_| ControlFlow::Continue(()));
        assert_eq!(result.unwrap_err().obstacle, Some(Obstacle::Stream), "{at}");
        assert!(calls.last().unwrap().contains("slvGetMode"), "the arm was not taken: {calls:?}");
    }
}

#[test]
fn a_failed_step_is_named_and_the_arm_and_the_motor_are_undone() {
    let config = RecoveryConfig { speed: Some(10.0), ..ALONE };
    let (_, normal, _) = recovered(Some(config), cobotta());
    let first = normal.iter().position(|call| call.contains("ManualResetPreparation")).unwrap();
    for at in first..normal.len() {
        let command = command_of(&normal[at]).to_string();
        if command == "slvGetMode" {
            continue;
        }
        let refusal = HResult::E_TOKEN_ADDRESS;
        for failure in [
            Answer::Refused(refusal),
            Answer::Failed(Failure::Timeout),
            Answer::Failed(Failure::NotSent),
            Answer::Failed(Failure::Lost),
        ] {
            let mut controller = cobotta();
            let answer =
                |number: usize, call: &str| if number == at { failure.clone() } else { controller.answer(call) };
            let (result, calls, _) = answered(Some(config), answer, |_| ControlFlow::Continue(()));
            let error = result.unwrap_err();
            assert_eq!((error.step.name(), error.obstacle), (command.as_str(), None), "{failure:?}");
            assert_eq!(error.code(), matches!(failure, Answer::Refused(_)).then_some(refusal));
            let ran = matches!(failure, Answer::Failed(Failure::Timeout));
            let has = |name: &str| normal[first..at].iter().any(|call| call.contains(name));
            let mut undo = Vec::new();
            if has("\"Motor\"") || (ran && command == "Motor") {
                undo.push("Robot_Execute(9, \"Motor\", I4[0, 0])");
            }
            if ran && command == "MotionPreparation" {
                undo.push("Robot_Halt(9, \"\")");
            }
            if has("\"TakeArm\"") || (ran && command == "TakeArm") {
                undo.push("Robot_Execute(9, \"GiveArm\", EMPTY)");
            }
            if matches!(failure, Answer::Failed(Failure::Lost)) {
                undo.clear();
            }
            assert_eq!(calls[at + 1..], undo, "{command} {failure:?}");
        }
    }
}

#[test]
fn a_link_that_is_lost_during_the_examination_leaves_nothing() {
    let (_, normal, _) = recovered(Some(ALONE), cobotta());
    for at in 0..normal.iter().position(|call| call.contains("TakeArm\"")).unwrap() {
        for failure in [Failure::Lost, Failure::Timeout] {
            let mut controller = cobotta();
            let answer =
                |number, call: &str| if number == at { Answer::Failed(failure) } else { controller.answer(call) };
            let (result, calls, _) = answered(Some(ALONE), answer, |_| ControlFlow::Continue(()));
            let StepError { cause, undone, .. } = result.unwrap_err().error;
            assert_eq!((cause, undone, calls.len()), (StepCause::Failed(failure), true, at + 1));
        }
    }
}

#[test]
fn the_caller_can_stop_it_after_each_step() {
    for (last, undo) in [
        (RecoveryStep::ClearError, &[][..]),
        (RecoveryStep::TakeArm, &["GiveArm"]),
        (RecoveryStep::Motor, &["Motor", "GiveArm"]),
    ] {
        let mut controller = failed(&[PATH]);
        let flow = |step| if step == last { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let (result, calls, reports) = answered(Some(ALONE), |_, call| controller.answer(call), flow);
        let error = result.unwrap_err();
        assert_eq!((error.step, error.error.cause, error.obstacle), (last, StepCause::Stopped, None));
        assert_eq!(reports.last(), Some(&(last, Ok(()))));
        let changes = changes(&calls);
        assert_eq!(changes[changes.len() - undo.len()..], *undo, "{changes:?}");
        assert_eq!(changes.iter().filter(|command| **command == "GiveArm").count(), undo.len().min(1));
    }
}

#[test]
fn an_early_cobotta_without_the_commands_is_recovered() {
    // the second code is the answer of a COBOTTA before version 2.8
    for code in [HResult::E_INVALID_CMD_NAME, HResult::E_INVALIDARG] {
        let unknown = Answer::Refused(HResult::E_INVALID_CMD_NAME);
        let other = vec![("ManualResetPreparation", Answer::Refused(code)), ("ManualReset", unknown)];
        let (result, _, reports) = recovered(Some(ALONE), Peer { other, ..cobotta() });
        assert_eq!(result, Ok(Recovered { motor_on: true }), "{code}");
        let left_out = reports.iter().filter(|(_, result)| result.is_err()).map(|(step, _)| step.name());
        assert_eq!(
            left_out.collect::<Vec<_>>(),
            ["ManualResetPreparation", "ManualResetPreparation", "ManualReset", "ManualResetPreparation"]
        );
    }
    // a controller may execute a call that it has abandoned
    for (command, undo) in
        [("Motor", "Robot_Execute(9, \"Motor\", I4[0, 0])"), ("MotionPreparation", "Robot_Halt(9, \"\")")]
    {
        let other = vec![(command, Answer::Refused(HResult::E_TIMEOUT))];
        let (_, calls, _) = recovered(Some(ALONE), Peer { other, ..cobotta() });
        assert!(calls.iter().any(|call| call == undo), "{calls:?}");
    }
}

#[test]
fn a_refused_call_is_not_the_reason_if_an_obstacle_or_the_caller_ends_the_recovery() {
    // the mode is Manual, and the last call of the examination is refused
    let other = vec![("GetMotionPreparationState", Answer::Refused(HResult::E_INVALID_CMD_NAME))];
    let manual = Peer { state: 1 << 5, errors: vec![], other, ..cobotta() };
    let error = recovered(Some(ALONE), manual).0.unwrap_err();
    assert_eq!((error.obstacle, error.error.cause, error.code()), (Some(Obstacle::Mode), StepCause::Stopped, None));
    // the caller ends it after a step that was left out
    let other = vec![("ManualResetPreparation", Answer::Refused(HResult::E_INVALIDARG))];
    let mut controller = Peer { other, ..cobotta() };
    let (result, ..) = answered(Some(ALONE), |_, call| controller.answer(call), |_| ControlFlow::Break(()));
    let error = result.unwrap_err();
    assert_eq!((error.step, error.obstacle), (RecoveryStep::ManualResetPreparation, None));
    assert_eq!((error.error.cause, error.code()), (StepCause::Stopped, None));
}

#[test]
fn a_step_that_nobody_has_agreed_to_is_not_made() {
    let prepared = Peer { prepared: true, torque_off: Some(false), ..cobotta() };
    let agreed: RecoveryStepSet = examined(prepared.clone()).steps(false).collect();
    assert!(agreed.contains(RecoveryStep::Motor) && !agreed.contains(RecoveryStep::MotionPreparation));
    let config = Some(RecoveryConfig { agreed: Some(agreed), ..ALONE });
    assert_eq!(recovered(config, prepared).0, Ok(Recovered { motor_on: true }));
    // an emergency stop since then
    let (result, calls, _) = recovered(config, cobotta());
    assert_eq!(result.unwrap_err().obstacle, Some(Obstacle::NotAgreed(RecoveryStep::ManualReset)));
    assert_eq!(changes(&calls), [""; 0]);
}

#[test]
fn a_preparation_moves_only_an_unprepared_cobotta_without_errors() {
    let idle = Peer { state: READY, torque_off: Some(false), errors: vec![], ..cobotta() };
    let (result, calls, _) = recovered(None, idle.clone());
    assert_eq!(result, Ok(Recovered { motor_on: false }));
    assert_eq!(changes(&calls), ["TakeArm", "ManualResetPreparation", "MotionPreparation"]);
    for peer in [Peer { prepared: true, ..idle }, peer()] {
        assert_eq!(changes(&recovered(None, peer).1), ["TakeArm"]);
    }
    let (result, calls, _) = recovered(None, cobotta());
    assert_eq!(result.unwrap_err().obstacle, Some(Obstacle::Error(PATH)));
    assert_eq!(changes(&calls), [""; 0]);
}

#[test]
fn the_error_says_the_step_the_code_and_what_to_do() {
    let (result, ..) = recovered(Some(RecoveryConfig::default()), failed(&[PATH]));
    let text = result.unwrap_err().to_string();
    assert!(text.starts_with("before TakeArm: ") && text.ends_with("no other program uses the robot"), "{text}");
    let other = vec![("Motor", Answer::Refused(HResult::E_TOKEN_ADDRESS))];
    let text = recovered(Some(ALONE), Peer { other, ..peer() }).0.unwrap_err().to_string();
    assert!(text.starts_with("Motor: the controller refused: 0x83501029 (E_TOKEN_ADDRESS), "), "{text}");
    assert!(text.contains(": "), "{text}");
}
