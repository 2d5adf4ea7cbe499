//! The page of the settings: a form with the lines `KEY=VALUE`, without the secret ones.
//!
//! ```text
//!  GET  /settings      the form
//!  GET  /settings.txt  its text, for programs
//!  POST /settings      text/plain: saves the lines and restarts the board
//! ```

use core::cell::Cell;
use core::fmt::{self, Write};
use core::net::SocketAddrV4;

use bcap_embassy::clock::now;
use bcap_embassy::http::{Content, Decision, Method, Request, Status};
use embassy_net::{IpAddress, IpEndpoint, Stack};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

use crate::access::{Denied, Guard, Headers};
use crate::console::NotSaved;
use crate::health::Html;
use crate::saving::{self, SaveError};
use crate::settings::is_secret;
use crate::{Settings, config, messages};

static GUARD: Mutex<CriticalSectionRawMutex, Cell<Guard>> = Mutex::new(Cell::new(Guard::new()));

/// The answer to a request: a page, the result of a change, or a refusal.
#[derive(Clone, Copy)]
pub(crate) enum SettingsAnswer {
    Form,
    Text,
    /// The board has no password or no console.
    Off,
    Denied(Denied),
    /// The body is not `text/plain`.
    Content,
    /// So many PLCs are connected, which a restart would disconnect.
    Plcs(usize),
    NotSaved(SaveError),
    Saved,
}

/// Returns the number of wrong passwords since the start.
pub(crate) fn wrong_passwords() -> u32 {
    GUARD.lock(|guard| guard.get().wrong())
}

/// Accepts or answers a request by its head.
pub(crate) fn decide(stack: Stack<'_>, settings: &Settings<'_>, request: &Request<'_>) -> Decision<SettingsAnswer> {
    let is_change = request.method == Method::Post;
    let answer = match admit(stack, settings, request, is_change) {
        Err(answer) => answer,
        Ok(()) if !is_change && request.path == "/settings" => SettingsAnswer::Form,
        Ok(()) if !is_change => SettingsAnswer::Text,
        Ok(()) if request.content_type.and_then(|kind| kind.split(';').next()).map(str::trim) == Some("text/plain") => {
            return Decision::Receive;
        }
        Ok(()) => SettingsAnswer::Content,
    };
    Decision::Answer(answer)
}

fn admit(
    stack: Stack<'_>,
    settings: &Settings<'_>,
    request: &Request<'_>,
    is_change: bool,
) -> Result<(), SettingsAnswer> {
    let (Some(password), Some(port), true) = (settings.password, settings.health, saving::is_possible()) else {
        return Err(SettingsAnswer::Off);
    };
    let own = stack.config_v4().ok_or(SettingsAnswer::Off)?.address.address();
    let Request { host, origin, authorization, client, .. } = *request;
    let headers = Headers { host, origin, authorization, is_change };
    let result = GUARD.lock(|cell| {
        let mut guard = cell.get();
        let result = guard.admit(headers, (own, port), password, now());
        cell.set(guard);
        result
    });
    if result == Err(Denied::WrongPassword) {
        messages::wrong_password(
            client.map(|IpEndpoint { addr: IpAddress::Ipv4(address), port }| SocketAddrV4::new(address, port)),
        );
    }
    result.map_err(SettingsAnswer::Denied)
}

/// Saves the first `len` bytes of `memory` as settings, unless PLCs are connected; returns `memory`.
pub(crate) async fn save(
    memory: &'static mut [u8],
    len: usize,
    settings: &'static Settings<'static>,
    plcs: usize,
) -> (&'static mut [u8], SettingsAnswer) {
    if plcs > 0 {
        return (memory, SettingsAnswer::Plcs(plcs));
    }
    let (memory, result) = saving::save(memory, len, settings).await;
    let answer = match result {
        Ok(()) => {
            messages::saved();
            SettingsAnswer::Saved
        }
        Err(error) => SettingsAnswer::NotSaved(error),
    };
    (memory, answer)
}

/// Writes an answer.
pub(crate) fn write(answer: SettingsAnswer, out: &mut dyn Write) -> Option<(Status, Content)> {
    let (status, text) = match answer {
        SettingsAnswer::Form => return write_form(out).ok().map(|()| (Status::Ok, Content::Html)),
        SettingsAnswer::Text => return write_lines(false, out).ok().map(|()| (Status::Ok, Content::Text)),
        SettingsAnswer::Plcs(count) => {
            let text = format_args!(
                "not saved: {count} PLCs are connected, and the restart would disconnect them; close them first, or use the console\n"
            );
            return out.write_fmt(text).ok().map(|()| (Status::Conflict, Content::Text));
        }
        SettingsAnswer::Denied(Denied::Pause { seconds }) => {
            let text = format_args!("refused after a wrong password: try again in {seconds} s\n");
            return out.write_fmt(text).ok().map(|()| (Status::TooManyRequests, Content::Text));
        }
        SettingsAnswer::NotSaved(SaveError::NotSaved(error)) => return write_error(error, out),
        SettingsAnswer::Off => (
            Status::NotFound,
            "no password is set: on a board with a console, add it there: bcap board configure PORT ... password=PASSWORD --restart\n",
        ),
        SettingsAnswer::Denied(Denied::Host) => {
            (Status::Forbidden, "refused: open this page by the address of the board\n")
        }
        SettingsAnswer::Denied(Denied::Origin) => {
            (Status::Forbidden, "refused: the header Origin is not http:// and the address of the board\n")
        }
        SettingsAnswer::Denied(Denied::NoPassword) => (Status::Unauthorized, "the password of the board is needed\n"),
        SettingsAnswer::Denied(Denied::WrongPassword) => (Status::Unauthorized, "wrong password\n"),
        SettingsAnswer::Content => (Status::UnsupportedMediaType, "not saved: send the settings as text/plain\n"),
        SettingsAnswer::NotSaved(SaveError::Busy) => {
            (Status::ServiceUnavailable, "not saved: another page saves settings; try again\n")
        }
        SettingsAnswer::NotSaved(SaveError::Text) => (Status::BadRequest, "not saved: the text is not UTF-8\n"),
        SettingsAnswer::Saved => (Status::Ok, "saved; the board restarts\n"),
    };
    out.write_str(text).ok().map(|()| (status, Content::Text))
}

fn write_error(error: NotSaved, out: &mut dyn Write) -> Option<(Status, Content)> {
    let (status, text) = match error {
        NotSaved::Line { number, column, error } => {
            writeln!(out, "not saved: line {number}, column {column}: {error}").ok()?;
            (Status::BadRequest, "")
        }
        NotSaved::Secret { number } => {
            write!(out, "not saved: line {number}: ").ok()?;
            (Status::BadRequest, "passwords are set over the console only\n")
        }
        NotSaved::TooLong => (Status::ContentTooLarge, "not saved: the settings are too long\n"),
        NotSaved::Reach => (
            Status::Conflict,
            "not saved: this changes how the board is reached (dhcp, address, gateway, mac, ssid, health or allow); if a value is wrong, \
             only the console helps. Check them, then send the line reach=yes as well\n",
        ),
        NotSaved::Changed => {
            (Status::Conflict, "not saved: the console has changed the settings; restart the board first\n")
        }
        NotSaved::OnTrial => (
            Status::Conflict,
            "not saved: an update is on trial, and the restart would roll it back; try again later\n",
        ),
        NotSaved::Flash => (Status::InternalServerError, "not saved: the flash failed; it has the earlier settings\n"),
    };
    out.write_str(text).ok()?;
    Some((status, Content::Text))
}

fn write_form(out: &mut dyn Write) -> fmt::Result {
    out.write_str(
        "<!DOCTYPE html><html lang=en><meta charset=utf-8><title>settings</title><h1>Settings</h1>\
         <form method=post enctype=text/plain><textarea name=settings rows=24 cols=80>\n",
    )?;
    write_lines(true, out)?;
    out.write_str(
        "</textarea><p><label><input type=checkbox name=reach value=yes> dhcp, address, gateway, mac, ssid, health and allow may \
         change. If one is wrong, only the console helps.</label><p><button>Save and restart</button></form>\
         <p>Passwords are not shown and stay. <a href=/>State</a>\n",
    )
}

/// Writes the lines of the settings that the board runs with, except for secret ones.
fn write_lines(is_html: bool, out: &mut dyn Write) -> fmt::Result {
    for line in config::running().lines().filter(|line| !line.is_empty() && !is_secret(line)) {
        if is_html {
            write!(out, "{}", Html(&line))?;
        } else {
            out.write_str(line)?;
        }
        out.write_char('\n')?;
    }
    Ok(())
}
