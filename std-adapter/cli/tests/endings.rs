//! A short run of `just endings` and `just pick-and-place`: random trials of how programs of the library and the command end
//! while they move a robot. The test process also runs as the program of the library.

use std::process::ExitCode;

#[cfg(unix)]
fn main() -> ExitCode {
    use bcap_tests::endings::{self, Options};
    use libtest_mimic::{Arguments, Failed, Trial};

    if let Some(ended) = endings::run_if_asked() {
        return ended;
    }
    let judge = |good: bool| if good { Ok(()) } else { Err(Failed::from("see the lines above")) };
    let trials = move || {
        let options = Options { trials: 6, seed: 1, only: None, parallel: 10 };
        judge(endings::run(options, Some(env!("CARGO_BIN_EXE_bcap").into())))
    };
    let tests = vec![
        Trial::test("nothing_is_left_behind_and_every_report_is_true", trials),
        Trial::test("pick_and_place_arrives_every_time", move || judge(endings::pick_and_place(1, 2))),
    ];
    // in sequence: both print a table, and the second makes the machine busy
    let arguments = Arguments { test_threads: Some(1), ..Arguments::from_args() };
    libtest_mimic::run(&arguments, tests).exit_code()
}

#[cfg(not(unix))]
fn main() -> ExitCode {
    ExitCode::SUCCESS
}
