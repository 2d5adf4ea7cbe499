//! Files that a page saves: packets and recordings for Wireshark, and numbers for Foxglove and PlotJuggler.

use std::fs::File;
use std::io::{self, Read as _};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse as _, Response};
use axum::routing::post;
use bcap_capture::mcap::{Log, NUMBER};
use futures_core::Stream;
use serde::Deserialize;
use serde_json::json;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::task::spawn_blocking;

use crate::app::App;
use crate::backup::path_in;
use crate::guard::{Refused, TOKEN, only};

/// The largest series of a page: ten numbers for ten minutes need 1 MB.
const SERIES: usize = 4 << 20;

/// The size of a piece of a recording, and how many wait for the page.
const PIECE: u64 = 64 << 10;
const PIECES: usize = 4;

const BYTES: &str = "application/octet-stream";

/// A number over time: milliseconds since 1970, and the value.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Series {
    name: String,
    samples: Vec<(u64, f64)>,
}

/// Returns the routes. They are POST, so that a browser sends their origin.
pub(crate) fn routes() -> Router<Arc<App>> {
    Router::new()
        .route("/packets/{robot}", post(packets))
        .route("/recordings/{name}", post(recording))
        .route("/mcap", post(series).layer(DefaultBodyLimit::max(SERIES)))
}

async fn packets(
    State(app): State<Arc<App>>,
    Path(robot): Path<usize>,
    headers: HeaderMap,
) -> Result<Response, Refused> {
    check(&app, &headers)?;
    let robot = app.robots.get(robot).ok_or((StatusCode::NOT_FOUND, "there is no such robot"))?;
    let file = robot.live().tape.pcapng().ok_or((StatusCode::CONFLICT, "there was no connection to the controller"))?;
    saved(file)
}

/// Sends a recording piece by piece, read by a thread, because the disk must not delay a halt.
async fn recording(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Refused> {
    check(&app, &headers)?;
    let none = (StatusCode::NOT_FOUND, "there is no such recording");
    let folder = app.config.recordings.as_ref().map(|recordings| &recordings.folder).ok_or(none)?;
    let path = path_in(folder, &name).map_err(|_| none)?;
    let (sender, pieces) = channel(PIECES);
    let open = move || if path.is_file() { File::open(&path).ok() } else { None };
    let Ok(Some(file)) = spawn_blocking(open).await else { return Err(none) };
    spawn_blocking(move || send(&file, &sender));
    Ok(([(CONTENT_TYPE, BYTES)], Body::from_stream(Pieces(pieces))).into_response())
}

/// Sends the pieces of a file until its end, an error, or the end of the page.
fn send(mut file: &File, pieces: &Sender<io::Result<Vec<u8>>>) {
    let (mut is_open, mut has_more) = (true, true);
    while is_open && has_more {
        let mut piece = Vec::new();
        let read = file.by_ref().take(PIECE).read_to_end(&mut piece);
        has_more = matches!(read, Ok(1..));
        is_open = pieces.blocking_send(read.map(|_| piece)).is_ok();
    }
}

/// The pieces of a file.
struct Pieces(Receiver<io::Result<Vec<u8>>>);

impl Stream for Pieces {
    type Item = io::Result<Vec<u8>>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.0.poll_recv(context)
    }
}

async fn series(State(app): State<Arc<App>>, headers: HeaderMap, body: Bytes) -> Result<Response, Refused> {
    check(&app, &headers)?;
    let series: Vec<Series> =
        serde_json::from_slice(&body).map_err(|_| (StatusCode::BAD_REQUEST, "these are not series of numbers"))?;
    saved(mcap(&series))
}

fn check(app: &App, headers: &HeaderMap) -> Result<(), Refused> {
    app.guard.check_origin(headers)?;
    app.guard.check_user(headers, only(headers, TOKEN)).map(drop)
}

fn saved(file: io::Result<Vec<u8>>) -> Result<Response, Refused> {
    let file = file.map_err(|_| (StatusCode::INTERNAL_SERVER_ERROR, "the file cannot be made"))?;
    Ok(([(CONTENT_TYPE, BYTES)], file).into_response())
}

/// Writes a topic for each series, in the order of time.
fn mcap(series: &[Series]) -> io::Result<Vec<u8>> {
    let mut samples: Vec<(u64, f64, &str)> = Vec::new();
    for Series { name, samples: of } in series {
        samples.extend(of.iter().map(|(at, value)| (*at, *value, name.as_str())));
    }
    samples.sort_by_key(|(at, ..)| *at);
    let mut log = Log::new(Vec::new())?;
    for (at, value, name) in samples {
        log.push(&format!("/{name}"), NUMBER, at.saturating_mul(1_000_000), &json!({ "value": value }))?;
    }
    log.end()?;
    Ok(log.into_inner())
}
