//! The screens of packets and raw calls in a real browser, and the files that a page saves.

use bcap_capture::decode::{Event, events};
use bcap_core::limits::Strictness;
use serde_json::json;

use crate::browser::opened;
use crate::chromium::Browser;
use crate::support::{Sim, Web};

const MARKED: &str = "[...document.querySelectorAll('.byte.marked')].map((byte) => byte.textContent).join(' ')";
const PRESSED: &str =
    "[...document.querySelectorAll('.field[aria-pressed=true]')].map((field) => field.children[1].textContent).join()";

/// Clicks a button that saves a file, and returns its bytes in hexadecimal.
fn saved(browser: &mut Browser, selector: &str) -> String {
    let click = format!(
        "new Promise((resolve) => {{ URL.createObjectURL = (blob) => {{ blob.arrayBuffer().then((bytes) =>
            resolve([...new Uint8Array(bytes)].map((byte) => byte.toString(16).padStart(2, '0')).join(''))); return ''; }};
            document.querySelector('{selector}').click(); }})"
    );
    browser.eval(&click).as_str().unwrap().to_owned()
}

fn bytes(hex: &str) -> Vec<u8> {
    bcap_capture::hex::parse(hex.as_bytes()).unwrap()
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
    // this server moves nothing, and writes with the control only
    browser.enter("#function", "72");
    browser.until_text("#usage", "72 Robot_Move(robot, interpolation, pose, option)");
    browser.until_text("#effect", "It can move the robot, or stop it. It is not sent while another client streams in Slave Mode. Start bcap web with --allow-motion.");
    browser.until("document.getElementById('call').disabled");
    browser.enter("#function", "variableputvalue");
    browser.until_text("#effect", "Take the control first.");
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
    assert_eq!(sim.lock().variable::<64>(bcap_core::rac::VariableKind::I, 1).unwrap().as_variant().as_i32(), Some(5));
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

#[test]
fn numbers_are_saved_for_foxglove() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=plots]");
    browser.until_text(".legend", "J2 45.000");
    let file = bytes(&saved(&mut browser, "#mcap"));
    let magic = b"\x89MCAP0\r\n";
    assert!(file.starts_with(magic) && file.ends_with(magic));
    let text = String::from_utf8_lossy(&file);
    for part in ["/J1", "/J2", "/J3", "bcap.Number", "{\"value\":45.0}"] {
        assert!(text.contains(part), "{part}");
    }
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
