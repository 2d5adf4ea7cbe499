//! Task objects.

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_testkit::value::Value;

use crate::bench::{Bench, Stop, fail};
use crate::case::Arg::{H, I, S, V};
use crate::case::Setup::{Controller, Task};
use crate::case::{Body, Case, Group, Level, Setup, Slot, Step, Want, case, steps};

const T: Slot = Slot::Task;
const A: Slot = Slot::A;

const fn task(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    setup: Setup,
    table: &'static [Step],
) -> Case {
    case(Group::Tasks, name, source, rule, setup, steps(table))
}

pub(super) const CASES: &[Case] = &[
    task(
        "names",
        "b-CAP specification, Appendix A",
        "the names of the tasks are an array of BSTR",
        Controller,
        &[Step::Call(F::CONTROLLER_GET_TASK_NAMES, &[H(Slot::Controller), S("")], Want::Array(8, 0))],
    ),
    task(
        "unknown",
        "b-CAP specification, section 4.2.1",
        "a task that does not exist is refused",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_TASK, &[H(Slot::Controller), S("NoSuchTask"), S("")], Want::Refused)],
    ),
    task(
        "empty-name",
        "b-CAP specification, section 4.2.1",
        "a task has a name",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_TASK, &[H(Slot::Controller), S(""), S("")], Want::Refused)],
    ),
    task(
        "name",
        "b-CAP specification, Appendix A",
        "Task_GetName returns a BSTR",
        Task,
        &[Step::Call(F::TASK_GET_NAME, &[H(T)], Want::Type(8))],
    ),
    task(
        "status",
        "public samples",
        "GetStatus returns an I4",
        Task,
        &[Step::Call(F::TASK_EXECUTE, &[H(T), S("GetStatus"), V("0,")], Want::Type(3))],
    ),
    task(
        "unknown-command",
        "b-CAP specification, Appendix A",
        "a command that does not exist is refused",
        Task,
        &[Step::Must(F::TASK_EXECUTE, &[H(T), S("NoSuchCommand"), V("0,")], Want::Refused)],
    ),
    task(
        "variable-names",
        "b-CAP specification, Appendix A",
        "the names of a task's variables are an array of BSTR",
        Task,
        &[Step::Call(F::TASK_GET_VARIABLE_NAMES, &[H(T), S("")], Want::Array(8, 0))],
    ),
    task(
        "start-with-wrong-mode",
        "b-CAP specification, section 4.2.2",
        "a mode of Task_Start that does not exist is refused",
        Task,
        &[Step::Call(F::TASK_START, &[H(T), I(99), S("")], Want::Refused)],
    )
    .at(Level::Motion),
    task(
        "stop-with-wrong-mode",
        "b-CAP specification, section 4.2.2",
        "a mode of Task_Stop that does not exist is refused",
        Task,
        &[Step::Call(F::TASK_STOP, &[H(T), I(99), S("")], Want::Refused)],
    )
    .at(Level::Motion),
    task(
        "start-without-mode",
        "b-CAP specification, section 4.2.2",
        "Task_Start has three arguments",
        Task,
        &[Step::Call(F::TASK_START, &[H(T)], Want::Code(&[HResult::E_INVALIDARG]))],
    )
    .at(Level::Motion),
    case(
        Group::Tasks,
        "start-and-stop",
        "b-CAP specification, section 4.2.2",
        "a started task runs until it ends or is stopped",
        Task,
        Body::Run(start_and_stop),
    )
    .at(Level::Motion),
];

/// GetStatus of a task that runs.
const RUNNING: Value = Value::I4(3);

fn start_and_stop(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(A, F::TASK_GET_VARIABLE, &[H(T), S("@STATUS"), S("")])?;
    let before = bench.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3))?;
    if before.value() == Some(&RUNNING) {
        return crate::bench::skip("the task runs already");
    }
    let started = bench.call(F::TASK_START, &[H(T), I(2), S("")])?;
    if started.code.is_err() {
        return crate::bench::skip(format!("Task_Start: {}", started.code));
    }
    let running = bench.call(F::VARIABLE_GET_VALUE, &[H(A)])?;
    // immediately, even if the reply above is wrong
    let stopped = bench.call(F::TASK_STOP, &[H(T), I(1), S("")])?;
    // a short program may have ended already, because mode 2 runs one cycle (b-CAP specification, section 4.2.2)
    let is_running = running.value() == Some(&RUNNING);
    let is_over = running.value() == before.value();
    if !(is_running || is_over) || running.code.is_err() {
        return fail(
            "the status 3 (running) after Task_Start, or that before it after a short program",
            running.text(),
        );
    }
    if stopped.code.is_err() {
        return fail("success of Task_Stop", stopped.text());
    }
    let after = bench.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3))?;
    match is_running && after.value() == running.value() {
        true => fail("another status than 3 (running) after Task_Stop", after.text()),
        false => Ok(()),
    }
}
