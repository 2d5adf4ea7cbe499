//! Requests a second and their times through the gateway board in QEMU, compared with a bare echo on the same board.
//!
//! ```text
//!  PLC ─► gateway ─► virtual controller ─► gateway ─► PLC      GET:RC8:1:I: and its answer
//!  PLC ─► echo ─► PLC                                          as many bytes, there and back
//! ```
//!
//! Both are measured in turn, in the same run. A request through the gateway crosses the emulated network four times
//! and two programs of this machine more; the times depend on the emulator and this machine, and say nothing about a
//! real board.
#![allow(missing_docs, reason = "a benchmark has no users")]

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
    let board = Board::start(&sim.bcap, &["--echo", &echo_port], &["provider=CaoProv.DENSO.VRC"]).up();
    let echo_address = format!("127.0.0.1:{echo_port}");
    println!("{:<28} {:>10} {:>10} {:>10} {:>10}", "", "requests/s", "p50 us", "p99 us", "max us");
    for plcs in [1, 4] {
        let mut gateway: Vec<Plc> = (0..plcs).map(|_| Plc::connect_when_free(&board.rac)).collect();
        let mut echo: Vec<Plc> = (0..plcs).map(|_| Plc::connect(&echo_address)).collect();
        let (mut through, mut back) = (Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            through.extend(measure(&mut gateway, |plc| assert_eq!(plc.ask(REQUEST), ANSWER)));
            back.extend(measure(&mut echo, |plc| {
                let mut answer = [0; REQUEST.len()];
                plc.echo(REQUEST.as_bytes(), &mut answer);
                assert_eq!(answer, REQUEST.as_bytes());
            }));
        }
        show(&format!("{plcs} PLCs, gateway"), through);
        show(&format!("{plcs} PLCs, bare echo"), back);
    }
    if board.log_is_text {
        let log = board.log();
        println!("{}", log.lines().rfind(|line| line.contains("served")).unwrap_or("no status"));
    }
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

fn show(name: &str, mut times: Vec<Duration>) {
    times.sort_unstable();
    let micros = |percent: usize| times[(times.len() - 1) * percent / 100].as_micros();
    let seconds = ROUND.as_secs() * ROUNDS as u64;
    println!(
        "{name:<28} {:>10} {:>10} {:>10} {:>10}",
        times.len() as u64 / seconds,
        micros(50),
        micros(99),
        micros(100)
    );
}
