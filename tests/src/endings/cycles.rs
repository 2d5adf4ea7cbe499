//! Pick and place with passes: short legs at all speeds, on a busy machine.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use bcap_sim::{Config, Controller as Simulated, Profile};
use bcap_std::server::Limits;
use bcap_std::{Error, Motion, Move, Pass, Position, Settings, asynch, blocking};

use super::model::Watched;
use crate::served::Served;

/// The lengths of the legs in mm, and the speeds in percent.
const LEGS: [f64; 4] = [5.0, 10.0, 20.0, 50.0];
const SPEEDS: [f64; 5] = [5.0, 10.0, 25.0, 50.0, 100.0];
const LIMIT: Duration = Duration::from_secs(120);

/// The result of the cycles of one leg and speed.
struct Counts {
    leg: f64,
    speed: f64,
    is_async: bool,
    cycles: usize,
    /// Cycles that did not end with `Arrived`, or did while the robot was not at rest at the place.
    wrong: Vec<String>,
}

/// Runs `cycles` cycles for each speed and each of the first `legs` lengths with both libraries, and prints the table. Returns
/// whether all outcomes are true.
#[must_use]
pub fn pick_and_place(cycles: usize, legs: usize) -> bool {
    let jobs: Vec<_> = LEGS.iter().take(legs).flat_map(|leg| SPEEDS.map(|speed| (*leg, speed))).collect();
    let jobs: Vec<_> = jobs.into_iter().flat_map(|(leg, speed)| [(leg, speed, false), (leg, speed, true)]).collect();
    let (next, busy) = (AtomicUsize::new(0), AtomicBool::new(true));
    let parallel = thread::available_parallelism().map_or(1, usize::from);
    let mut counts: Vec<Counts> = thread::scope(|scope| {
        for _ in 0..parallel {
            // the machine is busy
            scope.spawn(|| {
                while busy.load(Ordering::Relaxed) {
                    std::hint::spin_loop()
                }
            });
        }
        let workers: Vec<_> = (0..jobs.len().min(10))
            .map(|_| {
                scope.spawn(|| {
                    let mut counts = Vec::new();
                    while let Some((leg, speed, is_async)) = jobs.get(next.fetch_add(1, Ordering::SeqCst)) {
                        counts.push(run(*leg, *speed, *is_async, cycles));
                    }
                    counts
                })
            })
            .collect();
        let counts = workers.into_iter().flat_map(|worker| worker.join().unwrap_or_default()).collect();
        busy.store(false, Ordering::Relaxed);
        counts
    });
    counts.sort_by(|a, b| (a.leg, a.speed).partial_cmp(&(b.leg, b.speed)).unwrap_or(std::cmp::Ordering::Equal));
    let lost = counts.iter().map(|count| count.cycles).sum::<usize>() != cycles * jobs.len();
    let wrong: usize = counts.iter().map(|count| count.wrong.len()).sum();
    println!("leg mm  speed %  library   cycles  false outcomes");
    for Counts { leg, speed, is_async, cycles, wrong } in &counts {
        let library = if *is_async { "tokio" } else { "blocking" };
        println!(
            "{leg:6}  {speed:7}  {library:8}  {cycles:6}  {:14}  {}",
            wrong.len(),
            wrong.first().map_or("", |text| text)
        );
    }
    println!("{} cycles, {wrong} false outcomes", counts.iter().map(|count| count.cycles).sum::<usize>());
    wrong == 0 && !lost
}

fn run(leg: f64, speed: f64, is_async: bool, cycles: usize) -> Counts {
    let config = Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) };
    let sim = Served::of(Watched::new(Simulated::new(config)), Limits::default());
    let mut wrong = Vec::new();
    let mut judge = |ended: Result<Motion, Error>| {
        let truth = sim.application().truth();
        match ended {
            Ok(Motion::Arrived) if truth.there && !truth.moving => {}
            ended => wrong.push(format!("{ended:?}, at the place: {}, moving: {}", truth.there, truth.moving)),
        }
    };
    let address = format!("tcp:{}", sim.tcp);
    let made = if is_async {
        match tokio::runtime::Builder::new_current_thread().enable_all().build() {
            Ok(runtime) => runtime.block_on(run_async(&address, leg, speed, cycles, &mut judge)),
            Err(error) => unreachable!("no runtime: {error}"),
        }
    } else {
        run_blocking(&address, leg, speed, cycles, &mut judge)
    };
    if let Err(error) = made {
        wrong.push(error.to_string());
    }
    Counts { leg, speed, is_async, cycles, wrong }
}

/// Returns the motions of a cycle: down, up, across with a pass, down, up and back.
fn motions(home: [f64; 7], leg: f64, speed: f64) -> [Move; 6] {
    let [x, y, z, rx, ry, rz, figure] = home;
    let to = |dx: f64, dz: f64, pass| {
        let position = Position::new([x + dx, y, z + dz], [rx, ry, rz]).figure(figure as i32);
        Move::line(position).speed_percent(speed).pass(pass)
    };
    [
        to(0.0, -leg, Pass::Exact),
        to(0.0, 0.0, Pass::Near),
        to(leg, 0.0, Pass::Near),
        to(leg, -leg, Pass::Exact),
        to(leg, 0.0, Pass::Near),
        to(0.0, 0.0, Pass::Exact),
    ]
}

fn run_blocking(
    address: &str,
    leg: f64,
    speed: f64,
    cycles: usize,
    judge: &mut dyn FnMut(Result<Motion, Error>),
) -> Result<(), Error> {
    let mut cell = blocking::Controller::connect(address, &Settings::rc8())?;
    let mut arm = cell.robot()?.take_arm()?;
    arm.motor_on()?;
    let home = arm.robot().position()?.to_array();
    for _ in 0..cycles {
        let [down, up, across, down2, up2, back] = motions(home, leg, speed);
        let cycle = |arm: &mut blocking::Arm<'_>| {
            if arm.move_to(&down, LIMIT)? != Motion::Arrived {
                return Ok(Motion::Halted);
            }
            let placed = arm.start(&up, LIMIT)?.then(&across)?.then(&down2)?.wait()?;
            if placed != Motion::Arrived {
                return Ok(placed);
            }
            arm.start(&up2, LIMIT)?.then(&back)?.wait()
        };
        judge(cycle(&mut arm));
    }
    Ok(())
}

async fn run_async(
    address: &str,
    leg: f64,
    speed: f64,
    cycles: usize,
    judge: &mut dyn FnMut(Result<Motion, Error>),
) -> Result<(), Error> {
    let cell = asynch::Controller::connect(address, &Settings::rc8()).await?;
    let mut arm = cell.robot().await?.take_arm().await?;
    arm.motor_on().await?;
    let home = arm.robot().position().await?.to_array();
    for _ in 0..cycles {
        let [down, up, across, down2, up2, back] = motions(home, leg, speed);
        let cycle = async {
            if arm.move_to(&down, LIMIT).await? != Motion::Arrived {
                return Ok(Motion::Halted);
            }
            let placed = arm.start(&up, LIMIT).await?.then(&across).await?.then(&down2).await?.wait().await?;
            if placed != Motion::Arrived {
                return Ok(placed);
            }
            arm.start(&up2, LIMIT).await?.then(&back).await?.wait().await
        };
        judge(cycle.await);
    }
    drop(arm);
    cell.close().await
}
