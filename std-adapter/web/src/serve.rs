//! Accepts connections, and answers their requests.

use std::collections::VecDeque;
use std::future::ready;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{DefaultBodyLimit, Path, Request, State};
use axum::http::header::{SEC_WEBSOCKET_PROTOCOL, SET_COOKIE};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::middleware::{Next, from_fn_with_state, map_response};
use axum::response::IntoResponse as _;
use axum::routing::{any, get, post};
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use serde_json::json;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::AbortHandle;

use crate::app::App;
use crate::assets::{FILES, file, with_headers};
use crate::guard::{Guard, TOKEN};
use crate::login::Open;
use crate::robot::Robot;
use crate::secret::{Checked, Refused, only};
use crate::text::safe;
use crate::tls::Acceptor;
use crate::{save, socket, tls};

/// The maximum number of connections that are not pages. A further connection ends the oldest, so that idle connections cannot
/// block a halt.
const CONNECTIONS: usize = 128;

/// Maximum time for the headers of a request, and for an idle connection.
const HEADERS: Duration = Duration::from_secs(10);

/// The largest headers of a request.
const HEADER_SIZE: usize = 16 << 10;

/// The largest order of a page.
const ORDER_SIZE: usize = 64 << 10;

/// Maximum length of a password.
const PASSWORD_SIZE: usize = 1 << 10;

/// The protocol of the WebSocket; a page offers the token as a second one, because scripts cannot set its headers.
const PROTOCOL: &str = "bcap.live";

/// Accepts connections. It does not end.
pub(crate) async fn accept(listener: &TcpListener, app: &Arc<App>, tls: Option<&Acceptor>) {
    let (router, mut open) = (router(app), VecDeque::<AbortHandle>::new());
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            // a peer that is gone, or no file descriptors left for a moment
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        open.retain(|connection| !connection.is_finished());
        if open.len() >= CONNECTIONS
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
        }
        let (router, tls) = (router.clone().layer(Extension(peer.ip())), tls.cloned());
        open.push_back(tokio::spawn(connection(stream, router, tls)).abort_handle());
    }
}

async fn connection(stream: TcpStream, router: Router, tls: Option<Acceptor>) {
    // a halt must not wait for other bytes
    let _ = stream.set_nodelay(true);
    let Some(tls) = tls else { return serve(stream, router).await };
    if let Some(stream) = tls::accept(&tls, stream).await {
        serve(stream, router).await;
    }
}

async fn serve<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(stream: S, router: Router) {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADERS).max_buf_size(HEADER_SIZE);
    let served = http.serve_connection(TokioIo::new(stream), TowerToHyperService::new(router)).with_upgrades();
    // an error of a connection is the peer's
    let _ = served.await;
}

fn router(app: &Arc<App>) -> Router {
    let files = FILES.iter().fold(Router::new(), |router, &(name, content)| {
        let path = if name == "index.html" { "/".into() } else { format!("/{name}") };
        router.route(&path, get(move || ready(file(name, content))))
    });
    let check = |check: Check| from_fn_with_state((Arc::clone(app), check), checked);
    // the token of a WebSocket is in another header
    let has_token: Check = |guard, headers| guard.check_user(headers, only(headers, TOKEN)).map(drop);
    let of_users = save::routes()
        .route("/halt/{robot}", post(halt).layer(DefaultBodyLimit::max(NAME_SIZE)))
        .route_layer(check(has_token));
    let of_this_origin = of_users
        .route("/live", any(live))
        .route("/login", post(log_in).layer(DefaultBodyLimit::max(PASSWORD_SIZE)))
        .route("/logout", post(log_out))
        // a browser sends the origin with POST, and with a WebSocket
        .route_layer(check(Guard::check_origin));
    files
        .route("/session", get(session))
        .merge(of_this_origin)
        .layer(DefaultBodyLimit::max(0))
        .layer(check(Guard::check_host))
        .layer(map_response(with_headers))
        .with_state(Arc::clone(app))
}

/// A check of the headers of a request.
type Check = fn(&Guard, &HeaderMap) -> Result<(), Refused>;

/// Answers requests that a check refuses with an error.
async fn checked(State((app, check)): State<(Arc<App>, Check)>, request: Request, next: Next) -> Checked {
    check(&app.guard, request.headers())?;
    Ok(next.run(request).await)
}

/// Informs a page whether it must log in, or why its WebSocket is refused: scripts cannot read the response to a refused
/// WebSocket.
async fn session(State(app): State<Arc<App>>, headers: HeaderMap) -> Result<StatusCode, Refused> {
    // 401 requests the password
    let status = |status| if app.guard.login.is_some() { status } else { StatusCode::FORBIDDEN };
    app.guard.check_user(&headers, only(&headers, TOKEN)).map_err(|(refused, why)| (status(refused), why))?;
    if app.pages.available_permits() == 0 {
        return Err(TOO_MANY_PAGES);
    }
    Ok(StatusCode::NO_CONTENT)
}

const TOO_MANY_PAGES: Refused = (StatusCode::SERVICE_UNAVAILABLE, "too many pages are open; close one");

/// Logs a user in, and sets the cookie.
async fn log_in(State(app): State<Arc<App>>, Extension(host): Extension<IpAddr>, password: Bytes) -> Checked {
    let cookie = app.guard.login.as_ref().ok_or(NO_PASSWORD)?.log_in(host, &password);
    with_cookie(&app, host, "logs in", cookie)
}

const NO_PASSWORD: Refused = (StatusCode::NOT_FOUND, "this server has no password");

/// Logs a user out. The pages of the session are closed, which frees what they hold.
async fn log_out(State(app): State<Arc<App>>, Extension(host): Extension<IpAddr>, headers: HeaderMap) -> Checked {
    let cookie = app.guard.login.as_ref().ok_or(NO_PASSWORD)?.log_out(&headers);
    with_cookie(&app, host, LOGS_OUT, cookie)
}

const LOGS_OUT: &str = "logs out";

fn with_cookie(app: &App, host: IpAddr, what: &str, cookie: Result<String, Refused>) -> Checked {
    // a stranger does not fill the audit: these have no session, or too many attempts
    let is_quiet = matches!(&cookie, Err((status, _)) if *status == StatusCode::TOO_MANY_REQUESTS || what == LOGS_OUT);
    if !is_quiet {
        let outcome = cookie.as_ref().map(drop).map_err(|(_, why)| (*why).to_owned());
        app.audit.write(&host.to_string(), "server", what, &outcome);
    }
    let cookie = HeaderValue::try_from(cookie?).map_err(|_| (StatusCode::INTERNAL_SERVER_ERROR, "no cookie"))?;
    Ok(([(SET_COOKIE, cookie)], StatusCode::NO_CONTENT).into_response())
}

/// Opens the WebSocket of a page.
async fn live(State(app): State<Arc<App>>, headers: HeaderMap, upgrade: WebSocketUpgrade) -> Checked {
    let offered = only(&headers, SEC_WEBSOCKET_PROTOCOL.as_str()).unwrap_or_default();
    let secret = offered.split(',').find_map(|protocol| protocol.trim().strip_prefix("token."));
    let session = app.guard.check_user(&headers, secret)?;
    let permit = Arc::clone(&app.pages).try_acquire_owned();
    let permit = permit.map_err(|_| TOO_MANY_PAGES)?;
    let token = app.work.token();
    let client = app.clients.fetch_add(1, Ordering::Relaxed);
    let mut ends = app.ends.subscribe();
    let upgrade = upgrade.protocols([PROTOCOL]).max_message_size(ORDER_SIZE).max_frame_size(ORDER_SIZE);
    Ok(upgrade.on_upgrade(move |socket| async move {
        tokio::select! {
            () = socket::serve(app, client, socket) => {}
            // the page is dropped, as if it was closed
            () = Open::ended(session) => {}
            _ = ends.wait_for(|ends| *ends) => {}
        }
        drop((permit, token));
    }))
}

/// The maximum size of a robot's name in a request.
const NAME_SIZE: usize = 16 << 10;

/// Halts a robot. It needs no control, no `--allow-write`, and no open page. `name` may be empty: a page that shows the robots
/// of an earlier server has old numbers, so the name takes precedence.
async fn halt(State(app): State<Arc<App>>, Path(number): Path<usize>, name: Bytes) -> Checked {
    let is_named = |robot: &&Arc<Robot>| safe(&robot.name).as_bytes() == name;
    let numbered = app.robots.get(number).filter(|robot| name.is_empty() || is_named(robot));
    let robot = numbered.or_else(|| app.robots.iter().find(is_named)).cloned();
    let robot = robot.ok_or((StatusCode::NOT_FOUND, "there is no such robot"))?;
    let of = Arc::clone(&app);
    // the halt is written to the audit log even if the page is closed in the meantime
    let halting = app.work.spawn(async move {
        let outcome = robot.halt().await;
        let what = outcome.as_deref().map_or_else(|_| "HALT".to_owned(), |outcome| format!("HALT, {outcome}"));
        of.audit.write("a page", &robot.name, &what, &outcome);
        outcome
    });
    let panicked = "NOT HALTED, use the emergency stop: the task that halts has panicked";
    let outcome = halting.await.unwrap_or_else(|_| Err(panicked.into()));
    let is_halted = outcome.is_ok();
    let (Ok(text) | Err(text)) = outcome;
    Ok(json!({ "ok": is_halted, "text": text }).to_string().into_response())
}
