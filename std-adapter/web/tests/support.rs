//! A virtual controller, a server of the page, and a page without a browser.

use std::collections::HashMap;
use std::io::{self, Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, mpsc};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bcap_live::link::Access;
use bcap_live::tap::Tap;
use bcap_sim::pace::Paced;
use bcap_sim::scenario::Delivery;
use bcap_sim::{ArmProfile, Config as SimConfig, Controller, Profile};
use bcap_std::blocking::Arm;
use bcap_std::server::Server as SimServer;
use bcap_web::{Config, Server};
use serde_json::{Value, json};
use tokio::sync::oneshot;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::stream::MaybeTlsStream;
use tokio_tungstenite::tungstenite::{Message, WebSocket, client, connect};

/// Timeout for all waits of the tests, generous enough for a busy machine.
pub(crate) const LIMIT: Duration = Duration::from_secs(60);

/// A server on a thread, which ends when this is dropped.
pub(crate) struct Running<T> {
    pub(crate) value: T,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl<T: Send + 'static> Running<T> {
    pub(crate) fn start<F: Future<Output = io::Result<()>>>(
        open: impl FnOnce(oneshot::Receiver<()>, mpsc::Sender<T>) -> F + Send + 'static,
    ) -> Self {
        let (stop, stopped) = oneshot::channel();
        let (sender, value) = mpsc::channel();
        let thread = thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(open(stopped, sender)).unwrap();
        });
        Self { value: value.recv().unwrap(), stop: Some(stop), thread: Some(thread) }
    }
}

impl<T> Drop for Running<T> {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            thread.join().expect("the server ends without a panic");
        }
    }
}

/// A virtual controller.
pub(crate) struct Sim {
    pub(crate) controller: Arc<Mutex<Controller>>,
    pub(crate) server: Running<SocketAddr>,
}

impl Sim {
    pub(crate) fn start() -> Self {
        Self::at("127.0.0.1:0".parse().unwrap())
    }

    pub(crate) fn at(address: SocketAddr) -> Self {
        Self::with(address, SimConfig::new(Profile::Rc8))
    }

    /// Starts a virtual controller whose motor switches on immediately.
    pub(crate) fn quick() -> Self {
        Self::quick_of(Profile::Rc8)
    }

    /// Starts a virtual controller of another model whose motor switches on immediately.
    pub(crate) fn quick_of(profile: Profile) -> Self {
        let config = SimConfig { motor_on_delay: Duration::ZERO, ..SimConfig::new(profile) };
        Self::with("127.0.0.1:0".parse().unwrap(), config)
    }

    /// Starts one with another arm.
    pub(crate) fn of_arm(arm: ArmProfile) -> Self {
        Self::with("127.0.0.1:0".parse().unwrap(), SimConfig::new(Profile::Rc8).with_arm(arm.arm()))
    }

    /// Starts one with a folder of files.
    pub(crate) fn with_files(folder: &std::path::Path) -> Self {
        let config = SimConfig { files: Some(folder.to_owned()), ..SimConfig::new(Profile::Rc8) };
        Self::with("127.0.0.1:0".parse().unwrap(), config)
    }

    fn with(address: SocketAddr, config: SimConfig) -> Self {
        let controller = Arc::new(Mutex::new(Controller::new(config)));
        let shared = Arc::clone(&controller);
        let server = Running::start(async move |stopped, sender| {
            let server = SimServer::with_shared(shared).bcap_tcp(address).await?;
            sender.send(server.addresses().bcap_tcp[0]).unwrap();
            server.run(async { drop(stopped.await) }).await
        });
        Self { controller, server }
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.server.value
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, Controller> {
        self.controller.lock().unwrap()
    }

    /// Waits until the controller meets a condition.
    #[track_caller]
    pub(crate) fn until(&self, what: &str, condition: impl Fn(&Controller) -> bool) {
        until(what, || condition(&self.lock()));
    }
}

/// Begins a stream that sends no pose, so that a busy machine does not end it, and waits until a page shows it.
pub(crate) fn stream(sim: &Sim, arm: &mut Arm<'_>, page: &mut Page) {
    until("the page knows of the stream", || {
        // a call of the page that was on its way may end the stream as it begins, which is an error
        if sim.lock().slave_mode() == 0 {
            sim.lock().clear_errors(bcap_std::now());
            arm.motor_on().unwrap();
            arm.robot().execute::<()>("slvChangeMode", 0x202).unwrap();
        }
        page.receive().expect("the page is open");
        page.until("tiles", Value::is_array)[0]["state"] == "streaming" && sim.lock().slave_mode() == 0x202
    });
}

/// Serves a virtual controller with a time factor, and applies the faults of its scenario to answers.
pub(crate) fn serve_paced(paced: &Arc<Mutex<Paced>>) -> Running<SocketAddr> {
    let paced = Arc::clone(paced);
    let deliver = |paced: &mut Paced, peer, bytes: &mut Vec<u8>| match paced.controller().deliver(peer, bytes) {
        Delivery::Send => ControlFlow::Continue(()),
        Delivery::Drop => {
            bytes.clear();
            ControlFlow::Continue(())
        }
        Delivery::Disconnect => ControlFlow::Break(()),
    };
    Running::start(async move |stopped, sender| {
        let server = SimServer::with_shared(paced).tap(deliver).bcap_tcp("127.0.0.1:0").await?;
        sender.send(server.addresses().bcap_tcp[0]).unwrap();
        server.run(async { drop(stopped.await) }).await
    })
}

/// Waits until a condition holds.
#[track_caller]
pub(crate) fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let end = Instant::now() + LIMIT;
    while !condition() {
        assert!(Instant::now() < end, "{what}");
        thread::sleep(Duration::from_millis(5));
    }
}

pub(crate) fn access(address: SocketAddr) -> Access {
    Access {
        address: format!("tcp:{address}").parse().unwrap(),
        provider: None,
        machine: None,
        option: String::new(),
        tap: Tap::default(),
    }
}

/// A server of the page.
pub(crate) struct Web {
    server: Running<String>,
    pub(crate) audit: Arc<Mutex<Vec<String>>>,
}

impl Web {
    pub(crate) fn start(robots: &[(&str, SocketAddr)], allow_write: bool) -> Self {
        Self::with(&|config| config.allow_motion = false, robots, allow_write)
    }

    /// Starts a server whose pages may also move robots.
    pub(crate) fn moving(robots: &[(&str, SocketAddr)]) -> Self {
        Self::with(&|_| {}, robots, true)
    }

    pub(crate) fn with(change: &dyn Fn(&mut Config), robots: &[(&str, SocketAddr)], allow_write: bool) -> Self {
        let robots = robots.iter().map(|(name, address)| ((*name).to_owned(), access(*address))).collect();
        let mut config = Config::new("127.0.0.1:0".parse().unwrap(), robots);
        (config.allow_write, config.allow_motion) = (allow_write, true);
        change(&mut config);
        let audit = Arc::new(Mutex::new(Vec::new()));
        let lines = Arc::clone(&audit);
        let server = Running::start(async move |stopped, sender| {
            let audit = move |line: &str| lines.lock().unwrap().push(line.to_owned());
            let server = Server::bind(config, audit).await.unwrap();
            sender.send(server.url()).unwrap();
            server.run(async { drop(stopped.await) }).await;
            Ok(())
        });
        Self { server, audit }
    }

    pub(crate) fn url(&self) -> &str {
        &self.server.value
    }

    /// Returns the host and the port.
    pub(crate) fn host(&self) -> &str {
        self.url().strip_prefix("http://").unwrap().split('/').next().unwrap()
    }

    pub(crate) fn token(&self) -> &str {
        self.url().split_once("#token=").unwrap().1
    }

    /// Sends the head of a request, and returns the head of the response and its body.
    pub(crate) fn request(&self, first: &str, headers: &[(&str, &str)]) -> (String, String) {
        let mut stream = TcpStream::connect(self.host()).unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        let headers: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
        // the server may close a refused connection before all bytes are sent or received
        let _ = stream.write_all(format!("{first} HTTP/1.1\r\n{headers}connection: close\r\n\r\n").as_bytes());
        let mut response = Vec::new();
        let _ = stream.read_to_end(&mut response);
        let response = String::from_utf8_lossy(&response).into_owned();
        let (head, body) = response.split_once("\r\n\r\n").unwrap_or((&response, ""));
        (head.to_ascii_lowercase(), body.to_owned())
    }

    /// Returns the status of a request.
    pub(crate) fn status(&self, first: &str, headers: &[(&str, &str)]) -> u16 {
        let (head, _) = self.request(first, headers);
        head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0)
    }

    /// Halts a robot as the page does.
    pub(crate) fn halt(&self, robot: usize) -> Value {
        let origin = format!("http://{}", self.host());
        let headers =
            [("host", self.host()), ("origin", &origin), ("x-bcap-token", self.token()), ("content-length", "0")];
        let (_, body) = self.request(&format!("POST /halt/{robot}"), &headers);
        serde_json::from_str(body.split_once('{').map_or("", |_| body.trim())).unwrap_or_else(|_| panic!("{body}"))
    }

    /// Halts a robot while a page receives, and answers its pulses; the messages are dropped.
    pub(crate) fn halt_while_receiving(&self, page: &mut Page, robot: usize) -> Value {
        thread::scope(|scope| {
            let halt = scope.spawn(|| self.halt(robot));
            while !halt.is_finished() {
                page.receive().expect("the page is open");
            }
            halt.join().unwrap()
        })
    }

    pub(crate) fn page(&self) -> Page {
        self.try_page().unwrap_or_else(|status| panic!("no page: {status}"))
    }

    /// Opens a page; fails with the status of a refusal.
    pub(crate) fn try_page(&self) -> Result<Page, u16> {
        let mut request = format!("ws://{}/live", self.host()).into_client_request().unwrap();
        let headers = request.headers_mut();
        headers.insert("origin", format!("http://{}", self.host()).parse().unwrap());
        headers.insert("sec-websocket-protocol", format!("bcap.live, token.{}", self.token()).parse().unwrap());
        match client::connect_with_config(request, None, 0) {
            Ok((socket, _)) => {
                if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
                    stream.set_read_timeout(Some(LIMIT)).unwrap();
                }
                Ok(Page::new(socket))
            }
            Err(tokio_tungstenite::tungstenite::Error::Http(response)) => Err(response.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }

    /// Returns how many jogs have ended.
    pub(crate) fn ended_jogs(&self) -> usize {
        self.lines().iter().filter(|line| line.contains("the jog ends: ")).count()
    }

    /// Returns the lines of the audit without their times.
    pub(crate) fn lines(&self) -> Vec<String> {
        let lines = self.audit.lock().unwrap();
        lines.iter().map(|line| line.split_once(' ').unwrap().1.to_owned()).collect()
    }
}

/// A page without a browser.
pub(crate) struct Page<S = MaybeTlsStream<TcpStream>> {
    pub(crate) socket: WebSocket<S>,
    last: u64,
    /// The last content of each section: one that has not changed is not sent again.
    sections: HashMap<String, Value>,
    /// Whether it answers pulses.
    pub(crate) beats: bool,
    /// The number of the press whose button is held; 0 without one.
    pub(crate) held: u64,
}

impl<S: io::Read + io::Write> Page<S> {
    pub(crate) fn new(socket: WebSocket<S>) -> Self {
        Self { socket, last: 0, sections: HashMap::new(), beats: true, held: 0 }
    }

    /// Receives a message; `None` when the server has closed the page.
    pub(crate) fn receive(&mut self) -> Option<Value> {
        loop {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    let message: Value = serde_json::from_str(&text).unwrap();
                    if message["t"] == "pulse" && self.beats {
                        self.beat(message["n"].as_u64().unwrap());
                    }
                    if let (Some(kind), Some(content)) = (message["t"].as_str(), message.get("v")) {
                        self.sections.insert(kind.to_owned(), content.clone());
                    }
                    return Some(message);
                }
                Ok(Message::Close(_)) | Err(_) => return None,
                Ok(_) => {}
            }
        }
    }

    /// Sends a heartbeat.
    pub(crate) fn beat(&mut self, number: u64) {
        // the server may have closed the page
        let _ = self.socket.send(Message::text(json!({ "beat": number, "held": self.held }).to_string()));
    }

    /// Receives until the last content of a section meets a condition.
    #[track_caller]
    pub(crate) fn until(&mut self, kind: &str, condition: impl Fn(&Value) -> bool) -> Value {
        let end = Instant::now() + LIMIT;
        loop {
            let last = self.sections.get(kind).cloned().unwrap_or_default();
            if condition(&last) {
                return last;
            }
            assert!(Instant::now() < end, "the last {kind} is {last}");
            self.receive().unwrap_or_else(|| panic!("the page is closed; the last {kind} is {last}"));
        }
    }

    /// Waits until the first robot has a state.
    #[track_caller]
    pub(crate) fn until_state(&mut self, state: &str) -> Value {
        self.until("tiles", |tiles| tiles[0]["state"] == state)
    }

    pub(crate) fn send(&mut self, what: &str, mut fields: Value) -> u64 {
        self.last += 1;
        match what {
            "press" => {
                self.held = self.last;
                fields["press"] = json!(self.held);
            }
            "lift" => self.held = 0,
            // the page reads the count from the tile before it asks its user
            "write" | "clear" | "grip" | "recover" | "step" | "task" | "restore" if fields["revoked"].is_null() => {
                let tile = fields["robot"].as_u64().and_then(|robot| self.sections.get("tiles")?.get(robot as usize));
                fields["revoked"] = tile.map_or(json!(0), |tile| tile["revoked"].clone());
            }
            _ => {}
        }
        fields["id"] = json!(self.last);
        fields["do"] = json!(what);
        self.socket.send(Message::text(fields.to_string())).unwrap();
        self.last
    }

    /// Sends an order, and returns its answer.
    #[track_caller]
    pub(crate) fn order(&mut self, what: &str, fields: Value) -> Result<Value, String> {
        let id = self.send(what, fields);
        loop {
            let message = self.receive().expect("the page is open");
            if message["t"] == "answer" && message["id"] == id {
                return match message["error"].as_str() {
                    Some(error) => Err(error.to_owned()),
                    None => Ok(message["ok"].clone()),
                };
            }
        }
    }
}

/// A relay in front of a controller, whose connections a test freezes: their bytes stop, and they stay open.
pub(crate) struct Relay {
    pub(crate) address: SocketAddr,
    frozen: Arc<AtomicUsize>,
    count: Arc<AtomicUsize>,
    held: Arc<AtomicUsize>,
    clients: Arc<Mutex<Vec<TcpStream>>>,
}

impl Relay {
    pub(crate) fn start(target: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let frozen = Arc::new(AtomicUsize::new(usize::MAX));
        let (shared, count) = (Arc::clone(&frozen), Arc::<AtomicUsize>::default());
        let (counted, held) = (Arc::clone(&count), Arc::<AtomicUsize>::default());
        let (holds, clients) = (Arc::clone(&held), Arc::<Mutex<Vec<_>>>::default());
        let accepted = Arc::clone(&clients);
        // it ends with the process
        thread::spawn(move || {
            for (number, client) in listener.incoming().map_while(Result::ok).enumerate() {
                let Ok(server) = TcpStream::connect(target) else { continue };
                accepted.lock().unwrap().push(client.try_clone().unwrap());
                counted.store(number + 1, Ordering::SeqCst);
                for (mut from, mut to) in [(client.try_clone().unwrap(), server.try_clone().unwrap()), (server, client)]
                {
                    let (frozen, holds) = (Arc::clone(&shared), Arc::clone(&holds));
                    thread::spawn(move || {
                        let mut bytes = [0; 4096];
                        while let Ok(count @ 1..) = from.read(&mut bytes) {
                            let mut is_held = false;
                            while frozen.load(Ordering::SeqCst) == number {
                                if !std::mem::replace(&mut is_held, true) {
                                    holds.fetch_add(1, Ordering::SeqCst);
                                }
                                thread::park_timeout(Duration::from_millis(10));
                            }
                            if to.write_all(&bytes[..count]).is_err() {
                                break;
                            }
                        }
                        let _ = to.shutdown(std::net::Shutdown::Both);
                    });
                }
            }
        });
        Self { address, frozen, count, held, clients }
    }

    /// Returns the number of connections so far.
    pub(crate) fn count(&self) -> usize {
        self.count.load(Ordering::SeqCst)
    }

    /// Returns the number of times that bytes arrived at a frozen connection.
    pub(crate) fn held(&self) -> usize {
        self.held.load(Ordering::SeqCst)
    }

    /// Closes a connection.
    pub(crate) fn cut(&self, number: usize) {
        self.clients.lock().unwrap()[number].shutdown(std::net::Shutdown::Both).unwrap();
    }

    /// Freezes a connection; the first has the number 0.
    pub(crate) fn freeze(&self, number: usize) {
        self.frozen.store(number, Ordering::SeqCst);
    }
}

/// Opens a connection without a request.
pub(crate) fn idle(web: &Web) -> TcpStream {
    TcpStream::connect(web.host()).unwrap()
}

/// Connects a WebSocket of another program, such as a browser.
pub(crate) fn websocket(url: &str) -> WebSocket<MaybeTlsStream<TcpStream>> {
    connect(url).unwrap().0
}
