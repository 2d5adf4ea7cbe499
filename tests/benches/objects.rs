//! Objects of `bcap sim`: time to open and release one with few and with many open, memory of each, and requests per second
//! of many clients.
//!
//! ```text
//! BCAP=target/release/bcap cargo bench -p bcap-tests --bench objects
//! ```
//!
//! One client over loopback TCP opens and releases a variable, while 100 other clients have 12, then 1,000 objects each: the
//! service, the controller and variables. The times must not depend on the number of open objects.
//! Then the memory of the server's process before and after the objects were opened, and how many reads of
//! their variables the 100 clients complete in 3 s, each with one request in flight, with the processor time that the server
//! takes for one. The figures are printed, not judged.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, ExitCode, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use bcap_core::bcap::call::{self, ControllerHandle, VariableHandle};
use bcap_std::blocking::{self, TcpClient};
use bcap_tests::process::Process;

type Failure = Box<dyn std::error::Error + Send + Sync>;

const CLIENTS: usize = 100;
/// The variables of each client, which has 1,000 objects with the service and the controller: as many as a server permits.
const VARIABLES: usize = 998;
const FEW_VARIABLES: usize = 10;
const ROUNDS: usize = 2_000;
const TIME: Duration = Duration::from_secs(3);

/// A virtual controller in a separate process.
struct Server {
    child: Child,
    address: SocketAddr,
}

impl Server {
    fn start() -> Result<Self, Failure> {
        let program = std::env::var_os("BCAP").ok_or("set BCAP to the path of `bcap`")?;
        let mut command = Command::new(program);
        command.args(["sim", "--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"]);
        let mut child = command.stdout(Stdio::piped()).spawn()?;
        let mut line = String::new();
        BufReader::new(child.stdout.take().ok_or("no standard output")?).read_line(&mut line)?;
        let address = line.split_whitespace().find_map(|word| word.strip_prefix("bcap="));
        Ok(Self { address: address.ok_or_else(|| format!("not ready: {line}"))?.parse()?, child })
    }

    fn process(&self) -> Process {
        Process::new(self.child.id())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // it may have ended
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A client with the objects that it has opened.
struct Holder {
    client: TcpClient,
    controller: ControllerHandle,
    variables: Vec<VariableHandle>,
}

impl Holder {
    fn connect(address: SocketAddr) -> Result<Self, Failure> {
        let mut client = blocking::connect_tcp(address, &Default::default())?;
        client.call(call::service_start(""))?;
        let controller = client.call(call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", ""))?;
        Ok(Self { client, controller, variables: Vec::new() })
    }

    /// Opens variables until there are as many.
    fn open(&mut self, variables: usize) -> Result<(), Failure> {
        while self.variables.len() < variables {
            // I0 to I99, as a default controller has them
            let name = format!("I{}", self.variables.len() % 100);
            self.variables.push(self.client.call(call::controller_get_variable(self.controller, &name, ""))?);
        }
        Ok(())
    }
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("objects: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Failure> {
    let server = Server::start()?;
    let mut measured = Holder::connect(server.address)?;
    let holders = (0..CLIENTS).map(|_| Holder::connect(server.address));
    let mut holders = holders.collect::<Result<Vec<_>, Failure>>()?;
    let memory = || server.process().memory();
    let before = memory();
    println!("{:<16} {:>12} {:>12} {:>12} {:>12}", "objects open", "open", "p99", "release", "p99");
    for variables in [FEW_VARIABLES, VARIABLES] {
        holders.iter_mut().try_for_each(|holder| holder.open(variables))?;
        measure(CLIENTS * (variables + 2), &mut measured)?;
    }
    if let (Some(before), Some(after)) = (before, memory()) {
        let each = after.anonymous.saturating_sub(before.anonymous) as f64 / (CLIENTS * VARIABLES) as f64;
        let [from, to] = [before, after].map(|memory| memory.anonymous >> 10);
        println!("heap and stacks of the server: {from} KiB before, {to} KiB after; {each:.0} bytes for each object");
        println!("with the program in memory: {} KiB before, {} KiB after", before.now >> 10, after.now >> 10);
    }
    read(holders, server.process())
}

/// Lets each client read its variables in turn.
fn read(clients: Vec<Holder>, server: Process) -> Result<(), Failure> {
    let used = server.processor_time();
    let begun = Instant::now();
    let readers = clients.into_iter().map(|mut holder| {
        thread::spawn(move || {
            let mut count = 0_u64;
            for variable in holder.variables.iter().cycle() {
                if begun.elapsed() >= TIME {
                    break;
                }
                holder.client.call(call::variable_get_value(*variable))?;
                count += 1;
            }
            Ok::<_, Failure>((holder, count))
        })
    });
    let readers =
        readers.collect::<Vec<_>>().into_iter().map(|reader| reader.join().map_err(|_| "a client has panicked")?);
    // the clients stay connected until the time is read, so that it has no share of releasing their objects
    let clients = readers.collect::<Result<Vec<_>, Failure>>()?;
    let (elapsed, used) = (begun.elapsed(), used.zip(server.processor_time()));
    let count = clients.iter().map(|(_, count)| count).sum::<u64>() as f64;
    println!("{CLIENTS} clients with {} objects each: {:.0} requests/s", VARIABLES + 2, count / elapsed.as_secs_f64());
    if let Some((before, after)) = used {
        println!(
            "processor time of the server: {:.1} us for each request",
            1e6 * (after - before).as_secs_f64() / count
        );
    }
    Ok(())
}

fn measure(open: usize, Holder { client, controller, .. }: &mut Holder) -> Result<(), Failure> {
    let (mut opening, mut releasing) = (Vec::with_capacity(ROUNDS), Vec::with_capacity(ROUNDS));
    for _ in 0..ROUNDS {
        let begun = Instant::now();
        let variable = client.call(call::controller_get_variable(*controller, "I1", ""))?;
        let opened = Instant::now();
        client.call(call::variable_release(variable))?;
        opening.push(opened - begun);
        releasing.push(opened.elapsed());
    }
    let ([open_median, open_p99], [release_median, release_p99]) = (quantiles(opening), quantiles(releasing));
    println!("{open:<16} {open_median:>12.1?} {open_p99:>12.1?} {release_median:>12.1?} {release_p99:>12.1?}");
    Ok(())
}

/// Returns the median and the 99th percentile.
fn quantiles(mut times: Vec<Duration>) -> [Duration; 2] {
    times.sort_unstable();
    [times[times.len() / 2], times[times.len() * 99 / 100]]
}
