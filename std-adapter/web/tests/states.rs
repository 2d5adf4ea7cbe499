//! The page in each state: loaded again, in three browsers, and with hostile names.

use std::sync::{Arc, Mutex};

use bcap_core::hresult::HResult;
use bcap_sim::pace::Paced;
use bcap_sim::{Config, Controller, Profile, Scenario};
use bcap_std::{Move, Settings, blocking};
use serde_json::json;

use crate::chromium::Browser;
use crate::support::{LIMIT, Sim, Web, serve_paced, until};

/// Loads the page again, and waits until it shows a state.
fn reload(browser: &mut Browser, state: &str) {
    begin_reload(browser);
    browser.until_text("#state", state);
    browser.until("document.getElementById('stale').hidden");
}

/// Loads the page again, and waits until the old one has gone.
pub(crate) fn begin_reload(browser: &mut Browser) {
    browser.eval("window.isOld = true");
    browser.call("Page.reload", json!({}));
    browser.until("window.isOld === undefined && document.readyState === 'complete'");
}

fn take(browser: &mut Browser, name: &str) {
    browser.enter("#name", name);
    browser.until_text("#control", &format!("control: {name} (this page)"));
}

/// Idle, with the control, during a jog, after a halt, with an error, without the controller, and when it is there again.
#[test]
fn a_page_that_is_loaded_again_shows_each_state_and_frees_what_it_held() {
    let sim = Sim::start();
    let address = sim.address();
    let web = Web::moving(&[("press", address)]);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(web.url());
    browser.until_text("#state", "ready, motor off");
    reload(&mut browser, "ready, motor off");
    take(&mut browser, "Anna");
    reload(&mut browser, "ready, motor off");
    browser.until("document.getElementById('take') !== null");
    let freed = "press: Anna: the page is closed, the control is free: done";
    assert!(web.lines().iter().any(|line| line == freed), "{:?}", web.lines());
    jog_and_reload(&sim, &web, &mut browser);
    halt_and_reload(&sim, &mut browser);
    sim.lock().inject_error(HResult::from_u32(0x8350_0178), bcap_std::now());
    browser.until_text("#state", "error");
    reload(&mut browser, "error");
    browser.click("[data-id=alarms]");
    browser.until_text(".errors h3", "0x83500178");
    drop(sim);
    browser.until_text("#state", "not connected");
    reload(&mut browser, "not connected");
    let sim = Sim::at(address);
    browser.until_text("#state", "ready, motor off");
    reload(&mut browser, "ready, motor off");
    assert_eq!(browser.problems, [""; 0]);
    drop(sim);
}

/// A busy machine may lose the heartbeat before the page is loaded again: the robot must rest, and the arm must be free, then too.
fn jog_and_reload(sim: &Sim, web: &Web, browser: &mut Browser) {
    take(browser, "Anna");
    browser.click("[data-id=jog]");
    browser.click("#jog-begin");
    browser.click("#question-yes");
    until("the arm is taken", || {
        sim.lock().arm_owner().is_some() || web.lines().iter().any(|line| line.contains("the jog ends: "))
    });
    // the page may show the axes later than the arm is taken
    browser.until("document.querySelector('.axis') !== null");
    browser.press(".axis:nth-child(1) button:nth-of-type(2)");
    begin_reload(browser);
    sim.until("the robot rests, and the arm is free", |sim| !sim.is_moving() && sim.arm_owner().is_none());
    browser.lift();
    sim.lock().clear_errors(bcap_std::now());
    browser.until_text("#state", "ready, motor off");
    assert!(!sim.lock().motor_is_on());
}

fn halt_and_reload(sim: &Sim, browser: &mut Browser) {
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let _motion = arm.start(&Move::joint("J(90,45,90,0,45,0)").speed_percent(1.0), LIMIT).unwrap().keep();
    browser.until_text("#state", "moving");
    reload(browser, "moving");
    browser.click("#halt");
    browser.until_text("#notice", "press: halted, the robot rests");
    assert!(!sim.lock().is_moving());
    let rests = sim.lock().axes();
    begin_reload(browser);
    browser.until("/error|ready/.test(document.getElementById('state')?.textContent)");
    assert_eq!(sim.lock().axes(), rests, "a page that opens moves nothing");
    arm.motor_off().unwrap();
    arm.give().unwrap();
    sim.lock().clear_errors(bcap_std::now());
    browser.until_text("#state", "ready, motor off");
}

#[test]
fn three_browsers_share_a_robot_and_one_has_the_control() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let mut browsers: Vec<Browser> = (0..3).map_while(|_| Browser::start()).collect();
    let [anna, bob, carl] = &mut browsers[..] else { return };
    for browser in [&mut *anna, bob, carl] {
        browser.open(web.url());
        browser.until_text("#state", "ready, motor off");
    }
    take(anna, "Anna");
    for browser in [&mut *bob, carl] {
        browser.until_text("#control", "control: Anna");
        browser.until("document.getElementById('take') === null && document.getElementById('release') === null");
    }
    // a take-over needs the release or the loss of the holder
    anna.click("#release");
    take(bob, "Bob");
    anna.until_text("#control", "control: Bob");
    anna.until("document.getElementById('take') === null");
    // HALT needs no control
    carl.click("#halt");
    carl.until_text("#notice", "press: the robot was at rest");
    browsers.remove(1);
    let [anna, carl] = &mut browsers[..] else { unreachable!() };
    carl.until("document.getElementById('take') !== null");
    take(carl, "Carl");
    anna.until_text("#control", "control: Carl");
    for browser in &browsers {
        assert_eq!(browser.problems, [""; 0]);
    }
}

/// Names and texts that a controller or another user chooses.
#[test]
fn hostile_names_stay_text_on_each_screen() {
    const HOSTILE: &str = "<img src=x onerror=window.owned=1><script>window.owned=2</script>\u{202e}";
    let long = HOSTILE.to_owned() + &"A".repeat(1 << 20);
    let quoted = json!(HOSTILE);
    let scenario = format!(
        "[controller]\nrobot_type = {quoted}\nversion = {quoted}\nerrors = [\"0x84204043\"]\n[[task]]\nname = {quoted}\nsteps = [{{ wait_ms = 1 }}]\n\
         [[fault]]\nwhen = {{ at_ms = 1 }}\nthen = {{ message = {} }}",
        json!(long)
    );
    let mut controller = Controller::new(Config::new(Profile::Rc8));
    controller.play(Scenario::parse(&scenario).unwrap());
    let paced = Arc::new(Mutex::new(Paced::new(controller)));
    let server = serve_paced(&paced);
    let web = Web::moving(&[(HOSTILE, server.value)]);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(web.url());
    browser.until_text("#state", "error");
    let mut other = web.page();
    other.order("take", json!({ "robot": 0, "name": format!("{HOSTILE}{}", "B".repeat(1000)) })).unwrap();
    browser.until_text("#control", "control: <img src=x onerror");
    let screens = browser.eval("[...document.querySelectorAll('#screens button')].filter((button) => !button.hidden).map((button) => button.dataset.id)");
    for screen in screens.as_array().unwrap().iter().filter_map(|screen| screen.as_str()) {
        browser.click(&format!("[data-id={screen}]"));
        browser.until("document.getElementById('main').children.length > 0");
        // two rounds of values
        let seen = browser.eval(
            "new Promise((resolve) => setTimeout(() => resolve([document.querySelectorAll('img, b, main script').length,
                String(window.owned), document.body.scrollWidth <= innerWidth, document.body.innerText.includes('\\u202e')]), 500))",
        );
        assert_eq!(seen, json!([0, "undefined", true, false]), "{screen}");
    }
    until("the audit has the name", || web.lines().iter().any(|line| line.contains("takes the control")));
    assert!(web.lines().iter().all(|line| !line.contains('\u{202e}') && line.len() < 3000));
    assert_eq!(browser.problems, [""; 0]);
}
