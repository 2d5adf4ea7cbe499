//! The files of the page, and the headers that keep other pages out.

use axum::http::HeaderValue;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, HeaderName};
use axum::response::{IntoResponse, Response};

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The path, the type and the content of each file.
pub(crate) const FILES: &[(&str, &str, &str)] = &[
    ("/", HTML, include_str!("../page/index.html")),
    ("/style.css", CSS, include_str!("../page/style.css")),
    ("/icon.svg", "image/svg+xml", include_str!("../page/icon.svg")),
    ("/main.js", SCRIPT, include_str!("../page/main.js")),
    ("/net.js", SCRIPT, include_str!("../page/net.js")),
    ("/dom.js", SCRIPT, include_str!("../page/dom.js")),
    ("/cell.js", SCRIPT, include_str!("../page/cell.js")),
    ("/variables.js", SCRIPT, include_str!("../page/variables.js")),
    ("/alarms.js", SCRIPT, include_str!("../page/alarms.js")),
    ("/arm.js", SCRIPT, include_str!("../page/arm.js")),
    ("/space.js", SCRIPT, include_str!("../page/space.js")),
    ("/jog.js", SCRIPT, include_str!("../page/jog.js")),
    ("/tasks.js", SCRIPT, include_str!("../page/tasks.js")),
    ("/plots.js", SCRIPT, include_str!("../page/plots.js")),
    ("/packets.js", SCRIPT, include_str!("../page/packets.js")),
    ("/bytes.js", SCRIPT, include_str!("../page/bytes.js")),
    ("/raw.js", SCRIPT, include_str!("../page/raw.js")),
    ("/panel.js", SCRIPT, include_str!("../page/panel.js")),
    ("/backup.js", SCRIPT, include_str!("../page/backup.js")),
    ("/session.js", SCRIPT, include_str!("../page/session.js")),
    ("/login.js", SCRIPT, include_str!("../page/login.js")),
];

/// The headers of every response.
///
/// Scripts and styles only from this server, no frames, no plug-ins, no forms, no other host.
const HEADERS: [(&str, &str); 7] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
    ("permissions-policy", "camera=(), microphone=(), geolocation=(), usb=(), serial=()"),
];

/// Returns a file.
pub(crate) fn file(kind: &'static str, content: &'static str) -> Response {
    ([(CONTENT_TYPE, kind)], content).into_response()
}

/// Adds the headers of every response.
pub(crate) async fn with_headers(mut response: Response) -> Response {
    for (name, value) in HEADERS {
        response.headers_mut().insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    // another version of the command may listen here next
    response.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}
