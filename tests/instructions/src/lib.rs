//! Instructions per operation, counted by callgrind and held against the project's bars.
//!
//! Each case is counted by running its program under callgrind twice, with few repetitions and with many: the difference
//! divided by the repetitions is the cost of one, libc included and start-up excluded. The figures do not depend on the
//! machine's load or speed, only on the compiler, so a bar that is missed is a regression and fails the run.
//!
//! ```text
//! cargo run --profile bench -p bcap-instructions --bin codec      # needs valgrind
//! cargo run --profile bench -p bcap-instructions --bin client
//! cargo run --profile bench -p bcap-instructions --bin server
//! ```
//!
//! With the variable `BCAP_CALLGRIND`, the profiles are kept in that folder as `PROGRAM-CASE-REPETITIONS.out`; `flame` draws
//! them.

use std::error::Error;
use std::path::PathBuf;
use std::process::Command;

/// The arguments with which callgrind runs a program again: a case, the repetitions, and what else the case needs.
#[must_use]
pub fn arguments() -> Option<(usize, u64, Vec<String>)> {
    let mut arguments = std::env::args().skip(1);
    let (case, times) = (arguments.next()?.parse().ok()?, arguments.next()?.parse().ok()?);
    Some((case, times, arguments.collect()))
}

/// Prints the heads of the columns.
pub fn print_head() {
    println!("{:<46} {:>12} {:>8}", "instructions per operation", "measured", "bar");
}

/// Prints a row; returns whether the figure is within its bar. Without a bar it is only shown.
#[must_use]
pub fn print(name: &str, measured: u64, bar: Option<u64>) -> bool {
    let missed = bar.is_some_and(|bar| measured > bar);
    let bar = bar.map_or_else(|| "-".to_owned(), |bar| bar.to_string());
    println!("{name:<46} {measured:>12} {bar:>8}{}", if missed { "  OVER THE BAR" } else { "" });
    !missed
}

/// Returns the instructions of one repetition of a case of this program, its loop included.
///
/// # Errors
///
/// When callgrind is missing, or the case failed.
pub fn count(case: usize, few: u64, many: u64, more: &[String]) -> Result<u64, Box<dyn Error>> {
    let instructions = callgrind(case, many, more)?.saturating_sub(callgrind(case, few, more)?);
    Ok(instructions.div_ceil(many.saturating_sub(few).max(1)))
}

/// Runs this program under callgrind and returns the instructions that it counted.
fn callgrind(case: usize, times: u64, more: &[String]) -> Result<u64, Box<dyn Error>> {
    let program = std::env::current_exe()?;
    let profile = std::env::var_os("BCAP_CALLGRIND").map_or_else(
        || "/dev/null".into(),
        |folder| {
            let name = program.file_name().unwrap_or_default().to_string_lossy();
            PathBuf::from(folder).join(format!("{name}-{case}-{times}.out"))
        },
    );
    let output = Command::new("valgrind")
        .arg("--tool=callgrind")
        .arg(format!("--callgrind-out-file={}", profile.display()))
        .arg(program)
        .args([case.to_string(), times.to_string()])
        .args(more)
        .output()
        .map_err(|e| format!("cannot run valgrind: {e} (on Debian: apt-get install valgrind)"))?;
    let text = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        return Err(format!("valgrind failed, {}:\n{text}", output.status).into());
    }
    let collected = text.lines().find_map(|line| line.split_once("Collected :")).map(|(_, number)| number.trim());
    let number = collected.ok_or_else(|| format!("no count in what valgrind printed:\n{text}"))?;
    Ok(number.replace(',', "").parse()?)
}
