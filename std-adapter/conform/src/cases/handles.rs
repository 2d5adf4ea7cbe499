//! The handles of objects.

use std::collections::HashSet;

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::Arg::{H, I, S};
use crate::case::Setup::{Controller, Robot, Task};
use crate::case::{Body, Case, Group, Setup, Slot, Step, Want, case, steps};
use crate::device::Refusals;

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;
const B: Slot = Slot::B;
const INVALID: Want = Want::Code(&[HResult::E_HANDLE]);
const OPEN_A: Step = Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]);
const OPEN_B: Step = Step::Open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]);

const fn handles(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    setup: Setup,
    table: &'static [Step],
) -> Case {
    case(Group::Handles, name, source, rule, setup, steps(table))
}

const fn run(name: &'static str, rule: &'static str, run: fn(&mut Bench<'_>) -> Result<(), Stop>) -> Case {
    case(Group::Handles, name, "RAC specification, Table 2-3", rule, Controller, Body::Run(run))
}

pub(super) const CASES: &[Case] = &[
    handles(
        "zero",
        "RAC specification, Table 2-3",
        "0 is no handle",
        Controller,
        &[Step::Must(F::VARIABLE_GET_VALUE, &[I(0)], INVALID)],
    ),
    handles(
        "minus-one",
        "RAC specification, Table 2-3",
        "-1 is no handle",
        Controller,
        &[Step::Must(F::VARIABLE_GET_VALUE, &[I(-1)], INVALID)],
    ),
    handles(
        "largest",
        "RAC specification, Table 2-3",
        "2147483647 is no handle",
        Controller,
        &[Step::Must(F::VARIABLE_GET_VALUE, &[I(i32::MAX)], INVALID)],
    ),
    handles(
        "use-after-release",
        "b-CAP specification, section 4.1.4",
        "a released handle is invalid",
        Controller,
        &[
            OPEN_A,
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], INVALID),
        ],
    ),
    handles(
        "release-twice",
        "b-CAP specification, section 4.1.4",
        "a released handle cannot be released again",
        Controller,
        &[
            OPEN_A,
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], INVALID),
        ],
    ),
    handles(
        "release-of-another-object",
        "b-CAP specification, section 4.1.4",
        "the release of one object leaves the others",
        Controller,
        &[
            OPEN_A,
            OPEN_B,
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(B)], Want::Ok),
        ],
    ),
    handles(
        "two-of-one-name",
        "b-CAP specification, section 4.1.2",
        "two open objects have two handles",
        Controller,
        &[
            OPEN_A,
            OPEN_B,
            Step::Differ(A, B),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Ok),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(B)], Want::Ok),
        ],
    ),
    handles(
        "controller-as-variable",
        "RAC specification, Table 2-3",
        "the handle of a controller is no handle of a variable",
        Controller,
        &[Step::Must(F::VARIABLE_GET_VALUE, &[H(C)], INVALID)],
    ),
    handles(
        "variable-as-controller",
        "RAC specification, Table 2-3",
        "the handle of a variable is no handle of a controller",
        Controller,
        &[OPEN_A, Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(A), S("I1"), S("")], INVALID)],
    ),
    handles(
        "variable-as-robot",
        "RAC specification, Table 2-3",
        "the handle of a variable is no handle of a robot",
        Controller,
        &[OPEN_A, Step::Call(F::ROBOT_GET_NAME, &[H(A)], INVALID)],
    ),
    handles(
        "robot-as-variable",
        "RAC specification, Table 2-3",
        "the handle of a robot is no handle of a variable",
        Robot,
        &[Step::Must(F::VARIABLE_GET_VALUE, &[H(Slot::Robot)], INVALID)],
    ),
    handles(
        "robot-as-controller",
        "RAC specification, Table 2-3",
        "the handle of a robot is no handle of a controller",
        Robot,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(Slot::Robot), S("I1"), S("")], INVALID)],
    ),
    handles(
        "robot-as-task",
        "RAC specification, Table 2-3",
        "the handle of a robot is no handle of a task",
        Robot,
        &[Step::Call(F::TASK_GET_NAME, &[H(Slot::Robot)], INVALID)],
    ),
    handles(
        "task-as-robot",
        "RAC specification, Table 2-3",
        "the handle of a task is no handle of a robot",
        Task,
        &[Step::Call(F::ROBOT_GET_NAME, &[H(Slot::Task)], INVALID)],
    ),
    handles(
        "release-as-another-kind",
        "RAC specification, Table 2-3",
        "a variable cannot be released as a robot",
        Controller,
        &[OPEN_A, Step::Call(F::ROBOT_RELEASE, &[H(A)], INVALID), Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Ok)],
    ),
    handles(
        "robot-and-release",
        "b-CAP specification, section 4.3.5",
        "a robot is opened and released",
        Robot,
        &[
            Step::Must(F::ROBOT_RELEASE, &[H(Slot::Robot)], Want::NoValue),
            Step::Must(F::ROBOT_GET_NAME, &[H(Slot::Robot)], INVALID),
        ],
    ),
    handles(
        "task-and-release",
        "b-CAP specification, section 4.2.3",
        "a task is opened and released",
        Task,
        &[
            Step::Must(F::TASK_RELEASE, &[H(Slot::Task)], Want::NoValue),
            Step::Must(F::TASK_GET_NAME, &[H(Slot::Task)], INVALID),
        ],
    ),
    handles(
        "variable-of-robot",
        "b-CAP specification, Appendix A",
        "a robot has variables",
        Robot,
        &[
            Step::Open(A, F::ROBOT_GET_VARIABLE, &[H(Slot::Robot), S("@CURRENT_ANGLE"), S("")]),
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
        ],
    ),
    handles(
        "variable-of-task",
        "b-CAP specification, Appendix A",
        "a task has variables",
        Task,
        &[
            Step::Open(A, F::TASK_GET_VARIABLE, &[H(Slot::Task), S("@STATUS"), S("")]),
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
        ],
    ),
    handles(
        "name-of-variable",
        "b-CAP specification, Appendix A",
        "a variable has the name that it was opened with",
        Controller,
        &[OPEN_A, Step::Call(F::VARIABLE_GET_NAME, &[H(A)], Want::Value("8,I1"))],
    ),
    handles(
        "release-out-of-order",
        "b-CAP specification, section 4.1.6",
        "objects may be released in any order",
        Controller,
        &[
            OPEN_A,
            OPEN_B,
            Step::Must(F::VARIABLE_RELEASE, &[H(B)], Want::NoValue),
            Step::Must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue),
        ],
    ),
    run("of-another-client", "a handle belongs to the connection that got it", of_another_client),
    run("of-an-ended-client", "a handle of an ended connection is invalid for others", of_an_ended_client),
    run("twenty-different", "twenty open objects have twenty handles", twenty_different),
    run("many-opened-and-released", "300 objects may be opened and released in turn", opened_and_released),
    run("limit", "a device that has no room for a further object answers E_MAX_OBJECT, and serves the others", limit),
];

fn of_another_client(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    let mut stranger = bench.another()?;
    stranger.set_handle(A, bench.handle(A));
    stranger.must(F::VARIABLE_GET_VALUE, &[H(A)], INVALID)?;
    stranger.must(F::VARIABLE_RELEASE, &[H(A)], INVALID)?;
    bench.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Ok).map(drop)
}

fn of_an_ended_client(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut ended = bench.another()?;
    ended.open_controller()?;
    ended.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    let handle = ended.handle(A);
    ended.must(F::SERVICE_STOP, &[], Want::NoValue)?;
    drop(ended);
    bench.must(F::VARIABLE_GET_VALUE, &[I(handle)], INVALID).map(drop)
}

fn twenty_different(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut seen = HashSet::new();
    for _ in 0..20 {
        let reply = bench.call(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
        if [HResult::E_MAX_OBJECT, HResult::E_OUTOFMEMORY].contains(&reply.code) {
            return skip(format!("the device has room for {} variables; their handles differ", seen.len()));
        }
        bench.check(F::CONTROLLER_GET_VARIABLE, &reply, Want::Ok, Refusals::Skip)?;
        bench.keep(A, &reply)?;
        if !seen.insert(bench.handle(A)) {
            return fail("a handle of its own", format!("{} was given out twice", bench.handle(A)));
        }
    }
    Ok(())
}

fn opened_and_released(bench: &mut Bench<'_>) -> Result<(), Stop> {
    for _ in 0..300 {
        bench.open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
        bench.must(F::VARIABLE_RELEASE, &[H(A)], Want::NoValue)?;
    }
    Ok(())
}

fn limit(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
    for _ in 0..1100 {
        let reply = bench.call(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])?;
        match reply.code {
            code if code.is_ok() => {}
            HResult::E_MAX_OBJECT | HResult::E_OUTOFMEMORY => break,
            _ => return fail("success, E_MAX_OBJECT or E_OUTOFMEMORY", reply.text()),
        }
    }
    // room again after a release
    bench.must(F::VARIABLE_GET_VALUE, &[H(B)], Want::Ok)?;
    bench.must(F::VARIABLE_RELEASE, &[H(B)], Want::NoValue)?;
    bench.open(B, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")])
}
