//! Recordings of the sessions with the controllers: a file for each, in the folder of the recordings.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use bcap_live::tap::{Outcome, Status, Tap};
use serde_json::{Value, json};

use crate::app::App;
use crate::config::Recordings;
use crate::names::names_in;
use crate::socket::{Answer, Page};
use crate::text::now;
use crate::threads::{on_disk, spawn};

/// The maximum number of recordings that a page shows.
const FILES: usize = 200;

/// Maximum time for the last packets of the recordings.
const FINISH: Duration = Duration::from_secs(2);

impl Page {
    /// Starts the recordings of all robots, or ends them. It is not an order to a robot, so it does not need the control.
    pub(crate) async fn record(&self, starts: bool) -> Answer {
        let done = self.with_disk(if starts { start } else { stop }).await;
        let what = if starts { "starts a recording" } else { "ends the recording" };
        self.app.audit.write("a page", "server", what, &done);
        done
    }

    /// Lists the recordings, in reverse order.
    pub(crate) async fn recordings(&self) -> Answer {
        self.with_disk(|_, settings| {
            let names = names_in(&settings.folder)?;
            Ok(names.iter().rev().filter_map(|name| row(&settings.folder, name)).take(FILES).collect())
        })
        .await
    }

    /// Does work that waits for the disk.
    async fn with_disk(&self, work: impl FnOnce(&App, &Recordings) -> Answer + Send + 'static) -> Answer {
        let app = Arc::clone(&self.app);
        on_disk(move || work(&app, app.config.recordings.as_ref().ok_or(NONE)?)).await
    }
}

const NONE: &str = "this server records nothing; start it with --recordings DIR";

fn start(app: &App, Recordings { folder, limit }: &Recordings) -> Answer {
    if app.robots.iter().any(|robot| matches!(robot.access.tap.status(), Status::Runs { .. })) {
        return Err("a recording runs; end it first".into());
    }
    std::fs::create_dir_all(folder).map_err(|error| format!("cannot record to {}: {error}", folder.display()))?;
    start_each(app.robots.iter().map(|robot| &robot.access.tap), folder, *limit)
}

/// Starts a recording of each robot; if one fails, of no robot. The time names the files.
fn start_each<'a>(taps: impl Iterator<Item = &'a Tap> + Clone, folder: &Path, limit: u64) -> Answer {
    let time = now().map(|time| time.to_string().replace([':', '.'], "-")).unwrap_or_default();
    for (number, tap) in (1..).zip(taps.clone()) {
        // the other recordings belong to another page that starts them at the same time
        let undo = || taps.clone().take(number - 1).for_each(|tap| drop(tap.stop()));
        tap.start(&folder.join(format!("{time}-{number}.pcapng")), limit).inspect_err(|_| undo())?;
    }
    Ok(Value::Null)
}

fn stop(app: &App, _: &Recordings) -> Answer {
    let ended = stop_all(app);
    if ended.is_empty() {
        return Err("no recording runs".into());
    }
    ended.into_iter().try_for_each(|(_, outcome)| outcome).map(|()| Value::Null)
}

/// Ends the recordings at the end of the server, which does not wait for a disk that hangs.
pub(crate) fn finish(app: Arc<App>) {
    let (done, ended) = channel();
    // without the thread, or without this end of the channel, the recordings end with the process
    let _ = spawn("end of recordings", move || drop(done.send(stop_all(&app))));
    let _ = ended.recv_timeout(FINISH);
}

/// Ends the recordings of all robots.
fn stop_all(app: &App) -> Vec<Outcome> {
    app.robots.iter().filter_map(|robot| robot.access.tap.stop()).collect()
}

/// Returns the name, the size and the length of a recording in seconds.
fn row(folder: &Path, name: &str) -> Option<Value> {
    let file = folder.join(name).metadata().ok().filter(|file| file.is_file() && name.ends_with(".pcapng"))?;
    let length = || file.modified().ok()?.duration_since(file.created().ok()?).ok();
    Some(json!([name, file.len(), length().map(|length| length.as_secs_f64())]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_that_fails_ends_no_recording_of_another_page() {
        let (folder, taps) = (tempfile::tempdir().unwrap(), [Tap::default(), Tap::default(), Tap::default()]);
        let of_another = folder.path().join("a");
        taps[1].start(&of_another, u64::MAX).unwrap();
        assert_eq!(start_each(taps.iter(), folder.path(), 1), Err("a recording runs; end it first".into()));
        assert!(matches!(taps[0].status(), Status::Ended((_, Ok(())))));
        assert!(matches!(taps[1].status(), Status::Runs { file, .. } if file == of_another));
        assert_eq!(taps[2].status(), Status::Off);
    }
}
