//! Objects of the virtual controller: time to open and release one with few and with many open, memory of each, and requests
//! per second of many clients.
//!
//! ```text
//! cargo bench -p bcap-tests --bench objects
//! ```
//!
//! One client over loopback TCP opens and releases a variable, while 100 other clients hold 10, then 90,100 objects: each the
//! controller and 900 variables. The times must not depend on the number of open objects.
//! Then the resident memory of this process, clients included, before and after the objects were opened, and how many reads of
//! their variables the 100 clients complete in 3 s, each with one request in flight. The figures are printed, not judged.

use std::process::ExitCode;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use bcap_core::bcap::call::{self, ControllerHandle, VariableHandle};
use bcap_sim::{Config, Controller, Profile};
use bcap_std::blocking::{self, TcpClient};
use bcap_std::server::{Limits, Server};

type Failure = Box<dyn std::error::Error + Send + Sync>;

const CLIENTS: usize = 100;
/// The variables of each client; a client may open fewer than 1,000 objects.
const VARIABLES: usize = 900;
const ROUNDS: usize = 2_000;
const TIME: Duration = Duration::from_secs(3);

/// A client with the objects that it has opened.
struct Holder {
    client: TcpClient,
    controller: ControllerHandle,
    variables: Vec<VariableHandle>,
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
    let (told, address) = mpsc::channel();
    thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().ok()?;
        runtime.block_on(async {
            let server = Server::new(Controller::new(Config::new(Profile::Rc8))).limits(Limits::default());
            let server = server.bcap_tcp("127.0.0.1:0").await.ok()?;
            told.send(server.addresses().bcap_tcp[0]).ok()?;
            server.run(std::future::pending()).await.ok()
        })
    });
    let address = address.recv()?;
    let connect = || {
        let mut client = blocking::connect_tcp(address, &Default::default())?;
        client.call(call::service_start(""))?;
        let controller = client.call(call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", ""))?;
        Ok::<_, Failure>((client, controller))
    };
    let mut measured = connect()?;
    let mut others = Vec::new();
    for _ in 0..CLIENTS {
        let (client, controller) = connect()?;
        others.push(Holder { client, controller, variables: Vec::with_capacity(VARIABLES) });
    }
    let before = resident();
    println!("{:<16} {:>12} {:>12} {:>12} {:>12}", "objects open", "open", "p99", "release", "p99");
    let mut open = CLIENTS;
    for goal in [CLIENTS + 10, CLIENTS * (VARIABLES + 1)] {
        while open < goal {
            let holder = &mut others[open % CLIENTS];
            // I0 to I99, as a default controller has them
            let name = format!("I{}", holder.variables.len() % 100);
            holder.variables.push(holder.client.call(call::controller_get_variable(holder.controller, &name, ""))?);
            open += 1;
        }
        measure(goal, &mut measured)?;
    }
    if let (Some(before), Some(after)) = (before, resident()) {
        let each = 1024.0 * after.saturating_sub(before) as f64 / (CLIENTS * VARIABLES) as f64;
        println!("resident memory: {before} KiB before, {after} KiB after; {each:.0} bytes for each object");
    }
    read(others)
}

/// Lets each client read its variables in turn.
fn read(clients: Vec<Holder>) -> Result<(), Failure> {
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
            Ok::<_, Failure>(count)
        })
    });
    let mut count = 0;
    for reader in readers.collect::<Vec<_>>() {
        count += reader.join().map_err(|_| "a client has panicked")??;
    }
    let rate = count as f64 / begun.elapsed().as_secs_f64();
    println!("{CLIENTS} clients with {} objects each: {rate:.0} requests/s", VARIABLES + 1);
    Ok(())
}

/// Returns the resident memory of this process in KiB; `None` where the system does not tell.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?.trim().strip_suffix(" kB")?.parse().ok()
}

fn measure(open: usize, (client, controller): &mut (TcpClient, ControllerHandle)) -> Result<(), Failure> {
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
