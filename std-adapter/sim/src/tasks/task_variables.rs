//! The system variables of a task.

use std::time::Duration;

use bcap_core::variant::Variant;

use super::task::Task;
use crate::answer::{Answer, Answered};
use crate::context::Context;
use crate::table::Property;
use crate::value::{ValueResult, one_int, owned};

type TaskGetter = fn(&Task) -> ValueResult;
type TaskSetter = fn(&mut Task, &mut Context<'_>, &Variant<'_>) -> Answered;

const fn read(name: &'static str, get: TaskGetter) -> Property<TaskGetter, TaskSetter> {
    Property::read(name, get)
}

const fn write(name: &'static str, put: TaskSetter, accepts: &'static str) -> Property<TaskGetter, TaskSetter> {
    Property::write(name, put, accepts)
}

/// The system variables of a task, in the order of Task_GetVariableNames.
pub(crate) const VARIABLES: &[Property<TaskGetter, TaskSetter>] = &[
    read("@STATUS", Task::status_value),
    read("@STATUS_DETAILS", Task::status_value),
    Property::unsupported("@PRIORITY"),
    // the line, and the file: file objects have no ID
    read("@LINE_NO", |task| owned([task.line(), 0])),
    read("@CYCLE_TIME", |task| millis(task.cycle_time())),
    read("@ELAPSED_TIME", |task| millis(task.elapsed)),
    write(
        "@START",
        |task, ctx, mode| task.start_for(ctx, one_int(mode)?),
        "one number: 1 one cycle, 2 continuous, 3 one line, 4 one line back",
    ),
    write(
        "@STOP",
        |task, ctx, mode| {
            task.stop_for(ctx, one_int(mode)?)?;
            Ok(Answer::Done)
        },
        "one number, 0 to 4",
    ),
];

fn millis(time: Duration) -> ValueResult {
    owned(i32::try_from(time.as_millis()).unwrap_or(i32::MAX))
}
