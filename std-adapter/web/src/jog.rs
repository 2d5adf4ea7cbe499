//! Jogging: the thread that moves a robot while a page holds it, and the watch over that thread.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use bcap_live::axis::Axis;
use bcap_live::jog::{self, Grip, Phase, Press};
use tokio::time::{Instant, sleep};

use crate::app::App;
use crate::arm;
use crate::robot::Robot;
use crate::threads::lock;

/// How often the watch looks.
const LOOK: Duration = Duration::from_millis(20);

/// The time in which the jog thread halts a robot by itself. After it the connection of HALT halts the robot.
const IN_TIME: Duration = Duration::from_millis(150);

/// Begins a jog, which takes the arm.
pub(crate) fn start(app: &Arc<App>, robot: &Arc<Robot>, who: String) -> Result<Arc<Grip>, String> {
    let grip = Arc::new(Grip::default());
    let mut last = lock(&robot.grip);
    if last.as_ref().is_some_and(|last| last.phase() != Phase::Ended) {
        return Err("the last jog of this robot has not ended; wait a moment".into());
    }
    let (access, held) = (robot.access.clone(), Arc::clone(&grip));
    let thread = thread::Builder::new().name("jog".into()).spawn(move || jog::run(&access, &held));
    thread.map_err(|error| format!("a thread cannot be started: {error}; nothing was done"))?;
    *last = Some(Arc::clone(&grip));
    drop(last);
    app.audit.write::<()>(&who, &robot.name, "takes the arm for a jog", &Ok(()));
    tokio::spawn(watch(Arc::clone(app), Arc::clone(robot), who, Arc::clone(&grip)));
    Ok(grip)
}

/// Halts the robot over the connection of HALT if the jog thread does not: its connection may hang.
async fn watch(app: Arc<App>, robot: Arc<Robot>, who: String, grip: Arc<Grip>) {
    let (mut since, mut is_halted) = (None, false);
    while grip.phase() != Phase::Ended {
        sleep(LOOK).await;
        if grip.ends().is_none() {
            continue;
        }
        let since = *since.get_or_insert_with(Instant::now);
        // otherwise nothing of this jog moves, and a halt would stop tasks of others
        if grip.phase() == Phase::Moving && since.elapsed() > IN_TIME && !is_halted {
            is_halted = true;
            let outcome = robot.halter.halt().await;
            app.audit.write(&who, &robot.name, "the jog did not halt in time: HALT", &outcome);
        }
    }
    let (why, outcome) = (grip.ends().unwrap_or_default(), grip.outcome().unwrap_or(Err("the jog panicked".into())));
    let what = format!("the jog ends: {why}; {}", outcome.as_deref().unwrap_or("then"));
    app.audit.write(&who, &robot.name, &what, &outcome);
}

/// Checks a step of a page, and limits its speed.
pub(crate) fn press(robot: &Robot, axis: &str, by: f64, percent: f64) -> Result<Press, String> {
    let axis: Axis = axis.parse().map_err(|why| format!("{axis}: {why}"))?;
    let type_name = robot.live().type_name.clone().unwrap_or_default();
    // the request itself must be in the range
    Press::new(axis, by, percent)?;
    Press::new(axis, by, percent.min(arm::percent(&type_name, axis)))
}
