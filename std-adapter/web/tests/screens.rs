//! The main job of the screens in a real browser, and the files that a page saves.

use bcap_capture::decode::{Event, events};
use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::rac::VariableKind;
use bcap_core::variant::OwnedVariant;
use bcap_std::{Move, Settings, blocking};
use serde_json::json;

use crate::browser::opened;
use crate::chromium::Browser;
use crate::states::begin_reload;
use crate::support::{LIMIT, Relay, Sim, Web};

const MARKED: &str = "[...document.querySelectorAll('.byte.marked')].map((byte) => byte.textContent).join(' ')";
const PRESSED: &str =
    "[...document.querySelectorAll('.field[aria-pressed=true]')].map((field) => field.children[1].textContent).join()";

/// Clicks a button that saves a file, and returns its bytes in hexadecimal.
pub(crate) fn saved(browser: &mut Browser, selector: &str) -> String {
    let click = format!(
        "new Promise((resolve) => {{ URL.createObjectURL = (blob) => {{ blob.arrayBuffer().then((bytes) =>
            resolve([...new Uint8Array(bytes)].map((byte) => byte.toString(16).padStart(2, '0')).join(''))); return ''; }};
            document.querySelector('{selector}').click(); }})"
    );
    browser.eval(&click).as_str().unwrap().to_owned()
}

pub(crate) fn bytes(hex: &str) -> Vec<u8> {
    bcap_capture::hex::parse(hex.as_bytes()).unwrap()
}

/// The serial numbers of a new session begin again: an old row shows no bytes, instead of the bytes of another call.
#[test]
fn a_call_of_an_earlier_session_has_no_packets() {
    let sim = Sim::start();
    let relay = Relay::start(sim.address());
    let web = Web::start(&[("press", relay.address)], false);
    let mut page = web.page();
    page.until_state("ready, motor off");
    page.order("show", json!({ "robot": 0, "screen": "packets" })).unwrap();
    let row = page.until("packets", |content| content["rows"][0].is_array())["rows"][0].clone();
    let serial: u64 = row[1].as_str().unwrap().trim_start_matches('#').parse().unwrap();
    let packet = json!({ "robot": 0, "serial": serial, "at": row[0] });
    assert_ne!(page.order("packet", packet.clone()), Ok(json!([])));
    relay.cut(0);
    page.until_state("not connected");
    assert_ne!(page.order("packet", packet.clone()), Ok(json!([])), "until there is another session");
    page.until_state("ready, motor off");
    assert_eq!(page.order("packet", packet), Ok(json!([])));
}

/// The third axis of a SCARA slides.
#[test]
fn a_joint_that_slides_is_shown_in_mm() {
    let sim = Sim::of_arm(bcap_sim::ArmProfile::Hsr065);
    let web = Web::start(&[("press", sim.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.until_text(".numbers div:nth-child(3)", " mm");
    browser.until_text(".numbers div:nth-child(2)", "°");
    browser.click("[data-id=jog]");
    browser.until_text(".axis:nth-child(3) .value", " mm");
    browser.until_text(".axis:nth-child(2) .value", "°");
    browser.click("[data-id=variables]");
    browser.enter("#names", "J1 T1");
    browser.until_text("tbody tr:nth-child(1) th", "J1");
    browser.until_text("tbody tr:nth-child(1) .unit", "°, mm");
    assert_eq!(browser.problems, [""; 0]);
}

/// A field marks its bytes, and a byte its field; the packets are a file for Wireshark.
#[test]
fn a_packet_has_fields_and_bytes_that_belong_together() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=packets]");
    browser.enter("[type=search]", "variable_getvalue");
    // the tape still has the newest call
    browser.click(".packets tbody tr:not([hidden]) .serial");
    browser.until_text(".packet h3", "Request, 30 bytes");
    browser.click(".packet .field:nth-child(3)");
    assert!(browser.eval(PRESSED).as_str().unwrap().starts_with("serial "), "{}", browser.eval(PRESSED));
    assert_eq!(browser.eval("document.querySelectorAll('.byte.marked').length"), 2);
    browser.click(".packet .byte:nth-child(10)");
    assert_eq!(browser.eval(PRESSED), "function 101 Variable_GetValue");
    assert_eq!(browser.eval(MARKED), "65 00 00 00");
    browser.eval("document.querySelector('.dump').focus()");
    browser
        .call("Input.dispatchKeyEvent", json!({ "type": "keyDown", "key": "ArrowRight", "windowsVirtualKeyCode": 39 }));
    assert_eq!(browser.eval(PRESSED), "1 argument");
    assert_eq!(browser.eval(MARKED), "01 00");
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes(&saved(&mut browser, "#pcapng"))).unwrap();
    let (found, read) = events(file.path(), Strictness::Strict);
    read.unwrap();
    let count =
        |name: &str| found.iter().filter(|event| matches!(event, Event::Call(call) if call.function == name)).count();
    assert!(count("Controller_Connect") == 1 && count("Variable_GetValue") > 5, "{found:?}");
    browser.click("#objects");
    browser.until_text(".by-object", "Variable_GetValue @MODE");
    browser.click("#objects");
    // a refusal stops the list, and is shown with its bytes
    browser.click("#stop");
    browser.click("[data-id=variables]");
    browser.enter("#names", "robot/@NO_SUCH");
    browser.until_text("tbody tr th", "robot/@NO_SUCH");
    browser.click("[data-id=packets]");
    browser.until_text("#pause", "Go on");
    browser.until_text("tr.refused.shown td", "");
    browser.until_text(".packet .field", "SOH");
    let last = browser.eval("document.querySelector('.packets tbody tr').textContent");
    assert!(last.as_str().unwrap().contains("▲ 0x8"), "{last}");
    assert_eq!(browser.problems, [""; 0]);
}

/// A form of the function table is filled in, called in a loop, and used again.
#[test]
fn a_raw_call_is_filled_in_called_repeated_and_used_again() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], true);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=raw]");
    browser.until_text("#usage", "101 Variable_GetValue(variable)");
    assert_eq!(browser.eval("document.getElementById('argument-0').value"), "variable:I1");
    browser.click("#call");
    browser.until_text(".reply h2", "● 0x00000000 S_OK");
    assert!(
        browser
            .eval("document.querySelector('.answer').textContent")
            .as_str()
            .unwrap()
            .starts_with("Value0TYPE,DATA3,0")
    );
    browser.click(".reply .packet:nth-of-type(2) .field:nth-child(5)");
    assert_eq!(browser.eval(PRESSED), "HRESULT 0x00000000 (S_OK)");
    // this server does not allow motions, and writes only with the control
    browser.enter("#function", "72");
    browser.until_text("#usage", "72 Robot_Move(robot, interpolation, pose, option)");
    browser.until_text("#effect", "It can move the robot, or stop it. It is not sent while another client streams in Slave Mode. Start bcap web with --allow-motion.");
    browser.until("document.getElementById('call').disabled");
    browser.enter("#function", "variableputvalue");
    browser.until_text("#effect", "Take the control first.");
    // a system variable, and a handle, which may be one
    for variable in ["task:Pro1/variable: @START", "7", "robot/variable:@SERVO_ON"] {
        browser.enter("#argument-0", variable);
        browser.until_text("#effect", "It can move the robot, or stop it.");
        browser.enter("#argument-0", "variable:I1");
        browser.until_text("#effect", "It writes.");
    }
    browser.enter("#name", "Anna");
    browser.until("!document.getElementById('call').disabled");
    browser.eval(
        "(() => { const type = document.querySelector('.argument select'); type.value = '3'; type.onchange(); })()",
    );
    browser.enter("#argument-1", "5");
    browser.until_text("#question-text", "Variable_PutValue(variable:I1; 3,5).");
    browser.click("#question-no");
    browser.until_text("#notice", "nothing was done");
    browser.click("#call");
    browser.click("#question-yes");
    browser.until_text(".reply h2", "● 0x00000000 S_OK");
    let is_written = |sim: &bcap_sim::Controller| {
        sim.variable::<64>(VariableKind::I, 1).is_ok_and(|value| value.as_variant().as_i32() == Some(5))
    };
    sim.until("I1 is 5", is_written);
    // the reply above may be the one of the first call, and a form does not call during a call
    browser.until("document.getElementById('stop-loop').disabled");
    browser.until_text(".answer div", "Took");
    // an earlier call is used again, three times
    browser.enter("#function", "101");
    browser.enter("#argument-0", "variable:I1");
    browser.until_text(".answer", "TYPE,DATA3,5");
    browser.enter("#function", "16");
    browser.until("document.querySelectorAll('.last li').length === 2");
    browser.click(".last li:nth-child(2) button");
    browser.until_text("#usage", "102 Variable_PutValue(variable, value)");
    browser.click(".last li:nth-child(1) button");
    browser.enter("#times", "3");
    browser.eval("document.getElementById('interval').value = '100'");
    browser.click("#call");
    browser.until_text(".reply h2", "3 of 3: ● 0x00000000 S_OK");
    // a refusal has its meaning, and ends a loop
    browser.enter("#argument-0", "999");
    browser.until_text(".reply h2", "1 of 3: ▲ 0x80070006 E_HANDLE");
    browser.until_text(".answer", "Meaning");
    // text of the controller stays text
    let hostile = OwnedVariant::new("<img src=x onerror=window.owned=1>").unwrap();
    sim.lock().set_variable(VariableKind::S, 1, &hostile.as_variant()).unwrap();
    browser.enter("#argument-0", "variable:S1");
    browser.until_text(".answer", "<img src=x");
    browser.until(
        "[...document.querySelectorAll('.reply .field')].some((field) => field.textContent.includes('<img src=x'))",
    );
    assert_eq!(
        browser.eval("[document.querySelectorAll('img').length, String(window.owned)]"),
        json!([0, "undefined"])
    );
    browser.until_text(".reply h2", "3 of 3: ●");
    // a long loop is stopped
    browser.enter("#times", "1000");
    browser.enter("#argument-0", "variable:I1");
    browser.until_text(".reply h2", "2 of 1000: ");
    browser.click("#stop-loop");
    browser.until("document.getElementById('stop-loop').disabled");
    browser.eval("document.getElementById('times').value = '1'");
    browser.eval("document.getElementById('packet').value = '01 1e'");
    browser.click("#send");
    browser.click("#question-yes");
    browser.until_text("#notice.bad", "the packet is refused");
    assert_eq!(browser.problems, [""; 0]);
}

/// The wheel changes the window, the keys move the cursor, and the numbers are saved for Foxglove and PlotJuggler.
#[test]
fn numbers_are_zoomed_measured_and_saved() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=plots]");
    browser.until_text(".legend", "J2 45.000");
    let window = "document.getElementById('window').value";
    assert_eq!(browser.eval(window), "60");
    for (delta, seconds) in [(-1, "30"), (1, "60"), (1, "120")] {
        let wheel =
            format!("document.querySelector('.plot').dispatchEvent(new WheelEvent('wheel', {{ deltaY: {delta} }}))");
        browser.eval(&wheel);
        assert_eq!(browser.eval(window), seconds);
    }
    browser.eval("document.querySelector('.plot').focus()");
    browser
        .call("Input.dispatchKeyEvent", json!({ "type": "keyDown", "key": "ArrowLeft", "windowsVirtualKeyCode": 37 }));
    browser.until("/^J1 .* at -6[0-9][.][0-9] s$/.test(document.querySelector('.legend li').textContent)");
    let file = bytes(&saved(&mut browser, "#mcap"));
    let magic = b"\x89MCAP0\r\n";
    assert!(file.starts_with(magic) && file.ends_with(magic));
    let text = String::from_utf8_lossy(&file);
    for part in ["/J1", "/J2", "/J3", "bcap.Number", "{\"value\":45.0}"] {
        assert!(text.contains(part), "{part}");
    }
    // files that hang leave connections for HALT
    browser.eval("window.fetch = () => new Promise(() => {}); for (let n = 0; n < 2; n += 1) document.getElementById('mcap').click(); 0");
    browser.until_text("#notice.bad", "not saved: another file is being saved; wait for its end");
    assert_eq!(browser.problems, [""; 0]);
}

/// Files are for pages of this server only.
#[test]
fn a_file_needs_the_token_and_the_origin() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    web.page().until_state("ready, motor off");
    let origin = format!("http://{}", web.host());
    let (host, token) = (("host", web.host()), ("x-bcap-token", web.token()));
    let (origin, length) = (("origin", origin.as_str()), ("content-length", "0"));
    assert_eq!(web.status("POST /packets/0", &[host, token, origin, length]), 200);
    assert_eq!(web.status("POST /packets/1", &[host, token, origin, length]), 404);
    for path in ["/packets/0", "/mcap"] {
        assert_eq!(web.status(&format!("POST {path}"), &[host, origin, length]), 401, "{path}");
        let other = ("origin", "http://example.com");
        assert_eq!(web.status(&format!("POST {path}"), &[host, token, other, length]), 403, "{path}");
        assert_eq!(web.status(&format!("GET {path}"), &[host, token, origin]), 405, "{path}");
    }
    assert_eq!(web.status("POST /mcap", &[host, token, origin, length]), 400);
}

/// Two robots: the tile of the stopped robot says why it is stopped and what to do; its alarms list the first cause first, and
/// have the log.
#[test]
fn a_cell_of_two_says_why_one_is_not_ready() {
    let [press, welder] = [Sim::start(), Sim::start()];
    let web = Web::start(&[("press", press.address()), ("welder", welder.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    let level = |n: u32| format!(".tile:nth-child({n}) .state");
    browser.until_text(&level(2), "● ready, motor off");
    welder.lock().emergency_stop(true, bcap_std::now());
    browser.until_text(&level(2), "▲");
    browser.until_text(".tile:nth-child(2) .reasons strong", "emergency stop");
    browser.until_text(".tile:nth-child(2) .reasons span", "and release it");
    browser.until_text(&level(1), "● ready, motor off");
    browser.click(".tile:nth-child(2) button:not(.halt)");
    browser.until_text("#halt-robot", "welder");
    // after the click, because the button moves when the tile has further reasons
    for code in [0x8350_0076, 0x8350_0178] {
        welder.lock().inject_error(HResult::from_u32(code), bcap_std::now());
    }
    browser.click("[data-id=alarms]");
    browser.until("document.querySelectorAll('.errors li').length >= 2");
    browser.until_text(".errors li:first-child .first", "first cause");
    assert_eq!(browser.eval("document.querySelectorAll('.first').length"), 1);
    for part in ["Meaning: ", "Cause: ", "Remedy: "] {
        browser.until_text(".errors li", part);
    }
    // also above the button; the plan is available later than the errors
    browser.until_text(".plan", "ClearError");
    browser.click("#log");
    browser.until_text(".log tbody", "0x83500178");
    assert_eq!(browser.eval("document.querySelectorAll('.log tbody tr:first-child td').length"), 5);
    assert_eq!(browser.problems, [""; 0]);
}

/// The file provides a label and its unit, until the browser stores others; a search finds them; an output has its label.
#[test]
fn variables_have_labels_units_and_a_search() {
    let sim = Sim::start();
    let labels = [("I1", "good parts"), ("F1", "pressure [bar]"), ("IO128", "<b>gripper</b>")];
    let labels = labels.map(|(name, label)| (name.to_owned(), label.to_owned()));
    let web = Web::with(&|config| config.labels = labels.clone().into(), &[("press", sim.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=variables]");
    browser.enter("#names", "I1 F1 P1 IO128");
    browser.until("document.querySelectorAll('tbody tr').length === 3");
    let row = "[...document.querySelectorAll('tbody tr')].map((row) => [row.querySelector('th').textContent,
        row.querySelector('.label').value, row.querySelector('.unit').textContent])";
    assert_eq!(
        browser.eval(row),
        json!([["I1", "good parts", ""], ["F1", "pressure [bar]", "bar"], ["P1", "", "mm, °"]])
    );
    browser.until_text(".lamp .about", "<b>gripper</b>");
    assert_eq!(browser.eval("document.querySelectorAll('.lamp b').length"), 0);
    browser.enter("tbody tr:nth-child(1) .label", "waste [kg]");
    browser.until_text("tbody tr:nth-child(1) .unit", "kg");
    begin_reload(&mut browser);
    browser.click("[data-id=variables]");
    browser.until_text("tbody tr:nth-child(1) .unit", "kg");
    let shown = "[...document.querySelectorAll('tbody tr:not([hidden]) th, .lamp:not([hidden]) .name')].map((name) => name.textContent).join()";
    for (search, found) in [("waste", "I1"), ("gripper", "IO128"), ("bar", "F1")] {
        browser.enter("#search", search);
        assert_eq!(browser.eval(shown), found);
    }
    assert_eq!(browser.problems, [""; 0]);
}

/// The arm is drawn where the controller reports it, even after a rotation of the view by keys and by the pointer, and the
/// target is drawn.
#[test]
fn the_arm_is_drawn_in_three_dimensions() {
    let sim = Sim::quick();
    let web = Web::start(&[("press", sim.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=arm]");
    let data = "document.querySelector('.space').dataset";
    browser.until(&format!("{data}.flange !== undefined && {data}.flange !== ''"));
    // the flange is at the reported position, and at the target of a robot that rests
    let fits = format!("{data}.flange === {data}.position && {data}.flange === {data}.commanded");
    browser.until(&fits);
    let place = |browser: &mut Browser| browser.eval(&format!("{data}.flange")).as_str().unwrap().to_owned();
    let drawn = "(() => { const canvas = document.querySelector('.space'); const [x, y] = canvas.dataset.flange.split(' ').map(Number);
        const pixels = canvas.getContext('2d').getImageData((x - 6) * devicePixelRatio, (y - 6) * devicePixelRatio, 12, 12).data;
        return pixels.some((value, n) => n % 4 === 3 && value > 0); })()";
    let mut places = vec![place(&mut browser)];
    browser.eval("document.querySelector('.space').focus()");
    for key in ["ArrowLeft", "ArrowDown", "+"] {
        browser.eval(&format!(
            "document.querySelector('.space').dispatchEvent(new KeyboardEvent('keydown', {{ key: '{key}' }}))"
        ));
        assert_eq!(browser.eval(&fits), true, "{key}");
        assert_eq!(browser.eval(drawn), true, "{key}");
        places.push(place(&mut browser));
    }
    browser.press(".space");
    let to = "(() => { const r = document.querySelector('.space').getBoundingClientRect(); return [r.x + 40, r.y + 60]; })()";
    let to = browser.eval(to);
    browser.call(
        "Input.dispatchMouseEvent",
        json!({ "type": "mouseMoved", "x": to[0], "y": to[1], "button": "left", "buttons": 1 }),
    );
    browser.lift();
    places.push(place(&mut browser));
    places.dedup();
    assert_eq!(places.len(), 5, "each turn shows another side: {places:?}");
    browser.eval("document.querySelector('.space').dispatchEvent(new KeyboardEvent('keydown', { key: 'Home' }))");
    assert_eq!(place(&mut browser), places[0]);
    // during a motion the target is elsewhere, and the path grows
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let moving = arm.start(&Move::joint("J(60,45,90,0,45,0)").speed_percent(5.0), LIMIT).unwrap();
    browser.until(&format!("{data}.commanded !== {data}.flange && Number({data}.path) > 2"));
    browser.until_text(".views + p", "The dashed line is where the controller has commanded it to.");
    drop(moving);
    assert_eq!(browser.problems, [""; 0]);
}

/// Answers the question of the page with yes.
fn agree(browser: &mut Browser, text: &str) {
    browser.until_text("#question-text", text);
    browser.click("#question-yes");
    browser.until("!document.getElementById('question').open");
}

/// A task is started and stopped after a question, and a program is text.
#[test]
fn a_task_is_started_and_stopped_and_a_program_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("Pick.pcs"), "Sub Main\n<script>window.owned = 1</script>\nEnd Sub\n").unwrap();
    let sim = Sim::with_files(folder.path());
    let name = sim.lock().tasks().next().map(|(name, ..)| name.to_owned()).unwrap();
    let web = Web::moving(&[("press", sim.address())]);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=tasks]");
    browser.until_text("tbody tr th", &name);
    browser.until("document.querySelector('[data-what=forever]').disabled");
    browser.enter("#name", "Anna");
    browser.click("[data-what=forever]");
    agree(&mut browser, &format!("{name}: run again and again. The program can move the robot."));
    browser.until_text("#notice", &format!("press: {name}: run again and again is done"));
    browser.until_text("tbody tr.changed td", "running");
    // the line moves on
    browser.eval("window.lines = new Set()");
    browser.until("lines.add(document.querySelector('tbody tr.changed td.value')?.textContent); [...lines].filter((line) => /^\\d+$/.test(line)).length > 1");
    browser.click("[data-what=stop]");
    agree(&mut browser, &format!("{name}: stop."));
    browser.until("document.querySelector('tbody tr.changed') === null");
    std::thread::sleep(std::time::Duration::from_millis(1500));
    assert_eq!(
        browser.eval("document.querySelector('tbody td.value').textContent"),
        "",
        "the line of a task that rests is not known"
    );
    browser.until_text(".files", "Pick.pcs");
    browser.eval(
        "[...document.querySelectorAll('.files button')].find((button) => button.textContent === 'Pick.pcs').click()",
    );
    browser.until("document.querySelectorAll('.program li').length === 3");
    browser.until_text(".program li:nth-child(2)", "<script>window.owned = 1</script>");
    assert_eq!(
        browser.eval("[document.querySelectorAll('main script').length, String(window.owned)]"),
        json!([0, "undefined"])
    );
    assert_eq!(browser.problems, [""; 0]);
}

/// Each step of a recovery has its own button and its own question.
#[test]
fn a_recovery_is_made_button_by_button() {
    let sim = Sim::start();
    sim.lock().inject_error(HResult::from_u32(0x8350_0076), bcap_std::now());
    let web = Web::moving(&[("press", sim.address())]);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(web.url());
    browser.until_text("#state", "error");
    browser.enter("#name", "Anna");
    browser.click("[data-id=alarms]");
    browser.click("#recover");
    agree(&mut browser, "no other program uses it");
    let mut made = Vec::new();
    loop {
        browser.until("document.querySelector('.steps button') !== null || /recovered/.test(document.querySelector('.alarms').textContent)");
        let step = browser.eval("document.querySelector('.steps button')?.textContent");
        let Some(step) = step.as_str().map(str::to_owned) else { break };
        if made.is_empty() {
            assert_eq!(sim.lock().errors().count(), 1, "nothing is done before the first agreement");
        }
        // the page may redraw the button during the press, which then has no effect
        while browser.eval("document.getElementById('question').open") != true {
            browser.click(".steps button");
        }
        agree(&mut browser, &step);
        browser.until(&format!("document.querySelector('.steps button')?.textContent !== '{step}'"));
        if step == "ClearError" {
            // the errors are above the button
            browser.until_text(".present h2", "No errors");
        }
        made.push(step);
    }
    assert_eq!(
        (made.first().map(String::as_str), made.last().map(String::as_str)),
        (Some("ClearError"), Some("Motor"))
    );
    browser.until_text(".alarms", "recovered: no errors; the motor is as before, and the arm is free");
    let sim = sim.lock();
    assert_eq!((sim.errors().count(), sim.motor_is_on(), sim.arm_owner()), (0, false, None));
    assert_eq!(browser.problems, [""; 0]);
}
