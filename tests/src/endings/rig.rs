//! Runs a trial: a virtual controller in this process, a link, the program in another process, and the ending.

use std::io::{BufRead, BufReader, Read, Write as _};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_core::position::Position;
use bcap_sim::{Config, Controller as Simulated, Profile, Scenario};
use bcap_std::server::Limits;
use bcap_std::{Error, blocking, now};
use rustix::process::{Pid, WaitId, WaitIdOptions, kill_process, waitid};

use super::draw::{Ending, Job, Leg, Program, Signal, Since, Trial, Way};
use super::model::{Marks, Truth, Watched};
use super::victim::{self, Script};
use crate::proxy::{Cut, Relay};
use crate::served::Served;

/// Maximum run time of a program, after which it counts as hanging.
const LIMIT: Duration = Duration::from_secs(40);
/// The time after which the robot must be at rest.
const GRACE: Duration = Duration::from_secs(1);
const POLL: Duration = Duration::from_millis(1);

/// The programs of all trials.
#[derive(Clone, Debug)]
pub(super) struct Tools {
    /// The program that runs [`victim::run_if_asked`].
    pub(super) victim: PathBuf,
    /// The command `bcap`, if it takes part.
    pub(super) bcap: Option<PathBuf>,
    /// Whether `bcap move` asks for confirmation, because it runs without `--yes`.
    pub(super) asks: bool,
    /// Whether the output of the program is printed.
    pub(super) verbose: bool,
}

impl Tools {
    /// Returns the tools; this program is the victim.
    ///
    /// # Errors
    ///
    /// The path of this program is unknown, or `bcap` does not run.
    pub(super) fn new(bcap: Option<PathBuf>) -> std::io::Result<Self> {
        let help = bcap.as_ref().map(|bcap| Command::new(bcap).args(["move", "--help"]).output()).transpose()?;
        let asks = help.is_some_and(|help| String::from_utf8_lossy(&help.stdout).contains("--yes"));
        Ok(Self { victim: std::env::current_exe()?, bcap, asks, verbose: false })
    }
}

/// The report of a program, and the truth at that time.
#[derive(Clone, Debug)]
pub(super) struct Report {
    /// `arrived`, `halted`, `failed`, `timed-out`, `unknown` or `error ...`.
    pub(super) outcome: String,
    /// The truth at that time.
    pub(super) truth: Truth,
}

/// The observations of a trial.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    /// The report of the program.
    pub(super) report: Option<Report>,
    /// The truth one second after a signal that stops the process.
    pub(super) stopped: Option<Truth>,
    /// The truth one second after the end of the program.
    pub(super) last: Truth,
    /// Whether an external event caused the ending while the program ran.
    pub(super) disturbed: bool,
    /// Whether the program did not end.
    pub(super) hangs: bool,
}

type Sim = Arc<Served<Watched>>;
type Reports = Arc<Mutex<Option<Report>>>;

/// Runs a trial.
///
/// # Errors
///
/// The trial could not be set up.
pub(super) fn run(trial: &Trial, tools: &Tools) -> Result<Seen, Box<dyn std::error::Error>> {
    let config = config(trial);
    let sim: Sim = Arc::new(Served::of(Watched::new(Simulated::new(config.clone())), Limits::default()));
    set_up(trial, &sim)?;
    let link = Relay::start(sim.tcp, sim.udp);
    let direct = format!("tcp:{}", sim.tcp);
    let second = (trial.ending == Ending::SecondClient)
        .then(|| blocking::Controller::connect(&direct, &victim::settings(trial)).and_then(|cell| cell.stopper()))
        .transpose()?;
    let mut process = Process::start(trial, tools, &link, &sim)?;
    let marks = sim.application().marks();
    let mut stopped = None;
    let disturbed = !trial.ending.is_inside() && process.wait_for_time(trial, &marks);
    if disturbed {
        match trial.ending {
            Ending::SecondClient => drop(second.as_ref().map(blocking::Stopper::halt)),
            Ending::Signal(signal) => stopped = process.signal(signal, &sim),
            ending => disturb(ending, trial, &sim, &link, &config),
        }
    }
    let hangs = process.wait().is_none();
    let report = process.report();
    thread::sleep(GRACE);
    let last = sim.application().truth();
    Ok(Seen { report, stopped, last, disturbed, hangs })
}

fn config(trial: &Trial) -> Config {
    Config { motor_on_delay: Duration::from_millis(trial.motor_ms), ..Config::new(trial.profile()) }
}

/// The joints of the home position with the wrist turned over: only the figure differs.
const TURNED: [f64; 6] = [0.0, 45.0, 90.0, 180.0, -45.0, 180.0];

/// Prepares the arm, sets the destinations P10, P11 and J10, and plays the faults.
fn set_up(trial: &Trial, sim: &Sim) -> Result<(), Error> {
    let address = format!("tcp:{}", sim.tcp);
    let mut cell = blocking::Controller::connect(&address, &victim::settings(trial))?;
    if trial.profile() == Profile::Cobotta {
        for command in ["ManualResetPreparation", "MotionPreparation"] {
            cell.robot()?.execute::<()>(command, ())?;
        }
    }
    let mut position = cell.robot()?.position()?.to_array().map(|number| number as f32);
    // 5 to 50 mm away, the same for the same trial
    let part = |shift: u64| (trial.number.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> shift) as u8 as f32 / 255.0;
    let length = 5.0 + 45.0 * part(8);
    let angle = part(16) * std::f32::consts::TAU;
    (position[0], position[1]) = (position[0] + length * angle.cos() * 0.8, position[1] + length * angle.sin() * 0.8);
    position[2] -= length * 0.6 * part(24);
    cell.write("P10", position)?;
    let mut turned = position;
    // the wrist of a COBOTTA does not turn that far
    if trial.profile() != Profile::Cobotta {
        let joints = TURNED.map(|angle| angle.to_string()).join(", ");
        let there = cell.robot()?.execute::<Position>("J2P", format!("J({joints})"))?;
        turned = there.to_array().map(|number| number as f32);
    }
    cell.write("P11", turned)?;
    cell.write("J10", [part(32) * 25.0, 45.0 - part(40) * 20.0, 90.0, 0.0, 45.0 + part(48) * 25.0, 0.0, 0.0, 0.0_f32])?;
    cell.close()?;
    let motor = if trial.motor_before { "[controller]\nmotor = true\n" } else { "" };
    let delays = ["Robot_Move", "DriveEx", "Approach", "Depart"].map(|name| {
        let delay = trial.delay_ms;
        format!("[[fault]]\nwhen = {{ every = 1, of = \"{name}\" }}\nthen = {{ delay_ms = {delay} }}\n")
    });
    let text = if trial.delay_ms > 0 { motor.to_owned() + &delays.concat() } else { motor.to_owned() };
    match Scenario::parse(&text) {
        Ok(scenario) => sim.application().sim.play(scenario),
        Err(error) => unreachable!("{error}: {text}"),
    }
    let mut application = sim.application();
    // where a stream ends: the command's cosine is back at its start
    if let Job::Stream { degrees, .. } = trial.job {
        let mut end = application.sim.axes();
        end[0] += if trial.program == Program::Slave { 0.0 } else { degrees };
        application.destination = Some(end);
    }
    Ok(())
}

/// Ends the trial from outside the program.
fn disturb(ending: Ending, trial: &Trial, sim: &Sim, link: &Relay, config: &Config) {
    match ending {
        Ending::EmergencyStop => {
            let mut application = sim.application();
            application.sim.advance(now());
            application.stop();
            application.sim.emergency_stop(true, now());
        }
        Ending::Error(code) => {
            let mut application = sim.application();
            application.sim.advance(now());
            application.stop();
            application.sim.inject_error(HResult(code.cast_signed()), now());
        }
        Ending::Killed { reset } => {
            link.cut(Cut::Reset);
            let mut application = sim.application();
            application.stop();
            if reset {
                application.sim = Simulated::new(config.clone());
                application.sim.advance(now());
            }
        }
        Ending::Cut(cut) => link.cut(cut),
        _ => {}
    }
    if matches!(ending, Ending::Killed { .. } | Ending::Cut(_)) {
        thread::sleep(Duration::from_millis(trial.heal_ms));
        link.heal();
    }
}

/// The process of a trial.
struct Process {
    child: Child,
    reports: Reports,
    begun: Arc<std::sync::atomic::AtomicBool>,
    readers: Vec<JoinHandle<()>>,
    is_slave: bool,
    sim: Sim,
    started: Instant,
}

impl Process {
    fn start(trial: &Trial, tools: &Tools, link: &Relay, sim: &Sim) -> std::io::Result<Self> {
        let address = if trial.udp { format!("udp:{}", link.udp) } else { format!("tcp:{}", link.tcp) };
        let (mut command, input) = match &tools.bcap {
            Some(bcap) if trial.program.is_command() => bcap_command(bcap, trial, tools, &address),
            _ => {
                let mut command = Command::new(&tools.victim);
                let script = Script { address, trial: trial.clone() };
                let script = serde_json::to_string(&script).map_err(std::io::Error::other)?;
                command.args([victim::ARGUMENT, &script]);
                (command, None)
            }
        };
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        if let (Some(stdin), Some(text)) = (&mut child.stdin, input) {
            // a process that has ended reads nothing
            let _ = stdin.write_all(text.as_bytes());
        }
        drop(child.stdin.take());
        let begun = Arc::new(std::sync::atomic::AtomicBool::new(trial.program.is_command()));
        let reports = Reports::default();
        let outputs: [Option<Box<dyn Read + Send>>; 2] = [
            child.stdout.take().map(|output| Box::new(output) as Box<_>),
            child.stderr.take().map(|output| Box::new(output) as Box<_>),
        ];
        let readers = outputs.into_iter().flatten().map(|output| {
            let (reports, begun, sim, verbose) =
                (Arc::clone(&reports), Arc::clone(&begun), Arc::clone(sim), tools.verbose);
            thread::spawn(move || read(output, &reports, &begun, &sim, verbose))
        });
        let readers = readers.collect();
        let (is_slave, sim, started) = (trial.program == Program::Slave, Arc::clone(sim), Instant::now());
        Ok(Self { child, reports, begun, readers, is_slave, sim, started })
    }

    fn has_ended(&mut self) -> bool {
        !matches!(self.child.try_wait(), Ok(None))
    }

    /// Waits for the time of the ending; returns whether the process still runs.
    fn wait_for_time(&mut self, trial: &Trial, marks: &Marks) -> bool {
        let until = Instant::now() + Duration::from_secs(4);
        let begun = |since| match since {
            Since::Start => self.begun.load(Ordering::SeqCst),
            Since::Motion => marks.motion.load(Ordering::SeqCst),
        };
        while !begun(trial.since) && Instant::now() < until && !matches!(self.child.try_wait(), Ok(Some(_))) {
            thread::sleep(POLL);
        }
        let until = Instant::now() + trial.at();
        while Instant::now() < until {
            if self.has_ended() {
                return false;
            }
            thread::sleep(POLL.min(until.saturating_duration_since(Instant::now())));
        }
        !self.has_ended()
    }

    /// Sends a signal. After a signal that suspends the process, waits a second and until the process is suspended, which may
    /// be after a late reply; returns the truth then, and lets it continue. `None` for a process that continues to its end: the
    /// signal arrived before its handler was installed, and the system then ignores it if no shell could continue the process.
    fn signal(&mut self, signal: Signal, sim: &Sim) -> Option<Truth> {
        let pid = Pid::from_child(&self.child);
        let send = |signal| {
            // a process that has ended gets no signal
            let _ = kill_process(pid, signal);
        };
        match signal {
            Signal::Int => send(rustix::process::Signal::INT),
            Signal::Term => send(rustix::process::Signal::TERM),
            Signal::Hup => send(rustix::process::Signal::HUP),
            Signal::Kill => send(rustix::process::Signal::KILL),
            Signal::Tstp => {
                send(rustix::process::Signal::TSTP);
                thread::sleep(GRACE);
                let moving = sim.application().truth().moving;
                while self.is_running() && self.started.elapsed() < LIMIT {
                    thread::sleep(POLL);
                }
                if self.has_ended() {
                    return None;
                }
                let truth = sim.application().truth();
                send(rustix::process::Signal::CONT);
                return Some(Truth { moving: moving || truth.moving, ..truth });
            }
        }
        None
    }

    /// Returns whether it is neither suspended nor has ended.
    fn is_running(&self) -> bool {
        let states = WaitIdOptions::STOPPED | WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        matches!(waitid(WaitId::Pid(Pid::from_child(&self.child)), states), Ok(None))
    }

    /// Waits for the end; kills a process that hangs.
    fn wait(&mut self) -> Option<ExitStatus> {
        let status = loop {
            match self.child.try_wait() {
                Ok(Some(status)) => break Some(status),
                Ok(None) if self.started.elapsed() < LIMIT => thread::sleep(POLL),
                _ => break None,
            }
        };
        if status.is_none() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
        if self.is_slave && status.is_some_and(|status| status.success()) {
            record(&self.reports, "arrived", &self.sim);
        }
        for reader in self.readers.drain(..) {
            let _ = reader.join();
        }
        status
    }

    fn report(&self) -> Option<Report> {
        self.reports.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Reads the output of a program.
fn read(
    output: Box<dyn Read + Send>,
    reports: &Reports,
    begun: &std::sync::atomic::AtomicBool,
    sim: &Sim,
    verbose: bool,
) {
    for line in BufReader::new(output).lines().map_while(Result::ok) {
        if verbose {
            println!("    | {line}");
        }
        if line == "go" {
            begun.store(true, Ordering::SeqCst);
        } else if let Some(outcome) = line.strip_prefix("outcome ") {
            record(reports, outcome, sim);
        } else if line.starts_with("at ") {
            record(reports, "arrived", sim);
        } else if line.contains("not at") && line.contains("the robot was halted") && !line.contains("--within") {
            record(reports, "halted", sim);
        }
    }
}

fn record(reports: &Reports, outcome: &str, sim: &Sim) {
    let truth = sim.application().truth();
    *reports.lock().unwrap_or_else(PoisonError::into_inner) = Some(Report { outcome: outcome.into(), truth });
}

/// Returns the command with its arguments, and its standard input.
fn bcap_command(bcap: &PathBuf, trial: &Trial, tools: &Tools, address: &str) -> (Command, Option<String>) {
    let mut command = Command::new(bcap);
    let yes: &[&str] = if tools.asks { &["--yes"] } else { &[] };
    let (mut arguments, mut input): (Vec<String>, _) = (Vec::new(), None);
    match (&trial.program, &trial.job) {
        (Program::Slave, Job::Stream { cycles, degrees }) => {
            let seconds = format!("{}", f64::from(*cycles) * 0.008);
            let amplitude = format!("{degrees}");
            let words = ["slave", "cosine", "--seconds", &seconds, "--amplitude", &amplitude, "--yes"];
            arguments.extend(words.map(str::to_owned));
        }
        (Program::Move, Job::Move(leg)) => {
            arguments.push("move".into());
            arguments.extend(target(leg));
            arguments.extend(["--within", "20s"].map(str::to_owned));
            arguments.extend(yes.iter().map(|word| (*word).to_owned()));
        }
        (program, job) => {
            let words = if let Job::Move(leg) = job { target(leg) } else { Vec::new() };
            let words = words.iter().map(|word| if word.contains(' ') { format!("'{word}'") } else { word.clone() });
            let line = words.chain(yes.iter().map(|word| (*word).to_owned())).collect::<Vec<_>>().join(" ");
            input = Some(format!(
                "exec robot TakeArm 0 1\nexec robot Motor 1 0\nmove {line} --within 20s\nexec robot Motor 0 0\nexec robot GiveArm\n"
            ));
            arguments.extend(if *program == Program::Run {
                vec!["run".into(), "-".into()]
            } else {
                vec!["shell".into()]
            });
        }
    }
    arguments.extend(["--robot".into(), address.into()]);
    arguments.extend(["--provider".into(), trial.profile().provider().into()]);
    command.args(arguments);
    (command, input)
}

/// Returns the arguments of `bcap move`.
fn target(leg: &Leg) -> Vec<String> {
    let (line, to) = match &leg.way {
        Way::Line(to) => (true, to.as_str()),
        Way::Joint(to) => (false, to.as_str()),
        _ => (false, "J10"),
    };
    let mut words = vec![to.to_owned(), "--speed".into(), format!("{}", leg.speed)];
    if line {
        words.push("--line".into());
    }
    words
}
