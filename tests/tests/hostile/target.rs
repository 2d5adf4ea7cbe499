//! The attacked server, in a separate process, and the bystanders: clients that the attacks must not disturb.

use std::fmt::Debug;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use bcap_core::bcap::call::{self, ControllerHandle, VariableHandle};
use bcap_core::bcap::client::{Config, Timing};
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::Variant;
use bcap_std::blocking::{self, Connection, RacClient, TcpClient, Transport, UdpClient};
use bcap_std::server::Limits;
use bcap_std::{Options, now};
use bcap_tests::process::Process;
use bcap_tests::served::Served;

/// The argument by which this program becomes the server.
pub(crate) const SERVE: &str = "--serve";

/// The limits of the attacked server: low enough for a case to exceed them.
pub(crate) fn limits() -> Limits {
    Limits::default()
        .connections(96)
        .connections_per_address(64)
        .evict_after(Duration::from_secs(60))
        .udp_peers(16)
        .udp_peers_per_address(16)
        .udp_idle(Duration::from_secs(60))
        .udp_lost(Duration::from_secs(600))
        .receive(Duration::from_secs(4))
        .send(Duration::from_secs(1))
        .call(Duration::from_secs(3600))
        .idle(None)
        .frame(16 << 20)
        .memory(40 << 20)
        .keep_alive(None)
}

/// Handles that the bystanders have open: service, controller and variable over TCP and UDP.
const OPEN: i32 = 6;

/// The timeout for an event that must happen, long enough for a busy machine.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(30);

/// Serves until the standard input ends; for the process that [`Target::start`] begins.
pub(crate) fn serve() {
    let server = Served::start(limits());
    println!("{} {} {}", server.tcp, server.udp, server.rac);
    let _ = std::io::stdin().read_to_end(&mut Vec::new());
    let left = server.stop();
    println!("{} {}", left.open.len(), left.peers.len());
}

/// Returns the options of clients that must not time out.
pub(crate) fn long_timeouts() -> Options {
    let options = Options::default().timeout(TIMEOUT);
    options.udp(Config { timing: Timing { attempts: 60, ..Timing::UDP }, ..options.udp })
}

/// The server and its well-behaved clients.
#[derive(Debug)]
pub(crate) struct Target {
    child: Child,
    output: BufReader<std::process::ChildStdout>,
    pub(crate) tcp: SocketAddr,
    pub(crate) udp: SocketAddr,
    pub(crate) rac: SocketAddr,
    over_tcp: Bystander<TcpClient>,
    over_udp: Bystander<UdpClient>,
    over_rac: RacClient,
    rounds: i32,
    descriptors: Option<usize>,
}

/// A client in the middle of its session.
#[derive(Debug)]
struct Bystander<C> {
    client: C,
    controller: ControllerHandle,
    variable: VariableHandle,
}

impl Target {
    pub(crate) fn start() -> Self {
        let program = std::env::current_exe().expect("this program has a file");
        let mut child = Command::new(program)
            .arg(SERVE)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the server starts");
        let mut output = BufReader::new(child.stdout.take().expect("it has an output"));
        let mut line = String::new();
        output.read_line(&mut line).expect("the server says where it listens");
        let addresses: Vec<SocketAddr> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
        let [tcp, udp, rac] = addresses[..] else { panic!("three addresses: {line:?}") };
        let mut target = Self {
            child,
            output,
            tcp,
            udp,
            rac,
            over_tcp: Bystander::new(blocking::connect_tcp(tcp, &long_timeouts()).unwrap(), "TCP"),
            over_udp: Bystander::new(blocking::connect_udp(udp, &long_timeouts()).unwrap(), "UDP"),
            over_rac: blocking::connect_rac(rac, &long_timeouts()).unwrap(),
            rounds: 0,
            descriptors: None,
        };
        // before anything is measured: one-time allocations exist
        target.serves_others();
        target.has_released_all();
        target.descriptors = target.process().descriptors();
        target
    }

    pub(crate) fn process(&self) -> Process {
        Process::new(self.child.id())
    }

    /// Stops the server; `false` when it had not served to the end or something was left.
    pub(crate) fn stop(mut self) -> bool {
        drop(self.child.stdin.take());
        let mut left = String::new();
        let told = self.output.read_line(&mut left).is_ok();
        let ended = self.child.wait().is_ok_and(|status| status.success());
        if !told || !ended || left.trim() != "0 0" {
            println!("FAILED: the server has ended with {left:?} (handles and peers left)");
            return false;
        }
        true
    }

    /// Asserts that the case disturbed no other client and leaked no resource.
    pub(crate) fn is_unharmed(&mut self) {
        assert_eq!(self.child.try_wait().unwrap(), None, "the server lives");
        self.serves_others();
        self.has_released_all();
    }

    /// Asserts that the server answers connected and new clients.
    pub(crate) fn serves_others(&mut self) {
        self.rounds += 1;
        let round = self.rounds;
        self.over_tcp.works(round);
        self.over_udp.works(round);
        works(&mut self.over_rac, round);
        let mut client = blocking::connect_tcp(self.tcp, &long_timeouts()).unwrap();
        session(&mut client, "new over TCP", round);
        // the end of the connection is its release, and that is looked for
        let mut client = blocking::connect_udp(self.udp, &long_timeouts()).unwrap();
        session(&mut client, "new over UDP", round);
        works(&mut blocking::connect_rac(self.rac, &long_timeouts()).unwrap(), round);
    }

    /// Waits until only the bystanders' handles are open; panics at [`TIMEOUT`].
    pub(crate) fn has_released_all(&mut self) {
        let until = now() + TIMEOUT;
        loop {
            let open = self.open();
            let descriptors = self.process().descriptors();
            let is_flat = self.descriptors.is_none_or(|before| descriptors.is_none_or(|count| count <= before));
            if open == OPEN && is_flat {
                return;
            }
            assert!(
                now() < until,
                "{open} handles open, {descriptors:?} file descriptors (were {:?})",
                self.descriptors
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Returns how many handles the server has given out.
    pub(crate) fn open(&mut self) -> i32 {
        let Bystander { client, controller, .. } = &mut self.over_tcp;
        client.call(call::controller_execute(*controller, "open", ())).unwrap().as_i32().unwrap()
    }

    /// Returns the share of a processor that the server takes while the bystanders are silent.
    pub(crate) fn load(&self) -> Option<f64> {
        let (begun, before) = (Instant::now(), self.process().processor_time()?);
        std::thread::sleep(Duration::from_millis(500));
        let used = self.process().processor_time()?.saturating_sub(before);
        Some(used.as_secs_f64() / begun.elapsed().as_secs_f64())
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        // after `stop` it has gone already
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl<X: Transport<Error: Debug>> Bystander<Connection<X, Vec<u8>>> {
    fn new(mut client: Connection<X, Vec<u8>>, name: &str) -> Self {
        client.call(call::service_start("")).unwrap();
        let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
        let variable = client.call(call::controller_get_variable(controller, name, "")).unwrap();
        Self { client, controller, variable }
    }

    fn works(&mut self, round: i32) {
        let Self { client, variable, .. } = self;
        client.call(call::variable_put_value(*variable, [round, -round])).unwrap();
        let value = client.call(call::variable_get_value(*variable)).unwrap();
        assert_eq!(value.as_array().and_then(|a| a.items::<i32>()?.to_array()), Some([round, -round]));
    }
}

/// A session from beginning to end.
fn session<X: Transport<Error: Debug>>(client: &mut Connection<X, Vec<u8>>, name: &str, round: i32) {
    client.call(call::service_start("WDT=200")).unwrap();
    let controller = client.call(call::controller_connect("", "", "", "")).unwrap();
    let variable = client.call(call::controller_get_variable(controller, name, "")).unwrap();
    client.call(call::variable_put_value(variable, round)).unwrap();
    assert_eq!(client.call(call::variable_get_value(variable)).unwrap(), Variant::I4(round));
    client.call(call::variable_release(variable)).unwrap();
    client.call(call::controller_disconnect(controller)).unwrap();
    client.call(call::service_stop()).unwrap();
}

fn works(client: &mut RacClient, round: i32) {
    let variable = Variable::new(VariableKind::I, 77);
    client.put(variable, Variant::I4(round)).unwrap();
    assert_eq!(client.get(variable).unwrap(), Variant::I4(round));
}
