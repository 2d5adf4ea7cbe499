//! `bcap-fleet`: publishes the variables of many controllers until a signal ends it.

mod args;
mod check;
mod events;
mod failure;
mod live;
mod output;

use std::io;
use std::process::ExitCode;
use std::time::{SystemTime, UNIX_EPOCH};

use bcap_core::variant::OleDate;
use bcap_fleet::{Config, Fleet};
use bcap_terminal::screen::{Live, require};
use bcap_terminal::{args::parse_or_exit, signal};
use clap::CommandFactory as _;
use tokio::runtime::{self, Runtime};
use tokio::sync::oneshot;

use crate::args::Args;
use crate::failure::Failure;
use crate::live::{Shown, ShownEvents};
use crate::output::{print, print_line};

fn main() -> ExitCode {
    let args: Args = parse_or_exit(|command| command);
    match execute(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(args.json),
    }
}

fn execute(args: &Args) -> Result<(), Failure> {
    let Some(config) = &args.config else { return Ok(print_reference(args)?) };
    let config = Config::read(config)?;
    match (args.check, args.screen) {
        (true, _) => check::check(&config, args.offline, args.json),
        (false, true) => run_on_screen(config),
        (false, false) => run(config),
    }
}

/// Prints the completions or the manual page.
fn print_reference(args: &Args) -> io::Result<()> {
    let mut text = Vec::new();
    match args.completions {
        Some(shell) => clap_complete::generate(shell, &mut Args::command(), "bcap-fleet", &mut text),
        None => clap_mangen::Man::new(Args::command()).render(&mut text)?,
    }
    print(String::from_utf8_lossy(&text).trim_end())
}

/// Publishes until a signal arrives.
fn run(config: Config) -> Result<(), Failure> {
    let (events, printer) = events::start()?;
    runtime()?.block_on(async {
        // the signals first: a reader of the line may send one at once
        let ended = signal::wait()?;
        let controllers = config.controllers();
        let fleet = Fleet::start(config, move |event| events.add(event)).await?;
        let metrics = fleet.metrics_address().map(|address| format!(" metrics={address}")).unwrap_or_default();
        print_line(&format!("ready controllers={controllers}{metrics}"))?;
        fleet.run(ended).await;
        Ok::<_, Failure>(())
    })?;
    match printer.finish() {
        0 => {}
        count => eprintln!(" note: {count} lines were not printed, because the reader of the output was too slow"),
    }
    Ok(())
}

/// Publishes until a signal arrives or the user quits, and shows the fleet.
fn run_on_screen(config: Config) -> Result<(), Failure> {
    require("leave --screen out").map_err(Failure::Usage)?;
    runtime()?.block_on(async {
        let ended = signal::wait()?;
        let events = ShownEvents::default();
        let shown = events.clone();
        let fleet = Fleet::start(config, move |event| shown.add(&now(), event)).await?;
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

/// Makes the runtime: one thread is enough for many controllers.
fn runtime() -> io::Result<Runtime> {
    runtime::Builder::new_current_thread().enable_all().build()
}

/// Returns the time in UTC.
fn now() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let civil = i64::try_from(since.as_millis()).ok().and_then(OleDate::from_unix_millis).and_then(OleDate::to_civil);
    civil.map(|civil| format!("{civil}Z")).unwrap_or_default()
}
