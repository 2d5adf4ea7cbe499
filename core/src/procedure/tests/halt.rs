//! `halt` against robots that rest, brake, are moved by tasks or never stop.

use core::cell::Cell;

use super::*;

const HANDLES: Handles = Handles { controller: ControllerHandle(7), robot: RobotHandle(9) };
const HALT: &str = "Robot_Halt(9, \"\")";
const KILL: &str = "Controller_Execute(7, \"KillAll\", EMPTY)";
const NAMES: &str = "Controller_GetTaskNames(7, \"\")";
const SLAVE: &str = "Robot_Execute(9, \"slvGetMode\", EMPTY)";
const STATE: &str = "Controller_Execute(7, \"SysState\", EMPTY)";
const POSITION: &str = "Robot_Execute(9, \"CurJnt\", EMPTY)";
const POLL: [&str; 3] = [SLAVE, STATE, POSITION];
const MOVING: i32 = 0b11 << 20;
const RUNNING: i32 = 1;
/// The refusal of a controller whose task owns the arm.
const OWNED: HResult = HResult::from_u32(0x8350_0079);

fn config() -> HaltConfig {
    HaltConfig::within(Duration::from_millis(500))
}

fn at(angle: f64) -> Answer {
    Answer::value(&[angle, 0.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0])
}

/// Answers the calls of a robot at rest with S_OK; tasks have the handle 30.
fn resting(call: &str) -> Answer {
    match call {
        SLAVE | STATE => Answer::value(&0),
        POSITION => at(10.0),
        NAMES => Answer::value(&["Pro1", "Pro2", "Pro3"]),
        _ if call.starts_with("Controller_GetTask(") => Answer::value(&30),
        _ if call.starts_with("Task_Execute(") => Answer::value(&3),
        _ => Answer::Empty,
    }
}

/// Halts; `special` answers the calls that [`resting`] does not answer as wanted, by the number of the call.
fn halted(special: impl Fn(usize, &str, u64) -> Option<Answer>) -> Run<Halt> {
    run(halt(HANDLES, config()), |number, call, now| {
        special(number, call, now.as_micros() / 1000).unwrap_or_else(|| resting(call))
    })
}

fn count(calls: &[String], wanted: &str) -> usize {
    calls.iter().filter(|call| call.starts_with(wanted)).count()
}

const fn outcome(answer: HaltAnswer, tasks: Option<StoppedTasks>, rests: bool) -> Halt {
    Halt { answer, tasks, rests }
}

#[test]
fn a_halt_is_reported_after_the_robot_was_seen_at_rest() {
    let done = halted(|_, _, _| None);
    assert_eq!(done.calls, [&[HALT][..], &POLL, &POLL, &POLL].concat());
    let halt = done.result.unwrap();
    assert_eq!(halt, outcome(HaltAnswer::Halted, None, true));
    assert!(halt.is_halted());
    assert_eq!(halt.to_string(), "halted");
    // two pauses of 20 ms and ten calls
    assert_eq!(done.now.as_micros() / 1000, 50);
}

#[test]
fn a_robot_that_brakes_after_the_reply_is_waited_for() {
    // by its joints
    let done = halted(|_, call, millis| (call == POSITION).then(|| at((millis as f64 / 10.0).min(20.0))));
    assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, None, true)));
    assert!((240..300).contains(&(done.now.as_micros() / 1000)), "{}", done.now);
    // by SysState, while the joints do not change
    for bit in [1 << 20, 1 << 21] {
        let done = halted(|_, call, millis| (call == STATE && millis < 200).then(|| Answer::value(&bit)));
        assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, None, true)));
        assert!((220..300).contains(&(done.now.as_micros() / 1000)), "{}", done.now);
    }
}

/// Halts a robot whose controller answers S_FALSE to the first Robot_Halt; `position` gets the milliseconds, and whether there
/// was a second one.
fn nothing_to_halt(position: impl Fn(u64, bool) -> f64) -> Run<Halt> {
    let mut procedure = halt(HANDLES, config());
    let mut now = Instant::ZERO;
    assert!(matches!(procedure.poll(now), Action::Call(Channel::Motion)));
    let mut buffer = [0; 64];
    let bytes = FrameWriter::new(&mut buffer).unwrap().finish(1, 0, HResult::S_FALSE.0).unwrap();
    procedure.handle_reply(&Decoder::TCP.decode_datagram(bytes).unwrap(), now);
    now = Instant::from_millis(1);
    let mut again = false;
    let peer = |_, call: &str, now: Instant| {
        again |= call == HALT;
        if call == POSITION { at(position(now.as_micros() / 1000, again)) } else { resting(call) }
    };
    run_from(now, procedure, peer)
}

#[test]
fn nothing_moved_only_if_neither_the_reply_nor_a_poll_says_otherwise() {
    let done = nothing_to_halt(|_, _| 10.0);
    let halt = done.result.unwrap();
    assert_eq!(halt, outcome(HaltAnswer::NothingMoved, None, true));
    assert_eq!(halt.to_string(), "nothing was moving");
    assert_eq!(count(&done.calls, HALT), 0, "{:?}", done.calls);
    let halt = nothing_to_halt(|millis, _| (millis.min(100)) as f64).result;
    assert_eq!(halt, Ok(outcome(HaltAnswer::Halted, None, true)));
    let moves = nothing_to_halt(|millis, _| millis as f64).result.unwrap();
    assert_eq!(moves, outcome(HaltAnswer::Halted, None, false));
    assert!(!moves.is_halted());
}

/// Another thread sent it at the same time.
#[test]
fn a_motion_that_begins_just_after_a_halt_is_halted() {
    // it has stopped at 7 degrees by the time of the second Robot_Halt
    let position = |millis: u64, again: bool| if again { 7.0 } else { (millis as f64 - 10.0).max(0.0) };
    let done = nothing_to_halt(position);
    assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, None, true)));
    // the first poll that sees it
    assert_eq!(done.calls, [&POLL[..], &POLL, &[HALT], &POLL, &POLL, &POLL].concat());
    // a controller that does not report that nothing moved: after the time limit
    let again = Cell::new(0);
    let done = halted(|_, call, millis| {
        again.set(again.get() + i32::from(call == HALT));
        (call == POSITION).then(|| at(if again.get() < 2 { millis as f64 } else { 7.0 }))
    });
    assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, None, true)));
    assert_eq!((count(&done.calls, HALT), count(&done.calls, KILL)), (2, 0));
    // whether a second halt without a reply stopped it is unknown
    let done = halted(|number, call, millis| match call {
        HALT if number > 0 => Some(Answer::Failed(Failure::Timeout)),
        POSITION => Some(at(millis as f64)),
        _ => None,
    });
    let error = done.result.unwrap_err();
    assert_eq!((error.function, error.undone), (FunctionId::ROBOT_HALT, false));
}

#[test]
fn a_task_that_owns_the_arm_by_then_is_stopped() {
    let killed = Cell::new(false);
    let done = halted(|number, call, millis| {
        killed.set(killed.get() || call == KILL);
        match call {
            HALT if number > 0 && !killed.get() => Some(Answer::Refused(OWNED)),
            POSITION if !killed.get() => Some(at(millis as f64)),
            _ => None,
        }
    });
    assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, Some(StoppedTasks::All), true)));
    assert_eq!((count(&done.calls, HALT), count(&done.calls, KILL)), (3, 1));
}

#[test]
fn a_robot_that_never_rests_still_moves() {
    for moving in [
        |call: &str, millis: u64| (call == POSITION).then(|| at(millis as f64)),
        |call: &str, _| (call == STATE).then(|| Answer::value(&MOVING)),
    ] {
        let done = halted(|_, call, millis| moving(call, millis));
        let halt = done.result.unwrap();
        assert_eq!(halt, outcome(HaltAnswer::Halted, None, false));
        assert_eq!(halt.to_string(), "the robot STILL MOVES");
        assert_eq!((count(&done.calls, HALT), count(&done.calls, KILL)), (2, 0), "no task runs");
        // each Robot_Halt has the whole time limit
        assert!((1000..1080).contains(&(done.now.as_micros() / 1000)), "{}", done.now);
    }
}

/// On a busy machine the time limit can pass before there were enough polls.
#[test]
fn a_robot_at_rest_is_not_said_to_move_after_slow_polls() {
    let config = HaltConfig { limit: Duration::ZERO, ..config() };
    for (speed, rests) in [(0.0, true), (1.0, false)] {
        let done = run(halt(HANDLES, config), |_, call, now| match call {
            POSITION => at(speed * now.as_micros() as f64),
            call => resting(call),
        });
        assert_eq!(done.result.unwrap().rests, rests);
    }
}

#[test]
fn tasks_are_stopped_after_a_refusal_and_the_robot_is_halted_again() {
    let done = halted(|number, _, _| (number == 0).then_some(Answer::Refused(OWNED)));
    assert_eq!(done.calls, [&[HALT, KILL, HALT][..], &POLL, &POLL, &POLL].concat());
    let halt = done.result.unwrap();
    assert_eq!(halt, outcome(HaltAnswer::Halted, Some(StoppedTasks::All), true));
    assert_eq!(halt.to_string(), "halted; all tasks were stopped (KillAll)");
}

#[test]
fn tasks_are_stopped_if_one_runs_and_the_robot_moves_on_after_a_halt() {
    let killed = Cell::new(false);
    let done = halted(|_, call, _| {
        killed.set(killed.get() || call == KILL);
        (call == STATE && !killed.get()).then(|| Answer::value(&(MOVING | RUNNING)))
    });
    assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, Some(StoppedTasks::All), true)));
    assert_eq!((count(&done.calls, HALT), count(&done.calls, KILL)), (2, 1));
    // and by each means once only
    let done = halted(|_, call, _| (call == STATE).then(|| Answer::value(&(MOVING | RUNNING))));
    let halt = done.result.unwrap();
    assert_eq!(halt, outcome(HaltAnswer::Halted, Some(StoppedTasks::Single(3)), false));
    assert_eq!((count(&done.calls, HALT), count(&done.calls, KILL)), (3, 1));
    assert_eq!(halt.to_string(), "the robot STILL MOVES; 3 tasks were stopped (Task_Stop)");
}

#[test]
fn tasks_are_stopped_one_by_one_if_kill_all_has_no_effect() {
    // the arm is owned, or the robot moves, until the third task is stopped; the first Task_Stop of each task fails
    let failures = [None, Some(Answer::Refused(HResult::E_FAIL)), Some(Answer::Failed(Failure::Timeout))];
    for (owned, failure) in [true, false].into_iter().flat_map(|owned| failures.clone().map(|failure| (owned, failure)))
    {
        let (stopped, attempts) = (Cell::new(0), Cell::new(0));
        let done = halted(|_, call, _| match call {
            HALT if owned && stopped.get() < 3 => Some(Answer::Refused(OWNED)),
            STATE if !owned && stopped.get() < 3 => Some(Answer::value(&(MOVING | RUNNING))),
            _ if call.starts_with("Task_Stop(") => {
                attempts.set(attempts.get() + 1);
                let fails = attempts.get() % 2 == 1;
                let answer = failure.clone().filter(|_| fails);
                stopped.set(stopped.get() + i32::from(answer.is_none()));
                answer
            }
            _ => None,
        });
        assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, Some(StoppedTasks::Single(3)), true)), "{owned}");
        assert_eq!(
            (count(&done.calls, KILL), count(&done.calls, "Task_Stop(")),
            (1, if failure.is_some() { 6 } else { 3 })
        );
    }
    // a Task_Stop that fails twice leaves its task out
    let done = halted(|number, call, _| match call {
        _ if number == 0 => Some(Answer::Refused(OWNED)),
        KILL => Some(Answer::Refused(HResult::E_NOTIMPL)),
        _ if call.starts_with("Task_Stop(") => Some(Answer::Refused(HResult::E_FAIL)),
        _ => None,
    });
    assert_eq!((done.result.map(|halt| halt.tasks), count(&done.calls, "Task_Stop(")), (Ok(None), 6));
}

#[test]
fn all_tasks_were_stopped_only_if_none_runs() {
    let killed_at = |until: u64| {
        halted(move |number, call, millis| match call {
            _ if number == 0 => Some(Answer::Refused(OWNED)),
            STATE if millis < until => Some(Answer::value(&RUNNING)),
            _ => None,
        })
    };
    // a task may need a moment to end
    assert_eq!(killed_at(200).result, Ok(outcome(HaltAnswer::Halted, Some(StoppedTasks::All), true)));
    let done = killed_at(u64::MAX);
    let halt = done.result.unwrap();
    assert_eq!(halt, outcome(HaltAnswer::Halted, Some(StoppedTasks::AllButRunning), true));
    assert_eq!(halt.to_string(), "halted; KillAll was accepted, but a task still runs");
    // a supervisory task continues if the robot rests
    assert_eq!((count(&done.calls, KILL), count(&done.calls, "Task_Stop(")), (1, 0));
}

#[test]
fn each_task_that_does_something_is_stopped_without_kill_all() {
    let refused = |number, call: &str| match call {
        _ if number == 0 => Some(Answer::Refused(OWNED)),
        KILL => Some(Answer::Refused(HResult::E_INVALID_CMD_NAME)),
        "Controller_GetTask(7, \"Pro1\", \"@IfNotMember\")" => Some(Answer::value(&31)),
        "Controller_GetTask(7, \"Pro2\", \"@IfNotMember\")" => Some(Answer::value(&32)),
        "Task_Execute(32, \"GetStatus\", EMPTY)" => Some(Answer::value(&2)),
        _ => None,
    };
    let done = halted(|number, call, _| refused(number, call));
    let of_task = |name: &str, handle: u8, stops: bool| {
        let get = [NAMES.to_string(), format!("Controller_GetTask(7, {name:?}, \"@IfNotMember\")")];
        let status = format!("Task_Execute({handle}, \"GetStatus\", EMPTY)");
        let stop = stops.then(|| format!("Task_Stop({handle}, 4, \"\")"));
        get.into_iter().chain([status]).chain(stop).chain([format!("Task_Release({handle})")]).collect::<Vec<_>>()
    };
    let tasks = [of_task("Pro1", 31, true), of_task("Pro2", 32, false), of_task("Pro3", 30, true)].concat();
    let text = |calls: &[&str]| calls.iter().map(ToString::to_string).collect::<Vec<_>>();
    let polls = text(&[POLL, POLL, POLL].concat());
    assert_eq!(done.calls, [text(&[HALT, KILL]), tasks, text(&[NAMES, HALT]), polls].concat());
    let halt = done.result.unwrap();
    assert_eq!(halt, outcome(HaltAnswer::Halted, Some(StoppedTasks::Single(2)), true));
    assert_eq!(halt.to_string(), "halted; 2 tasks were stopped (Task_Stop)");
    // a task of unknown state is stopped; one that cannot be opened is skipped
    let done = halted(|number, call, _| match call {
        "Controller_GetTask(7, \"Pro1\", \"@IfNotMember\")" => Some(Answer::Refused(HResult::E_FAIL)),
        _ if call.starts_with("Task_Execute(") => Some(Answer::Refused(HResult::E_NOTIMPL)),
        _ => refused(number, call),
    });
    assert_eq!(done.result.unwrap().tasks, Some(StoppedTasks::Single(2)));
    assert_eq!((count(&done.calls, "Task_Stop(32"), count(&done.calls, "Task_Release(")), (1, 2));
}

#[test]
fn a_list_of_many_tasks_is_stopped_to_its_end() {
    let names: Vec<String> = (0..20).map(|n| format!("T{n}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let done = halted(|number, call, _| match call {
        _ if number == 0 => Some(Answer::Refused(OWNED)),
        KILL => Some(Answer::Refused(HResult::E_NOTIMPL)),
        NAMES => Some(Answer::value(&names.as_slice())),
        _ => None,
    });
    assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, Some(StoppedTasks::Single(20)), true)));
    assert_eq!(count(&done.calls, "Task_Release("), 20);
}

#[test]
fn a_halt_that_stays_refused_is_no_halt_even_at_rest() {
    for tasks in [Answer::value(&[""; 0]), Answer::Refused(HResult::E_NOTIMPL), Answer::Empty] {
        let done = halted(|_, call, _| match call {
            HALT => Some(Answer::Refused(OWNED)),
            KILL => Some(Answer::Refused(HResult::E_NOTIMPL)),
            NAMES => Some(tasks.clone()),
            _ => None,
        });
        let halt = done.result.unwrap();
        assert_eq!(halt, outcome(HaltAnswer::Refused(OWNED), None, true));
        assert!(!halt.is_halted());
        assert!(halt.to_string().starts_with("the robot rests, but is not halted"), "{halt}");
        // each poll tries again
        assert_eq!((count(&done.calls, HALT), count(&done.calls, KILL)), (4, 1));
    }
    // a task that is stopped a little later frees the arm
    let done = halted(|_, call, millis| (call == HALT && millis < 100).then_some(Answer::Refused(OWNED)));
    assert_eq!(done.result.map(|halt| halt.tasks), Ok(Some(StoppedTasks::All)));
    let done = halted(|_, call, millis| match call {
        HALT => Some(Answer::Refused(OWNED)),
        POSITION => Some(at(millis as f64)),
        _ => None,
    });
    let text = done.result.unwrap().to_string();
    assert!(text.starts_with("the robot STILL MOVES; Robot_Halt was refused: 0x83500079"), "{text}");
    assert!(text.ends_with("; 3 tasks were stopped (Task_Stop)"), "{text}");
}

#[test]
fn in_slave_mode_sys_state_is_not_sent() {
    for mode in [Answer::value(&0x102), Answer::Refused(HResult::E_NOTIMPL), Answer::value(&"?")] {
        let done = halted(|_, call, _| (call == SLAVE).then(|| mode.clone()));
        assert_eq!(done.calls, [HALT, SLAVE, POSITION, SLAVE, POSITION, SLAVE, POSITION]);
        assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, None, true)));
        let moves = halted(|_, call, millis| match call {
            SLAVE => Some(mode.clone()),
            POSITION => Some(at(millis as f64)),
            _ => None,
        });
        assert_eq!(moves.result, Ok(outcome(HaltAnswer::Halted, None, false)));
    }
    // without SysState, rest is judged by the joints
    let done = halted(|_, call, _| (call == STATE).then_some(Answer::Refused(HResult::E_NOTIMPL)));
    assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, None, true)));
}

#[test]
fn a_busy_controller_is_asked_again_and_no_task_is_stopped() {
    let busy = Answer::Refused(HResult::E_BUSY_PROC);
    let done = halted(|_, _, millis| (millis < 300).then(|| busy.clone()));
    assert_eq!((done.result, count(&done.calls, KILL)), (Ok(outcome(HaltAnswer::Halted, None, true)), 0));
    let done = halted(|_, _, _| Some(busy.clone()));
    assert_eq!(done.result.err().and_then(|error| error.hresult()), Some(HResult::E_BUSY_PROC));
    assert_eq!(count(&done.calls, HALT), done.calls.len());
}

#[test]
fn a_halt_or_a_poll_without_a_reply_is_an_error() {
    for failure in [Failure::Timeout, Failure::NotSent, Failure::Lost] {
        for (number, call) in [HALT, SLAVE, STATE, POSITION].into_iter().enumerate() {
            let done = halted(|n, _, _| (n == number).then_some(Answer::Failed(failure)));
            let error = done.result.unwrap_err();
            assert_eq!((error.function, error.cause), (function_of(call), StepCause::Failed(failure)));
            assert_eq!(done.calls.len(), number + 1);
        }
    }
    for code in [HResult::E_HANDLE, HResult::E_NOT_CONNECTED] {
        let done = halted(|_, _, _| Some(Answer::Refused(code)));
        assert_eq!((done.result.err().and_then(|error| error.hresult()), done.calls.len()), (Some(code), 1));
    }
    for position in [Answer::Refused(HResult::E_FAIL), Answer::value(&[f64::NAN; 8]), Answer::Empty] {
        let done = halted(|_, call, _| (call == POSITION).then(|| position.clone()));
        assert_eq!(done.result.err().map(|error| error.function), Some(FunctionId::ROBOT_EXECUTE));
    }
}

#[test]
fn a_lost_reply_while_tasks_are_stopped_does_not_prevent_the_next_halt() {
    let first = |number: usize| (number == 0).then_some(Answer::Refused(OWNED));
    // the second call is KillAll, the third Robot_Halt
    for (lost, tasks) in [(1, None), (2, Some(StoppedTasks::All))] {
        let done =
            halted(|number, _, _| first(number).or((number == lost).then_some(Answer::Failed(Failure::Timeout))));
        assert_eq!(done.result, Ok(outcome(HaltAnswer::Halted, tasks, true)));
        assert_eq!(done.calls[..3], [HALT, KILL, HALT]);
    }
    let listed = ["Controller_GetTaskNames", "Controller_GetTask(", "Task_Execute", "Task_Stop", "Task_Release"];
    for call in listed {
        for (failure, goes_on) in [(Failure::Timeout, true), (Failure::NotSent, true), (Failure::Lost, false)] {
            let done = halted(|number, text, _| match text {
                KILL => Some(Answer::Refused(HResult::E_NOTIMPL)),
                _ if text.starts_with(call) => Some(Answer::Failed(failure)),
                _ => first(number),
            });
            assert_eq!(done.result.is_ok(), goes_on, "{call} {failure:?}");
            assert_eq!(count(&done.calls, HALT), if goes_on { 2 } else { 1 }, "{call} {failure:?}");
        }
    }
}
