//! `bcap replay`: makes the calls of a capture again, and prints the replies that differ.

use bcap_capture::decode::events;
use bcap_capture::replay::{Options, Plan};
use bcap_core::limits::Strictness;

use crate::args::{LinkArgs, Replay};
use crate::error::Failure;
use crate::output::{print_block, print_json, print_line};
use crate::{robot, traffic};

/// Runs `bcap replay`.
pub(crate) fn replay(args: &Replay, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let (events, read) = events(&args.file, Strictness::Lenient);
    read?;
    let plan = Plan::new(events)?;
    plan.check(&args.allow)?;
    let robot = robot::resolve(&args.robot, link)?;
    let mut options = Options::new(link.timeout());
    options.fast = args.fast;
    options.volatile.clone_from(&args.volatile);
    options.recorder = traffic::recorder().cloned();
    let totals = plan.run(&robot, &options, |outcome| match outcome.is_different {
        true if json => print_json(&outcome.to_json()),
        true => print_block(&outcome.to_string()),
        false => Ok(()),
    })?;
    if json {
        // serializing numbers cannot fail
        print_json(&serde_json::to_string(&totals).unwrap_or_default())?;
    } else {
        print_line(&totals.to_string())?;
    }
    match totals.differences {
        0 => Ok(()),
        different => Err(Failure::RepliesDiffer { different, total: totals.compared }),
    }
}
