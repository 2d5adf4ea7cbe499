//! `bcap replay`: makes the calls of a capture again, and compares the replies.
//!
//! ```text
//!  plan   the capture  -> connections with their calls; what each call waits for; what must be allowed
//!  order  lets a call begin when the calls that were answered before it have been answered again
//!  link   a thread for each connection: handles are replaced, calls made, replies compared
//! ```

mod link;
mod order;
mod plan;

use std::sync::mpsc::channel;
use std::thread;
use std::time::Instant;

use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use serde::Serialize;
use serde_json::value::RawValue;

use self::link::{Came, Outcome};
use self::order::Order;
use self::plan::Plan;
use crate::args::{LinkArgs, Replay};
use crate::capture::{self, Call, reply_text, request_text};
use crate::error::Failure;
use crate::output::{print_block, print_json, print_line};
use crate::robot::Robot;
use crate::value::{self, Value};

/// Runs `bcap replay`.
pub(crate) fn replay(args: &Replay, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let (events, read) = capture::events(&args.file, Strictness::Lenient);
    read?;
    let plan = Plan::new(events)?;
    plan.check(&args.allow)?;
    let robot = Robot::resolve(&args.robot, link)?;
    let order = Order::new(plan.answered);
    let began = (!args.fast).then(Instant::now);
    let mut totals = Totals { connections: plan.links.len(), ..Totals::default() };
    thread::scope(|scope| {
        let (outcomes, received) = channel();
        let start = || {
            plan.links.iter().try_for_each(|planned| {
                let (outcomes, robot, order) = (outcomes.clone(), &robot, &order);
                let link =
                    link::Link { planned, robot, order, began, timeout: link.timeout(), volatile: &args.volatile };
                thread::Builder::new().spawn_scoped(scope, move || link.run(&outcomes)).map(drop)
            })
        };
        let started =
            start().map_err(|error| Failure::Input(format!("cannot start a thread for each connection: {error}")));
        drop(outcomes);
        let done = started.and_then(|()| received.iter().try_for_each(|outcome| totals.add(&outcome, json)));
        if done.is_err() {
            // without a reader of the output the robot must not be moved
            order.stop();
        }
        done
    })?;
    totals.print(json)?;
    match totals.differences {
        0 => Ok(()),
        different => Err(Failure::RepliesDiffer { different, total: totals.compared }),
    }
}

/// The numbers at the end.
#[derive(Default, Serialize)]
struct Totals {
    connections: usize,
    calls: usize,
    compared: usize,
    differences: usize,
}

impl Totals {
    /// Counts a call, and prints a difference.
    fn add(&mut self, outcome: &Outcome<'_>, json: bool) -> Result<(), Failure> {
        self.calls += 1;
        self.compared += usize::from(outcome.call.reply.is_some());
        self.differences += usize::from(outcome.is_different);
        if !outcome.is_different {
            return Ok(());
        }
        Ok(if json { print_json(&difference(outcome)) } else { print_block(&difference_text(outcome)) }?)
    }

    fn print(&self, json: bool) -> Result<(), Failure> {
        let Self { connections, calls, compared, differences } = self;
        if json {
            // serializing numbers cannot fail
            return Ok(print_json(&serde_json::to_string(self).unwrap_or_default())?);
        }
        let counted = |count: usize, noun: &str| format!("{count} {noun}{}", if count == 1 { "" } else { "s" });
        let [calls, connections, differences] =
            [(*calls, "call"), (*connections, "connection"), (*differences, "difference")]
                .map(|(n, noun)| counted(n, noun));
        Ok(print_line(&format!("{calls} of {connections}, {compared} replies compared, {differences}"))?)
    }
}

fn difference_text(outcome: &Outcome<'_>) -> String {
    let call = outcome.call;
    let recorded = call.reply.as_ref().map(|reply| reply_text(reply.code, reply.value.as_ref()));
    let came = match &outcome.came {
        Came::Reply(code, value) => reply_text(*code, value.as_ref()),
        Came::Nothing(why) => format!("no reply: {why}"),
    };
    let recorded = recorded.unwrap_or_else(|| "no reply".into());
    format!("{} {}\n  recorded: {recorded}\n  replayed: {came}", call.link, request_text(call))
}

/// A difference as a line of JSON.
#[derive(Serialize)]
struct Difference<'a> {
    link: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    serial: Option<u16>,
    call: String,
    recorded: Option<ReplyFields>,
    replayed: Option<ReplyFields>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'a str>,
}

#[derive(Serialize)]
struct ReplyFields {
    code: i32,
    hresult: Option<&'static str>,
    value: Option<Box<RawValue>>,
}

impl ReplyFields {
    fn new(code: HResult, value: Option<&Value>) -> Self {
        let value = value.and_then(|value| RawValue::from_string(value::to_json(value)).ok());
        Self { code: code.0, hresult: code.name(), value }
    }
}

fn difference(outcome: &Outcome<'_>) -> String {
    let call: &Call = outcome.call;
    let recorded = call.reply.as_ref().map(|reply| ReplyFields::new(reply.code, reply.value.as_ref()));
    let (replayed, error) = match &outcome.came {
        Came::Reply(code, value) => (Some(ReplyFields::new(*code, value.as_ref())), None),
        Came::Nothing(why) => (None, Some(why.as_str())),
    };
    let line =
        Difference { link: &call.link, serial: call.serial, call: request_text(call), recorded, replayed, error };
    // serializing strings, numbers and values cannot fail
    serde_json::to_string(&line).unwrap_or_default()
}
