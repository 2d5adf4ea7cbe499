//! Recordings of sessions, and their replay on the page.

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use bcap_capture::decode::{Event, events};
use bcap_capture::playback::Playback;
use bcap_core::limits::Strictness;
use bcap_core::rac::VariableKind;
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_std::server::Server as SimServer;
use bcap_web::{Recordings, Replay};
use serde_json::{Value, json};

use crate::browser::opened;
use crate::screens::{bytes, saved};
use crate::support::{Page, Running, Sim, Web, idle};

fn serve(sim: &Sim, folder: &Path, limit: u64) -> Web {
    let recordings = Recordings { folder: folder.to_owned(), limit };
    let change = move |config: &mut bcap_web::Config| {
        (config.allow_motion, config.recordings) = (false, Some(recordings.clone()));
    };
    Web::with(&change, &[("press", sim.address())], false)
}

fn page(web: &Web) -> Page {
    let mut page = web.page();
    page.until_state("ready, motor off");
    page.order("show", json!({ "robot": 0, "screen": "session" })).unwrap();
    page
}

fn record(page: &mut Page, starts: bool) -> Result<Value, String> {
    page.order("record", json!({ "starts": starts }))
}

/// Waits until the recording has more bytes.
fn until_size(page: &mut Page, size: u64) {
    page.until("session", |session| session["recordings"][0][2][1].as_u64().is_some_and(|now| now > size));
}

fn file_of(page: &mut Page, folder: &Path) -> PathBuf {
    let rows = page.order("recordings", json!({})).unwrap();
    folder.join(rows[0][0].as_str().unwrap())
}

/// Serves a capture as `bcap sim --replay` does.
fn play(file: &Path) -> (Running<std::net::SocketAddr>, [String; 3], Replay) {
    let replay = Replay::default();
    let lacking = replay.clone();
    let playback = Playback::read(file, move |request| lacking.lacks(request)).unwrap();
    let session = playback.session().unwrap();
    let server = Running::start(async move |stopped, sender| {
        let server = SimServer::new(playback).bcap_tcp("127.0.0.1:0").await?;
        sender.send(server.addresses().bcap_tcp[0]).unwrap();
        server.run(async { drop(stopped.await) }).await
    });
    (server, session, replay)
}

fn replayed(server: &Running<std::net::SocketAddr>, [provider, machine, option]: [String; 3], replay: Replay) -> Web {
    let changes = Mutex::new(Some((provider, machine, option, replay)));
    let change = move |config: &mut bcap_web::Config| {
        let (provider, machine, option, replay) = changes.lock().unwrap().take().unwrap();
        let access = &mut config.robots[0].1;
        (access.provider, access.machine, access.option) = (Some(provider), Some(machine), option);
        (config.allow_motion, config.replay) = (false, Some(replay));
    };
    Web::with(&change, &[("replay", server.value)], false)
}

#[test]
fn a_session_of_more_than_4_mb_is_recorded_and_shown_again() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    sim.lock().set_variable(VariableKind::I, 1, &Variant::I4(1234)).unwrap();
    let long = OwnedVariant::new("x".repeat(250_000).as_str()).unwrap();
    sim.lock().set_variable(VariableKind::S, 1, &long.as_variant()).unwrap();
    let web = serve(&sim, folder.path(), u64::MAX);
    let mut anna = page(&web);
    anna.order("select", json!({ "robot": 0, "names": ["I1", "S1"] })).unwrap();
    // a read-only server also records
    record(&mut anna, true).unwrap();
    assert_eq!(record(&mut anna, true), Err("a recording runs; end it first".into()));
    until_size(&mut anna, 5_000_000);
    record(&mut anna, false).unwrap();
    assert_eq!(record(&mut anna, false), Err("no recording runs".into()));
    let rows = anna.order("recordings", json!({})).unwrap();
    assert!(rows.as_array().unwrap().len() == 1 && rows[0][1].as_u64().unwrap() > 5_000_000, "{rows}");
    let lines = web.lines();
    assert!(lines.contains(&"server: a page: starts a recording: done".to_owned()), "{lines:?}");
    let file = file_of(&mut anna, folder.path());
    let (found, read) = events(&file, Strictness::Strict);
    read.unwrap();
    let opens = |event: &&Event| matches!(event, Event::Call(call) if call.function == "Controller_Connect");
    assert_eq!(
        found.iter().filter(opens).count(),
        2,
        "the session that reads and the one of HALT, from their beginning"
    );
    drop((web, sim));

    let (server, session, replay) = play(&file);
    let web = replayed(&server, session, replay);
    let mut page = web.page();
    page.until_state("ready, motor off");
    page.order("show", json!({ "robot": 0, "screen": "variables" })).unwrap();
    page.order("select", json!({ "robot": 0, "names": ["I1"] })).unwrap();
    page.until("variables", |rows| rows[0][1] == "1234");
    page.order("select", json!({ "robot": 0, "names": ["I1", "F7"] })).unwrap();
    page.until("variables", |rows| rows[1] == json!(["F7", "0x80004005 (E_FAIL)", false, false, null, true]));
    page.until("replay", |lacks| {
        lacks[0].as_u64().is_some_and(|count| count > 0)
            && lacks[1].as_str().is_some_and(|last| last.contains("Controller_GetVariable") && last.contains("F7"))
    });
    // the page of a user says so
    let Some(mut browser) = opened(&web) else { return };
    browser
        .until_text("#replay", "REPLAY of a recording: the values are recorded ones, and no robot is connected. The");
    browser.until_text("#replay", "F7");
    assert_eq!(browser.problems, [""; 0]);
}

/// The buttons of the screen, and a file that is saved.
#[test]
fn a_user_starts_and_ends_a_recording_and_saves_it() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let web = serve(&sim, folder.path(), u64::MAX);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=session]");
    browser.until("!document.getElementById('record').disabled");
    browser.click("#record");
    browser.until_text("#notice", "the recording has started");
    browser.until_text("#recording li", "● press: records 2");
    browser.until_text("#record", "End recording");
    browser.until("/, 0[.][1-9] MB/.test(document.getElementById('recording').textContent)");
    browser.click("#record");
    browser.until_text("#notice", "the recording has ended");
    browser.until_text("#recordings th", "-1.pcapng");
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes(&saved(&mut browser, "#recordings button"))).unwrap();
    let (found, read) = events(file.path(), Strictness::Strict);
    read.unwrap();
    assert!(found.len() > 50, "{}", found.len());
    // without --recordings the button says why it is disabled
    let web = Web::start(&[("press", sim.address())], false);
    browser.open(web.url());
    // no longer the page before
    browser.until(&format!("location.host === '{}'", web.host()));
    browser.click("[data-id=session]");
    browser.until("document.getElementById('record').title === 'start bcap web with --recordings DIR'");
    assert_eq!(browser.problems, [""; 0]);
}

#[test]
fn a_recording_has_a_limit_and_its_folder_must_be_writable() {
    let (sim, folder) = (Sim::start(), tempfile::tempdir().unwrap());
    let web = serve(&sim, folder.path(), 100_000);
    let mut anna = page(&web);
    record(&mut anna, true).unwrap();
    let ended = anna.until("session", |session| session["recordings"][0][2][3].is_string());
    assert_eq!(ended["recordings"][0][2][3], "it has 0 MB, the limit of a recording");
    anna.until_state("ready, motor off");
    let size = file_of(&mut anna, folder.path()).metadata().unwrap().len();
    assert!((100_000..200_000).contains(&size), "{size}");
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let web = serve(&sim, &file, 1);
    let refused = record(&mut page(&web), true).unwrap_err();
    assert!(refused.starts_with(&format!("cannot record to {}: ", file.display())), "{refused}");
    let web = Web::start(&[("press", sim.address())], true);
    let none = "this server records nothing; start it with --recordings DIR".to_owned();
    assert_eq!(record(&mut page(&web), true), Err(none));
}

/// The series of a page have a limit, so that the file that is made of them has one.
#[test]
fn series_with_too_many_samples_are_refused() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    for (count, status) in [(100_000, "200"), (100_001, "413")] {
        let body = format!(r#"[{{"name":"J1","samples":[{}[1,1]]}}]"#, "[1,1],".repeat(count - 1));
        let (host, token, mut stream) = (web.host(), web.token(), idle(&web));
        let length = body.len();
        write!(stream, "POST /mcap HTTP/1.1\r\nhost: {host}\r\norigin: http://{host}\r\nx-bcap-token: {token}\r\n")
            .unwrap();
        write!(stream, "content-length: {length}\r\nconnection: close\r\n\r\n{body}").unwrap();
        let mut response = Vec::new();
        stream.read_to_end(&mut response).unwrap();
        assert!(response.starts_with(format!("HTTP/1.1 {status} ").as_bytes()), "{count}");
    }
}

/// Only a page of this server gets a recording, and no other file of the computer.
#[test]
fn a_name_stays_in_the_folder_and_a_file_needs_the_token() {
    let (sim, parent) = (Sim::start(), tempfile::tempdir().unwrap());
    let folder = parent.path().join("recordings");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(parent.path().join("secret.pcapng"), "secret").unwrap();
    std::fs::write(folder.join("a.pcapng"), "recorded").unwrap();
    std::fs::create_dir(folder.join("folder.pcapng")).unwrap();
    let web = serve(&sim, &folder, 1);
    let origin = format!("http://{}", web.host());
    let own =
        [("host", web.host()), ("origin", origin.as_str()), ("x-bcap-token", web.token()), ("content-length", "0")];
    let (head, body) = web.request("POST /recordings/a.pcapng", &own);
    assert!(head.starts_with("http/1.1 200") && body.contains("recorded"), "{head} {body}");
    for name in
        ["..%2fsecret.pcapng", "%2e%2e%2fsecret.pcapng", "..", ".", "folder.pcapng", "b.pcapng", "..%5csecret.pcapng"]
    {
        let (head, body) = web.request(&format!("POST /recordings/{name}"), &own);
        assert!(head.starts_with("http/1.1 404") && !body.contains("secret"), "{name}: {head} {body}");
    }
    assert_eq!(web.status("POST /recordings/a.pcapng", &[own[0], own[1], own[3]]), 401);
    let evil = [own[0], ("origin", "http://evil.example"), own[2], own[3]];
    assert_eq!(web.status("POST /recordings/a.pcapng", &evil), 403);
    assert_eq!(web.status("GET /recordings/a.pcapng", &own[..3]), 405);
}
