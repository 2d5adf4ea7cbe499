//! Task objects.

use bcap_core::bcap::FunctionId as F;
use bcap_testkit::value::Value;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::Arg::{H, I, S};
use crate::case::{Run, Slot, Want};

const T: Slot = Slot::Task;
const A: Slot = Slot::A;
/// The cases of `tasks.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[("start-and-stop", start_and_stop)];

/// GetStatus of a running task.
const RUNNING: Value = Value::I4(3);

fn start_and_stop(bench: &mut Bench<'_>) -> Result<(), Stop> {
    bench.open(A, F::TASK_GET_VARIABLE, &[H(T), S("@STATUS"), S("")])?;
    let before = bench.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3))?;
    if before.value() == Some(&RUNNING) {
        return skip("the task runs already");
    }
    let started = bench.call(F::TASK_START, &[H(T), I(2), S("")])?;
    if started.result().is_err() {
        return skip(format!("Task_Start: {}", started.result()));
    }
    let running = bench.call(F::VARIABLE_GET_VALUE, &[H(A)])?;
    // immediately, even if the reply above is wrong
    let stopped = bench.call(F::TASK_STOP, &[H(T), I(1), S("")])?;
    // a short program may have ended already, because mode 2 runs one cycle (b-CAP specification, section 4.2.2)
    let is_running = running.value() == Some(&RUNNING);
    let is_over = running.value() == before.value();
    if !(is_running || is_over) || running.result().is_err() {
        return fail(
            "the status 3 (running) after Task_Start, or that before it after a short program",
            running.text(),
        );
    }
    if stopped.result().is_err() {
        return fail("success of Task_Stop", stopped.text());
    }
    let after = bench.must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3))?;
    if after.value() == Some(&RUNNING) {
        return fail("another status than 3 (running) after Task_Stop", after.text());
    }
    // a device that starts no task shows the same status
    if is_running { Ok(()) } else { skip("the program had ended before its status was read") }
}
