//! The panel of a virtual controller.

use std::sync::{Arc, Mutex};

use bcap_sim::pace::Paced;
use bcap_sim::{Config, Controller, Profile};
use serde_json::json;

use crate::chromium::Browser;
use crate::support::{Page, Running, Web, serve_paced};

/// A virtual controller with a page, as `bcap sim --web` serves both.
pub(crate) struct Cell {
    pub(crate) web: Web,
    paced: Arc<Mutex<Paced>>,
    _server: Running<std::net::SocketAddr>,
}

impl Cell {
    pub(crate) fn start() -> Self {
        let paced = Arc::new(Mutex::new(Paced::new(Controller::new(Config::new(Profile::Rc8)))));
        let server = serve_paced(&paced);
        let panel = Arc::clone(&paced);
        let web = Web::with(&move |config| config.panel = Some(Arc::clone(&panel)), &[("cell", server.value)], true);
        Self { web, paced, _server: server }
    }

    fn is_stopped(&self) -> bool {
        self.paced.lock().unwrap().controller().emergency_stopped()
    }
}

fn play(page: &mut Page, text: &str) -> Result<(), String> {
    page.order("play", json!({ "robot": 0, "text": text })).map(drop)
}

#[test]
fn a_scenario_changes_the_virtual_controller_of_the_holder_of_the_control() {
    let cell = Cell::start();
    let mut page = cell.web.page();
    page.until_state("ready, motor off");
    let stop = "[controller]\nemergency_stop = true";
    assert_eq!(play(&mut page, stop).unwrap_err(), "take the control first");
    assert!(!cell.is_stopped());
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    page.order("show", json!({ "robot": 0, "screen": "panel" })).unwrap();
    // the faults of one scenario stay while the state is changed
    play(&mut page, "[[fault]]\nwhen = { every = 1, of = \"Robot_Move\" }\nthen = { refuse = \"E_BUF_FULL\" }")
        .unwrap();
    play(&mut page, stop).unwrap();
    page.until("panel", |panel| panel["emergency_stop"] == true);
    page.until_state("not ready");
    assert!(cell.is_stopped());
    for (text, why) in [
        ("[controller]\nno_such_key = 1", "nothing was changed: "),
        ("[controller]\ntorque_off = true", "nothing was changed: controller: `torque_off` is for a model"),
        ("not TOML", "nothing was changed: "),
    ] {
        let refused = play(&mut page, text).unwrap_err();
        assert!(refused.starts_with(why), "{refused}");
    }
    play(&mut page, "[controller]\nemergency_stop = false\nmode = \"manual\"").unwrap();
    page.until("panel", |panel| panel["mode"] == "manual" && panel["emergency_stop"] == false);
    page.order("pace", json!({ "robot": 0, "factor": 0.5 })).unwrap();
    page.until("panel", |panel| panel["factor"] == 0.5);
    let refused = page.order("pace", json!({ "robot": 0, "factor": 0 })).unwrap_err();
    assert_eq!(refused, "0: the time factor is 0.1 to 10");
    let lines = cell.web.lines();
    let expected = "cell: Anna: plays the scenario: [controller]\\nemergency_stop = true: done";
    assert!(lines.iter().any(|line| line == expected), "{lines:?}");
    assert!(lines.iter().any(|line| line == "cell: Anna: sets the time factor to 0.5: done"), "{lines:?}");
}

#[test]
fn lost_answers_are_seen_and_end_with_the_faults() {
    let cell = Cell::start();
    let mut page = cell.web.page();
    page.until_state("ready, motor off");
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    play(&mut page, "[[fault]]\nwhen = { every = 1 }\nthen = \"disconnect\"").unwrap();
    page.until_state("not connected");
    play(&mut page, "").unwrap();
    page.until_state("ready, motor off");
}

#[test]
fn a_server_of_real_controllers_has_no_panel() {
    let sim = crate::support::Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = web.page();
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    let refused = play(&mut page, "[controller]\nemergency_stop = true").unwrap_err();
    assert_eq!(refused, "this server has no virtual controller; start `bcap sim --web`");
    let Some(mut browser) = Browser::start() else { return };
    browser.open(web.url());
    browser.until_text("#state", "ready, motor off");
    browser.until("document.querySelector('[data-id=panel]').hidden");
}

/// Each kind of button, as a person uses it.
#[test]
fn the_buttons_of_the_panel_play_scenarios() {
    let cell = Cell::start();
    let Some(mut browser) = Browser::start() else { return };
    browser.open(cell.web.url());
    browser.until_text("#state", "ready, motor off");
    browser.click("[data-id=panel]");
    browser.until_text("#panel-state", "virtual RC8 · mode auto");
    browser.until("document.getElementById('play').disabled");
    browser.enter("#name", "Anna");
    browser.until_text("#control", "control: Anna (this page)");
    let press = |browser: &mut Browser, text: &str| {
        let find =
            format!("[...document.querySelectorAll('.panel button')].find((b) => b.textContent === {})", json!(text));
        browser.until(&format!("!{find}.disabled"));
        browser.eval(&format!("{find}.click()"));
    };
    for scheme in ["light", "dark"] {
        for size in [(1280, 800), (768, 1024)] {
            browser.look(size, scheme);
            assert_eq!(browser.eval(include_str!("audit.js")), json!([]), "{scheme} {size:?}");
        }
    }
    press(&mut browser, "Press");
    browser.until_text("#panel-state", "EMERGENCY STOP PRESSED");
    browser.until_text("#state", "not ready");
    press(&mut browser, "Release");
    press(&mut browser, "Manual");
    browser.until_text("#panel-state", "mode manual");
    press(&mut browser, "Auto");
    press(&mut browser, "Servo error 0x84204043");
    browser.until_text("#panel-state", "1 errors");
    browser.until_text("#state", "error");
    press(&mut browser, "Answer 300 ms late");
    browser.until_text("#notice", "simulator: Answer 300 ms late");
    press(&mut browser, "No faults");
    browser.eval("document.getElementById('factor').value = '2'; document.getElementById('factor').dispatchEvent(new Event('change'))");
    browser.until_text("#panel-state", "time 2×");
    browser.eval("document.getElementById('scenario').value = 'nonsense'");
    browser.click("#play");
    browser.until_text("#notice.bad", "nothing was changed");
    // each action is on the screen of the session
    browser.click("[data-id=session]");
    browser.until_text("#audit", "cell: Anna: sets the time factor to 2: done");
    browser.until_text("main", "cell: tcp:127.0.0.1:");
    browser.until_text("main dl", "jog, tasks, recoveries");
    assert_eq!(browser.eval(include_str!("audit.js")), json!([]));
    assert_eq!(browser.problems, [""; 0]);
}
