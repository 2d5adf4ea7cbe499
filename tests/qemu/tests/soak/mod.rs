//! Runs the gateway board in QEMU while everything around it fails at random.
//!
//! ```text
//!  3 PLCs with RAC ───┐
//!  1 PLC with Modbus ─┼─ user network ─┐                  ┌─ robot: killed, stopped, started again
//!  refused PUTs ──────┤                ├─ link, cut ─ gateway image
//!  random bytes ──────┘                │                  └─ log ─ serial line of 115,200 baud
//!  random frames ─────── UDP ──────────┘
//! ```
//!
//! The PLCs write unique numbers and read them back, so a wrong answer is detected. A reset would end the emulator and the
//! test. After each failure every PLC must be served again. Times are printed, not asserted.
//!
//! `SOAK_SECONDS` and `SOAK_SEED` are the length, 30 s, and the seed of the failures, 1.

mod chaos;
mod garbage;
mod plc;

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use bcap_qemu::{Board, Sim, bcap, free_port};
use fastrand::Rng;

use self::chaos::Chaos;
use self::garbage::{Frames, Garbage};
use self::plc::{Front, Seen};

/// The time between two lines with figures.
const PROGRESS: Duration = Duration::from_secs(60);

/// The state that the threads share.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    /// Number of restarts of the robot.
    robots: AtomicU32,
    /// Number of times the link was cut or connected.
    links: AtomicU32,
}

impl Shared {
    fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Signals the threads to end, even when this thread panics.
struct Stop<'a>(&'a Shared);

impl Drop for Stop<'_> {
    fn drop(&mut self) {
        self.0.stop.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_board_around_which_everything_fails_answers_right_and_is_not_reset() {
    let bcap = bcap();
    let setting = |name: &str, usual: u64| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    let length = Duration::from_secs(setting("SOAK_SECONDS", 30));
    let seed = setting("SOAK_SEED", 1);
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let [health, modbus] = [(); 2].map(|()| free_port().to_string());
    let frames = Frames::open();
    let socket = std::env::temp_dir().join(format!("bcap-soak-{}", std::process::id()));
    let limit = (length.as_secs() * 2 + 600).to_string();
    // not decoded: the text of a watchdog or a fault would be lost
    let options = ["--raw", "--baud", "115200", "--time", &limit, "--health", &health, "--modbus", &modbus];
    let network = ["--frames", &frames.ports, "--monitor", socket.to_str().unwrap()];
    let settings = ["provider=CaoProv.DENSO.VRC", garbage::MAC, "put=I/0-79", "register=0=I/60-79"];
    let mut board = Board::start(&sim.bcap, &[&options[..], &network].concat(), &settings).up();

    let [modbus, page] = [modbus, health].map(|port| format!("127.0.0.1:{port}"));
    let rac = board.rac.clone();
    let fronts = [(Front::Rac, &rac), (Front::Rac, &rac), (Front::Rac, &rac), (Front::Modbus, &modbus)];
    let (shared, garbage, seen) = (Shared::default(), Garbage::default(), fronts.map(|_| Seen::default()));
    let rng = |number: u8| Rng::with_seed(seed.wrapping_mul(100).wrapping_add(number.into()));
    thread::scope(|scope| {
        let _stop = Stop(&shared);
        for (number, (&(front, address), seen)) in (0..).zip(fronts.iter().zip(&seen)) {
            let (rng, shared) = (rng(number), &shared);
            scope.spawn(move || plc::run(front, address, number, rng, seen, shared));
        }
        scope.spawn(|| garbage.refused_puts(&rac, rng(10), &shared));
        scope.spawn(|| garbage.connections(&[&rac, &modbus, &page], rng(11), &shared));
        scope.spawn(|| garbage.frames(&frames, rng(12), &shared));
        let mut chaos = Chaos::new(bcap, sim, &socket, rng(13));
        let begin = Instant::now();
        let mut shown = begin;
        while begin.elapsed() < length {
            chaos.fail(&mut board, &seen, &shared);
            if shown.elapsed() >= PROGRESS || begin.elapsed() >= length {
                shown = Instant::now();
                let figures = plc::figures(&seen);
                show(&format!("soak: seed {seed}, {} s: {figures}; {chaos}; {garbage}", begin.elapsed().as_secs()));
            }
        }
        show(&format!("soak: {}", garbage::page(&page)));
    });
    let wrong: Vec<String> = seen.iter().flat_map(Seen::wrong).collect();
    assert!(wrong.is_empty(), "wrong answers: {wrong:#?}");
    assert!(board.is_running(), "the board was reset: {}", board.log());
}

/// Prints a line that is shown even if the test passes.
fn show(text: &str) {
    let _ = io::stderr().write_all(format!("{text}\n").as_bytes());
}
