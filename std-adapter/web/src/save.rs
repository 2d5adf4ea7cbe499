//! Files that a page saves: packets for Wireshark, and numbers for Foxglove and PlotJuggler.

use std::sync::Arc;

use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse as _, Response};
use axum::routing::post;
use bcap_capture::mcap::{Log, NUMBER};
use serde::Deserialize;
use serde_json::json;

use crate::app::App;
use crate::guard::{Refused, TOKEN, only};

/// The largest series of a page: ten numbers for ten minutes need 1 MB.
const SERIES: usize = 4 << 20;

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

async fn series(State(app): State<Arc<App>>, headers: HeaderMap, body: Bytes) -> Result<Response, Refused> {
    check(&app, &headers)?;
    let series: Vec<Series> =
        serde_json::from_slice(&body).map_err(|_| (StatusCode::BAD_REQUEST, "these are not series of numbers"))?;
    saved(mcap(&series))
}

fn check(app: &App, headers: &HeaderMap) -> Result<(), Refused> {
    app.guard.check_origin(headers)?;
    app.guard.check_user(headers, only(headers, TOKEN))
}

fn saved(file: std::io::Result<Vec<u8>>) -> Result<Response, Refused> {
    let file = file.map_err(|_| (StatusCode::INTERNAL_SERVER_ERROR, "the file cannot be made"))?;
    Ok(([(CONTENT_TYPE, "application/octet-stream")], file).into_response())
}

/// Writes a topic for each series, in the order of time.
fn mcap(series: &[Series]) -> std::io::Result<Vec<u8>> {
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
