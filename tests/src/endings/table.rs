//! The verdict on a trial, and the table of all.

use std::collections::BTreeMap;
use std::fmt;

use super::Seen;
use super::draw::{Ending, Job, Trial};

/// The faults that must not occur, in the order of the columns.
const FAULTS: [&str; 6] = ["false Arrived", "false Halted", "moving", "motor on", "arm taken", "no end"];

/// One row.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    trials: u32,
    arrived: u32,
    halted: u32,
    faults: [u32; 6],
}

impl Row {
    fn add(&mut self, seen: &Seen, faults: [bool; 6]) {
        let outcome = seen.report.as_ref().map(|report| report.outcome.as_str());
        self.trials += 1;
        self.arrived += u32::from(outcome == Some("arrived"));
        self.halted += u32::from(outcome == Some("halted"));
        for (count, fault) in self.faults.iter_mut().zip(faults) {
            *count += u32::from(fault);
        }
    }
}

/// The table.
#[derive(Debug, Default)]
pub(super) struct Table {
    endings: BTreeMap<(bool, &'static str), Row>,
    programs: BTreeMap<String, Row>,
    models: BTreeMap<String, Row>,
    /// Trials that could not be made.
    failed: Vec<String>,
    bad: u32,
}

/// Judges the observations.
fn faults(trial: &Trial, seen: &Seen) -> [bool; 6] {
    let Seen { report, stopped, last, disturbed, hangs } = seen;
    let reported = |name: &str| report.as_ref().filter(|report| report.outcome == name).map(|report| report.truth);
    let false_arrived = reported("arrived").is_some_and(|truth| truth.moving || !truth.there);
    // it was not stopped, and rests at its destination; an undisturbed program must arrive
    let undisturbed = trial.ending == Ending::Completes || !trial.ending.is_inside() && !disturbed;
    let false_halted =
        reported("halted").is_some_and(|truth| (truth.there && !truth.moving && truth.stops == 0) || undisturbed);
    let states = || stopped.iter().chain([last]);
    let motor = !trial.motor_before && states().any(|truth| truth.motor);
    [false_arrived, false_halted, states().any(|truth| truth.moving), motor, states().any(|truth| truth.arm), *hangs]
}

impl Table {
    /// Adds a trial, and prints its draws if it has a fault.
    pub(super) fn add(&mut self, trial: &Trial, seen: Result<Seen, String>) {
        let seen = match seen {
            Ok(seen) => seen,
            Err(error) => {
                self.failed.push(format!("trial {} of seed {}: {error}", trial.number, trial.seed));
                return;
            }
        };
        let faults = faults(trial, &seen);
        let apart = trial.ending.is_apart();
        // a program that cannot act may leave the robot as it is, but its report must be true
        let counted = if apart { &faults[..2] } else { &faults[..] };
        if counted.contains(&true) {
            self.bad += 1;
            let names: Vec<_> = FAULTS.iter().zip(faults).filter(|(_, is)| *is).map(|(name, _)| *name).collect();
            println!("FAILED {}: {trial:?}\n       {seen:?}", names.join(", "));
        }
        let program = match trial.job {
            Job::Stream { .. } => format!("{:?}, Slave Mode", trial.program),
            _ => format!("{:?}", trial.program),
        };
        self.endings.entry((apart, trial.ending.row())).or_default().add(&seen, faults);
        if !apart {
            self.programs.entry(program).or_default().add(&seen, faults);
            self.models.entry(format!("{:?}", trial.profile())).or_default().add(&seen, faults);
        }
    }

    /// Returns whether no trial has a fault.
    #[must_use]
    pub(super) fn is_good(&self) -> bool {
        self.bad == 0 && self.failed.is_empty()
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let head = |f: &mut fmt::Formatter<'_>, title: &str| {
            write!(f, "\n{title:<26} trials arrived halted")?;
            FAULTS.iter().try_for_each(|name| write!(f, "  {name}"))?;
            writeln!(f)
        };
        let row = |f: &mut fmt::Formatter<'_>, name: &str, row: &Row| {
            write!(f, "{name:<26} {:6} {:7} {:6}", row.trials, row.arrived, row.halted)?;
            for (name, count) in FAULTS.iter().zip(row.faults) {
                write!(f, "  {count:width$}", width = name.len())?;
            }
            writeln!(f)
        };
        let sum = |rows: &mut dyn Iterator<Item = &Row>| {
            rows.fold(Row::default(), |mut sum, row| {
                (sum.trials, sum.arrived) = (sum.trials + row.trials, sum.arrived + row.arrived);
                sum.halted += row.halted;
                sum.faults.iter_mut().zip(row.faults).for_each(|(sum, count)| *sum += count);
                sum
            })
        };
        for (apart, title) in [(false, "ending"), (true, "left to the watchdog")] {
            head(f, title)?;
            let rows = || self.endings.iter().filter(move |((is_apart, _), _)| *is_apart == apart);
            rows().try_for_each(|((_, name), counts)| row(f, name, counts))?;
            row(f, "all", &sum(&mut rows().map(|(_, counts)| counts)))?;
        }
        for (title, rows) in [("program", &self.programs), ("model", &self.models)] {
            head(f, title)?;
            rows.iter().try_for_each(|(name, counts)| row(f, name, counts))?;
        }
        self.failed.iter().try_for_each(|text| writeln!(f, "not made: {text}"))
    }
}
