//! A soak test: a server with many clients, half of which misbehave. It measures the throughput of the others and checks
//! that the server's resources do not grow.
//!
//! ```text
//!   idle      all clients are connected and send nothing
//!   alone     the well-behaved half works, for a second                           ┐
//!   together  the other half misbehaves at the same time, for two                 ┘ in turn, until the time is over
//!   after     all clients are disconnected
//! ```
//!
//! `cargo bench -p bcap-tests --bench soak -- --seconds 60 --clients 200`; the seconds are the whole duration. The
//! server is a separate process with the default limits and one thread.
//!
//! It fails when the well-behaved half keeps less than 80 % of its throughput alone (in 60 s or more), when 200 silent
//! connections use 1 % of a processor, when the numbers of handles, tasks or files at the end differ from those at the
//! start, or when memory has grown by 10 MiB since the first line of the table. Other load on the machine distorts the
//! figures.
//!
//! With `--programs` the servers are the programs `bcap` of the environment variable `BCAP` and `bcap-fleet` next to it; see
//! the module `programs`.

mod misbehaviour;
mod programs;
mod server;
mod work;

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;

use crate::server::{SERVE, Server, State};

/// Lines of the table.
const ROWS: u32 = 6;
/// The duration of one interval with the well-behaved half alone, and with both halves together.
const ALONE: Duration = Duration::from_secs(1);
const TOGETHER: Duration = Duration::from_secs(2);
/// The minimum total time together for a verdict on throughput.
const ENOUGH: Duration = Duration::from_secs(60);
/// The minimum share of its throughput that the well-behaved half keeps, in per cent.
const KEPT: f64 = 80.0;
/// The processor time that silent connections may take, in per cent.
const IDLE: f64 = 1.0;
/// Maximum growth of the server, in bytes.
const GROWTH: u64 = 10 << 20;

/// The state that all clients share.
#[derive(Debug, Default)]
pub(crate) struct Plan {
    /// Calls that the well-behaved have made.
    pub(crate) calls: AtomicU64,
    /// Sessions of the well-behaved that have failed.
    pub(crate) failures: AtomicU64,
    /// The pause of a well-behaved client after each pair of calls.
    pub(crate) pace: Duration,
    /// The count of invalid actions.
    pub(crate) misbehaviour: AtomicU64,
    /// Whether the others are to misbehave now.
    pub(crate) is_together: AtomicBool,
    /// Whether all are to go.
    pub(crate) is_over: AtomicBool,
}

/// The options of the run.
#[derive(Clone, Copy, Debug)]
struct Wishes {
    time: Duration,
    clients: usize,
    is_of_programs: bool,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.first().is_some_and(|first| first == SERVE) {
        server::serve();
        return ExitCode::SUCCESS;
    }
    let Some(wishes) = wishes(&arguments) else {
        eprintln!("usage: soak [--seconds SECONDS] [--clients CLIENTS] [--programs]");
        return ExitCode::from(2);
    };
    let mut verdict = Verdict(true);
    match std::env::var_os("BCAP").filter(|_| wishes.is_of_programs) {
        Some(bcap) => programs::soak(bcap.as_ref(), wishes, &mut verdict),
        None if wishes.is_of_programs => verdict.check(false, "BCAP names the command"),
        None => soak(wishes, &mut verdict),
    }
    if verdict.0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn wishes(arguments: &[String]) -> Option<Wishes> {
    let mut wishes = Wishes { time: Duration::from_secs(60), clients: 200, is_of_programs: false };
    let mut words = arguments.iter().filter(|word| *word != "--bench");
    while let Some(word) = words.next() {
        match word.as_str() {
            "--seconds" => wishes.time = Duration::from_secs(words.next()?.parse().ok()?),
            "--clients" => wishes.clients = words.next()?.parse().ok().filter(|clients| *clients >= 2)?,
            "--programs" => wishes.is_of_programs = true,
            _ => return None,
        }
    }
    Some(wishes)
}

/// Runs `clients` clients in a separate thread, which ends when all clients have ended.
pub(crate) fn run_clients<F: Future<Output = ()> + Send + 'static>(
    clients: usize,
    client: impl Fn(usize) -> F + Send + 'static,
) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(async {
            let mut tasks = JoinSet::new();
            for number in 0..clients {
                tasks.spawn(client(number));
            }
            while let Some(ended) = tasks.join_next().await {
                ended.expect("a client does not panic");
            }
        });
    })
}

/// Whether all is as it should be.
struct Verdict(bool);

impl Verdict {
    fn check(&mut self, is_good: bool, what: &str) {
        println!("{}  {what}", if is_good { "  ok  " } else { "FAILED" });
        self.0 &= is_good;
    }
}

fn soak(wishes: Wishes, verdict: &mut Verdict) {
    let mut server = Server::start();
    idle(&mut server, wishes, verdict);
    let begin = server.quiet();

    let plan = Arc::<Plan>::default();
    let half = wishes.clients / 2;
    let good = work::start(server.addresses(), 0..half, Arc::clone(&plan));
    let bad = misbehaviour::start(server.addresses(), wishes.clients - half, Arc::clone(&plan));
    // one-time allocations happen before the measurement
    let _ = Window::of(&plan, &server, ALONE);
    println!("calls/s alone  together  kept   misbehaviour  {}", State::HEAD);
    let mut rows = Vec::new();
    for _ in 0..ROWS {
        let (alone, together) = row(&plan, &server, wishes.time / ROWS);
        let state = server.state();
        let (kept, misbehaviour) = (100.0 * together.calls() / alone.calls(), together.misbehaviour());
        println!("{:13.0}  {:8.0}  {kept:3.0} %  {misbehaviour:6.0}/s  {state}", alone.calls(), together.calls());
        rows.push(Row { alone, together, state });
    }
    plan.is_over.store(true, Ordering::Relaxed);
    good.join().expect("the well-behaved have been served");
    bad.join().expect("the others have found their end");
    let failures = plan.failures.load(Ordering::Relaxed);
    verdict.check(failures == 0, &format!("{failures} sessions of well-behaved clients have failed"));
    judge(wishes, &rows, &begin, &server.settled(&begin), verdict);
}

/// Alternates between both ways of working, until both together have taken `time`.
fn row(plan: &Plan, server: &Server, time: Duration) -> (Window, Window) {
    let (mut alone, mut together) = (Window::default(), Window::default());
    while together.time < time {
        plan.is_together.store(false, Ordering::Relaxed);
        // until the last of the others has let go
        std::thread::sleep(Duration::from_millis(300));
        alone.add(Window::of(plan, server, ALONE));
        plan.is_together.store(true, Ordering::Relaxed);
        together.add(Window::of(plan, server, TOGETHER.min(time)));
    }
    (alone, together)
}

/// The work of an interval.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    calls: u64,
    misbehaviour: u64,
    time: Duration,
    /// The processor time that the server has used.
    used: Duration,
}

impl Window {
    fn of(plan: &Plan, server: &Server, time: Duration) -> Self {
        let count = || [&plan.calls, &plan.misbehaviour].map(|count| count.load(Ordering::Relaxed));
        let used = || server.process().processor_time().unwrap_or_default();
        let (before, used_before, begun) = (count(), used(), Instant::now());
        std::thread::sleep(time);
        let (after, used, time) = (count(), used() - used_before, begun.elapsed());
        Self { calls: after[0] - before[0], misbehaviour: after[1] - before[1], time, used }
    }

    fn add(&mut self, other: Self) {
        self.calls += other.calls;
        self.misbehaviour += other.misbehaviour;
        self.time += other.time;
        self.used += other.used;
    }

    /// Returns the calls of a second.
    fn calls(&self) -> f64 {
        self.calls as f64 / self.time.as_secs_f64()
    }

    /// Returns the calls in a second of the server's processor time, which does not depend on the load of the machine.
    fn calls_for_time_used(&self) -> f64 {
        self.calls as f64 / self.used.as_secs_f64()
    }

    fn misbehaviour(&self) -> f64 {
        self.misbehaviour as f64 / self.time.as_secs_f64()
    }
}

/// A line of the table.
struct Row {
    alone: Window,
    together: Window,
    state: State,
}

/// Measures the cost of silent connections.
fn idle(server: &mut Server, wishes: Wishes, verdict: &mut Verdict) {
    let connections = work::silent(server.addresses(), wishes.clients);
    let time = (wishes.time / 12).max(Duration::from_secs(2));
    let (before, begun) = (server.process().processor_time(), Instant::now());
    std::thread::sleep(time);
    let Some(used) = server.process().processor_time().zip(before).map(|(after, before)| after - before) else {
        return println!("the server's processor time is not known here: there is no /proc");
    };
    let share = 100.0 * used.as_secs_f64() / begun.elapsed().as_secs_f64();
    let what = format!("{} silent connections cost {share:.2} % of a processor, of {IDLE} % allowed", wishes.clients);
    verdict.check(share < IDLE, &what);
    drop(connections);
}

fn judge(wishes: Wishes, rows: &[Row], begin: &State, end: &State, verdict: &mut Verdict) {
    let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return };
    let (mut alone, mut together) = (Window::default(), Window::default());
    for row in rows {
        alone.add(row.alone);
        together.add(row.together);
    }
    let kept = 100.0 * together.calls() / alone.calls();
    let what =
        format!("with the others the well-behaved clients keep {kept:.0} % of their throughput, {KEPT} % wanted");
    if wishes.time >= ENOUGH {
        verdict.check(kept >= KEPT, &what);
    } else {
        println!("        {what}; not judged by so short a run");
    }
    let share = 100.0 * together.calls_for_time_used() / alone.calls_for_time_used();
    println!("        a second of the server's processor time has {share:.0} % of the calls that it has alone");
    let steady = 100.0 * last.alone.calls() / first.alone.calls();
    println!("        alone they have {steady:.0} % of the first line's throughput in the last");
    println!("        when all have gone: {end}");
    let flat = (begin.handles, begin.peers, begin.tasks) == (end.handles, end.peers, end.tasks);
    verdict.check(flat, "handles, peers and tasks are what they were before");
    match (begin.descriptors, end.descriptors) {
        (Some(before), Some(after)) => verdict.check(before == after, "so are file descriptors"),
        _ => println!("        file descriptors are not known here: there is no /proc"),
    }
    if let (Some(early), Some(late)) = (first.state.memory, last.state.memory) {
        let growth = late.now.saturating_sub(early.now);
        let what = format!("memory has grown by {:.1} MiB since the first line", growth as f64 / f64::from(1 << 20));
        verdict.check(growth < GROWTH, &what);
    }
}
