//! Unknown errors, and unknown ends of a recovery or a jog, are not called good.

use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use bcap_live::jog::{self, Grip};
use bcap_live::recovery::{self, Recovery};
use bcap_sim::pace::Paced;
use bcap_sim::{Config, Controller, Profile, Scenario};
use bcap_std::{Settings, blocking};
use serde_json::{Value, json};

use crate::chromium::Browser;
use crate::support::{Sim, Web, access, serve_paced, until};

fn scenario(text: &str) -> Scenario {
    Scenario::parse(text).unwrap()
}

#[test]
fn errors_that_are_not_read_are_not_called_none() {
    let sim = Sim::start();
    let refused = "[[fault]]\nwhen = { every = 1, of = \"GetCurErrorCount\" }\nthen = { refuse = \"E_NOTIMPL\" }\n";
    sim.lock().play(scenario(refused));
    let web = Web::start(&[("press", sim.address())], true);
    let mut page = web.page();
    page.order("show", json!({ "robot": 0, "screen": "alarms" })).unwrap();
    let why = "GetCurErrorCount: the controller refused: 0x80004001";
    let alarms = page.until("alarms", |alarms| alarms["known"] == true && alarms["skipped"].to_string().contains(why));
    assert_eq!(alarms["errors"], json!([]));
    let Some(mut browser) = Browser::start() else { return };
    browser.open(web.url());
    browser.until_text("#state", "ready, motor off");
    browser.enter("#name", "Bob");
    browser.click("[data-id=alarms]");
    browser.until_text(".present h2", "The errors are not known");
    browser.until_text(".present", why);
    browser.until("document.getElementById('clear')?.disabled === false");
    drop(sim);
    // the browser took its time, and the server closes a page that does not read for 10 s
    let mut page = web.page();
    page.order("show", json!({ "robot": 0, "screen": "alarms" })).unwrap();
    page.until("alarms", |alarms| alarms["known"] == false && alarms["skipped"] == "the connection is lost");
    browser.until_text(".plan", "the steps are not known");
    browser.until_text(".present h2", "The errors are not known");
    assert_eq!(browser.eval("document.querySelector('.plan').textContent.includes('Nothing to recover')"), false);
    assert_eq!(browser.problems, [""; 0]);
}

/// The recovery ends during the command Motor, whose reply is lost.
#[test]
fn a_recovery_that_ends_says_what_is_not_known() {
    let config = Config { motor_on_delay: Duration::from_secs(2), ..Config::new(Profile::Rc8) };
    let mut controller = Controller::new(config);
    controller.play(scenario("[[fault]]\nwhen = { call = 1, of = \"Motor\" }\nthen = \"disconnect\"\n"));
    let paced = Arc::new(Mutex::new(Paced::new(controller)));
    let pace = |factor| paced.lock().unwrap().set_factor(factor, bcap_std::now()).unwrap();
    let server = serve_paced(&paced);
    let web = Web::moving(&[("press", server.value)]);
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", server.value), &Settings::rc8()).unwrap();
    let mut page = web.page();
    page.until_state("ready, motor off");
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    page.order("show", json!({ "robot": 0, "screen": "alarms" })).unwrap();
    page.order("recover", json!({ "robot": 0, "name": "press" })).unwrap();
    // the motor must not be on before the end
    pace(0.1);
    let next = |step: &'static str| move |alarms: &Value| alarms["recovery"]["next"] == step;
    for step in ["TakeArm", "Motor"] {
        page.until("alarms", next(step));
        page.order("step", json!({ "robot": 0, "step": step })).unwrap();
    }
    // if the recovery ended before the call, nothing would be unknown
    until("the motor starts", || cell.execute::<i32>("SysInfo", 14).unwrap() == 1);
    page.order("endrecovery", json!({ "robot": 0 })).unwrap();
    pace(10.0);
    let ended = page.until("alarms", |alarms| alarms["recovery"]["outcome"] != json!(null));
    let outcome = ended["recovery"]["outcome"].as_str().unwrap();
    let (step, arm) = outcome.split_once("; IT IS UNKNOWN whether the motor is off and the arm is free: ").unwrap();
    let why =
        "ended: the user ended it; errors that were cleared stay cleared; IT IS UNKNOWN whether the step was made: ";
    assert!(step.starts_with(why) && step.contains("Motor") && !arm.is_empty(), "{outcome}");
}

/// The recovery ends during the command Motor. The controller refuses to switch the motor off, always or only at first.
#[test]
fn a_motor_that_a_stopped_recovery_leaves_on_is_not_called_off() {
    let ended = "ended: the page is closed; errors that were cleared stay cleared";
    let unknown = "; IT IS UNKNOWN whether the motor is off and the arm is free: a step could not be undone";
    for (refused, is_on, more) in [(5, true, unknown), (2, false, "")] {
        let sim = Sim::start();
        sim.lock().play(scenario(&format!(
            "[[fault]]\nwhen = {{ call = 1, of = \"Motor\" }}\nthen = {{ delay_ms = 2000 }}\n\
             [[fault]]\nwhen = {{ call = 2, to = {refused}, of = \"Motor\" }}\nthen = {{ refuse = \"E_FAIL\" }}\n",
        )));
        let (recovery, access) = (Recovery::default(), access(sim.address()));
        thread::scope(|scope| {
            scope.spawn(|| recovery::run(&access, &recovery));
            for step in ["TakeArm", "Motor"] {
                until("the step is the next one", || recovery.agree(step).is_ok());
            }
            sim.until("the motor is on", Controller::motor_is_on);
            recovery.end("the page is closed");
        });
        assert_eq!(recovery.state().outcome, Some(Err(format!("{ended}{more}"))));
        let sim = sim.lock();
        assert_eq!((sim.motor_is_on(), sim.arm_owner()), (is_on, None));
    }
}

/// The jog ends during TakeArm. If it then switched the motor on, the refused Motor would leave an error.
#[test]
fn a_jog_that_ends_during_take_arm_leaves_the_motor_off() {
    let sim = Sim::start();
    sim.lock().play(scenario(
        "[[fault]]\nwhen = { call = 1, of = \"TakeArm\" }\nthen = { delay_ms = 1000 }\n\
         [[fault]]\nwhen = { every = 1, of = \"Motor\" }\nthen = { refuse = \"E_FAIL\" }\n",
    ));
    let (grip, access) = (Grip::default(), access(sim.address()));
    thread::scope(|scope| {
        scope.spawn(|| jog::run(&access, &grip));
        // a busy machine may lose the heartbeat before
        while sim.lock().arm_owner().is_none() && grip.outcome().is_none() {
            grip.beat(Instant::now());
            thread::sleep(Duration::from_millis(2));
        }
        grip.end("HALT was pressed");
    });
    assert!(grip.outcome().unwrap().is_ok(), "{grip:?}");
}
