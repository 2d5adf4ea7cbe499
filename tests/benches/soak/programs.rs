//! Four programs as processes, each with well-behaved and misbehaving clients: `bcap sim`, `bcap proxy`, `bcap gateway` and
//! `bcap-fleet` with Mosquitto.
//!
//! ```text
//!  b-CAP ───► sim ◄─────┬──────┬────────┐        idle       nothing is sent
//!  b-CAP ───► proxy ────┘      │        │        alone      the well-behaved clients work  ┐
//!  RAC ─────► gateway ─────────┘        │        together   the others work too            ┘ in turn
//!  MQTT ────► Mosquitto ─► fleet ───────┘        after      all clients are disconnected
//! ```
//!
//! It fails when a session of a well-behaved client fails, when these clients keep less than 80 % of their calls (in 60 s or
//! more), when a program has more descriptors at the end than before, has grown by 10 MiB since the first line, or writes more
//! than 128 KiB a second: an optimised gateway prints half of that, a line for each write that it executes.

use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::Variant;
use bcap_std::Options;
use bcap_std::asynch::{self, RacClient};
use bcap_tests::mosquitto::Mosquitto;
use bcap_tests::process::Process;
use rumqttc::{AsyncClient, Event, EventLoop, MqttOptions, NetworkOptions, Packet, PublishOptions, QoS};
use tokio::net::TcpStream;
use tokio::time::{sleep, timeout};

use crate::server::Addresses;
use crate::{ALONE, ENOUGH, GROWTH, KEPT, Plan, ROWS, TOGETHER, Verdict, Wishes, misbehaviour, run_clients, work};

/// The pause of a well-behaved client after each pair of calls: the programs share the processors.
const PACE: Duration = Duration::from_millis(20);
/// Connections to each program that send nothing.
const SILENT: usize = 20;
/// The maximum number of bytes that a program may write in a second.
const OUTPUT: u64 = 128 << 10;
/// The time limit of one reply.
const REPLY: Duration = Duration::from_secs(30);
/// The time until the expiry of a command, in the fleet's configuration 1 s longer.
const LONGEST: Duration = Duration::from_secs(59);
const TO_FLEET: &str = "bcap/soak/cell1/command";

/// A program with its clients.
struct Program {
    name: &'static str,
    child: Child,
    ready: String,
    /// The bytes that it has written.
    output: Arc<AtomicU64>,
    plan: Arc<Plan>,
    clients: Vec<JoinHandle<()>>,
}

impl Program {
    /// Starts a program, and waits for its line `ready`.
    fn start(name: &'static str, command: &mut Command) -> Self {
        let mut child =
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
        let mut out = BufReader::new(child.stdout.take().expect("an output"));
        let mut ready = String::new();
        out.read_line(&mut ready).expect("a line");
        assert!(ready.starts_with("ready "), "{name}: {ready:?}");
        let output = Arc::<AtomicU64>::default();
        count(out, &output);
        count(child.stderr.take().expect("an output of errors"), &output);
        Self { name, child, ready, output, plan: Arc::new(Plan { pace: PACE, ..Plan::default() }), clients: Vec::new() }
    }

    /// Returns the address after `key=` in the line `ready`.
    fn address(&self, key: &str) -> SocketAddr {
        let value = self.ready.split_whitespace().find_map(|word| word.strip_prefix(key)?.strip_prefix('='));
        value.and_then(|value| value.parse().ok()).unwrap_or_else(|| panic!("{key} in {:?}", self.ready))
    }

    fn state(&self) -> State {
        let process = Process::new(self.child.id());
        State {
            memory: process.memory().map_or(0, |memory| memory.now),
            descriptors: process.descriptors().unwrap_or_default(),
            output: self.output.load(Ordering::Relaxed),
            calls: self.plan.calls.load(Ordering::Relaxed),
            misbehaviour: self.plan.misbehaviour.load(Ordering::Relaxed),
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Counts the bytes of an output until it ends.
fn count(mut from: impl Read + Send + 'static, output: &Arc<AtomicU64>) {
    let output = Arc::clone(output);
    std::thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut buffer) {
            output.fetch_add(count as u64, Ordering::Relaxed);
        }
    });
}

/// The figures of a program at one time.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    memory: u64,
    descriptors: usize,
    output: u64,
    calls: u64,
    misbehaviour: u64,
}

/// Calls and time of the windows of one kind.
#[derive(Clone, Copy, Debug, Default)]
struct Rate {
    calls: u64,
    misbehaviour: u64,
    time: Duration,
}

impl Rate {
    fn add(&mut self, before: &State, after: &State, time: Duration) {
        self.calls += after.calls - before.calls;
        self.misbehaviour += after.misbehaviour - before.misbehaviour;
        self.time += time;
    }

    fn calls(&self) -> f64 {
        self.calls as f64 / self.time.as_secs_f64()
    }
}

/// Runs the programs for the requested time. `bcap` is the path of the command; `bcap-fleet` is in the same folder.
pub(crate) fn soak(bcap: &Path, wishes: Wishes, verdict: &mut Verdict) {
    // with Nagle's algorithm in the broker the host would wait for acknowledgements of TCP most of the time
    let broker = Mosquitto::start(|_| "allow_anonymous true\nset_tcp_nodelay true\n".into());
    let Some(broker) = broker else { return verdict.check(false, "Mosquitto is installed") };
    let mut programs = start(bcap, &broker);
    let before = settle(&programs, None);
    for program in &mut programs {
        let clients = (wishes.clients / 20).max(1);
        begin(program, clients, broker.port);
    }
    let mut rates = vec![[Rate::default(); 2]; programs.len()];
    let (mut first, begun) = (Vec::new(), Instant::now());
    println!("  time  program  calls/s alone  together  kept  hostile/s  memory  files  output");
    for _ in 0..ROWS {
        row(&programs, wishes.time / ROWS, &mut rates);
        let states: Vec<State> = programs.iter().map(Program::state).collect();
        for ((program, state), [alone, together]) in programs.iter().zip(&states).zip(&rates) {
            println!(
                "{:4} s  {:7}  {:13.0}  {:8.0}  {:3.0}%  {:9.0}  {:3.1} MiB  {:5}  {:.1} MiB",
                begun.elapsed().as_secs(),
                program.name,
                alone.calls(),
                together.calls(),
                100.0 * together.calls() / alone.calls(),
                together.misbehaviour as f64 / together.time.as_secs_f64(),
                mebibytes(state.memory),
                state.descriptors,
                mebibytes(state.output)
            );
        }
        if first.is_empty() {
            first = states;
        }
    }
    let (last, time) = (programs.iter().map(Program::state).collect::<Vec<_>>(), begun.elapsed());
    for program in &mut programs {
        program.plan.is_over.store(true, Ordering::Relaxed);
        program.clients.drain(..).for_each(|thread| thread.join().expect("the clients end"));
    }
    let after = settle(&programs, Some(&before));
    for (number, program) in programs.iter().enumerate() {
        let [alone, together] = rates[number];
        judge(program, [&first[number], &last[number]], [&before[number], &after[number]], time, verdict);
        let (kept, name) = (100.0 * together.calls() / alone.calls(), program.name);
        let text = format!("{name}: its well-behaved clients keep {kept:.0} % of their calls");
        if wishes.time >= ENOUGH {
            verdict.check(kept >= KEPT, &text);
        }
    }
}

/// Measures both ways of working in turn for this time.
fn row(programs: &[Program], time: Duration, rates: &mut [[Rate; 2]]) {
    let begun = Instant::now();
    while begun.elapsed() < time {
        for (way, window) in [ALONE, TOGETHER].into_iter().enumerate() {
            for program in programs {
                program.plan.is_together.store(way == 1, Ordering::Relaxed);
            }
            // until the last of the others has let go
            std::thread::sleep(Duration::from_millis(300));
            let (before, from): (Vec<State>, _) = (programs.iter().map(Program::state).collect(), Instant::now());
            std::thread::sleep(window);
            for ((program, before), rates) in programs.iter().zip(&before).zip(&mut *rates) {
                rates[way].add(before, &program.state(), from.elapsed());
            }
        }
    }
}

fn judge(
    program: &Program,
    [first, last]: [&State; 2],
    [before, after]: [&State; 2],
    time: Duration,
    verdict: &mut Verdict,
) {
    let name = program.name;
    let failed = program.plan.failures.load(Ordering::Relaxed);
    let calls = program.plan.calls.load(Ordering::Relaxed);
    verdict.check(failed == 0 && calls > 0, &format!("{name}: {failed} sessions failed, {calls} calls were answered"));
    let growth = last.memory.saturating_sub(first.memory);
    verdict.check(
        growth < GROWTH,
        &format!("{name}: memory has grown by {:.1} MiB since the first line", mebibytes(growth)),
    );
    let files = format!("{name}: {} descriptors before, {} after", before.descriptors, after.descriptors);
    verdict.check(after.descriptors <= before.descriptors, &files);
    let rate = (last.output - before.output) / time.as_secs().max(1);
    verdict.check(rate < OUTPUT, &format!("{name}: {rate} bytes of output a second"));
}

fn mebibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

/// Waits until the descriptors of all programs are as before or do not change, at most a minute; returns the figures.
fn settle(programs: &[Program], before: Option<&[State]>) -> Vec<State> {
    let descriptors = |states: &[State]| states.iter().map(|state| state.descriptors).collect::<Vec<_>>();
    let until = Instant::now() + Duration::from_secs(60);
    let mut states: Vec<State> = programs.iter().map(Program::state).collect();
    loop {
        std::thread::sleep(Duration::from_secs(1));
        let present: Vec<State> = programs.iter().map(Program::state).collect();
        let is_flat = descriptors(&present) == descriptors(before.unwrap_or(&states));
        states = present;
        if is_flat || Instant::now() >= until {
            return states;
        }
    }
}

/// Starts the programs; the fleet and the gateway have sessions with the virtual controller.
fn start(bcap: &Path, broker: &Mosquitto) -> Vec<Program> {
    const FREE: &str = "127.0.0.1:0";
    let sim = Program::start("sim", Command::new(bcap).args(["sim", "--bcap", FREE, "--udp", FREE, "--rac", FREE]));
    let [robot, udp, rac] = ["bcap", "udp", "rac"].map(|key| sim.address(key).to_string());
    let mut proxy = Command::new(bcap);
    proxy.args(["proxy", "--quiet", "--listen", FREE, "--listen-rac", FREE]);
    proxy.args(["--robot", &robot, "--robot-udp", &udp, "--robot-rac", &rac]);
    let mut gateway = Command::new(bcap);
    gateway.args(["gateway", "--rac", FREE, "--modbus", FREE, "--register", "100=I/10-19:i16"]);
    gateway.args(["--allow-put", "I/10-19", "--clients-per-address", "64"]);
    gateway.args(["--robot", &format!("tcp:{robot}")]);
    let config = broker.path().join("fleet.toml");
    let text = format!(
        "group = \"soak\"\nnode = \"edge\"\n[broker]\nhost = \"127.0.0.1\"\nport = {}\n[metrics]\nport = 0\n\
         [commands]\nallow = [\"I/40-49=0..1000000\"]\nper_second = 1000\nlongest_seconds = 60\n\
         [[controller]]\nname = \"cell1\"\naddress = \"tcp:{robot}\"\n\
         [[controller.publish]]\nnames = [\"I1-9\", \"mode\"]\ninterval_ms = 100\n",
        broker.port
    );
    std::fs::write(&config, text).expect("a configuration");
    let fleet = Program::start("fleet", Command::new(bcap.with_file_name("bcap-fleet")).arg(&config));
    vec![sim, Program::start("proxy", &mut proxy), Program::start("gateway", &mut gateway), fleet]
}

/// Starts the clients of a program: well-behaved clients, as many misbehaving clients, and silent connections.
fn begin(program: &mut Program, clients: usize, broker: u16) {
    let plan = &program.plan;
    let (addresses, good) = match program.name {
        "gateway" => {
            let (rac, modbus) = (program.address("rac"), program.address("modbus"));
            let plan = Arc::clone(plan);
            let good = run_clients(clients, move |number| plc(rac, 10 + number as u32, Arc::clone(&plan)));
            (Addresses { tcp: modbus, udp: modbus, rac }, good)
        }
        "fleet" => {
            let metrics = program.address("metrics");
            let (good, bad) = (Arc::clone(plan), Arc::clone(plan));
            program.clients.push(run_clients(1, move |_| flood(broker, Arc::clone(&bad))));
            (
                Addresses { tcp: metrics, udp: metrics, rac: metrics },
                run_clients(1, move |_| host(broker, Arc::clone(&good))),
            )
        }
        name => {
            let [tcp, udp, rac] = ["bcap", "udp", "rac"].map(|key| program.address(key));
            let addresses = Addresses { tcp, udp, rac };
            // variables that no other client writes
            let first = if name == "sim" { 20 } else { 30 };
            (addresses, work::start(addresses, first..first + clients, Arc::clone(plan)))
        }
    };
    let bad = misbehaviour::start(addresses, clients, Arc::clone(plan));
    let (tcp, silent) = (addresses.tcp, Arc::clone(plan));
    program.clients.extend([good, bad, run_clients(SILENT, move |_| silence(tcp, Arc::clone(&silent)))]);
}

/// Keeps a connection open that sends nothing, and opens it again when the server has closed it.
async fn silence(server: SocketAddr, plan: Arc<Plan>) {
    while !plan.is_over.load(Ordering::Relaxed) {
        if let Ok(stream) = TcpStream::connect(server).await {
            let closed = stream.readable();
            let over = async {
                while !plan.is_over.load(Ordering::Relaxed) {
                    sleep(PACE * 10).await;
                }
            };
            tokio::select! { _ = closed => {}, () = over => {} }
        }
        sleep(PACE * 10).await;
    }
}

/// A PLC that writes a variable and reads it.
async fn plc(gateway: SocketAddr, index: u32, plan: Arc<Plan>) {
    let options = Options::default().timeout(REPLY);
    while !plan.is_over.load(Ordering::Relaxed) {
        let ended = match asynch::connect_rac(gateway, &options).await {
            Ok(mut client) => lines(&mut client, Variable::new(VariableKind::I, index), &plan).await,
            Err(error) => Err(error.into()),
        };
        plan.count(&format!("PLC of I{index}"), ended).await;
    }
}

async fn lines(client: &mut RacClient, variable: Variable, plan: &Plan) -> work::Session {
    let mut number = 0;
    while !plan.is_over.load(Ordering::Relaxed) {
        number += 1;
        client.put(variable, Variant::I4(number)).await?;
        assert_eq!(client.get(variable).await?, Variant::I4(number), "a value is its writer's own");
        plan.calls.fetch_add(2, Ordering::Relaxed);
        sleep(plan.pace).await;
    }
    Ok(())
}

fn mqtt(name: &str, broker: u16) -> (AsyncClient, EventLoop) {
    let mut options = MqttOptions::new(name, ("127.0.0.1", broker));
    options.set_max_packet_size(1 << 20, 8 << 20);
    let (client, mut events) = AsyncClient::builder(options).capacity(100).build();
    let mut network = NetworkOptions::new();
    network.set_tcp_nodelay(true);
    events.set_network_options(network);
    (client, events)
}

/// A host whose commands are executed in sequence, each after a pause.
async fn host(broker: u16, plan: Arc<Plan>) {
    let (client, mut events) = mqtt("host", broker);
    for topic in ["answer", "mode"] {
        client.subscribe(format!("bcap/soak/cell1/{topic}"), QoS::AtLeastOnce).await.expect("a queue");
    }
    // a command whose longest time began before the start of the fleet is refused
    sleep(Duration::from_secs(5)).await;
    let (mut number, mut sent) = (0_u64, Instant::now());
    while !plan.is_over.load(Ordering::Relaxed) {
        let answer = format!("{{\"id\":\"{number}\",\"result\":\"done\"}}");
        match timeout(PACE * 10, events.poll()).await {
            // a reading: the fleet has subscribed to commands
            Ok(Ok(Event::Incoming(Packet::Publish(_)))) if number == 0 => {}
            Ok(Ok(Event::Incoming(Packet::Publish(publish)))) if publish.payload == answer.as_bytes() => {
                plan.calls.fetch_add(1, Ordering::Relaxed);
            }
            Err(_) if number > 0 && sent.elapsed() > REPLY => {
                plan.failures.fetch_add(1, Ordering::Relaxed);
            }
            _ => continue,
        }
        sleep(plan.pace).await;
        (number, sent) = (number + 1, Instant::now());
        let expires = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default() + LONGEST;
        let command =
            format!("{{\"id\":\"{number}\",\"name\":\"I40\",\"value\":{number},\"expires\":{}}}", expires.as_millis());
        client.publish(TO_FLEET, command, PublishOptions::at_least_once()).await.expect("a queue");
    }
}

/// Commands that are refused, as fast as about 500 a second, and a message of 2 MB every second.
async fn flood(broker: u16, plan: Arc<Plan>) {
    let (client, mut events) = mqtt("flood", broker);
    let send = async {
        for number in 0_u64.. {
            sleep(Duration::from_millis(2)).await;
            if !plan.is_together.load(Ordering::Relaxed) {
                continue;
            }
            let payload = match number % 500 {
                0 => vec![b'x'; 2 << 20],
                odd if odd % 2 == 1 => {
                    format!("{{\"id\":\"x{number}\",\"name\":\"I99\",\"value\":1,\"expires\":1}}").into()
                }
                _ => number.to_be_bytes().repeat(30),
            };
            client.publish(TO_FLEET, payload, PublishOptions::at_most_once()).await.expect("a queue");
            plan.misbehaviour.fetch_add(1, Ordering::Relaxed);
        }
    };
    let drive = async {
        while !plan.is_over.load(Ordering::Relaxed) {
            let _ = timeout(PACE * 10, events.poll()).await;
        }
    };
    tokio::select! { () = send => {}, () = drive => {} }
}
