//! `bcap fleet`: the arguments and the output of the crate `bcap-fleet`.

mod live;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use bcap_core::variant::OleDate;
use bcap_fleet::{Config, Error, Event, Fleet, Row};
use bcap_terminal::screen::{Live, require};
use bcap_terminal::signal;
use serde::Serialize;
use tokio::sync::oneshot;

use crate::args;
use crate::error::Failure;
use crate::listen::runtime;
use crate::output::{note, print_json, print_line};
use live::{Events, Shown};

/// The most lines that wait for the output.
const BACKLOG: usize = 4096;

/// The longest time that the end waits for the output.
const CLOSE: Duration = Duration::from_secs(2);

/// Runs `bcap fleet`.
pub(crate) fn fleet(args: &args::Fleet, json: bool) -> Result<(), Failure> {
    let config = Config::read(&args.config).map_err(failure)?;
    match (args.check, args.screen) {
        (true, _) => check(&config, json),
        (false, true) => on_screen(config),
        (false, false) => run(config),
    }
}

fn failure(error: Error) -> Failure {
    match error {
        Error::Listen { .. } => Failure::Connection {
            message: error.to_string(),
            hint: "choose another port in [metrics]; port 0 takes a free one".into(),
        },
        error => Failure::Input(error.to_string()),
    }
}

/// Publishes until a signal arrives.
fn run(config: Config) -> Result<(), Failure> {
    let (lines, waiting) = sync_channel(BACKLOG);
    let dropped = Arc::new(AtomicU64::new(0));
    let writer = thread::Builder::new().name("events".into()).spawn(move || write(&waiting))?;
    runtime()?.block_on(async {
        // the signals first: a reader of the line may send one at once
        let ended = signal::wait()?;
        let controllers = config.controllers();
        let (log, count) = (lines.clone(), Arc::clone(&dropped));
        let fleet = Fleet::start(config, move |event| send(&log, &count, event)).await.map_err(failure)?;
        let metrics = fleet.metrics_address().map(|address| format!(" metrics={address}")).unwrap_or_default();
        print_line(&format!("ready controllers={controllers}{metrics}"))?;
        fleet.run(ended).await;
        Ok::<_, Failure>(())
    })?;
    drop(lines);
    let until = Instant::now() + CLOSE;
    while !writer.is_finished() && Instant::now() < until {
        thread::sleep(Duration::from_millis(1));
    }
    match dropped.load(Ordering::Relaxed) {
        0 => {}
        count => note(&format!("{count} lines were not printed, because the reader of the output was too slow")),
    }
    Ok(())
}

/// Publishes until a signal arrives or the user quits, and shows the fleet.
fn on_screen(config: Config) -> Result<(), Failure> {
    require("leave --screen out").map_err(Failure::Input)?;
    runtime()?.block_on(async {
        let ended = signal::wait()?;
        let events = Events::default();
        let shown = events.clone();
        let fleet = Fleet::start(config, move |event| shown.add(&now(), event)).await.map_err(failure)?;
        let metrics = fleet.metrics_address().map(|address| address.to_string());
        let mut shown = Shown::new(fleet.monitor(), events, metrics);
        let (quit, quits) = oneshot::channel::<()>();
        let live = Live::open(quit, move |keys| shown.screen(keys))?;
        let mut closed = Ok(());
        let ended = async {
            tokio::select! {
                () = ended => {}
                // the sender is dropped
                _ = quits => {}
            }
            closed = live.close();
        };
        fleet.run(ended).await;
        Ok(closed?)
    })
}

/// Returns the time in UTC.
fn now() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let civil = i64::try_from(since.as_millis()).ok().and_then(OleDate::from_unix_millis).and_then(OleDate::to_civil);
    civil.map(|civil| format!("{civil}Z")).unwrap_or_default()
}

/// An event with its time in UTC.
#[derive(Serialize)]
struct Line<'a> {
    time: String,
    #[serde(flatten)]
    event: &'a Event,
}

/// Gives a line to the writer. A reader that does not read loses lines, which are counted, and does not delay the fleet.
fn send(lines: &SyncSender<String>, dropped: &AtomicU64, event: &Event) {
    if let Ok(line) = serde_json::to_string(&Line { time: now(), event })
        && lines.try_send(line).is_err()
    {
        dropped.fetch_add(1, Ordering::Relaxed);
    }
}

fn write(lines: &Receiver<String>) {
    while let Ok(line) = lines.recv() {
        if print_json(&line).is_err() {
            return;
        }
    }
}

/// A row of the check as JSON.
#[derive(Serialize)]
struct RowLine<'a> {
    name: &'a str,
    what: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    us: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'a str>,
}

/// Tries everything once, and prints a table.
fn check(config: &Config, json: bool) -> Result<(), Failure> {
    let rows = runtime()?.block_on(bcap_fleet::check(config)).map_err(failure)?;
    let width = |of: fn(&Row) -> &str| rows.iter().map(|row| of(row).chars().count()).max().unwrap_or(0);
    let (names, whats) = (width(|row| &row.name), width(|row| &row.what));
    for row in &rows {
        let us = |time: &Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        if json {
            let ok = row.result.as_ref().ok();
            let line = RowLine {
                name: &row.name,
                what: &row.what,
                value: ok.map(|(value, _)| value.as_str()),
                us: ok.map(|(_, time)| us(time)),
                error: row.result.as_ref().err().map(String::as_str),
            };
            print_json(&serde_json::to_string(&line).unwrap_or_default())?;
            continue;
        }
        let Row { name, what, result, .. } = row;
        let result = match result {
            Ok((value, time)) => format!("ok    {:>8.1} ms  {value}", time.as_secs_f64() * 1000.0),
            Err(error) => format!("error {error}"),
        };
        print_line(&format!("{name:names$}  {what:whats$}  {result}"))?;
    }
    let failed = rows.iter().filter(|row| row.result.is_err()).count();
    if failed == 0 {
        return Ok(());
    }
    note("an address or name in the configuration may be wrong, or the device is not reachable from here");
    Err(Failure::Connection {
        message: format!("{failed} of {} checks failed", rows.len()),
        hint: "the lines above say which, and why".into(),
    })
}
