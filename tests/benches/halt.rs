//! The latency of a halt: from `halt()` to the request at the controller, and to the robot at rest; and the outcome that the
//! waiting code gets.
//!
//! `cargo bench -p bcap-tests --bench halt -- TRIALS`, 300 without a number. The last column counts motions that were
//! reported as arrived although the robot rests elsewhere; it must be 0.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::slave::{AxisLimits, Cycle, Format, Mode, Next, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
use bcap_core::time::Instant;
use bcap_sim::{Config, Controller as Simulated, Profile};
use bcap_std::server::Limits;
use bcap_std::{Error, Joints, Motion, Move, Settings, asynch, blocking, now};
use bcap_testkit::network::Random;
use bcap_tests::hooked::Hooked;
use bcap_tests::served::Served;

/// The controller and the measurements.
struct Rig {
    sim: Served<Hooked<Simulated>>,
    /// When Robot_Halt arrived, in microseconds of this process's clock.
    halted: Arc<AtomicU64>,
    arrivals: Vec<Duration>,
    rests: Vec<Duration>,
    told: [usize; 4],
    wrong: usize,
}

impl Rig {
    fn new() -> Self {
        let config = Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) };
        let halted = Arc::<AtomicU64>::default();
        let (mut hooked, arrived) = (Hooked::new(Simulated::new(config)), Arc::clone(&halted));
        hooked.set(move |request| {
            if request.function == FunctionId::ROBOT_HALT {
                // the first halt: the code that waits for a motion may send another
                let _ = arrived.compare_exchange(0, now().as_micros(), Ordering::SeqCst, Ordering::SeqCst);
            }
            None
        });
        let sim = Served::of(hooked, Limits::default());
        Self { sim, halted, arrivals: Vec::new(), rests: Vec::new(), told: [0; 4], wrong: 0 }
    }

    fn address(&self) -> String {
        format!("tcp:{}", self.sim.tcp)
    }

    fn is_moving(&self) -> bool {
        let mut hooked = self.sim.application();
        hooked.inner.advance(now());
        hooked.inner.is_moving()
    }

    fn joint(&self) -> f64 {
        self.sim.application().inner.joints()[0]
    }

    /// Begins a trial.
    fn begin(&self) {
        self.halted.store(0, Ordering::SeqCst);
    }

    /// Waits until the robot rests after a halt that was requested at `asked`, and records both delays.
    fn record(&mut self, asked: Instant) {
        let arrived = Instant::from_micros(self.halted.swap(0, Ordering::SeqCst));
        while self.is_moving() {
            std::thread::sleep(Duration::from_micros(200));
        }
        if arrived > asked {
            self.arrivals.push(arrived.saturating_since(asked));
            self.rests.push(now().saturating_since(asked));
        }
    }

    /// Counts the outcomes that the waiting code got: arrived, halted, an error, or no outcome because it had stopped waiting.
    fn told(&mut self, told: Option<Result<Motion, Error>>, target: f64) {
        let off = (self.joint() - target).abs() > 0.05;
        let kind = match told {
            Some(Ok(Motion::Arrived)) => 0,
            Some(Ok(_)) => 1,
            Some(Err(_)) => 2,
            None => 3,
        };
        self.told[kind] += 1;
        self.wrong += usize::from(kind == 0 && off);
    }

    fn report(mut self, name: &str) {
        let [arrived, halted, failed, dropped] = self.told;
        let quantile = |list: &mut Vec<Duration>, part: usize| {
            list.sort_unstable();
            list.get(list.len().saturating_sub(1) * part / 100).copied().unwrap_or_default().as_secs_f64() * 1e3
        };
        println!(
            "{name:>24}  {:7.2} {:7.2} {:7.2}  {:8.1} {:8.1}  {arrived:6} {halted:6} {failed:6} {dropped:6}  {:5}",
            quantile(&mut self.arrivals, 50),
            quantile(&mut self.arrivals, 99),
            quantile(&mut self.arrivals, 100),
            quantile(&mut self.rests, 50),
            quantile(&mut self.rests, 99),
            self.wrong,
        );
    }
}

const LIMIT: Duration = Duration::from_secs(30);

fn to(degrees: f64) -> Move {
    Move::joint(Joints::new([degrees, 45.0, 90.0, 0.0, 45.0, 0.0]))
}

/// The target of a trial: there and back.
fn target(trial: u32) -> f64 {
    if trial.is_multiple_of(2) { 10.0 } else { 0.0 }
}

fn blocking_move(trials: u32) {
    let mut rig = Rig::new();
    let mut cell = blocking::Controller::connect(&rig.address(), &Settings::rc8()).unwrap();
    let stopper = cell.stopper().unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let mut random = Random(1);
    for trial in 0..trials {
        rig.begin();
        let delay = Duration::from_micros(random.below(250_000));
        let (ended, asked) = std::thread::scope(|scope| {
            let stopper = &stopper;
            let halt = scope.spawn(move || {
                std::thread::sleep(delay);
                let asked = now();
                stopper.halt().map(|_| asked).unwrap()
            });
            (arm.move_to(&to(target(trial)), LIMIT), halt.join().unwrap())
        });
        rig.record(asked);
        rig.told(Some(ended), target(trial));
    }
    drop(arm);
    drop(cell);
    rig.report("blocking, stopper");
}

async fn dropped_move(trials: u32) {
    let mut rig = Rig::new();
    let cell = asynch::Controller::connect(&rig.address(), &Settings::rc8()).await.unwrap();
    let mut arm = cell.robot().await.unwrap().take_arm().await.unwrap();
    arm.motor_on().await.unwrap();
    let mut random = Random(2);
    for trial in 0..trials {
        rig.begin();
        let delay = Duration::from_micros(random.below(250_000));
        let ended = tokio::select! {
            ended = arm.move_to(&to(target(trial)), LIMIT) => Some(ended),
            () = tokio::time::sleep(delay) => None,
        };
        let asked = now();
        // the task sends the halt before it makes this call
        arm.robot().joints().await.unwrap();
        rig.record(asked);
        rig.told(ended, target(trial));
    }
    drop(arm);
    cell.close().await.unwrap();
    rig.report("tokio, dropped future");
}

fn slave_mode(trials: u32) {
    let mut rig = Rig::new();
    let mut cell = blocking::Controller::connect(&rig.address(), &Settings::rc8()).unwrap();
    let stopper = cell.stopper().unwrap();
    let mut random = Random(3);
    for _ in 0..trials {
        let mut arm = cell.robot().unwrap().take_arm().unwrap();
        arm.motor_on().unwrap();
        let begun = rig.joint();
        rig.begin();
        let delay = Duration::from_micros(100_000 + random.below(300_000));
        let mode = SlaveMode { mode: Mode::Mode0, pose: PoseType::J };
        let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
        let mut swing = |cycle: &Cycle<'_>| {
            let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
            let part = f64::from(cycle.number + 1) / 200.0;
            joints[0] += 2.0 * (1.0 - (part * std::f64::consts::TAU).cos());
            if cycle.number < 200 { Next::Pose(Pose::j(joints)) } else { Next::Finish }
        };
        let (ended, asked) = std::thread::scope(|scope| {
            let stopper = &stopper;
            let halt = scope.spawn(move || {
                std::thread::sleep(delay);
                let asked = now();
                stopper.halt().map(|_| asked).unwrap_or(asked)
            });
            let ended = arm.stream(format, AxisLimits::uniform(200.0, 2000.0), &mut swing);
            (ended, halt.join().unwrap())
        });
        rig.record(asked);
        // a stream that ends with success is back where it began
        rig.told(Some(ended.map(|_| Motion::Arrived)), begun);
        drop(arm);
        // the halt ended Slave Mode with an error of the controller
        cell.execute::<()>("ClearError", ()).unwrap();
    }
    drop(cell);
    rig.report("Slave Mode, stopper");
}

fn main() {
    let trials = std::env::args().filter_map(|text| text.parse().ok()).next().unwrap_or(300);
    println!("{trials} trials each; times in ms from halt() or from the drop of the future");
    println!(
        "{:>24}  {:>23}  {:>17}  {:>27}  wrong",
        "", "request p50, p99, max", "rest p50, p99", "arrived halted failed dropped"
    );
    blocking_move(trials);
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(dropped_move(trials));
    slave_mode(trials.div_ceil(4));
}
