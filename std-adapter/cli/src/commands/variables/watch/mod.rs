//! `bcap watch`: reads variables periodically.

mod csv_file;
mod mcap_file;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use bcap_capture::duration;
use bcap_std::ObjectPath;
use clap::Args;

use crate::commands::variables::put::GROUP;
use crate::commands::variables::watch::csv_file::Table;
use crate::commands::variables::watch::mcap_file::Samples;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::print;
use crate::session::Session;
use crate::session::variables::{expand, get_one, paths, read};
use bcap_capture::value::named::shown;
use bcap_capture::value::selection::Selection;
use bcap_core::variant::OwnedVariant as Value;

/// Reads variables periodically
///
/// A line begins with the seconds since the start; with --json it has the milliseconds as "ms". On SIGINT, SIGTERM and SIGHUP the
/// command releases its objects, stops the service and exits with 0.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap watch robot/@CURRENT_POSITION --interval 20
  bcap watch I1 I2 IO128 --changed --json
  bcap watch I1-I4 P1 --interval 10ms --count 100 --csv table.csv
  bcap watch I1 robot/@CURRENT_ANGLE --interval 20ms --count 100 --mcap values.mcap")]
pub(crate) struct Watch {
    /// The variables, as for `bcap get`
    #[arg(value_name = "NAME", required = true)]
    pub(crate) names: Vec<String>,

    /// The time from one round to the next, in ms or with a unit (10ms, 2s)
    #[arg(long, value_name = "MS", default_value = "100", value_parser = duration::parse)]
    pub(crate) interval: Duration,

    /// Prints a variable only when its value has changed; with --csv a row only when any value has changed
    #[arg(long, visible_alias = "changes")]
    pub(crate) changed: bool,

    /// Writes a table to a file instead: a row for each round, the seconds since the start in its first column `t`; - is the
    /// standard output
    ///
    /// An array has a column for each element, P1.1 to P1.7. An existing file is replaced.
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    pub(crate) csv: Option<PathBuf>,

    /// Writes the values to an MCAP file instead, for Foxglove and PlotJuggler: a topic for each variable, such as /I1
    ///
    /// A message is JSON with the field `value`; its time is the time of the reading. With --changed a value is written
    /// only when it has changed. An existing file is replaced.
    #[arg(long, value_name = "FILE.mcap", conflicts_with = "json")]
    pub(crate) mcap: Option<PathBuf>,

    /// Ends after this number of rounds
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,
}

/// Runs `bcap watch` until it is interrupted or has done `--count` rounds.
pub(crate) fn watch(args: &Watch, session: &mut Session, json: bool) -> Result<(), Failure> {
    let interrupt = session.handle_signals()?;
    let names = expand(session, &Selection::parse_each(&args.names)?)?;
    let paths = paths(&names)?;
    // before the files: a controller that cannot be reached does not cost the values of an earlier run
    paths.iter().take(GROUP).try_for_each(|path| session.object(path).map(drop))?;
    let table = args.csv.as_deref().map(Table::create).transpose()?;
    let samples = args.mcap.as_deref().map(Samples::create).transpose()?;
    let (start, last) = (Instant::now(), vec![None; paths.len()]);
    let mut output = Output { start, changed: args.changed, json, table, samples, last, is_new: false };
    let done = rounds(args, session, &interrupt, &names, &paths, &mut output);
    // even after a failure, so that the file has its index
    let ended = output.samples.as_mut().map_or(Ok(()), Samples::end);
    done.and(ended)
}

/// Reads the variables until `--count` or a signal ends it.
fn rounds(
    args: &Watch,
    session: &mut Session,
    interrupt: &Interrupt,
    names: &[String],
    paths: &[ObjectPath],
    output: &mut Output,
) -> Result<(), Failure> {
    let start = output.start;
    let mut pace = Pace { interval: args.interval, next: start };
    let mut rounds = 0;
    loop {
        session.restart_budget();
        let began = start.elapsed();
        for (n, path) in paths.iter().enumerate() {
            // the first ones stay open; a controller has a limit
            let value = match n {
                ..GROUP => session.object(path).and_then(|variable| read(session, path, variable)),
                _ => get_one(session, path),
            }?;
            output.value(n, &names[n], value)?;
        }
        output.end_round(began, names)?;
        rounds += 1;
        if args.count.is_some_and(|count| rounds >= count) {
            return Ok(());
        }
        if interrupt.sleep(pace.until_next(Instant::now())).is_err() {
            return Ok(());
        }
    }
}

/// Where the values go.
struct Output {
    start: Instant,
    /// Whether unchanged values are omitted.
    changed: bool,
    json: bool,
    /// Instead of lines.
    table: Option<Table>,
    /// Instead of lines.
    samples: Option<Samples>,
    /// The last value of each variable.
    last: Vec<Option<Value>>,
    /// Whether this round has a value to show.
    is_new: bool,
}

impl Output {
    fn value(&mut self, n: usize, name: &str, value: Value) -> Result<(), Failure> {
        let is_new = !self.changed || self.last[n].as_ref() != Some(&value);
        if let Some(samples) = self.samples.as_mut().filter(|_| is_new) {
            samples.push(name, self.start.elapsed(), &value)?;
        }
        if is_new && self.table.is_none() && self.samples.is_none() {
            print(&stamped(self.start.elapsed(), &shown(name, &value, self.json), self.json), self.json)?;
        }
        self.is_new |= is_new;
        self.last[n] = Some(value);
        Ok(())
    }

    fn end_round(&mut self, began: Duration, names: &[String]) -> Result<(), Failure> {
        let is_new = std::mem::take(&mut self.is_new);
        if let Some(samples) = &mut self.samples {
            samples.end_round(self.start.elapsed())?;
        }
        match &mut self.table {
            Some(table) if is_new => table.push(began, names, self.last.iter().flatten()),
            _ => Ok(()),
        }
    }
}

/// Adds the time since the start to the beginning of a line.
fn stamped(elapsed: Duration, line: &str, json: bool) -> String {
    if json {
        format!("{{\"ms\":{},{}", elapsed.as_millis(), &line[1..])
    } else {
        format!("{:10.3} {line}", elapsed.as_secs_f64())
    }
}

/// The schedule of the rounds: they start at multiples of the interval. Rounds that a slow controller missed are skipped.
struct Pace {
    interval: Duration,
    next: Instant,
}

impl Pace {
    fn until_next(&mut self, now: Instant) -> Duration {
        self.next += self.interval;
        if self.next < now {
            self.next = now;
        }
        self.next - now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_are_periodic_and_missed_rounds_are_skipped() {
        let start = Instant::now();
        let ms = Duration::from_millis;
        let mut pace = Pace { interval: ms(100), next: start };
        assert_eq!(pace.until_next(start + ms(30)), ms(70));
        assert_eq!(pace.until_next(start + ms(130)), ms(70));
        assert_eq!(pace.until_next(start + ms(570)), ms(0));
        assert_eq!(pace.until_next(start + ms(580)), ms(90));
    }

    #[test]
    fn lines_have_timestamps() {
        assert_eq!(stamped(Duration::from_millis(1234), "I1 = 5", false), "     1.234 I1 = 5");
        let json = stamped(Duration::from_millis(1234), r#"{"name":"I1","vt":3,"v":5}"#, true);
        assert_eq!(json, r#"{"ms":1234,"name":"I1","vt":3,"v":5}"#);
    }
}
