//! A headless Chromium, driven by its DevTools protocol over a WebSocket: it needs no driver program.

use std::fs;
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use bcap_test_support::tools;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio_tungstenite::tungstenite::stream::MaybeTlsStream;
use tokio_tungstenite::tungstenite::{Message, WebSocket};

use crate::support::{LIMIT, until, websocket};

/// A browser with a page; the process ends when this is dropped.
pub(crate) struct Browser {
    process: Child,
    _profile: TempDir,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    session: String,
    last: u64,
    /// Where the mouse was pressed last.
    place: Value,
    /// Exceptions of scripts, and errors that the browser reports, such as violations of the Content-Security-Policy.
    pub(crate) problems: Vec<String>,
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Browser {
    /// Starts a browser; `None` if it is not installed, which fails with `CI=true`.
    pub(crate) fn start() -> Option<Self> {
        Self::with(&[])
    }

    /// Starts a browser with further arguments.
    pub(crate) fn with(args: &[&str]) -> Option<Self> {
        let profile = tempfile::tempdir().unwrap();
        let process = Command::new(tools::find("chromium")?)
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"])
            .args(["--disable-background-networking", "--disable-extensions", "--remote-debugging-port=0"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .args(args)
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let file = profile.path().join("DevToolsActivePort");
        let mut address = None;
        until("chromium opens its port", || {
            let text = fs::read_to_string(&file).unwrap_or_default();
            address = text.split_once('\n').map(|(port, path)| format!("ws://127.0.0.1:{port}{}", path.trim()));
            address.is_some()
        });
        let socket = websocket(&address.unwrap());
        let mut browser = Self {
            process,
            _profile: profile,
            socket,
            session: String::new(),
            last: 0,
            place: Value::Null,
            problems: Vec::new(),
        };
        if let MaybeTlsStream::Plain(stream) = browser.socket.get_ref() {
            stream.set_read_timeout(Some(LIMIT)).unwrap();
        }
        browser.open_page();
        Some(browser)
    }

    /// Opens another page, which gets all further calls. Returns it, for [`turn_to`](Self::turn_to).
    pub(crate) fn open_page(&mut self) -> String {
        self.session.clear();
        let target = self.call("Target.createTarget", json!({ "url": "about:blank" }))["targetId"].clone();
        let attached = self.call("Target.attachToTarget", json!({ "targetId": target, "flatten": true }));
        self.session = attached["sessionId"].as_str().unwrap().to_owned();
        for domain in ["Page", "Runtime", "Log"] {
            self.call(&format!("{domain}.enable"), json!({}));
        }
        self.session.clone()
    }

    /// Sends all further calls to a page.
    pub(crate) fn turn_to(&mut self, page: &str) {
        page.clone_into(&mut self.session);
    }

    /// Calls a method, and returns its result.
    #[track_caller]
    pub(crate) fn call(&mut self, method: &str, params: Value) -> Value {
        self.try_call(method, params).unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// Calls a method, and returns its result or its error.
    fn try_call(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.last += 1;
        let mut call = json!({ "id": self.last, "method": method, "params": params });
        if !self.session.is_empty() {
            call["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::text(call.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == self.last {
                return if message["error"].is_null() {
                    Ok(message["result"].clone())
                } else {
                    Err(message["error"].clone())
                };
            }
            self.event(&message);
        }
    }

    fn event(&mut self, message: &Value) {
        match message["method"].as_str() {
            Some("Runtime.exceptionThrown") => {
                self.problems.push(message["params"]["exceptionDetails"]["exception"]["description"].to_string());
            }
            Some("Log.entryAdded") if message["params"]["entry"]["level"] == "error" => {
                self.problems.push(message["params"]["entry"]["text"].to_string());
            }
            _ => {}
        }
    }

    pub(crate) fn open(&mut self, url: &str) {
        self.call("Page.navigate", json!({ "url": url }));
    }

    /// Keeps the WebSockets of the pages that are opened next in the array `sockets`.
    pub(crate) fn keep_sockets(&mut self) {
        let source = "window.sockets = []; window.WebSocket = class extends WebSocket {
            constructor(...all) { super(...all); sockets.push(this); } };";
        self.call("Page.addScriptToEvaluateOnNewDocument", json!({ "source": source }));
    }

    /// Evaluates an expression in the page.
    #[track_caller]
    pub(crate) fn eval(&mut self, expression: &str) -> Value {
        let params = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let result = self.call("Runtime.evaluate", params);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {}", result["exceptionDetails"]);
        result["result"]["value"].clone()
    }

    /// Evaluates an expression in the page; `None` if another page replaces it during that.
    #[track_caller]
    fn eval_unless_left(&mut self, expression: &str) -> Option<Value> {
        let params = json!({ "expression": expression, "returnByValue": true });
        match self.try_call("Runtime.evaluate", params) {
            Ok(result) => Some(result["result"]["value"].clone()),
            Err(error) if error["message"] == "Inspected target navigated or closed" => None,
            Err(error) => panic!("{expression}: {error}"),
        }
    }

    /// Waits until an expression is true. While a page loads it may fail.
    #[track_caller]
    pub(crate) fn until(&mut self, expression: &str) {
        let end = Instant::now() + LIMIT;
        while self.eval_unless_left(expression) != Some(json!(true)) {
            if Instant::now() > end {
                let text = self.eval("document.body.innerText");
                panic!("{expression}; the page is {text}, problems {:?}", self.problems);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until an element has a text.
    #[track_caller]
    pub(crate) fn until_text(&mut self, selector: &str, text: &str) {
        self.until(&format!(
            "document.querySelector({})?.textContent.includes({}) === true",
            json!(selector),
            json!(text)
        ));
    }

    /// Clicks an element with the mouse, as a person does: it must be visible and enabled.
    #[track_caller]
    pub(crate) fn click(&mut self, selector: &str) {
        let watch = format!(
            "window.isClicked = false; addEventListener('click', (event) => {{ isClicked ||= event.target.closest({}) !== null; }},
                {{ capture: true, once: true }}); 0",
            json!(selector)
        );
        // drawing during the click can move the element away from the mouse
        for _ in 0..5 {
            self.eval(&watch);
            self.hold(selector);
            self.lift();
            // a click that opens another page was made
            if self.eval_unless_left("window.isClicked") != Some(json!(false)) {
                break;
            }
        }
    }

    /// Presses the mouse on an element, which must be visible and enabled.
    #[track_caller]
    pub(crate) fn hold(&mut self, selector: &str) {
        let element = format!("document.querySelector({})", json!(selector));
        self.until(&format!("{element} !== null && !{element}.disabled && {element}.checkVisibility()"));
        self.press(selector);
    }

    /// Presses the mouse on an element.
    pub(crate) fn press(&mut self, selector: &str) {
        let element = format!("document.querySelector({})", json!(selector));
        self.place = self.eval(&format!(
            "(() => {{ {element}.scrollIntoView({{ block: 'center' }}); const r = {element}.getBoundingClientRect();
                return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        ));
        self.mouse("mousePressed");
    }

    /// Lifts the mouse where it was pressed.
    pub(crate) fn lift(&mut self) {
        self.mouse("mouseReleased");
    }

    fn mouse(&mut self, kind: &str) {
        let [x, y] = [&self.place[0], &self.place[1]];
        let params = json!({ "type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 });
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Replaces the text of a field, and presses Enter.
    #[track_caller]
    pub(crate) fn enter(&mut self, selector: &str, text: &str) {
        self.click(selector);
        self.eval(&format!("document.querySelector({}).select()", json!(selector)));
        self.call("Input.insertText", json!({ "text": text }));
        self.key("Enter");
    }

    /// Presses a key.
    pub(crate) fn key(&mut self, key: &str) {
        let (code, text) = match key {
            "Enter" => (13, "\r"),
            "Escape" => (27, ""),
            "Tab" => (9, ""),
            key => (u32::from(key.to_ascii_uppercase().as_bytes()[0]), key),
        };
        for kind in ["keyDown", "keyUp"] {
            let mut params = json!({ "type": kind, "key": key, "windowsVirtualKeyCode": code });
            if kind == "keyDown" && !text.is_empty() {
                params["text"] = json!(text);
            }
            self.call("Input.dispatchKeyEvent", params);
        }
    }

    /// Sets the size of the page, and whether it is dark.
    pub(crate) fn look(&mut self, (width, height): (u32, u32), scheme: &str) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.call("Emulation.setDeviceMetricsOverride", size);
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        self.call("Emulation.setEmulatedMedia", json!({ "features": features }));
    }

    /// Returns a picture as base64 of WebP.
    pub(crate) fn picture(&mut self) -> String {
        self.call("Page.captureScreenshot", json!({ "format": "webp", "quality": 28 }))["data"]
            .as_str()
            .unwrap()
            .to_owned()
    }
}
