//! Known attacks on peers of these protocols, as named cases against this project's clients and servers.
//!
//! ```text
//!   this process                                        a separate process
//!   cases: raw bytes, real clients ── TCP UDP RAC ──►   the server with a small application
//!   bystanders: a client of each link, held open ──►
//! ```
//!
//! A case asserts the answers of the server (or the behaviour of the attacked client) and the state of the connection. After
//! each case, the server must answer the bystanders and a new client of each link, and must hold no handle or file
//! descriptor of the case. At the end neither process may have grown by 10 MiB. Each group of cases has two processes of its
//! own; the groups run at the same time, because most cases wait.
//!
//! `cargo test -p bcap-tests --test hostile NAME` runs the cases whose names contain NAME; `--list` names them.

mod arguments;
mod attacks;
mod clients;
mod connections;
mod datagram_clients;
mod datagrams;
mod frames;
mod lines;
mod rac_clients;
mod script;
mod serial;
mod target;
mod wire;

use std::process::{Command, ExitCode, Output};
use std::sync::{Arc, Mutex, PoisonError};

use bcap_tests::process::{Memory, Process};
use libtest_mimic::{Arguments, Trial};

use crate::target::Target;

/// Maximum growth of a process over a group.
const GROWTH: u64 = 10 << 20;

/// A case of a group.
type Case = (&'static str, fn(&mut Target));

/// Names cases by their functions, in the module that is named first.
macro_rules! cases {
    ($module:ident: $($name:ident)+) => {
        &[$((concat!(stringify!($module), "::", stringify!($name)), $name as fn(&mut $crate::Target)),)+]
    };
}
pub(crate) use cases;

const GROUPS: [&[Case]; 11] = [
    frames::CASES,
    arguments::CASES,
    connections::CASES,
    connections::UNFINISHED,
    datagrams::CASES,
    lines::CASES,
    serial::CASES,
    clients::CASES,
    datagram_clients::CASES,
    rac_clients::CASES,
    attacks::CASES,
];

/// The variable with the number of the group that a process runs.
const GROUP: &str = "BCAP_HOSTILE_GROUP";

fn main() -> ExitCode {
    if std::env::args().nth(1).as_deref() == Some(target::SERVE) {
        target::serve();
        return ExitCode::SUCCESS;
    }
    // in sequence: the cases share the server, and its memory is measured
    let arguments = Arguments { test_threads: Some(1), ..Arguments::from_args() };
    if arguments.list {
        let none = Arc::new(Mutex::new(None));
        libtest_mimic::run(&arguments, GROUPS.iter().flat_map(|group| trials(group, &none)).collect()).exit();
    }
    let group = std::env::var(GROUP).ok().and_then(|number| GROUPS.get(number.parse::<usize>().ok()?));
    if group.map_or_else(|| run_groups(&arguments), |group| run(group, &arguments)) {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(101)
    }
}

/// Runs this program once for each group that has chosen cases, all at the same time; returns whether all succeeded.
fn run_groups(arguments: &Arguments) -> bool {
    let is_chosen = |case: &Case| {
        arguments
            .filter
            .as_ref()
            .is_none_or(|filter| if arguments.exact { case.0 == filter } else { case.0.contains(filter.as_str()) })
    };
    let chosen = (0..GROUPS.len()).filter(|group| GROUPS[*group].iter().any(is_chosen));
    let running: Vec<_> = chosen.map(|group| std::thread::spawn(move || again(group))).collect();
    let mut is_good = true;
    for group in running {
        let output = group.join().expect("a group of cases ran");
        print!("{}", String::from_utf8_lossy(&output.stdout));
        eprint!("{}", String::from_utf8_lossy(&output.stderr));
        is_good &= output.status.success();
    }
    is_good
}

/// Runs the chosen cases of a group; returns whether all succeeded.
fn run(group: &'static [Case], arguments: &Arguments) -> bool {
    let target = Arc::new(Mutex::new(Some(Target::start())));
    let before = memory(&target);
    let conclusion = libtest_mimic::run(arguments, trials(group, &target));
    let after = memory(&target);
    let stopped = target.lock().unwrap_or_else(PoisonError::into_inner).take().is_some_and(Target::stop);
    println!("{} hostile cases; after each the server was alive and the others were served", conclusion.num_passed);
    let mut is_good = !conclusion.has_failed() && stopped;
    for ((name, before), (_, after)) in before.into_iter().zip(after) {
        let (Some(before), Some(after)) = (before, after) else {
            println!("the memory of {name} is not known here: there is no /proc");
            continue;
        };
        let (growth, mib) = (after.now.saturating_sub(before.now), |bytes: u64| bytes as f64 / f64::from(1 << 20));
        println!(
            "memory of {name}: {:.1} MiB before, {:.1} MiB after, {:.1} MiB at most",
            mib(before.now),
            mib(after.now),
            mib(after.most)
        );
        if growth >= GROWTH {
            println!("FAILED: it has grown by {:.1} MiB", mib(growth));
            is_good = false;
        }
    }
    is_good
}

/// The variable that makes glibc release memory as soon as it is free.
///
/// By default glibc keeps the memory of large requests, which hides how much is still in use.
const THRESHOLD: &str = "MALLOC_MMAP_THRESHOLD_";

/// Runs this program again for a group, with that variable set.
fn again(group: usize) -> Output {
    let program = std::env::current_exe().expect("this program has a file");
    let mut command = Command::new(program);
    command.args(std::env::args_os().skip(1)).env(THRESHOLD, "65536").env("MALLOC_ARENA_MAX", "1");
    command.env(GROUP, group.to_string()).output().expect("this program starts")
}

/// Returns the cases of a group as tests.
fn trials(group: &'static [Case], target: &Arc<Mutex<Option<Target>>>) -> Vec<Trial> {
    let test = |&(name, case): &Case| {
        let target = Arc::clone(target);
        Trial::test(name, move || {
            let mut target = target.lock().unwrap_or_else(PoisonError::into_inner);
            let target = target.as_mut().ok_or("the server has stopped")?;
            case(target);
            target.is_unharmed();
            Ok(())
        })
    };
    group.iter().map(test).collect()
}

/// Returns the memory of the two processes.
fn memory(target: &Mutex<Option<Target>>) -> [(&'static str, Option<Memory>); 2] {
    let target = target.lock().unwrap_or_else(PoisonError::into_inner);
    let server = target.as_ref().and_then(|target| target.process().memory());
    [("the server", server), ("the clients", Process::this().memory())]
}
