//! A plant in one machine: virtual controllers in one process, `bcap-fleet`, a Mosquitto and a subscriber.
//!
//! ```text
//! cargo bench -p bcap-fleet --bench plant -- [CONTROLLERS [VALUES [HZ [SECONDS]]]]
//! ```
//!
//! Each controller changes all of its values HZ times a second to the time of the change, and the fleet reads them as
//! often. It prints the messages that arrive at the subscriber, the cost of each process, and the capacity of the
//! broker alone when a plain client publishes the same messages as fast as it can.
#![cfg_attr(not(target_os = "linux"), allow(unused, reason = "/proc has the costs of processes"))]

mod mqtt;
mod process;
mod simulator;
mod subscriber;

use std::env;
use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, ExitCode};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use process::{Process, Usage};
use subscriber::{Seen, Subscriber};

pub(crate) type Failure = Box<dyn std::error::Error + Send + Sync>;

/// The time that all processes run before the measurement.
const WARM_UP: Duration = Duration::from_secs(5);

/// The time that the broker alone is measured.
const ALONE: Duration = Duration::from_secs(5);

/// The size of the plant.
#[derive(Clone, Copy, Debug)]
struct Load {
    controllers: u32,
    values: u32,
    hz: u32,
    seconds: u32,
}

fn main() -> ExitCode {
    let arguments: Vec<_> = env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let words: Vec<_> = arguments.iter().map(String::as_str).collect();
    let number = |index: usize, default| words.get(index).and_then(|word| word.parse().ok()).unwrap_or(default);
    let ended = match words.as_slice() {
        ["simulator", ..] => simulator::run(number(1, 1), number(2, 1), number(3, 1)),
        _ => run(Load { controllers: number(0, 500), values: number(1, 20), hz: number(2, 5), seconds: number(3, 10) }),
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("plant: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(load: Load) -> Result<(), Failure> {
    if !cfg!(target_os = "linux") || !Path::new("/usr/sbin/mosquitto").exists() {
        println!("skipped: it needs Linux and /usr/sbin/mosquitto");
        return Ok(());
    }
    let Load { controllers, values, hz, .. } = load;
    println!("{controllers} controllers, {values} values each, {hz} Hz: {} values/s", controllers * values * hz);
    for format in ["sparkplug", "json", "json, joined"] {
        measure(format, load)?;
    }
    Ok(())
}

fn measure(format: &str, load: Load) -> Result<(), Failure> {
    let folder = tempfile::tempdir()?;
    let (broker, port) = Process::broker(folder.path())?;
    let arguments = [load.controllers, load.values, load.hz].map(|number| number.to_string());
    let mut simulator = Process::start(Command::new(env::current_exe()?).arg("simulator").args(arguments))?;
    let mut ports = Vec::new();
    for _ in 0..load.controllers {
        ports.push(simulator.line()?.parse::<u16>()?);
    }
    let subscriber = Subscriber::start(port)?;
    let start = |ports: &[u16]| {
        let file = folder.path().join("fleet.toml");
        std::fs::write(&file, config(format, port, ports, load))?;
        let mut fleet = Process::start(Command::new(env!("CARGO_BIN_EXE_bcap-fleet")).arg(&file))?;
        let line = fleet.line()?;
        let metrics = line.rsplit_once("metrics=").ok_or("no address of the metrics")?.1.to_owned();
        thread::sleep(WARM_UP);
        Ok::<_, Failure>((fleet, metrics))
    };
    let one = start(ports.get(..1).unwrap_or_default())?.0.usage()?;
    let (fleet, metrics) = start(&ports)?;

    let usage = || Ok::<_, Failure>([fleet.usage()?, simulator.usage()?, broker.usage()?, Usage::of("self")?]);
    let before = (usage()?, Counters::read(&metrics)?, Instant::now());
    subscriber.take();
    thread::sleep(Duration::from_secs(load.seconds.into()));
    let seen = subscriber.take();
    let after = (usage()?, Counters::read(&metrics)?, Instant::now());
    let seconds = (after.2 - before.2).as_secs_f64();

    println!("\n{format}");
    let per_second = |count: u64| count as f64 / seconds;
    println!("  values/s that arrive        {:>10.0}", per_second(seen.values));
    println!("  messages/s that arrive      {:>10.0}", per_second(seen.messages));
    println!("  readings/s of the fleet     {:>10.0}", per_second(after.1.readings - before.1.readings));
    println!(
        "  skipped, dropped, errors/s  {:>10.0} {:.0} {:.0}",
        per_second(after.1.overruns - before.1.overruns),
        per_second(after.1.dropped - before.1.dropped),
        per_second(after.1.errors - before.1.errors)
    );
    for (name, before, after) in ["fleet", "simulator", "broker", "subscriber"]
        .iter()
        .zip(&before.0)
        .zip(&after.0)
        .map(|((name, before), after)| (name, before, after))
    {
        let share = per_second(after.ticks - before.ticks);
        println!("  CPU of the {name:<16} {share:>10.0} %    memory {:>7} KiB", after.kib);
    }
    let more = after.0[0].kib.saturating_sub(one.kib) as f64 / f64::from(load.controllers.saturating_sub(1).max(1));
    println!("  memory per controller       {more:>10.1} KiB");
    seen.print();
    drop((fleet, simulator));
    alone(port, &subscriber, &broker, &seen)
}

/// Publishes the same messages as fast as the broker takes them.
fn alone(port: u16, subscriber: &Subscriber, broker: &Process, seen: &Seen) -> Result<(), Failure> {
    if seen.sample.is_empty() {
        return Err("no message has arrived".into());
    }
    let before = broker.usage()?;
    subscriber.take();
    let began = Instant::now();
    subscriber::flood(port, &seen.sample, ALONE)?;
    let seconds = began.elapsed().as_secs_f64();
    let flooded = subscriber.take();
    let share = (broker.usage()?.ticks - before.ticks) as f64 / seconds;
    println!(
        "  the broker alone            {:>10.0} values/s in {:.0} messages/s, CPU {share:.0} %",
        flooded.values as f64 / seconds,
        flooded.messages as f64 / seconds
    );
    Ok(())
}

fn config(format: &str, port: u16, ports: &[u16], load: Load) -> String {
    let (format, joined) = format.split_once(", ").map_or((format, false), |(format, _)| (format, true));
    let mut text = format!(
        "group = \"plant\"\nnode = \"edge1\"\nformat = \"{format}\"\n[broker]\nhost = \"127.0.0.1\"\nport = {port}\n\
         [metrics]\nport = 0\n"
    );
    for (number, port) in (1..).zip(ports) {
        let _ = write!(
            text,
            "[[controller]]\nname = \"cell{number}\"\naddress = \"tcp:127.0.0.1:{port}\"\n[[controller.publish]]\n\
             names = [\"I1-{}\"]\ninterval_ms = {}\njoined = {joined}\n",
            load.values,
            1000 / load.hz
        );
    }
    text
}

/// Counters of the fleet, over all controllers.
struct Counters {
    readings: u64,
    overruns: u64,
    errors: u64,
    dropped: u64,
}

impl Counters {
    fn read(address: &str) -> Result<Self, Failure> {
        let mut stream = TcpStream::connect(address)?;
        stream.write_all(b"GET /metrics HTTP/1.1\r\n\r\n")?;
        let mut text = String::new();
        stream.read_to_string(&mut text)?;
        let sum = |name: &str| {
            let lines = text.lines().filter(|line| line.starts_with(name));
            lines.filter_map(|line| line.rsplit_once(' ')?.1.parse::<u64>().ok()).sum()
        };
        Ok(Self {
            readings: sum("bcap_readings_total"),
            overruns: sum("bcap_scan_overruns_total"),
            errors: sum("bcap_read_errors_total"),
            dropped: sum("bcap_dropped_total"),
        })
    }
}

/// Returns the time in microseconds, in 31 bits.
pub(crate) fn clock() -> i32 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i32::try_from(since.as_micros() % (1 << 31)).unwrap_or(0)
}
