//! The delay that `bcap proxy` adds to a round trip.
//!
//! ```text
//! cargo bench -p bcap-cli --bench proxy
//! ```
//!
//! A client reads a variable directly and through a proxy that records to a file and decodes, in turns: with a virtual controller
//! on loopback, and with one whose requests and replies are each delayed by at least 1 ms, as a controller on a network answers.
//! Fails if the proxy adds more than 10 % to the median of the second one.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Instant;

use bcap_std::Settings;
use bcap_std::blocking::Controller;
use hdrhistogram::Histogram;

type Failure = Box<dyn std::error::Error>;

/// The proxy may add this share to the median.
const BAR: f64 = 0.1;
const ROUNDS: usize = 50;

fn main() -> ExitCode {
    match run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("proxy: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<bool, Failure> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("bench.pcapng");
    let file = file.to_str().ok_or("the folder is not UTF-8")?;
    let sim = Running::start(&["sim", "--bcap", "127.0.0.1:0", "--udp", "127.0.0.1:0", "--rac", "127.0.0.1:0"])?;
    let slow = Running::proxy(&sim, &["--quiet", "--delay", "1ms"])?;
    println!("{:<34} {:>10} {:>10} {:>10}", "round trip in us", "median", "p99", "max");
    let near = compare("loopback", &sim, &Running::proxy(&sim, &["--write", file])?, 200)?;
    let far = compare("delayed by 1 ms twice", &slow, &Running::proxy(&slow, &["--write", file])?, 10)?;
    println!("added to the median: {:.1} % on loopback, {:.1} % with delays", near * 100.0, far * 100.0);
    Ok(far <= BAR)
}

/// Measures calls with and without a proxy in turns; returns the share that the proxy adds to the median.
fn compare(title: &str, direct: &Running, proxy: &Running, calls: usize) -> Result<f64, Failure> {
    let mut clients = [direct, proxy]
        .into_iter()
        .map(|server| Ok((Controller::connect(&server.bcap, &Settings::rc8())?, Histogram::<u64>::new(3)?)))
        .collect::<Result<Vec<_>, Failure>>()?;
    for round in 0..=ROUNDS {
        for (client, times) in &mut clients {
            for _ in 0..calls {
                let began = Instant::now();
                let _: i32 = client.read("I1")?;
                // the first round warms up
                if round > 0 {
                    times.record(u64::try_from(began.elapsed().as_nanos())?)?;
                }
            }
        }
    }
    let micros = |nanos: u64| format!("{}.{}", nanos / 1000, nanos / 100 % 10);
    for (way, (_, times)) in ["directly", "through bcap proxy"].iter().zip(&clients) {
        let [p50, p99] = [0.5, 0.99].map(|share| micros(times.value_at_quantile(share)));
        println!("{:<34} {p50:>10} {p99:>10} {:>10}", format!("{title}, {way}"), micros(times.max()));
    }
    let median = |index: usize| clients.get(index).map_or(0, |(_, times)| times.value_at_quantile(0.5));
    let [direct, through] = [0, 1].map(median).map(|nanos| u32::try_from(nanos).map_or(f64::INFINITY, f64::from));
    Ok(through / direct - 1.0)
}

/// A process of the command; dropping it kills it.
struct Running {
    child: Child,
    bcap: String,
}

impl Running {
    fn start(args: &[&str]) -> Result<Self, Failure> {
        let mut child = Command::new(env!("CARGO_BIN_EXE_bcap")).args(args).stdout(Stdio::piped()).spawn()?;
        let mut out = BufReader::new(child.stdout.take().ok_or("no output")?);
        let mut line = String::new();
        out.read_line(&mut line)?;
        let bcap = line.split_whitespace().find_map(|word| word.strip_prefix("bcap=")).ok_or("no address")?;
        let bcap = format!("tcp:{bcap}");
        // the lines of a proxy are read, as a terminal would
        std::thread::spawn(move || std::io::copy(&mut out, &mut std::io::sink()));
        Ok(Self { child, bcap })
    }

    fn proxy(robot: &Self, more: &[&str]) -> Result<Self, Failure> {
        let address = ["proxy", "--listen", "127.0.0.1:0", "--robot", &robot.bcap, "--robot-rac", "127.0.0.1:1"];
        Self::start(&[&address[..], more].concat())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
