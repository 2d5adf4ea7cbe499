//! Files that a page saves: packets and recordings for Wireshark, and numbers for Foxglove and PlotJuggler.

use std::io;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse as _;
use axum::routing::post;
use bcap_capture::mcap::{Log, NUMBER};
use serde::Deserialize;
use serde_json::json;
use tokio::fs::File;
use tokio::sync::Semaphore;
use tokio::task::spawn_blocking;
use tokio_util::io::ReaderStream;

use crate::app::App;
use crate::names::path_in;
use crate::secret::{Checked, Refused};
use crate::threads::on_disk;

/// The largest series of a page: ten numbers for ten minutes need 1 MB.
const SERIES: usize = 4 << 20;

/// The maximum number of samples of a file.
const SAMPLES: usize = 100_000;

/// Makes one file at a time; a second request waits.
static TURN: Semaphore = Semaphore::const_new(1);

/// The size of a piece of a recording.
const PIECE: usize = 64 << 10;

/// A number over time: milliseconds since 1970, and the value.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Series {
    name: String,
    samples: Vec<(u64, f64)>,
}

/// Returns the routes, for users of this page only. They are POST, so that a browser sends their origin.
pub(crate) fn routes() -> Router<Arc<App>> {
    Router::new()
        .route("/packets/{robot}", post(packets))
        .route("/recordings/{name}", post(recording))
        .route("/mcap", post(series).layer(DefaultBodyLimit::max(SERIES)))
}

async fn packets(State(app): State<Arc<App>>, Path(robot): Path<usize>) -> Checked {
    let robot = app.robots.get(robot).ok_or((StatusCode::NOT_FOUND, "there is no such robot"))?;
    let file = robot.live().tape.pcapng().ok_or((StatusCode::CONFLICT, "there was no connection to the controller"))?;
    saved(file)
}

/// Sends a recording piece by piece. Other threads read it, because the disk must not delay a halt.
async fn recording(State(app): State<Arc<App>>, Path(name): Path<String>) -> Checked {
    let none = (StatusCode::NOT_FOUND, "there is no such recording");
    let folder = app.config.recordings.as_ref().map(|recordings| &recordings.folder).ok_or(none)?;
    let path = path_in(folder, &name).map_err(|_| none)?;
    let open = move || {
        // opening another kind of file may block forever
        let is_file = path.metadata().is_ok_and(|found| found.is_file());
        Ok(is_file.then(|| std::fs::File::open(path)).and_then(Result::ok))
    };
    let file = on_disk(open).await.map_err(|_| (StatusCode::SERVICE_UNAVAILABLE, "the disk does not answer"))?;
    let pieces = ReaderStream::with_capacity(File::from_std(file.ok_or(none)?), PIECE);
    Ok(([(CONTENT_TYPE, "application/octet-stream")], Body::from_stream(pieces)).into_response())
}

/// Creates a file of series. Another thread does it, because it must not delay a halt.
async fn series(body: Bytes) -> Checked {
    let turn = TURN.acquire().await;
    let make = move || {
        let _turn = turn;
        let series: Vec<Series> =
            serde_json::from_slice(&body).map_err(|_| (StatusCode::BAD_REQUEST, "these are not series of numbers"))?;
        if series.iter().map(|series| series.samples.len()).sum::<usize>() > SAMPLES {
            return Err((StatusCode::PAYLOAD_TOO_LARGE, "there are more than 100,000 samples; choose fewer series"));
        }
        saved(mcap(&series))
    };
    spawn_blocking(make).await.unwrap_or(Err(NOT_MADE))
}

const NOT_MADE: Refused = (StatusCode::INTERNAL_SERVER_ERROR, "the file cannot be made");

fn saved(file: io::Result<Vec<u8>>) -> Checked {
    Ok(file.map_err(|_| NOT_MADE)?.into_response())
}

/// Writes a topic for each series, in the order of time.
fn mcap(series: &[Series]) -> io::Result<Vec<u8>> {
    let numbers = series.iter().flat_map(|Series { name, samples }| samples.iter().map(move |sample| (sample, name)));
    let mut samples: Vec<_> = numbers.map(|(&(at, value), name)| (at, value, name)).collect();
    samples.sort_by_key(|(at, ..)| *at);
    let mut log = Log::new(Vec::new())?;
    for (at, value, name) in samples {
        log.push(&format!("/{name}"), NUMBER, at.saturating_mul(1_000_000), &json!({ "value": value }))?;
    }
    log.end()?;
    Ok(log.into_inner())
}
