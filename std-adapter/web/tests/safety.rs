//! Tests that try to break the safety rules of the page, without a browser.

use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_core::variant::Variant;
use bcap_live::link::Access;
use bcap_std::blocking::{Arm, Controller};
use bcap_std::{Move, Settings};
use bcap_web::{Config, Server};
use serde_json::json;

use crate::support::{LIMIT, Page, Relay, Sim, Web, access, idle, until};

const I: VariableKind = VariableKind::I;
const S: VariableKind = VariableKind::S;

fn server(sim: &Sim, allow_write: bool) -> Web {
    Web::start(&[("press", sim.address())], allow_write)
}

/// Connects another client, which moves the robot or streams.
pub(crate) fn other(sim: &Sim) -> Controller {
    Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap()
}

fn with_motor(cell: &mut Controller) -> Arm<'_> {
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    arm
}

/// Starts a motion that lasts longer than the test.
pub(crate) fn start_moving(sim: &Sim, cell: &mut Controller) {
    let mut arm = with_motor(cell);
    let _motion = arm.start(&Move::joint("J(90,45,90,0,45,0)").speed_percent(1.0), LIMIT).unwrap().keep();
    arm.keep();
    sim.until("the robot moves", bcap_sim::Controller::is_moving);
}

#[test]
fn requests_of_other_pages_and_hosts_are_refused() {
    let sim = Sim::start();
    let web = server(&sim, true);
    let (host, token) = (web.host(), web.token());
    let (origin, wrong) = (format!("http://{host}"), format!("{}x", &token[1..]));
    let local = format!("localhost:{}", host.split_once(':').unwrap().1);
    let protocol = format!("bcap.live, token.{token}");
    let upgrade = |host: &str, origin: Option<&str>, protocol: &str| {
        let mut headers = vec![
            ("host", host),
            ("upgrade", "websocket"),
            ("sec-websocket-version", "13"),
            ("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ=="),
            ("sec-websocket-protocol", protocol),
        ];
        headers.extend(origin.map(|origin| ("origin", origin)));
        // `connection: close` of the helper follows this header
        headers.push(("connection", "upgrade"));
        web.status("GET /live", &headers)
    };
    assert_eq!(upgrade(host, None, &protocol), 403, "without an origin");
    assert_eq!(upgrade(host, Some("http://evil.example"), &protocol), 403, "another site");
    assert_eq!(upgrade(host, Some("null"), &protocol), 403, "a page of a file or a sandbox");
    assert_eq!(upgrade(host, Some(&format!("https://{host}")), &protocol), 403, "another scheme");
    assert_eq!(upgrade(&local, Some(&origin), &protocol), 403, "localhost is another origin than 127.0.0.1");
    assert_eq!(upgrade("evil.example", Some("http://evil.example"), &protocol), 421, "DNS rebinding");
    assert_eq!(upgrade(host, Some(&origin), "bcap.live"), 401, "no token");
    assert_eq!(upgrade(host, Some(&origin), &format!("bcap.live, token.{wrong}")), 401, "a wrong token");
    assert_eq!(upgrade(host, Some(&origin), &format!("bcap.live, token.{}", &token[1..])), 401, "a shorter token");

    let halt = |method: &str, headers: &[(&str, &str)]| web.status(&format!("{method} /halt/0"), headers);
    let good = [("host", host), ("origin", &origin), ("x-bcap-token", token)];
    for method in ["GET", "HEAD", "PUT", "DELETE", "OPTIONS"] {
        assert_eq!(halt(method, &good), 405, "{method} halts nothing");
    }
    assert_eq!(halt("POST", &[good[0], good[1]]), 401);
    assert_eq!(halt("POST", &[good[0], good[1], ("x-bcap-token", &wrong)]), 401);
    assert_eq!(halt("POST", &[good[0], good[2]]), 403);
    assert_eq!(halt("POST", &[good[0], ("origin", "http://evil.example"), good[2]]), 403);
    assert_eq!(halt("POST", &[("host", "evil.example"), ("origin", "http://evil.example"), good[2]]), 421);
    // the first wins in some programs, the last in others
    assert_eq!(halt("POST", &[good[0], ("origin", "http://evil.example"), good[1], good[2]]), 403);
    assert_eq!(halt("POST", &[good[0], good[1], ("x-bcap-token", &wrong), good[2]]), 401);
    assert_eq!(web.lines(), [""; 0], "nothing was halted");
    assert_eq!(halt("POST", &good), 200);
    assert_eq!(web.status("POST /halt/1", &good), 404);
    let (head, body) = web.request("GET /session", &[good[0], ("x-bcap-token", &wrong)]);
    let why = "the token is missing or wrong; open the address that bcap web printed";
    assert!(head.starts_with("http/1.1 403") && body == why, "{head} {body}");
    assert_eq!(web.status("GET /session", &good), 204);
    assert_eq!(web.status("GET /", &[("host", &local)]), 200, "localhost is a name of this computer");
    assert_eq!(web.status("GET /", &[("host", "evil.example")]), 421);
    assert_eq!(web.status("GET /", &[]), 421, "no host");
    assert_eq!(web.status("GET /", &[("host", host), ("host", host)]), 421, "two hosts");
    assert_eq!(web.status("POST /", &good), 405);
    assert_eq!(web.status("GET /../Cargo.toml", &[("host", host)]), 404);
}

#[test]
fn every_response_keeps_other_pages_and_hosts_out() {
    let sim = Sim::start();
    let web = server(&sim, false);
    for first in ["GET /", "GET /main.js", "GET /style.css", "GET /icon.svg", "GET /nothing", "POST /halt/0"] {
        let (head, body) = web.request(first, &[("host", web.host())]);
        for header in [
            "content-security-policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; ",
            "x-content-type-options: nosniff",
            "x-frame-options: deny",
            "referrer-policy: no-referrer",
            "cross-origin-resource-policy: same-origin",
            "cache-control: no-store",
        ] {
            assert!(head.contains(header), "{first}: {header} is not in {head}");
        }
        assert!(!head.contains("set-cookie") && !head.contains("access-control"), "{head}");
        // the page works without another host, and its files have no secret
        assert!(!body.contains("https://") && !body.contains(web.token()), "{first}");
    }
    assert!(web.url().len() > 60 && web.token().len() == 48, "192 bits");
    assert_ne!(web.token(), server(&sim, false).token());
}

#[test]
fn a_read_only_server_changes_nothing() {
    let sim = Sim::start();
    sim.lock().inject_error(HResult::from_u32(0x8350_0076), bcap_std::now());
    let web = server(&sim, false);
    let mut page = web.page();
    page.until_state("error");
    for (order, fields) in [
        ("take", json!({ "robot": 0, "name": "Anna" })),
        ("check", json!({ "robot": 0, "name": "I1", "text": "5" })),
        ("write", json!({ "robot": 0, "check": 1 })),
        ("clear", json!({ "robot": 0 })),
    ] {
        let refused = page.order(order, fields).unwrap_err();
        assert_eq!(refused, "this server is read-only; start it with --allow-write", "{order}");
    }
    assert_eq!(sim.lock().errors().count(), 1);
    assert_eq!(sim.lock().variable::<16>(I, 1).unwrap().as_variant(), Variant::I4(0));
}

#[test]
fn one_page_at_a_time_writes_what_it_has_checked() {
    let sim = Sim::start();
    let web = server(&sim, true);
    let (mut anna, mut bob) = (web.page(), web.page());
    anna.until_state("ready, motor off");
    let value = |sim: &Sim| sim.lock().variable::<16>(I, 1).unwrap().as_variant().as_i32().unwrap();
    let check = json!({ "robot": 0, "name": "I1", "text": "5" });
    let write = |check: u64| json!({ "robot": 0, "check": check });
    let not_checked = "this value is not the one that was checked last; check it again";
    assert_eq!(anna.order("check", check.clone()).unwrap_err(), "take the control first");
    anna.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    for (order, fields) in
        [("take", json!({ "robot": 0, "name": "Bob" })), ("check", check.clone()), ("write", write(1))]
    {
        assert_eq!(bob.order(order, fields).unwrap_err(), "Anna has the control; ask for its release", "{order}");
    }
    assert_eq!(bob.until("tiles", |tiles| tiles[0]["holder"] == "Anna")[0]["name"], "press");
    assert_eq!(anna.order("write", write(0)).unwrap_err(), not_checked);
    let checked = |number: u64| json!({ "check": number, "name": "I1", "old": "0", "new": "5", "exact": true });
    assert_eq!(anna.order("check", check.clone()), Ok(checked(1)));
    // the user agrees to the first check after a second check was made, for example by two undos
    assert_eq!(anna.order("check", json!({ "robot": 0, "name": "I1", "text": "6" })).unwrap()["check"], 2);
    assert_eq!(anna.order("write", write(1)).unwrap_err(), not_checked);
    assert_eq!(value(&sim), 0);
    assert_eq!(anna.order("check", check.clone()), Ok(checked(3)));
    anna.order("write", write(3)).unwrap();
    assert_eq!(value(&sim), 5);
    assert_eq!(anna.order("write", write(3)).unwrap_err(), not_checked, "a check is for one write");
    // a value that another client has changed since the user saw it stays
    anna.order("check", json!({ "robot": 0, "name": "I1", "text": "7" })).unwrap();
    sim.lock().set_variable(I, 1, &Variant::I4(6)).unwrap();
    let changed = anna.order("write", write(4)).unwrap_err();
    assert_eq!(changed, "I1 has changed meanwhile from 5 to 6; nothing was written");
    assert!(anna.order("check", json!({ "robot": 0, "name": "I1", "text": "3,14" })).is_err());
    assert_eq!(value(&sim), 6);
    // the loss of the page frees the control
    drop(anna);
    bob.until("tiles", |tiles| tiles[0]["holder"].is_null());
    bob.order("take", json!({ "robot": 0, "name": "Bob" })).unwrap();
    bob.order("release", json!({ "robot": 0 })).unwrap();
    let lines = web.lines();
    let expected = [
        "press: Anna: takes the control: done",
        "press: Bob: takes the control: Anna has the control; ask for its release",
        "press: Anna: writes I1: 0 -> 5: done",
        "press: Anna: writes I1: 5 -> 7: I1 has changed meanwhile from 5 to 6; nothing was written",
        "press: Anna: the page is closed, the control is free: done",
        "press: Bob: takes the control: done",
        "press: Bob: releases the control: done",
    ];
    assert_eq!(lines, expected);
}

/// Its connection stays open, but the pings are not answered.
#[test]
fn a_page_whose_computer_is_lost_frees_the_control() {
    let sim = Sim::start();
    let web = server(&sim, true);
    let mut lost = web.page();
    lost.until_state("ready, motor off");
    lost.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    assert!(web.page().order("take", json!({ "robot": 0, "name": "Bob" })).is_err());
    until("the control is free", || web.lines().iter().any(|line| line.contains("Anna: the page is closed")));
    assert!(web.page().order("take", json!({ "robot": 0, "name": "Bob" })).is_ok());
}

#[test]
fn errors_are_cleared_and_nothing_else_is_started() {
    let sim = Sim::start();
    sim.lock().inject_error(HResult::from_u32(0x8350_0076), bcap_std::now());
    let web = server(&sim, true);
    let mut page = web.page();
    page.order("show", json!({ "robot": 0, "screen": "alarms" })).unwrap();
    let alarms = page.until("alarms", |alarms| alarms["errors"][0]["code"] == "0x83500076");
    assert!(alarms["steps"].as_array().unwrap().contains(&json!("ClearError")), "{alarms}");
    assert!(alarms["errors"][0]["meaning"].as_str().unwrap().len() > 10, "{alarms}");
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    page.order("clear", json!({ "robot": 0 })).unwrap();
    page.until("alarms", |alarms| alarms["errors"] == json!([]));
    let sim = sim.lock();
    assert_eq!((sim.errors().count(), sim.motor_is_on(), sim.arm_owner()), (0, false, None));
}

#[test]
fn sizes_rates_and_connections_are_limited() {
    let sim = Sim::start();
    let web = server(&sim, false);
    let mut page = web.page();
    page.until_state("ready, motor off");
    for _ in 0..300 {
        page.send("show", json!({ "robot": 0, "screen": "cell" }));
    }
    let refused = (0..300).filter(|_| {
        loop {
            let message = page.receive().unwrap();
            if message["t"] == "answer" {
                break message["error"] == "too many orders; wait a moment";
            }
        }
    });
    assert!(refused.count() > 0, "a burst of 40, and 20 a second");
    // each page has its own rate
    drop(page);
    let mut page = web.page();
    let names: Vec<String> = (0..2000).map(|n| format!("I{n}")).collect();
    let error = page.order("select", json!({ "robot": 0, "names": names })).unwrap_err();
    assert_eq!(error, "2000 variables; a page shows at most 1000");
    // 5,000 ranges in one order, whose names would not fit into the memory
    let error = page.order("select", json!({ "robot": 0, "names": vec!["I0-I65535"; 5000] })).unwrap_err();
    assert_eq!(error, "327680000 variables; a page shows at most 1000");
    assert!(page.order("select", json!({ "robot": 7, "names": [] })).is_err());
    for invalid in ["", "[]", "{\"id\":1}", "{\"id\":1,\"do\":\"move\"}", "{\"id\":-1,\"do\":\"clear\",\"robot\":0}"] {
        page.socket.send(tokio_tungstenite::tungstenite::Message::text(invalid)).unwrap();
        loop {
            let message = page.receive().unwrap();
            if message["t"] == "answer" {
                assert_eq!(message["error"], "this is not an order", "{invalid}");
                break;
            }
        }
    }
    // an order that is too large closes only the page
    let large = "x".repeat(70_000);
    let _ = page.socket.send(tokio_tungstenite::tungstenite::Message::text(large));
    until("the page is closed", || page.receive().is_none());
    let header = "x".repeat(20_000);
    let status = web.status("GET /", &[("host", web.host()), ("x", &header)]);
    // the connection is closed, possibly before the response arrives
    assert!([431, 0].contains(&status), "{status}");
    let mut pages = Vec::new();
    // the end of the pages above takes a moment
    until("16 pages are open", || {
        pages.extend(web.try_page().ok());
        pages.len() == 16
    });
    assert_eq!(web.try_page().err(), Some(503), "one page too many");
    // scripts cannot read why
    let (head, body) = web.request("GET /session", &[("host", web.host()), ("x-bcap-token", web.token())]);
    assert!(head.starts_with("http/1.1 503") && body == "too many pages are open; close one", "{head} {body}");
    // connections that send nothing block no client, and end no page
    let held: Vec<_> = (0..300).map(|_| idle(&web)).collect();
    assert_eq!(web.halt(0)["ok"], true);
    assert!(pages.iter_mut().all(|page| page.order("show", json!({ "robot": 0, "screen": "cell" })).is_ok()));
    drop(held);
}

/// Each page gets its own variables, in its order, and they are read once for all pages.
#[test]
fn pages_show_different_variables() {
    let sim = Sim::start();
    let web = server(&sim, false);
    let (mut anna, mut bob) = (web.page(), web.page());
    anna.until_state("ready, motor off");
    for n in [2, 10, 30] {
        sim.lock().set_variable(I, n, &Variant::I4(i32::try_from(n).unwrap() * 100)).unwrap();
    }
    assert_eq!(anna.order("select", json!({ "robot": 0, "names": ["I9-I11", "I2"] })), Ok(json!(4)));
    assert_eq!(bob.order("select", json!({ "robot": 0, "names": ["I30", "I2", "NO_SUCH"] })), Ok(json!(3)));
    let shown = |page: &mut Page, last: &str| {
        page.order("show", json!({ "robot": 0, "screen": "variables" })).unwrap();
        let rows = page.until("variables", |rows| {
            let rows = rows.as_array().filter(|rows| rows.last().is_some_and(|row| row[0] == last));
            rows.is_some_and(|rows| rows.iter().all(|row| row[1] != ""))
        });
        rows.as_array()
            .unwrap()
            .iter()
            .map(|row| format!("{} {}", row[0].as_str().unwrap(), row[4]))
            .collect::<Vec<_>>()
    };
    assert_eq!(shown(&mut anna, "I2"), ["I9 0.0", "I10 1000.0", "I11 0.0", "I2 200.0"]);
    assert_eq!(shown(&mut bob, "NO_SUCH"), ["I30 3000.0", "I2 200.0", "NO_SUCH null"]);
}

#[test]
fn texts_of_a_controller_are_cut_and_escaped() {
    let sim = Sim::start();
    let hostile = "<img src=x onerror=alert(1)>\u{202e}\u{1b}[2J\n".to_owned() + &"A".repeat(1 << 20);
    sim.lock().set_variable(S, 1, &OwnedText::of(&hostile)).unwrap();
    let web = Web::start(&[("<b>\u{202e}press", sim.address())], false);
    let mut page = web.page();
    let tiles = page.until_state("ready, motor off");
    assert_eq!(tiles[0]["name"], "<b>\\u{202e}press");
    page.order("select", json!({ "robot": 0, "names": ["S1"] })).unwrap();
    page.order("show", json!({ "robot": 0, "screen": "variables" })).unwrap();
    let rows = page.until("variables", |rows| rows[0][3] == true);
    let text = rows[0][1].as_str().unwrap();
    assert!(text.contains("<img src=x onerror=alert(1)>\\u{202e}\\u{1b}[2J\\n"), "{text}");
    assert!(text.len() < 1200 && text.ends_with("more characters)"), "{} bytes", text.len());
    assert_eq!(rows[0][5], false, "the page must not offer to edit it");
    page.order("show", json!({ "robot": 0, "screen": "packets" })).unwrap();
    let packets = page.until("packets", |packets| packets["rows"].to_string().contains("onerror"));
    assert!(packets.to_string().len() < 500_000 && !packets.to_string().contains('\u{202e}'));
}

/// Starts a controller, and a relay in front of it.
fn relayed() -> (Sim, Relay) {
    let sim = Sim::start();
    let relay = Relay::start(sim.address());
    (sim, relay)
}

/// Opens a page, and moves the robot by another client.
fn watching_a_motion(sim: &Sim, web: &Web) -> (Page, Controller) {
    let mut page = web.page();
    page.until_state("ready, motor off");
    let mut cell = other(sim);
    start_moving(sim, &mut cell);
    (page, cell)
}

#[test]
fn a_halt_works_while_the_other_connections_hang() {
    let (sim, relay) = relayed();
    let web = Web::start(&[("press", relay.address)], false);
    let (mut page, _cell) = watching_a_motion(&sim, &web);
    page.until_state("moving");
    // the connection that reads
    relay.freeze(0);
    let began = Instant::now();
    let halted = web.halt(0);
    assert_eq!(halted, json!({ "ok": true, "text": "halted, the robot rests" }));
    assert!(!sim.lock().is_moving());
    assert!(began.elapsed() < Duration::from_secs(10), "{:?}", began.elapsed());
    let lost = page.until_state("not connected");
    assert!(lost[0]["reasons"][0][1].as_str().unwrap().contains("tries again every second"), "{lost}");
    page.until("tiles", |tiles| tiles[0]["state"] != "not connected");
    assert_eq!(web.halt(0)["text"], "the robot was at rest; nothing was moving");
    let lines = web.lines();
    assert_eq!(
        lines,
        [
            "press: a page: HALT, halted, the robot rests: done",
            "press: a page: HALT, the robot was at rest; nothing was moving: done"
        ]
    );
}

#[test]
fn a_halt_does_not_wait_for_its_next_session() {
    let (sim, relay) = relayed();
    let web = Web::start(&[("press", relay.address)], false);
    let (_page, _cell) = watching_a_motion(&sim, &web);
    // the second connection of HALT, which is opened after the loss of the reading connection
    relay.freeze(3);
    relay.cut(0);
    until("the next session of HALT hangs", || relay.held() > 0);
    assert_eq!(web.halt(0)["text"], "halted, the robot rests");
    assert!(!sim.lock().is_moving());
    assert_eq!(relay.count(), 4, "HALT has opened a session instead of using its first one");
}

#[test]
fn a_halt_that_fails_says_so() {
    let sim = Sim::start();
    let web = server(&sim, false);
    web.page().until_state("ready, motor off");
    drop(sim);
    let halted = web.halt(0);
    assert_eq!(halted["ok"], false);
    assert!(halted["text"].as_str().unwrap().starts_with("NOT HALTED, use the emergency stop: "), "{halted}");
}

#[test]
fn a_controller_that_starts_again_is_read_and_halted_again() {
    let sim = Sim::start();
    let address = sim.address();
    let web = server(&sim, false);
    let mut page = web.page();
    page.until_state("ready, motor off");
    drop(sim);
    page.until_state("not connected");
    let sim = Sim::at(address);
    page.until_state("ready, motor off");
    let mut cell = other(&sim);
    start_moving(&sim, &mut cell);
    assert_eq!(web.halt(0)["text"], "halted, the robot rests");
    assert!(!sim.lock().is_moving());
}

#[test]
fn a_stream_of_another_client_goes_on() {
    let sim = Sim::start();
    let web = server(&sim, true);
    let mut page = web.page();
    // an order waits for the first connection for 2 s only
    page.until_state("ready, motor off");
    page.order("select", json!({ "robot": 0, "names": ["I1-I3", "task:Pro1/@STATUS"] })).unwrap();
    page.order("show", json!({ "robot": 0, "screen": "variables" })).unwrap();
    page.until("variables", |rows| rows[3][3] == true);
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    let mut cell = other(&sim);
    let mut arm = with_motor(&mut cell);
    crate::support::stream(&sim, &mut arm, &mut page);
    let tile = page.until_state("streaming");
    assert_eq!(tile[0]["reasons"][0][0], "another client streams in Slave Mode");
    // to open this one would end the stream; the others are open
    let unopened = "task:Pro1/@LINE_NO";
    page.order("select", json!({ "robot": 0, "names": ["I1-I3", "task:Pro1/@STATUS", unopened] })).unwrap();
    for screen in ["cell", "variables", "alarms", "packets"] {
        page.order("show", json!({ "robot": 0, "screen": screen })).unwrap();
        // two slow rounds
        let end = Instant::now() + Duration::from_millis(2200);
        while Instant::now() < end {
            page.receive().unwrap();
        }
        assert_eq!(sim.lock().slave_mode(), 0x202, "{screen}");
    }
    page.order("show", json!({ "robot": 0, "screen": "variables" })).unwrap();
    let rows = page.until("variables", |rows| rows[4][0] == unopened && rows[4][1] != "");
    assert_eq!((&rows[3][3], &rows[4][3]), (&json!(true), &json!(false)), "{rows}");
    assert!(rows[4][1].as_str().unwrap().contains("Task_GetVariable may end it"), "{rows}");
    let refused = page.order("check", json!({ "robot": 0, "name": unopened, "text": "5" })).unwrap_err();
    assert!(refused.contains("Task_GetVariable may end it"), "{refused}");
    let checked = page.order("check", json!({ "robot": 0, "name": "I1", "text": "5" })).unwrap();
    let refused = page.order("write", json!({ "robot": 0, "check": checked["check"] })).unwrap_err();
    assert!(refused.contains("Variable_PutValue may end it"), "{refused}");
    let refused = page.order("clear", json!({ "robot": 0 })).unwrap_err();
    assert!(refused.contains("ClearError would end it"), "{refused}");
    assert_eq!(sim.lock().slave_mode(), 0x202);
    // a person may end it
    assert_eq!(web.halt(0)["ok"], true);
    assert_eq!(sim.lock().slave_mode(), 0);
}

#[tokio::test]
async fn other_computers_and_serial_lines_are_refused() {
    let bind = async |listen: &str, robots: Vec<(String, Access)>| {
        Server::bind(Config::new(listen.parse().unwrap(), robots), |_| {}).await.unwrap_err().to_string()
    };
    let robot = || vec![("press".to_owned(), access("127.0.0.1:5007".parse().unwrap()))];
    for listen in ["0.0.0.0:0", "192.168.0.1:0", "[::]:0"] {
        let refused = bind(listen, robot()).await;
        assert!(refused.ends_with("--certificate, --key and --password-file, or listen on 127.0.0.1"), "{refused}");
    }
    let mut serial = robot();
    serial[0].1.address = "serial:/dev/ttyUSB0".parse().unwrap();
    assert!(bind("127.0.0.1:0", serial).await.contains("HALT would have no connection"));
    assert_eq!(bind("127.0.0.1:0", Vec::new()).await, "0 robots; a page shows 1 to 32");
}

/// A text as a value.
struct OwnedText;

impl OwnedText {
    fn of(text: &str) -> Variant<'static> {
        let value: &'static bcap_core::variant::OwnedVariant =
            Box::leak(Box::new(bcap_core::variant::OwnedVariant::new(text).unwrap()));
        value.as_variant()
    }
}
