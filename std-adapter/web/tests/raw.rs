//! Calls of any function, without a browser: what the table of effects allows, and what the end of the screen leaves.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bcap_core::bcap::{Effect, FunctionId};
use bcap_core::rac::VariableKind;
use bcap_core::variant::Variant;
use bcap_sim::pace::Paced;
use bcap_sim::{Config, Controller, Profile, Scenario};
use bcap_std::{Settings, blocking};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;

use crate::support::{Page, Sim, Web, serve_paced};

const CONTROL: &str = "take the control first";
const WRITE: &str = "this server is read-only; start it with --allow-write";
const MOTION: &str = "this server moves nothing; start it with --allow-motion";

#[track_caller]
fn call(page: &mut Page, function: &str, arguments: &[&str]) -> Result<Value, String> {
    let fields = fields(page, function, arguments);
    page.order("call", fields)
}

/// Returns a call for which the user has agreed now.
fn fields(page: &mut Page, function: &str, arguments: &[&str]) -> Value {
    json!({ "agreed": agreed(page, "press"), "function": function, "arguments": arguments })
}

fn agreed(page: &mut Page, name: &str) -> Value {
    let tiles = page.until("tiles", Value::is_array);
    json!({ "robot": 0, "name": name, "revoked": tiles[0]["revoked"], "repeats": false })
}

fn opened(web: &Web) -> Page {
    let mut page = web.page();
    page.until_state("ready, motor off");
    page.order("show", json!({ "robot": 0, "screen": "raw" })).unwrap();
    page
}

fn with_control(web: &Web) -> Page {
    let mut page = opened(web);
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    page
}

fn is(sim: &Sim, number: i32) -> bool {
    sim.lock().variable::<64>(VariableKind::I, 1).unwrap().as_variant() == Variant::I4(number)
}

#[test]
fn each_function_that_writes_or_moves_is_refused_by_a_read_only_server() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    let table = opened(&web).order("functions", json!({})).unwrap();
    let rows = table.as_array().unwrap();
    assert_eq!(
        (rows.len(), &rows[100]["name"], &rows[100]["effect"]),
        (137, &json!("Variable_GetValue"), &json!("reads"))
    );
    assert_eq!(rows[71]["arguments"][1], json!(["interpolation", "I4"]));
    let strong: Vec<FunctionId> = FunctionId::all().filter(|function| !function.effect().is_harmless()).collect();
    // each page has a burst of 40 orders
    for functions in strong.chunks(30) {
        let mut page = opened(&web);
        for function in functions {
            // without arguments a command or an option is unknown, which counts as the strongest
            let refused = call(&mut page, &function.to_string(), &[]).unwrap_err();
            let is_writing = function.effect() == Effect::Writes && *function != FunctionId::VARIABLE_PUT_VALUE;
            let expected = if is_writing { WRITE } else { MOTION };
            assert_eq!(refused, expected, "{function}");
        }
    }
    assert!(strong.len() > 40, "{}", strong.len());
    assert_eq!(web.lines(), [""; 0], "nothing was tried");
}

#[test]
fn a_call_has_its_reply_and_its_bytes() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    let mut page = opened(&web);
    let reply = call(&mut page, "101", &["variable:I1"]).unwrap();
    assert_eq!((&reply["code"], &reply["name"], &reply["value"]), (&json!("0x00000000"), &json!("S_OK"), &json!("0")));
    assert_eq!(reply["typed"], "3,0");
    let [request, received] = [&reply["packets"][0], &reply["packets"][1]];
    assert_eq!(request["fields"][4][2], "function 101 Variable_GetValue");
    assert_eq!(received["fields"][4][2], "HRESULT 0x00000000 (S_OK)");
    let refused = call(&mut page, "Variable_GetValue", &["3,999"]).unwrap();
    assert_eq!((&refused["ok"], &refused["name"]), (&json!(false), &json!("E_HANDLE")));
    assert!(refused["meaning"].as_str().is_some_and(|meaning| meaning.contains("handle")), "{refused}");
    // a handle of an earlier reply is a number; the refusal above has not ended the session
    let opened = call(&mut page, "Controller_GetVariable", &["controller", "8,I1", "8,"]).unwrap();
    let handle: u8 = opened["value"].as_str().unwrap().parse().unwrap();
    assert_eq!(call(&mut page, "Variable_GetValue", &[&format!("3,{handle}")]).unwrap()["value"], "0");
    let packet =
        |function: &str| format!("01 1e000000 0900 0000 {function} 0100 0a000000 0300 01000000 {handle:02x}000000 04");
    let agreed = agreed(&mut page, "press");
    let bytes = |packet: &str| json!({ "agreed": agreed, "packet": packet });
    assert_eq!(page.order("bytes", bytes(&packet("65000000"))).unwrap()["typed"], "3,0");
    assert_eq!(page.order("bytes", bytes(&packet("48000000"))).unwrap_err(), MOTION, "Robot_Move");
    let cut = page.order("bytes", bytes("01 1e 00")).unwrap_err();
    assert!(cut.starts_with("the packet is refused: ") && cut.contains("`bcap raw`"), "{cut}");
    for (function, argument, part) in [
        ("Variable_Read", "variable:I1", "there is no function Variable_Read"),
        ("Variable_GetValue", "robot", "robot is not a variable, which Variable_GetValue takes here"),
        ("Variable_GetValue", "5", "a comma is missing"),
    ] {
        let refused = call(&mut page, function, &[argument]).unwrap_err();
        assert!(refused.contains(part), "{refused}");
    }
    // the end of the service ends the session, and the next call opens another
    assert_eq!(call(&mut page, "Service_Stop", &[]).unwrap()["ok"], true);
    assert_eq!(call(&mut page, "Robot_GetName", &["robot"]).unwrap()["ok"], true);
}

#[test]
fn a_writing_call_needs_the_right_the_control_and_the_name() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], true);
    let put = ["variable:I1", "3,5"];
    assert_eq!(call(&mut opened(&web), "Variable_PutValue", &put).unwrap_err(), CONTROL);
    let mut page = with_control(&web);
    let other = json!({ "agreed": agreed(&mut page, "welder"), "function": "Variable_PutValue", "arguments": put });
    assert_eq!(page.order("call", other).unwrap_err(), "welder is not the name of this robot; nothing was done");
    let take = ["robot", "8,TakeArm", "8195,0,1"];
    assert_eq!(call(&mut page, "Robot_Execute", &take).unwrap_err(), MOTION);
    assert_eq!(call(&mut page, "Robot_Execute", &["robot", "8,no such command", "0,"]).unwrap_err(), MOTION);
    assert!(is(&sim, 0));
    assert_eq!(call(&mut page, "Variable_PutValue", &put).unwrap()["ok"], true);
    assert!(is(&sim, 5));
    let refused = call(&mut page, "Variable_PutValue", &["variable:I1", "8,five"]).unwrap();
    assert_eq!(refused["ok"], false);
    let lines = web.lines();
    assert!(lines.contains(&"press: Anna: calls Variable_PutValue(I1, I4(5)): done".to_owned()), "{lines:?}");
    assert!(lines.iter().any(|line| line.contains("(I1, \"five\"): 0x8")), "{lines:?}");
}

/// The controller may reuse the number of a released object.
#[test]
fn an_object_that_a_call_released_is_opened_again() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], true);
    let mut page = with_control(&web);
    for _ in 0..2 {
        assert_eq!(call(&mut page, "Variable_GetValue", &["variable:I1"]).unwrap()["ok"], true);
        assert_eq!(call(&mut page, "Variable_Release", &["variable:I1"]).unwrap()["ok"], true);
    }
    let written = call(&mut page, "Variable_PutValue", &["variable:I1", "3,5"]).unwrap();
    assert_eq!(written["ok"], true, "{written}");
    assert!(is(&sim, 5));
}

/// Takes the arm, and starts a motion that lasts longer than the test.
fn start_moving(sim: &Sim, page: &mut Page) {
    for (command, parameter) in [("TakeArm", "8195,0,1"), ("Motor", "8195,1,0")] {
        let made = call(page, "Robot_Execute", &["robot", &format!("8,{command}"), parameter]).unwrap();
        assert_eq!(made["ok"], true, "{made}");
    }
    let arguments = ["robot", "3,1", "8,@E J(90, 45, 90, 0, 45, 0)", "8,SPEED=1"];
    let fields = fields(page, "Robot_Move", &arguments);
    page.send("call", fields);
    // the server closes a page that answers no pulse for 2 s
    crate::support::until("the robot moves", || {
        page.receive().expect("the page is open");
        sim.lock().is_moving()
    });
}

fn rests(sim: &Sim) {
    let is_at_rest = |sim: &Controller| !sim.is_moving() && sim.arm_owner().is_none() && !sim.motor_is_on();
    sim.until("the robot rests, its motor is off, and the arm is free", is_at_rest);
}

/// `@START` starts a program, `@SERVO_ON` switches the motor on, and a handle may be any variable's.
#[test]
fn a_system_variable_needs_the_right_to_move() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], true);
    let mut page = with_control(&web);
    for variable in ["task:Pro1/variable:@START", "robot/variable:@SERVO_ON", "robot/variable: @SERVO_ON", "3,1"] {
        assert_eq!(call(&mut page, "Variable_PutValue", &[variable, "3,2"]).unwrap_err(), MOTION, "{variable}");
    }
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web);
    for variable in ["robot/@SERVO_ON", "robot/ @SERVO_ON"] {
        let check = json!({ "robot": 0, "name": variable, "text": "true" });
        let refused = page.order("check", check).unwrap_err();
        assert!(
            refused.contains("a system variable may switch the motor") && refused.contains("Raw calls"),
            "{variable}: {refused}"
        );
    }
    assert_eq!(call(&mut page, "Variable_PutValue", &["robot/variable:@SERVO_ON", "11,-1"]).unwrap()["ok"], true);
    assert!(sim.lock().motor_is_on());
    page.order("show", json!({ "robot": 0, "screen": "cell" })).unwrap();
    rests(&sim);
}

/// The user confirms a loop once, for one robot on the screen of raw calls. HALT ends it, and calls that move the robot are not
/// repeated.
#[test]
fn a_loop_ends_with_halt_and_with_its_screen_and_repeats_no_motion() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address()), ("welder", sim.address())]);
    let mut page = with_control(&web);
    let put = ["variable:I1", "3,5"];
    let mut first = fields(&mut page, "Variable_PutValue", &put);
    first["agreed"]["repeats"] = json!(true);
    assert_eq!(page.order("call", first.clone()).unwrap()["ok"], true);
    let mut moves = fields(&mut page, "Robot_Execute", &["robot", "8,TakeArm", "8195,0,1"]);
    moves["agreed"]["repeats"] = json!(true);
    let refused = page.order("call", moves).unwrap_err();
    assert_eq!(refused, "a call that can move the robot is not repeated; nothing was done");
    for (robot, screen) in [(0, "cell"), (1, "raw")] {
        page.order("show", json!({ "robot": robot, "screen": screen })).unwrap();
        assert_eq!(page.order("call", first.clone()).unwrap_err(), "the screen was left; nothing was done");
    }
    page.order("show", json!({ "robot": 0, "screen": "raw" })).unwrap();
    assert_eq!(page.order("call", first.clone()).unwrap()["ok"], true);
    assert_eq!(web.halt_while_receiving(&mut page, 0)["ok"], true);
    let refused = page.order("call", first).unwrap_err();
    assert!(
        refused.contains("HALT was pressed, or the control was released, before it began; nothing was done"),
        "{refused}"
    );
    let read = json!({ "robot": 0, "name": "press", "revoked": 0, "repeats": true });
    let read = json!({ "agreed": read, "function": "Variable_GetValue", "arguments": ["variable:I1"] });
    assert_eq!(page.order("call", read).unwrap()["value"], "5", "a loop that reads goes on");
}

/// A call that was sent before HALT may arrive after it: HALT waits for its end, and does not report the robot as halted
/// before.
#[test]
fn a_halt_is_not_done_while_a_call_that_was_made_before_is_under_way() {
    let mut controller = Controller::new(Config::new(Profile::Rc8));
    let late = "[[fault]]\nwhen = { call = 1, of = \"TakeArm\" }\nthen = { delay_ms = 3000 }\n";
    controller.play(Scenario::parse(late).unwrap());
    let paced = Arc::new(Mutex::new(Paced::new(controller)));
    let pace = |factor| paced.lock().unwrap().set_factor(factor, bcap_std::now()).unwrap();
    let server = serve_paced(&paced);
    let web = Web::moving(&[("press", server.value)]);
    let mut page = with_control(&web);
    // the answer must not arrive before the end of HALT
    pace(0.1);
    let fields = fields(&mut page, "Robot_Execute", &["robot", "8,TakeArm", "8195,0,1"]);
    page.send("call", fields);
    crate::support::until("the call is under way", || {
        page.receive().expect("the page is open");
        paced.lock().unwrap().controller().arm_owner().is_some()
    });
    let halted = web.halt_while_receiving(&mut page, 0);
    let text = halted["text"].to_string();
    assert!(text.contains("has not ended, and may still move the robot: use the emergency stop"), "{halted}");
    assert_eq!(halted["ok"], false);
    pace(10.0);
    crate::support::until("nothing is under way", || web.halt(0)["ok"] == true);
}

/// The call lasts longer than the test, and the page continues to answer pulses.
#[test]
fn an_order_that_leaves_the_screen_does_not_wait_for_a_call_that_moves() {
    let leaves: [(&str, Value); 2] =
        [("show", json!({ "robot": 0, "screen": "cell" })), ("release", json!({ "robot": 0 }))];
    for (order, fields) in leaves {
        let sim = Sim::quick();
        let web = Web::moving(&[("press", sim.address())]);
        let mut page = with_control(&web);
        start_moving(&sim, &mut page);
        page.send(order, fields);
        crate::support::until("the robot rests", || {
            page.receive().expect("the page is open");
            !sim.lock().is_moving()
        });
        rests(&sim);
    }
}

/// A second call waits for the first when HALT, or another screen, ends the first.
#[test]
fn a_call_that_waits_behind_another_one_is_not_made_after_the_end_of_that() {
    for is_halted in [true, false] {
        let sim = Sim::quick();
        let web = Web::moving(&[("press", sim.address())]);
        let mut page = with_control(&web);
        start_moving(&sim, &mut page);
        let arguments = ["robot", "8,ClearError", "0,"];
        let fields = fields(&mut page, "Robot_Execute", &arguments);
        let waits = page.send("call", fields);
        // it is received first: the server reads messages in order
        page.socket.send(Message::Ping(Vec::new().into())).unwrap();
        while !page.socket.read().unwrap().is_pong() {}
        // the page answers pulses during the halt
        let answer = std::thread::scope(|scope| {
            let halt = is_halted.then(|| scope.spawn(|| web.halt(0)));
            if !is_halted {
                page.send("show", json!({ "robot": 0, "screen": "cell" }));
            }
            let answer = loop {
                let message = page.receive().expect("the page is open");
                if message["t"] == "answer" && message["id"] == waits {
                    break message;
                }
            };
            assert!(halt.is_none_or(|halt| halt.join().unwrap()["ok"] == true));
            answer
        });
        assert!(
            answer["error"].as_str().is_some_and(|why| why.contains("before it began; nothing was done")),
            "{answer}"
        );
        let lines = web.lines();
        assert!(!lines.iter().any(|line| line.contains("ClearError")), "{lines:?}");
    }
}

#[test]
fn the_end_of_the_server_halts_and_frees_the_arm_before_it_returns() {
    let sim = Sim::quick();
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web);
    start_moving(&sim, &mut page);
    drop(web);
    let sim = sim.lock();
    assert_eq!((sim.is_moving(), sim.arm_owner(), sim.motor_is_on()), (false, None, false));
}

/// The session of the calls is the third connection, after the ones that read and halt.
#[test]
fn a_call_that_is_being_prepared_is_not_made_after_the_page_is_gone_or_after_a_halt() {
    for is_halted in [false, true] {
        let sim = Sim::start();
        let relay = crate::support::Relay::start(sim.address());
        let web = Web::moving(&[("press", relay.address)]);
        let mut page = with_control(&web);
        crate::support::until("the connection of HALT is there", || relay.count() == 2);
        relay.freeze(2);
        let arguments = ["task:Pro1", "3,2", "8,"];
        let fields = fields(&mut page, "Task_Start", &arguments);
        page.send("call", fields);
        crate::support::until("the session of the calls is begun", || relay.count() == 3);
        let mut page = Some(page);
        if is_halted {
            assert_eq!(web.halt(0)["ok"], true);
        } else {
            page = None;
            crate::support::until("the control is free", || {
                web.page().order("take", json!({ "robot": 0, "name": "Bob" })).is_ok()
            });
        }
        relay.freeze(usize::MAX);
        crate::support::until("the call has its line of the audit", || {
            web.lines().iter().any(|line| line.contains("Task_Start") && line.contains("nothing was done"))
        });
        assert!(!sim.lock().tasks().any(|(_, status, _)| status == bcap_sim::TaskStatus::Running), "{is_halted}");
        drop(page);
    }
}

#[test]
fn a_page_shows_present_values_while_its_call_moves_the_robot() {
    let sim = Sim::quick();
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web);
    start_moving(&sim, &mut page);
    // the call is answered after 90 s
    let at = |tiles: &Value| tiles[0]["joints"][0].as_f64();
    let begun = at(&page.until_state("moving"));
    page.until("tiles", |tiles| at(tiles) > begun);
}

#[test]
fn the_end_of_the_screen_halts_a_call_that_moves_and_frees_the_arm() {
    let sim = Sim::quick();
    let web = Web::moving(&[("press", sim.address())]);
    assert_eq!(call(&mut opened(&web), "Robot_Execute", &["robot", "8,TakeArm", "8195,0,1"]).unwrap_err(), CONTROL);
    let mut page = with_control(&web);
    start_moving(&sim, &mut page);
    drop(page);
    rests(&sim);
    crate::support::until("the halt has its line of the audit", || {
        web.lines().iter().any(|line| {
            line.contains("HALT, because its screen was left during a call that moves, halted, the robot rests: done")
        })
    });
    // without a motion the arm is also given back
    sim.lock().clear_errors(bcap_std::now());
    let mut page = with_control(&web);
    let taken = call(&mut page, "Robot_Execute", &["robot", "8,TakeArm", "8195,0,1"]).unwrap();
    assert_eq!(taken["ok"], true, "{taken}");
    assert!(sim.lock().arm_owner().is_some());
    page.order("show", json!({ "robot": 0, "screen": "cell" })).unwrap();
    rests(&sim);
}

#[test]
fn an_end_that_leaves_the_motor_on_has_its_line_of_the_audit() {
    let sim = Sim::quick();
    let refused = "[[fault]]\nwhen = { call = 2, to = 99, of = \"Motor\" }\nthen = { refuse = \"E_FAIL\" }\n";
    sim.lock().play(Scenario::parse(refused).unwrap());
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web);
    for (command, parameter) in [("TakeArm", "8195,0,1"), ("Motor", "8195,1,0")] {
        let made = call(&mut page, "Robot_Execute", &["robot", &format!("8,{command}"), parameter]).unwrap();
        assert_eq!(made["ok"], true, "{made}");
    }
    page.order("show", json!({ "robot": 0, "screen": "cell" })).unwrap();
    let expected =
        "press: a page: the end of the raw calls: IT IS UNKNOWN whether the robot rests, the motor is off and the arm";
    crate::support::until("the end has its line of the audit", || {
        page.receive().expect("the page is open");
        web.lines().iter().any(|line| line.starts_with(expected) && line.contains("the motor was NOT switched off"))
    });
    assert!(sim.lock().motor_is_on());
}

/// The connection of a lost computer stays open, but it does not answer.
#[test]
fn a_call_that_moves_ends_when_the_page_answers_no_pulse() {
    let sim = Sim::quick();
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web);
    start_moving(&sim, &mut page);
    page.beats = false;
    rests(&sim);
    crate::support::until("the control is free", || {
        web.page().order("take", json!({ "robot": 0, "name": "Bob" })).is_ok()
    });
}

/// The page answers each pulse when it has ten later ones.
#[test]
fn a_page_with_a_long_round_trip_stays_open() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = with_control(&web);
    page.beats = false;
    // a page without a heartbeat is closed after 3 s
    let end = Instant::now() + Duration::from_secs(5);
    while Instant::now() < end {
        let message = page.receive().expect("the page is open");
        if let Some(number) = message["n"].as_u64() {
            page.beat(number.saturating_sub(10));
        }
    }
    assert_eq!(call(&mut page, "Variable_GetValue", &["variable:I1"]).unwrap()["value"], "0");
}

#[test]
fn a_stream_of_another_client_is_not_ended_by_a_call() {
    let sim = Sim::quick();
    let web = Web::moving(&[("press", sim.address())]);
    let mut page = opened(&web);
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    // from here on it must answer pulses
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    crate::support::stream(&sim, &mut arm, &mut page);
    assert_eq!(call(&mut page, "Variable_GetValue", &["variable:I1"]).unwrap()["value"], "0");
    for (function, arguments) in [
        ("Controller_Execute", &["controller", "8,SysState", "0,"][..]),
        ("Controller_GetTaskNames", &["controller", "8,"]),
        ("Variable_PutValue", &["variable:I1", "3,5"]),
        ("Robot_Speed", &["robot", "3,0", "4,50"]),
        ("Task_GetName", &["task:Pro1"]),
    ] {
        let skipped = call(&mut page, function, arguments).unwrap_err();
        assert!(skipped.contains("a stream of Slave Mode runs"), "{function}: {skipped}");
    }
    assert_eq!(sim.lock().slave_mode(), 0x202);
    assert!(is(&sim, 0));
}
