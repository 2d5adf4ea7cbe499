//! A client that sends refused PUTs as fast as it can, while a PLC works.
//!
//! ```text
//!  PLC ── a GET every 10 ms ────────────┐
//!                                       ├─ gateway image ─ log ─ serial line of 115,200 baud
//!  attacker ── PUTs that no rule allows ┘
//! ```
//!
//! Each refused line is a line of the log, so the log has more bytes than the serial line can carry. The board must not be
//! reset, and every answer must be right. The PLC's times are printed with and without the attack, not asserted.
//!
//! `FLOOD_SECONDS` is the length of all attacks, 60 s.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle, sleep};
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_qemu::{Board, Plc, Sim, bcap, error};

const BAUD: &str = "115200";
const PACE: Duration = Duration::from_millis(10);
/// The seconds of an attack. Then the PLC works alone for a third of that, so that other load on the machine affects both.
const ROUND: u64 = 30;
/// Lines that the attacker sends together.
const BATCH: usize = 32;
/// The maximum number of lines that wait for their answers, a fraction of a second's work. An attack ends when all are
/// answered.
const WAITING: u64 = 4096;

#[test]
fn a_flood_of_refused_requests_resets_nothing() {
    let bcap = bcap();
    let seconds = std::env::var("FLOOD_SECONDS").map_or(60, |text| text.parse().unwrap());
    let rounds = (seconds / ROUND).max(1);
    let attack_of = Duration::from_secs(seconds) / u32::try_from(rounds).unwrap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let limit = (seconds * 2 + 120).to_string();
    let mut board =
        Board::start(&sim.bcap, &["--baud", BAUD, "--time", &limit], &["provider=CaoProv.DENSO.VRC", "put=I/10-19"])
            .up();
    let mut plc = Plc::connect_when_free(&board.rac);
    let (mut quiet, mut attacked, mut refused) = (Times::default(), Times::default(), 0);
    for _ in 0..rounds {
        quiet.add(work(&mut plc, &mut board, attack_of / 3));
        let attack = Attack::start(&board.rac);
        attacked.add(work(&mut plc, &mut board, attack_of));
        refused += attack.end();
    }
    assert!(refused > seconds * 100, "{refused} refused PUTs are no flood");
    show(&format!("flood: {refused} refused PUTs in {seconds} s; a PLC without them {quiet}; with them {attacked}"));
    if board.log_is_text {
        show(&format!("flood: the log has {} lines of refusals", board.log().matches("refused b\"PUT").count()));
        // the log continues after the attack
        let _ = board.log_line(&["up ", "refused"]);
    }
    assert!(board.is_running(), "the board was reset");
}

/// Prints a line that is shown even if the test passes.
fn show(text: &str) {
    let _ = io::stderr().write_all(format!("{text}\n").as_bytes());
}

/// Times of requests.
#[derive(Default)]
struct Times(Vec<Duration>);

impl Times {
    fn add(&mut self, mut more: Self) {
        self.0.append(&mut more.0);
    }
}

impl std::fmt::Display for Times {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut times = self.0.clone();
        times.sort_unstable();
        let micros = |percent: usize| times[(times.len() - 1) * percent / 100].as_micros();
        write!(f, "p50 {} p99 {} max {} us of {}", micros(50), micros(99), micros(100), times.len())
    }
}

/// Sends requests at a steady pace for some time, and checks each answer.
fn work(plc: &mut Plc, board: &mut Board, length: Duration) -> Times {
    let (mut times, begin) = (Vec::new(), Instant::now());
    while begin.elapsed() < length {
        let number = i32::try_from(times.len()).unwrap();
        let since = Instant::now();
        assert_eq!(plc.try_ask(&format!("PUT:RC8:10:I:3,{number}\r")).ok().as_deref(), Some("0\r"), "{}", board.log());
        assert_eq!(plc.ask("GET:RC8:10:I:\r"), format!("0,3,{number}\r"));
        times.push(since.elapsed() / 2);
        assert!(board.is_running(), "the board was reset after {:?}: {}", begin.elapsed(), board.log());
        sleep(PACE);
    }
    Times(times)
}

/// A client that sends refused PUTs until `stop` is set.
struct Attack {
    stop: Arc<AtomicBool>,
    refused: Arc<AtomicU64>,
    threads: [JoinHandle<()>; 2],
}

impl Attack {
    fn start(address: &str) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let refused = Arc::new(AtomicU64::new(0));
        let mut sender = TcpStream::connect(address).unwrap();
        let mut receiver = sender.try_clone().unwrap();
        let answer = error(HResult::E_ACCESSDENIED);
        let (stopping, answered, counting) = (Arc::clone(&stop), Arc::clone(&refused), Arc::clone(&refused));
        let send = move || {
            let mut sent = 0;
            while !stopping.load(Ordering::Relaxed) {
                if sent > answered.load(Ordering::Relaxed) + WAITING {
                    sleep(Duration::from_millis(1));
                    continue;
                }
                if sender.write_all("PUT:RC8:20:I:3,1\r".repeat(BATCH).as_bytes()).is_err() {
                    break;
                }
                sent += BATCH as u64;
            }
            let _ = sender.shutdown(std::net::Shutdown::Write);
        };
        let receive = move || {
            let (mut bytes, mut total) = ([0; 4096], 0);
            while let Ok(count @ 1..) = receiver.read(&mut bytes) {
                total += count;
                counting.store(u64::try_from(total / answer.len()).unwrap(), Ordering::Relaxed);
            }
        };
        Self { stop, refused, threads: [thread::spawn(send), thread::spawn(receive)] }
    }

    /// Ends the attack, and returns how many of its lines were refused.
    fn end(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().unwrap();
        }
        self.refused.load(Ordering::Relaxed)
    }
}
