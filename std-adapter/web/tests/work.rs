//! Recoveries step by step, the logs, tasks and files, without a browser.

use std::sync::Arc;

use bcap_core::hresult::HResult;
use bcap_sim::Profile;
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;

use crate::support::{Page, Relay, Sim, Web};

const MOTION: &str = "this server moves nothing; start it with --allow-motion";

fn with_control(web: &Web, state: &str) -> Page {
    let mut page = web.page();
    page.until_state(state);
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    page
}

fn is_on(sim: &Sim) -> bool {
    sim.lock().motor_is_on()
}

fn count(sim: &Sim) -> usize {
    sim.lock().errors().count()
}

/// Waits until the recovery on the screen of alarms meets a condition.
#[track_caller]
fn recovery(page: &mut Page, condition: impl Fn(&Value) -> bool) -> Value {
    page.until("alarms", |alarms| condition(&alarms["recovery"]))["recovery"].clone()
}

#[test]
fn a_recovery_makes_one_step_for_each_agreement() {
    let sim = Sim::start();
    sim.lock().inject_error(HResult::from_u32(0x8350_0076), bcap_std::now());
    let begin = json!({ "robot": 0, "name": "press" });
    let writing = Web::start(&[("press", sim.address())], true);
    let refused = with_control(&writing, "error").order("recover", begin.clone()).unwrap_err();
    assert_eq!(refused, MOTION);
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web, "error");
    page.order("show", json!({ "robot": 0, "screen": "alarms" })).unwrap();
    assert!(page.order("recover", json!({ "robot": 0, "name": "welder" })).is_err());
    page.order("recover", begin.clone()).unwrap();
    let plan = recovery(&mut page, |run| run["plan"] != json!(null) && run["plan"] != json!([]))["plan"].clone();
    assert_eq!(plan, json!(["ClearError", "TakeArm", "Motor"]));
    let step = |step: &str| json!({ "robot": 0, "step": step });
    let skipped = page.order("step", step("Motor")).unwrap_err();
    assert_eq!(skipped, "Motor is not the next step; nothing was done");
    assert_eq!((count(&sim), is_on(&sim)), (1, false), "nothing was made before the first agreement");
    page.order("step", step("ClearError")).unwrap();
    recovery(&mut page, |run| run["busy"] == false && run["done"].to_string().contains("ClearError"));
    assert_eq!((count(&sim), is_on(&sim)), (0, false), "clearing starts nothing");
    let next = recovery(&mut page, |run| run["busy"] == false)["next"].as_str().unwrap().to_owned();
    if next == "TakeArm" {
        page.order("step", step("TakeArm")).unwrap();
        recovery(&mut page, |run| run["next"] == "Motor" && run["busy"] == false);
    }
    assert!(!is_on(&sim));
    page.order("step", step("Motor")).unwrap();
    let ended = recovery(&mut page, |run| run["outcome"] != json!(null));
    assert_eq!(ended["outcome"], "recovered: no errors; the motor is as before, and the arm is free");
    let owner = sim.lock().arm_owner();
    assert_eq!((owner, is_on(&sim)), (None, false));
    // a page that is lost ends a recovery
    sim.lock().inject_error(HResult::from_u32(0x8350_0076), bcap_std::now());
    page.order("recover", begin).unwrap();
    recovery(&mut page, |run| run["next"] == "ClearError");
    drop(page);
    crate::support::until("the recovery has its line of the audit", || {
        web.lines().iter().any(|line| line.contains("ends after []: ended: the page is closed"))
    });
    assert_eq!(count(&sim), 1);
}

#[test]
fn the_end_of_the_server_halts_a_step_that_moves() {
    let sim = Sim::quick_of(Profile::Cobotta);
    sim.lock().inject_error(HResult::from_u32(0x8350_0076), bcap_std::now());
    let relay = Relay::start(sim.address());
    let web = Web::moving(&[("press", relay.address)]);
    let mut page = with_control(&web, "error");
    page.order("show", json!({ "robot": 0, "screen": "alarms" })).unwrap();
    page.order("recover", json!({ "robot": 0, "name": "press" })).unwrap();
    loop {
        let next = recovery(&mut page, |run| run["next"] != json!(null) && run["busy"] == false)["next"].clone();
        if next == "MotionPreparation" {
            break;
        }
        page.order("step", json!({ "robot": 0, "step": next })).unwrap();
        recovery(&mut page, |run| run["next"] != next);
    }
    relay.freeze(2);
    page.order("step", json!({ "robot": 0, "step": "MotionPreparation" })).unwrap();
    crate::support::until("the call is under way", || relay.held() > 0);
    let audit = Arc::clone(&web.audit);
    drop(web);
    let lines = audit.lock().unwrap();
    assert!(
        lines.iter().any(|line| line.contains("HALT, because the page is closed during a step that moves")),
        "{lines:?}"
    );
}

#[test]
fn the_log_of_the_controller_is_read() {
    let sim = Sim::start();
    for code in [0x8350_0076, 0x8350_0178] {
        sim.lock().inject_error(HResult::from_u32(code), bcap_std::now());
    }
    let web = Web::start(&[("press", sim.address())], false);
    let mut page = web.page();
    page.until_state("error");
    let log = page.order("log", json!({ "robot": 0 })).unwrap();
    let errors: Vec<_> = log.as_array().unwrap().iter().filter(|entry| entry[1] == "error").collect();
    assert_eq!(errors.len(), 2, "{log}");
    assert!(errors.iter().any(|entry| entry[3].as_str().unwrap().contains("0x83500178")), "{log}");
}

#[test]
fn tasks_start_with_the_right_to_move_and_files_are_shown() {
    let sim = Sim::start();
    let (name, _, _) =
        sim.lock().tasks().next().map(|(name, status, cycles)| (name.to_owned(), status, cycles)).unwrap();
    let task = |what: &str| json!({ "robot": 0, "of": "press", "name": name, "what": what });
    let writing = Web::start(&[("press", sim.address())], true);
    let mut page = with_control(&writing, "ready, motor off");
    assert_eq!(page.order("task", task("forever")).unwrap_err(), MOTION);
    let web = Web::moving(&[("press", sim.address())]);
    assert_eq!(web.page().order("task", task("forever")).unwrap_err(), "take the control first");
    let mut page = with_control(&web, "ready, motor off");
    let other = json!({ "robot": 0, "of": "welder", "name": name, "what": "forever" });
    assert_eq!(page.order("task", other).unwrap_err(), "welder is not the name of this robot; nothing was done");
    page.order("show", json!({ "robot": 0, "screen": "tasks" })).unwrap();
    page.order("task", task("forever")).unwrap();
    page.until("tasks", |rows| rows.to_string().contains("running"));
    page.order("line", json!({ "robot": 0, "name": name })).unwrap();
    page.order("task", task("stop")).unwrap();
    page.until("tasks", |rows| {
        rows.as_array().is_some_and(|rows| !rows.is_empty()) && !rows.to_string().contains("running")
    });
    assert!(web.lines().contains(&format!("press: Anna: runs again and again {name}: done")), "{:?}", web.lines());
}

/// The reading connection, which has the order, hangs; HALT, the release or the loss of the page occurs before it continues.
#[test]
fn an_order_that_waits_is_not_carried_out_after_a_halt_or_without_the_control() {
    for end in ["halt", "release", "loss"] {
        let sim = Sim::start();
        let relay = crate::support::Relay::start(sim.address());
        let web = Web::moving(&[("press", relay.address)]);
        let mut page = with_control(&web, "ready, motor off");
        relay.freeze(0);
        crate::support::until("a round of reading waits for its reply", || relay.held() > 0);
        page.send("task", json!({ "robot": 0, "of": "press", "name": "Pro1", "what": "forever" }));
        // the order is received first: the server reads messages in order
        page.socket.send(Message::Ping(Vec::new().into())).unwrap();
        while !page.socket.read().unwrap().is_pong() {}
        let mut page = Some(page);
        match (end, &mut page) {
            ("halt", _) => assert_eq!(web.halt(0)["ok"], true),
            ("release", Some(page)) => {
                page.send("release", json!({ "robot": 0 }));
                page.until("tiles", |tiles| tiles[0]["revoked"].as_u64() > Some(0));
            }
            _ => {
                page = None;
                crate::support::until("the control is free", || {
                    web.page().order("take", json!({ "robot": 0, "name": "Bob" })).is_ok()
                });
            }
        }
        relay.freeze(usize::MAX);
        crate::support::until("the order has its line of the audit", || {
            web.lines().iter().any(|line| line.contains("runs again and again"))
        });
        let lines = web.lines();
        let is_refused = |line: &String| line.contains("runs again and again") && line.contains("nothing was done");
        assert!(lines.iter().any(is_refused), "{end}: {lines:?}");
        assert!(!sim.lock().tasks().any(|(_, status, _)| status == bcap_sim::TaskStatus::Running), "{end}");
        drop(page);
    }
}

/// The WebSocket of the page stalls, or its question is open, while HALT arrives over another connection and reports rest.
#[test]
fn an_order_for_which_the_user_has_agreed_before_a_halt_is_refused() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web, "ready, motor off");
    page.order("check", json!({ "robot": 0, "name": "I1", "text": "5" })).unwrap();
    let before = page.until("tiles", Value::is_array)[0]["revoked"].clone();
    assert_eq!(web.halt(0)["ok"], true);
    let task = |what: &str, revoked: &Value| json!({ "robot": 0, "of": "press", "name": "Pro1", "what": what, "revoked": revoked });
    let orders = [
        ("task", task("forever", &before)),
        ("write", json!({ "robot": 0, "check": 1, "revoked": before })),
        ("clear", json!({ "robot": 0, "revoked": before })),
        ("grip", json!({ "robot": 0, "name": "press", "revoked": before })),
        ("recover", json!({ "robot": 0, "name": "press", "revoked": before })),
    ];
    for (what, order) in orders {
        let refused = page.order(what, order).unwrap_err();
        assert!(refused.contains("HALT was pressed"), "{what}: {refused}");
    }
    {
        let sim = sim.lock();
        assert!(!sim.tasks().any(|(_, status, _)| status == bcap_sim::TaskStatus::Running));
        assert_eq!((sim.arm_owner(), sim.motor_is_on()), (None, false));
    }
    // a stop is never refused, and the user may agree again
    page.order("task", task("stop", &before)).unwrap();
    let now = page.until("tiles", |tiles| tiles[0]["revoked"] != before)[0]["revoked"].clone();
    page.order("task", task("forever", &now)).unwrap();
    page.until_state("ready, motor off");
    sim.until("the task runs", |sim| sim.tasks().any(|(_, status, _)| status == bcap_sim::TaskStatus::Running));
}

/// Files of a controller are text, whatever is in them.
#[test]
fn a_file_is_shown_as_lines_of_text() {
    let folder = tempfile::tempdir().unwrap();
    let hostile = "Sub Main\n<script>alert(1)</script>\u{202e}\nEnd Sub";
    std::fs::write(folder.path().join("Hostile.pcs"), hostile).unwrap();
    let sim = Sim::with_files(folder.path());
    let web = Web::start(&[("press", sim.address())], false);
    let mut page = web.page();
    page.until_state("ready, motor off");
    let files = page.order("files", json!({ "robot": 0, "folder": "" })).unwrap();
    assert!(files["rows"].as_array().unwrap().contains(&json!(["Hostile.pcs", false, true])), "{files}");
    let view = page.order("view", json!({ "robot": 0, "path": "Hostile.pcs" })).unwrap();
    assert_eq!(view["lines"], json!(["Sub Main", "<script>alert(1)</script>\\u{202e}", "End Sub"]));
    assert!(page.order("view", json!({ "robot": 0, "path": "../../etc/passwd" })).is_err());
    assert!(page.order("files", json!({ "robot": 0, "folder": "no such" })).is_err());
}
