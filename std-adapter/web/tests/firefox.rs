//! The core of the page in a headless Firefox, driven by WebDriver BiDi, which Firefox has itself.

use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use bcap_core::rac::VariableKind;
use bcap_core::variant::Variant;
use bcap_test_support::tools;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio_tungstenite::tungstenite::stream::MaybeTlsStream;
use tokio_tungstenite::tungstenite::{Message, WebSocket};

use crate::browser::IS_BEGUN;
use crate::support::{LIMIT, Sim, Web, until, websocket};

/// A browser with a page; the process ends when this is dropped.
struct Firefox {
    process: Child,
    _profile: TempDir,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    context: Value,
    last: u64,
}

impl Drop for Firefox {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Firefox {
    /// Starts a browser; `None` if it is not installed, which fails with `CI=true`.
    fn start() -> Option<Self> {
        let profile = tempfile::tempdir().unwrap();
        let mut process = Command::new(tools::find("firefox-esr")?)
            .args(["--headless", "--no-remote", "--remote-debugging-port=0", "--profile"])
            .arg(profile.path())
            .env("HOME", profile.path())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stderr.take().unwrap()).lines().map_while(Result::ok);
        let address = lines.find_map(|line| Some(line.split_once("WebDriver BiDi listening on ")?.1.to_owned()));
        let socket = websocket(&format!("{}/session", address.expect("Firefox opens its port")));
        // otherwise it may wait for a reader
        std::thread::spawn(move || lines.for_each(drop));
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream.set_read_timeout(Some(LIMIT)).unwrap();
        }
        let mut firefox = Self { process, _profile: profile, socket, context: Value::Null, last: 0 };
        firefox.call("session.new", json!({ "capabilities": {} }));
        firefox.context = firefox.call("browsingContext.getTree", json!({}))["contexts"][0]["context"].clone();
        Some(firefox)
    }

    /// Calls a method, and returns its result.
    #[track_caller]
    fn call(&mut self, method: &str, params: Value) -> Value {
        self.last += 1;
        let call = json!({ "id": self.last, "method": method, "params": params });
        self.socket.send(Message::text(call.to_string())).unwrap();
        loop {
            let read = self.socket.read().unwrap_or_else(|error| panic!("{call}: {error}"));
            let Message::Text(text) = read else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == self.last {
                assert_eq!(message["type"], "success", "{method}: {message}");
                return message["result"].clone();
            }
        }
    }

    /// Evaluates an expression, whose value is JSON; `null` if it throws.
    fn eval(&mut self, expression: &str) -> Value {
        let expression = format!("Promise.resolve({expression}).then((value) => JSON.stringify(value ?? null))");
        let target = json!({ "context": self.context });
        let result =
            self.call("script.evaluate", json!({ "expression": expression, "target": target, "awaitPromise": true }));
        result["result"]["value"].as_str().and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
    }

    #[track_caller]
    fn until(&mut self, expression: &str) {
        let end = Instant::now() + LIMIT;
        while self.eval(expression) != true {
            assert!(Instant::now() < end, "{expression}; the page is {}", self.eval("document.body.innerText"));
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    #[track_caller]
    fn until_text(&mut self, selector: &str, text: &str) {
        self.until(&format!(
            "document.querySelector({})?.textContent.includes({}) === true",
            json!(selector),
            json!(text)
        ));
    }

    fn open(&mut self, url: &str) {
        self.call("browsingContext.navigate", json!({ "context": self.context, "url": url, "wait": "none" }));
    }

    fn pointer(&mut self, actions: Value) {
        let mouse = json!([{ "type": "pointer", "id": "mouse", "actions": actions }]);
        self.call("input.performActions", json!({ "context": self.context, "actions": mouse }));
    }

    /// Waits until an element is visible and enabled, and presses the mouse on it.
    #[track_caller]
    fn hold(&mut self, selector: &str) {
        let element = format!("document.querySelector({})", json!(selector));
        self.until(&format!("{element} !== null && !{element}.disabled && {element}.checkVisibility()"));
        self.press(selector);
    }

    /// Presses the mouse where an element is.
    fn press(&mut self, selector: &str) {
        let element = format!("document.querySelector({})", json!(selector));
        let place = self.eval(&format!(
            "(() => {{ {element}.scrollIntoView({{ block: 'center' }}); const r = {element}.getBoundingClientRect();
                return [Math.round(r.x + r.width / 2), Math.round(r.y + r.height / 2)]; }})()"
        ));
        self.pointer(json!([
            { "type": "pointerMove", "x": place[0], "y": place[1] },
            { "type": "pointerDown", "button": 0 }
        ]));
    }

    fn lift(&mut self) {
        self.pointer(json!([{ "type": "pointerUp", "button": 0 }]));
    }

    #[track_caller]
    fn click(&mut self, selector: &str) {
        self.hold(selector);
        self.lift();
    }

    /// Replaces the text of a field, and presses Enter.
    #[track_caller]
    fn enter(&mut self, selector: &str, text: &str) {
        self.click(selector);
        self.eval(&format!("document.querySelector({}).select()", json!(selector)));
        let keys = text
            .chars()
            .chain(['\u{e007}'])
            .flat_map(|key| [json!({ "type": "keyDown", "value": key }), json!({ "type": "keyUp", "value": key })]);
        let keys = json!([{ "type": "key", "id": "keys", "actions": keys.collect::<Vec<_>>() }]);
        self.call("input.performActions", json!({ "context": self.context, "actions": keys }));
    }
}

#[test]
fn a_user_of_firefox_reads_writes_jogs_and_halts() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let Some(mut firefox) = Firefox::start() else { return };
    firefox.open(web.url());
    firefox.until_text("#state", "ready, motor off");
    assert_eq!(firefox.eval("location.href"), format!("http://{}/", web.host()), "the token is not shown");
    firefox.enter("#name", "Anna");
    firefox.until_text("#control", "control: Anna (this page)");
    firefox.click("[data-id=variables]");
    firefox.enter("#names", "I1");
    // the rows of the first selection move the button when they go
    firefox.until("document.querySelectorAll('tbody tr').length === 1 && document.querySelector('.lamp') === null");
    firefox.until_text("tbody tr th", "I1");
    firefox.click("tbody button");
    firefox.enter(".edit", "5");
    firefox.until_text("#question-text", "I1: 0 → 5");
    firefox.click("#question-yes");
    firefox.until_text("#notice", "press: I1 = 5 is written");
    assert_eq!(sim.lock().variable::<16>(VariableKind::I, 1).unwrap().as_variant(), Variant::I4(5));
    // each screen opens, and its text stays text
    let script = "(() => { const s = document.createElement('script'); s.textContent = 'window.owned = 1'; document.body.append(s); return String(window.owned); })()";
    assert_eq!(firefox.eval(script), "undefined");
    for screen in ["cell", "alarms", "arm", "tasks", "plots", "packets", "raw", "jog"] {
        firefox.click(&format!("[data-id={screen}]"));
        firefox.until("document.getElementById('main').children.length > 0");
    }
    jog(&sim, &web, &mut firefox);
    firefox.click("#halt");
    firefox.until_text("#notice", "press: the robot was at rest");
    let context = firefox.context.clone();
    firefox.call("browsingContext.reload", json!({ "context": context, "wait": "none" }));
    firefox.until("document.getElementById('take') !== null");
    firefox.until_text("#state", "ready, motor off");
}

/// A held button moves the robot, and a window without the focus ends it. While other tests run, a busy machine may lose the
/// heartbeat before.
fn jog(sim: &Sim, web: &Web, firefox: &mut Firefox) {
    let (mut moved, mut notices) = (false, Vec::new());
    let last = Instant::now() + Duration::from_secs(180);
    while Instant::now() < last {
        sim.lock().clear_errors(bcap_std::now());
        firefox.until_text("#state", "ready, motor off");
        firefox.click("#jog-begin");
        firefox.eval("document.getElementById('notice').textContent = ''");
        let ended = web.ended_jogs();
        firefox.click("#question-yes");
        // the page may miss a short jog
        until("the jog is ready, or has ended", || web.ended_jogs() > ended || firefox.eval(IS_BEGUN) == true);
        let before = sim.lock().axes();
        firefox.until("document.querySelector('.axis') !== null");
        firefox.press(".axis:nth-child(1) button:nth-of-type(2)");
        // the page may redraw the button during the press, which then has no effect
        let end = Instant::now() + Duration::from_secs(5);
        let is_pressed = || sim.lock().axes() != before || sim.lock().arm_owner().is_none();
        while !is_pressed() && Instant::now() < end {
            thread::sleep(Duration::from_millis(5));
        }
        notices.push(firefox.eval("document.getElementById('notice').textContent"));
        firefox.eval("(dispatchEvent(new Event('blur')), 0)");
        sim.until("it rests, and the arm is free", |sim| !sim.is_moving() && sim.arm_owner().is_none());
        firefox.lift();
        if sim.lock().axes() != before {
            moved = true;
            break;
        }
    }
    assert!(moved, "each attempt has lost its heartbeat: {:?}, {notices:?}", web.lines());
    sim.lock().clear_errors(bcap_std::now());
    firefox.until_text("#state", "ready, motor off");
}
