//! Instructions of a request, requests a second and their times through the gateway board in QEMU, compared with a bare echo on
//! the same board.
//!
//! ```text
//!  PLC ─► gateway ─► virtual controller ─► gateway ─► PLC      GET:RC8:1:I: and its answer
//!  PLC ─► echo ─► PLC                                          as many bytes, there and back
//! ```
//!
//! The measurements of both alternate in the same run. A request through the gateway crosses the emulated network four times
//! and passes through two more programs of this machine; the times depend on the emulator and this machine, and say nothing
//! about a real board. The instructions are those of the emulated processor, counted by a plugin of QEMU. They depend slightly
//! on the machine, which determines how many frames arrive together. A request is two receives and two sends, so its floor is
//! two echoes.
//!
//! The median of the rounds is compared with bars; above one of them the benchmark fails. With the environment variable
//! `BCAP_CALLGRIND` it measures nothing and records a profile of requests in that folder.
#![allow(missing_docs, reason = "a benchmark has no users")]

use std::fs;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use std::process::ExitCode;
use std::thread;
use std::time::{Duration, Instant};

use bcap_qemu::{Board, Plc, Sim, bcap, free_port, run};

/// The duration and the number of the rounds.
const ROUND: Duration = Duration::from_secs(2);
const ROUNDS: usize = 5;

/// The numbers of PLCs, and the maximum instructions of a request and of an echo: 7 % above the figures of docs/performance.md
/// with one PLC, and 15 % with four, where a run differs from the next by 10 %.
const BARS: [(usize, u64, u64); 2] = [(1, 36_900, 12_900), (4, 40_000, 10_000)];

/// The requests of a profile.
const PROFILED: usize = 2000;

const REQUEST: &str = "GET:RC8:1:I:\r";
const ANSWER: &str = "0,3,123456\r";

fn main() -> ExitCode {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    assert!(run(&bcap, &["put", "I1", "123456", "--robot", &format!("tcp:{}", sim.bcap)]).ok);
    let echo_port = free_port().to_string();
    let file = std::env::temp_dir().join(format!("bcap-qemu-count-{}", std::process::id()));
    let profile = std::env::var("BCAP_CALLGRIND").ok().map(|folder| format!("{folder}/board.out"));
    let mut options = vec!["--echo", &echo_port, "--count", file.to_str().expect("a path of UTF-8")];
    options.extend(profile.iter().flat_map(|profile| ["--profile", profile]));
    let board = Board::start(&sim.bcap, &options, &["provider=CaoProv.DENSO.VRC"]).up();
    let passed = match profile {
        Some(profile) => {
            record(&file, &mut Plc::connect_when_free(&board.rac), Path::new(&profile));
            true
        }
        None => measure_all(&file, &board, &format!("127.0.0.1:{echo_port}")),
    };
    drop(board);
    let _ = fs::remove_file(&file);
    if passed { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Measures requests and echoes; returns whether none takes more instructions than its bar.
fn measure_all(file: &Path, board: &Board, echo_address: &str) -> bool {
    println!(
        "{:<28} {:>12} {:>10} {:>10} {:>10} {:>10}",
        "", "instructions", "requests/s", "p50 us", "p99 us", "max us"
    );
    let mut passed = true;
    for (plcs, request_bar, echo_bar) in BARS {
        let mut gateway: Vec<Plc> = (0..plcs).map(|_| Plc::connect_when_free(&board.rac)).collect();
        let mut echo: Vec<Plc> = (0..plcs).map(|_| Plc::connect(echo_address)).collect();
        let (mut through, mut back) = (Measured::default(), Measured::default());
        for _ in 0..ROUNDS {
            through.round(file, &mut gateway, |plc| assert_eq!(plc.ask(REQUEST), ANSWER));
            back.round(file, &mut echo, |plc| {
                let mut answer = [0; REQUEST.len()];
                plc.echo(REQUEST.as_bytes(), &mut answer);
                assert_eq!(answer, REQUEST.as_bytes());
            });
        }
        let share = 200 * back.instructions() / through.instructions().max(1);
        passed &= through.show(&format!("{plcs} PLCs, gateway"), request_bar);
        passed &= back.show(&format!("{plcs} PLCs, bare echo"), echo_bar);
        println!("{plcs} PLCs: two echoes are {share} % of a request through the gateway");
    }
    if board.log_is_text {
        let log = board.log();
        println!("{}", log.lines().rfind(|line| line.contains("served")).unwrap_or("no status"));
    }
    passed
}

/// Records a profile of requests.
fn record(file: &Path, plc: &mut Plc, profile: &Path) {
    let mut switch = fs::OpenOptions::new().write(true).open(file).expect("the plugin has made the file");
    let mut set = |on: u64| {
        switch
            .seek(SeekFrom::Start(8))
            .and_then(|_| switch.write_all(&on.to_ne_bytes()))
            .expect("the file can be written");
    };
    assert_eq!(plc.ask(REQUEST), ANSWER);
    set(1);
    for _ in 0..PROFILED {
        assert_eq!(plc.ask(REQUEST), ANSWER);
    }
    set(0);
    // the plugin writes it when the board executes its next instructions, at the next tick of its clock
    let until = Instant::now() + Duration::from_secs(10);
    while !fs::read_to_string(profile).is_ok_and(|text| text.contains("fn=")) {
        assert!(Instant::now() < until, "no profile was written");
        thread::sleep(Duration::from_millis(20));
    }
    // the file is complete when the board answers: the plugin writes it between two instructions
    assert_eq!(plc.ask(REQUEST), ANSWER);
    println!("{PROFILED} requests: {}", profile.display());
}

/// The rounds of one kind.
#[derive(Default)]
struct Measured {
    times: Vec<Duration>,
    /// The instructions of a request in each round, including the board's instructions while it waits for the next request.
    rounds: Vec<u64>,
}

impl Measured {
    fn round(&mut self, file: &Path, plcs: &mut [Plc], ask: impl Fn(&mut Plc) + Sync) {
        let before = counted(file);
        let times = measure(plcs, ask);
        self.rounds.push((counted(file) - before) / (times.len() as u64).max(1));
        self.times.extend(times);
    }

    /// Returns the median of the rounds.
    fn instructions(&self) -> u64 {
        let mut rounds = self.rounds.clone();
        rounds.sort_unstable();
        rounds[rounds.len() / 2]
    }

    /// Prints a line; returns whether the instructions are within the bar.
    fn show(mut self, name: &str, bar: u64) -> bool {
        let instructions = self.instructions();
        self.times.sort_unstable();
        let micros = |percent: usize| self.times[(self.times.len() - 1) * percent / 100].as_micros();
        let each_second = self.times.len() as u64 / (ROUND.as_secs() * ROUNDS as u64);
        println!(
            "{name:<28} {instructions:>12} {each_second:>10} {:>10} {:>10} {:>10}",
            micros(50),
            micros(99),
            micros(100)
        );
        if instructions > bar {
            println!("{name}: {instructions} instructions are above the bar of {bar}");
        }
        instructions <= bar
    }
}

/// Returns the instructions that the board has executed.
fn counted(file: &Path) -> u64 {
    let bytes = fs::read(file).expect("the plugin has made the file");
    u64::from_ne_bytes(*bytes.first_chunk().expect("the file begins with 8 bytes"))
}

/// Lets each PLC send requests for the duration of a round, and returns the time of each request.
fn measure(plcs: &mut [Plc], ask: impl Fn(&mut Plc) + Sync) -> Vec<Duration> {
    let until = Instant::now() + ROUND;
    let ask = &ask;
    thread::scope(|scope| {
        let work = |plc: &mut Plc| {
            let mut times = Vec::new();
            while Instant::now() < until {
                let since = Instant::now();
                ask(plc);
                times.push(since.elapsed());
            }
            times
        };
        let threads: Vec<_> = plcs.iter_mut().map(|plc| scope.spawn(move || work(plc))).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    })
}
