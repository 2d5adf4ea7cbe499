//! The files of the page, and the headers that keep other pages out.

use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

/// Includes files of the page by their names.
macro_rules! files {
    ($($name:literal)+) => { &[$(($name, include_str!(concat!("../page/", $name)))),+] };
}

/// The names and the contents of the files.
pub(crate) const FILES: &[(&str, &str)] = files! {
    "index.html" "style.css" "icon.svg" "main.js" "net.js" "dom.js" "cell.js" "variables.js" "alarms.js" "arm.js" "space.js"
    "jog.js" "tasks.js" "plots.js" "packets.js" "bytes.js" "raw.js" "panel.js" "backup.js" "session.js" "login.js"
};

/// Returns a file with its type.
pub(crate) fn file(name: &'static str, content: &'static str) -> impl IntoResponse {
    let kind = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    };
    ([(CONTENT_TYPE, kind)], content)
}

/// The headers of every response.
///
/// Scripts and styles only from this server, no frames, no plug-ins, no forms, no other host.
const HEADERS: [(&str, &str); 8] = [
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
    // another version of the command may listen here next
    ("cache-control", "no-store"),
];

/// Adds the headers of every response.
pub(crate) async fn with_headers(response: Response) -> impl IntoResponse {
    (HEADERS, response)
}
