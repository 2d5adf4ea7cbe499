//! Random trials of how programs end while they move a robot; and pick and place with passes.
//!
//! ```text
//! BCAP=target/release/bcap cargo bench -p bcap-tests --bench endings -- [TRIALS] [SEED] [--only N]
//! cargo bench -p bcap-tests --bench endings -- pick-and-place [CYCLES]
//! ```
//!
//! TRIALS is the number for each model, 2000 without it. Without `BCAP` only programs of the library take part. A trial
//! that leaves an effect on the robot, or makes a false report, is printed with its draws; `--only N` repeats it.

use std::process::ExitCode;

#[cfg(unix)]
fn main() -> ExitCode {
    use bcap_tests::endings::{self, Options};

    if let Some(ended) = endings::run_if_asked() {
        return ended;
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let good = if arguments.first().is_some_and(|word| word == "pick-and-place") {
        let cycles = arguments.iter().find_map(|word| word.parse().ok()).unwrap_or(100);
        Ok(endings::pick_and_place(cycles, usize::MAX))
    } else {
        let bcap = std::env::var_os("BCAP").map(Into::into);
        Options::parse(arguments.into_iter(), 2000).map(|options| endings::run(options, bcap))
    };
    if let Err(error) = &good {
        eprintln!("endings: {error}");
    }
    if good == Ok(true) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

#[cfg(not(unix))]
fn main() -> ExitCode {
    ExitCode::SUCCESS
}
