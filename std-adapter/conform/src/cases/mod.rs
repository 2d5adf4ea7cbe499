//! The cases for devices: a table for each group, functions for cases that no table can express, and cases that are made of
//! the function table.

mod frames;
mod functions;
mod handles;
mod rac;
mod sessions;
mod slave;
mod table;
mod tasks;
mod timeouts;
mod udp;
mod variables;

use std::sync::LazyLock;

use crate::case::{Case, Group, Run};

/// The cases, read once.
static ALL: LazyLock<Vec<Case>> = LazyLock::new(|| {
    let tables = Group::ALL.into_iter().flat_map(|group| table::read(group, source(group), named(group)));
    let mut cases: Vec<_> = tables.chain(functions::cases()).chain(variables::system()).collect();
    cases.sort_by_key(Case::group);
    cases
});

/// Returns all cases, by group.
pub(crate) fn all() -> &'static [Case] {
    &ALL
}

/// Returns the table of a group.
const fn source(group: Group) -> &'static str {
    match group {
        Group::Frames => include_str!("frames.cases"),
        Group::Arguments => include_str!("arguments.cases"),
        Group::Types => include_str!("types.cases"),
        Group::Sessions => include_str!("sessions.cases"),
        Group::Timeouts => include_str!("timeouts.cases"),
        Group::Udp => include_str!("udp.cases"),
        Group::Handles => include_str!("handles.cases"),
        Group::Variables => include_str!("variables.cases"),
        Group::Tasks => include_str!("tasks.cases"),
        Group::Slave => include_str!("slave.cases"),
        Group::Rac => include_str!("rac.cases"),
        Group::Seen => include_str!("seen.cases"),
    }
}

/// Returns the cases of a group that are functions, by name.
const fn named(group: Group) -> &'static [(&'static str, Run)] {
    match group {
        Group::Frames => frames::FUNCTIONS,
        Group::Sessions => sessions::FUNCTIONS,
        Group::Timeouts => timeouts::FUNCTIONS,
        Group::Udp => udp::FUNCTIONS,
        Group::Handles => handles::FUNCTIONS,
        Group::Tasks => tasks::FUNCTIONS,
        Group::Slave => slave::FUNCTIONS,
        Group::Rac => rac::FUNCTIONS,
        Group::Arguments | Group::Types | Group::Variables | Group::Seen => &[],
    }
}

#[cfg(test)]
mod tests {
    use bcap_core::bcap::FunctionId;

    use super::*;
    use crate::case::{Arg, Body, Level, Step};

    /// Returns the level of a call by the function table of the core.
    fn level(function: FunctionId, args: &[Arg]) -> Level {
        // a missing text is an empty one
        let text = |at: usize| match args.get(at) {
            Some(Arg::S(text)) => Some(*text),
            _ => Some(""),
        };
        functions::level_of(function.properties(text(1), text(2)).effect)
    }

    #[test]
    fn the_level_of_a_case_allows_the_effects_of_its_calls() {
        let mut wrong = Vec::new();
        for case in all() {
            let Body::Steps(steps) = &case.body else { continue };
            for step in steps.iter() {
                let step = if let Step::Other(step) = step { step } else { step };
                let (Step::Call(function, args, _) | Step::Must(function, args, _) | Step::Open(_, function, args)) =
                    step
                else {
                    continue;
                };
                // a function or a command that does not exist has no effect
                let is_known =
                    function.signature().is_some() && !args.iter().any(|arg| matches!(arg, Arg::S("NoSuchCommand")));
                if is_known && level(*function, args) > case.level {
                    wrong.push(format!("{}: {step:?}", case.name()));
                }
            }
        }
        assert_eq!(wrong, [""; 0]);
    }
}
