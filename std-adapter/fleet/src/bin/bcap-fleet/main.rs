//! `bcap-fleet`: publishes the variables of many controllers until a signal ends it.

mod args;
mod check;
mod failure;
mod live;
mod output;
mod reload;

use std::io;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

use bcap_fleet::{Config, Fleet};
use bcap_service::events::{self, Log, utc};
use bcap_terminal::screen::{Live, require};
use bcap_terminal::{args::parse_or_exit, signal};
use clap::CommandFactory as _;
use tokio::runtime::{self, Runtime};
use tokio::sync::oneshot;

use crate::args::Args;
use crate::failure::Failure;
use crate::live::{Shown, ShownEvents};
use crate::output::{print, print_line};
use crate::reload::{Outcome, Reload};

fn main() -> ExitCode {
    let args: Args = parse_or_exit(|command| command);
    match execute(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(args.json),
    }
}

fn execute(args: &Args) -> Result<(), Failure> {
    let Some(path) = &args.config else { return Ok(print_reference(args)?) };
    let config = Config::read(path)?;
    match (args.check, args.screen) {
        (true, _) => check::check(&config, args.offline, args.json),
        (false, true) => run_on_screen(config),
        (false, false) => run(path, config),
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
fn run(path: &Path, mut config: Config) -> Result<(), Failure> {
    let (log, writer) = events::open(io::stdout())?;
    let log = Arc::new(log);
    runtime()?.block_on(async {
        // install the signal handlers first: a reader of the `ready` line may send a signal immediately
        let mut reload = Reload::new(path)?;
        let mut fleet = start(&config, &log).await?;
        let metrics = fleet.metrics_address().map(|address| format!(" metrics={address}")).unwrap_or_default();
        print_line(&format!("ready controllers={}{metrics}", config.controllers()))?;
        loop {
            let mut next = None;
            fleet.run(async { next = reload.wait(&log).await }).await;
            let Some(new) = next else { return Ok::<_, Failure>(()) };
            fleet = match start(&new, &log).await {
                Ok(fleet) => {
                    log.write(&Outcome::Reloaded { controllers: new.controllers() });
                    config = new;
                    fleet
                }
                Err(error) => {
                    log.write(&Outcome::ReloadFailed { reason: error.to_string() });
                    start(&config, &log).await?
                }
            };
        }
    })?;
    drop(log);
    writer.finish();
    Ok(())
}

/// Starts a fleet whose events are lines of a log.
async fn start(config: &Config, log: &Arc<Log>) -> Result<Fleet, bcap_fleet::Error> {
    let log = Arc::clone(log);
    Fleet::start(config.clone(), move |event| log.write(event)).await
}

/// Publishes until a signal arrives or the user quits, and shows the fleet.
fn run_on_screen(config: Config) -> Result<(), Failure> {
    require("leave --screen out").map_err(Failure::Usage)?;
    runtime()?.block_on(async {
        let ended = signal::wait()?;
        let events = ShownEvents::default();
        let shown = events.clone();
        let fleet = Fleet::start(config, move |event| shown.add(&utc(), event)).await?;
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
