//! Instructions of a request, requests a second and their times through the gateway board in QEMU, compared with a bare echo on the same board.
//!
//! ```text
//!  PLC ─► gateway ─► virtual controller ─► gateway ─► PLC      GET:RC8:1:I: and its answer
//!  PLC ─► echo ─► PLC                                          as many bytes, there and back
//! ```
//!
//! Both are measured in turn, in the same run. A request through the gateway crosses the emulated network four times
//! and two programs of this machine more; the times depend on the emulator and this machine, and say nothing about a
//! real board. The instructions are those of the emulated processor, counted by a plugin of QEMU. They depend a little on the
//! machine, which decides how many frames arrive at once. A request is two receives and two sends, so its floor is two echoes.
#![allow(missing_docs, reason = "a benchmark has no users")]

use std::fs;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use bcap_qemu::{Board, Plc, Sim, bcap, free_port, run};

/// How long each of the rounds lasts, and how many there are.
const ROUND: Duration = Duration::from_secs(2);
const ROUNDS: usize = 3;

const REQUEST: &str = "GET:RC8:1:I:\r";
const ANSWER: &str = "0,3,123456\r";

fn main() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    assert!(run(&bcap, &["put", "I1", "123456", "--robot", &format!("tcp:{}", sim.bcap)]).ok);
    let echo_port = free_port().to_string();
    let file = std::env::temp_dir().join(format!("bcap-qemu-count-{}", std::process::id()));
    let options = ["--echo", &echo_port, "--count", file.to_str().expect("a path of UTF-8")];
    let board = Board::start(&sim.bcap, &options, &["provider=CaoProv.DENSO.VRC"]).up();
    let echo_address = format!("127.0.0.1:{echo_port}");
    println!(
        "{:<28} {:>12} {:>10} {:>10} {:>10} {:>10}",
        "", "instructions", "requests/s", "p50 us", "p99 us", "max us"
    );
    for plcs in [1, 4] {
        let mut gateway: Vec<Plc> = (0..plcs).map(|_| Plc::connect_when_free(&board.rac)).collect();
        let mut echo: Vec<Plc> = (0..plcs).map(|_| Plc::connect(&echo_address)).collect();
        let (mut through, mut back) = (Measured::default(), Measured::default());
        for _ in 0..ROUNDS {
            through.round(&file, &mut gateway, |plc| assert_eq!(plc.ask(REQUEST), ANSWER));
            back.round(&file, &mut echo, |plc| {
                let mut answer = [0; REQUEST.len()];
                plc.echo(REQUEST.as_bytes(), &mut answer);
                assert_eq!(answer, REQUEST.as_bytes());
            });
        }
        let share = 200 * back.instructions() / through.instructions().max(1);
        through.show(&format!("{plcs} PLCs, gateway"));
        back.show(&format!("{plcs} PLCs, bare echo"));
        println!("{plcs} PLCs: two echoes are {share} % of a request through the gateway");
    }
    if board.log_is_text {
        let log = board.log();
        println!("{}", log.lines().rfind(|line| line.contains("served")).unwrap_or("no status"));
    }
    drop(board);
    let _ = fs::remove_file(&file);
}

/// The rounds of one kind.
#[derive(Default)]
struct Measured {
    times: Vec<Duration>,
    /// The instructions of the board in all rounds.
    counted: u64,
}

impl Measured {
    fn round(&mut self, file: &Path, plcs: &mut [Plc], ask: impl Fn(&mut Plc) + Sync) {
        let before = counted(file);
        self.times.extend(measure(plcs, ask));
        self.counted += counted(file) - before;
    }

    /// Returns the instructions of one request, with those of the board while it waits for the next one.
    fn instructions(&self) -> u64 {
        self.counted / (self.times.len() as u64).max(1)
    }

    fn show(mut self, name: &str) {
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
    }
}

/// Returns the instructions that the board has executed.
fn counted(file: &Path) -> u64 {
    let bytes = fs::read(file).expect("the plugin has made the file");
    u64::from_ne_bytes(bytes.try_into().expect("the file has 8 bytes"))
}

/// Lets each PLC ask for as long as a round lasts, and returns how long each request took.
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
