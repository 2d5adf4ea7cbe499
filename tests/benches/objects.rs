//! Time to open and release an object of the virtual controller, with few and with many objects open.
//!
//! ```text
//! cargo bench -p bcap-tests --bench objects
//! ```
//!
//! One client over loopback TCP opens and releases a variable, while other clients hold 10, then 90,000 objects (900 in
//! each of 100 connections). The times must not depend on the number of open objects; they are printed, not judged.

use std::process::ExitCode;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use bcap_core::bcap::call::{self, ControllerHandle};
use bcap_sim::{Config, Controller, Profile};
use bcap_std::blocking::{self, TcpClient};
use bcap_std::server::{Limits, Server};

type Failure = Box<dyn std::error::Error + Send + Sync>;

const CLIENTS: usize = 100;
const ROUNDS: usize = 2_000;

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
    let mut others = (0..CLIENTS).map(|_| connect()).collect::<Result<Vec<_>, _>>()?;
    println!("{:<16} {:>12} {:>12} {:>12} {:>12}", "objects open", "open", "p99", "release", "p99");
    let mut open = 0;
    for goal in [10, 90_000] {
        while open < goal {
            let (client, controller) = &mut others[open % CLIENTS];
            client.call(call::controller_get_variable(*controller, "I1", ""))?;
            open += 1;
        }
        measure(goal, &mut measured)?;
    }
    Ok(())
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
