//! Random trials of how programs end while they move a robot, and a table of the effects that they left.
//!
//! ```text
//!  this process                                                 a process for each trial
//!   virtual controller ── server ── link (can be cut) ───────►  a program of the library, or `bcap`
//!        ▲  truth: position, motion, motor, arm                      │ output: go, arrived, halted, ...
//!        └────────────── judge ◄─────────────────────────────────────┘
//! ```
//!
//! The truth is read from the model of the robot and not over the protocol. The destination of a motion is the position of a
//! copy of the model after it. All draws of a trial follow from the seed and its number, so that it can be repeated alone.

mod cycles;
mod draw;
mod model;
mod rig;
mod table;
mod victim;

use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use bcap_sim::Profile;

pub use self::cycles::pick_and_place;
use self::draw::Trial;
use self::rig::{Seen, Tools};
use self::table::Table;
pub use self::victim::run_if_asked;

/// Which trials are made.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// The number of trials with each model.
    pub trials: u64,
    /// The seed.
    pub seed: u64,
    /// Only this trial, with its output.
    pub only: Option<u64>,
    /// Number of trials that run at the same time.
    pub parallel: usize,
}

impl Options {
    /// Reads `[TRIALS] [SEED] [--only N]`; ignores what `cargo bench` adds.
    ///
    /// # Errors
    ///
    /// An argument that is not a number.
    pub fn parse(arguments: impl Iterator<Item = String>, trials: u64) -> Result<Self, String> {
        let mut options = Self { trials, seed: 1, only: None, parallel: 12 };
        let (mut arguments, mut place) = (arguments.filter(|word| word != "--bench"), 0);
        while let Some(word) = arguments.next() {
            let number = |text: &str| text.parse().map_err(|_| format!("{text:?} is not a number"));
            match (word.as_str(), place) {
                ("--only", _) => options.only = Some(number(&arguments.next().unwrap_or_default())?),
                (text, 0) => (options.trials, place) = (number(text)?, 1),
                (text, 1) => (options.seed, place) = (number(text)?, 2),
                (text, _) => return Err(format!("{text:?}: too many arguments; write [TRIALS] [SEED] [--only N]")),
            }
        }
        Ok(options)
    }
}

/// Runs the trials and prints the table. Returns whether no trial left an effect on the robot or made a false report.
#[must_use]
pub fn run(options: Options, bcap: Option<PathBuf>) -> bool {
    let with_command = bcap.is_some();
    let mut tools = match Tools::new(bcap) {
        Ok(tools) => tools,
        Err(error) => {
            eprintln!("endings: {error}");
            return false;
        }
    };
    tools.verbose = options.only.is_some();
    let total = options.trials * Profile::ALL.len() as u64;
    let (first, end) = options.only.map_or((0, total), |only| (only, only + 1));
    let (next, table) = (AtomicU64::new(first), Mutex::new(Table::default()));
    thread::scope(|scope| {
        for _ in 0..options.parallel.max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::SeqCst);
                    if number >= end {
                        return;
                    }
                    let trial = Trial::draw(options.seed, number, with_command);
                    let seen = rig::run(&trial, &tools).map_err(|error| error.to_string());
                    table.lock().unwrap_or_else(PoisonError::into_inner).add(&trial, seen);
                }
            });
        }
    });
    let table = table.into_inner().unwrap_or_else(PoisonError::into_inner);
    print!("{table}");
    table.is_good()
}
