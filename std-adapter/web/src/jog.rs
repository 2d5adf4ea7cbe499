//! The jog of a page: the thread that moves a robot while the page holds it, and the watch over that thread.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bcap_live::axis::Axis;
use bcap_live::jog::{self, Grip, Phase, Press};
use serde_json::Value;
use tokio::time::{Instant, sleep};

use crate::app::App;
use crate::arm;
use crate::halt::AT_REST;
use crate::robot::{AGAIN, HALTS, Robot};
use crate::socket::{Answer, Page};
use crate::text::safe;
use crate::threads::lock;

/// Interval of the checks of the watch.
const LOOK: Duration = Duration::from_millis(20);

/// The time in which the jog thread must halt the robot. After that the connection of HALT halts it.
const IN_TIME: Duration = Duration::from_millis(150);

impl Page {
    /// Begins a jog, which takes the arm, and returns its number. `name` is the robot's name in the question.
    pub(crate) fn take_grip(&self, number: usize, name: &str, revoked: u64) -> Answer {
        let (who, robot) = self.mover(number)?;
        robot.check_name(name)?;
        self.end_motion("a jog begins");
        let grip = Arc::new(Grip::default());
        let mut last = lock(&robot.grip);
        // under the lock: a HALT after this check ends this jog
        robot.check_since(revoked)?;
        if last.as_ref().is_some_and(|last| last.phase() != Phase::Ended) {
            return Err("the last jog of this robot has not ended; wait a moment".into());
        }
        let (access, running) = (robot.access.clone(), Arc::clone(&grip));
        self.app.spawn("jog", move || jog::run(&access, &running))?;
        *last = Some(Arc::clone(&grip));
        let jog = robot.jogs.fetch_add(1, Ordering::Relaxed) + 1;
        drop(last);
        lock(&self.motions).grip = Some((number, Arc::clone(&grip)));
        let begun = self.audited(&who, &robot, "begins a jog", Ok(jog));
        self.app.work.spawn(watch(Arc::clone(&self.app), robot, who, grip));
        begun
    }

    /// Returns the jog of this page.
    fn grip(&self, number: usize) -> Result<Arc<Grip>, String> {
        let grip = lock(&self.motions).grip.clone().filter(|(robot, _)| *robot == number).map(|(_, grip)| grip);
        grip.ok_or_else(|| "the jog has ended; begin it again".into())
    }

    /// Makes steps while a button is held, and limits their speed. `number_of_press` is the number that heartbeats repeat.
    pub(crate) fn press(&self, number: usize, axis: &str, by: f64, percent: f64, number_of_press: u64) -> Answer {
        let (_, robot) = self.mover(number)?;
        let axis: Axis = axis.parse().map_err(|why| format!("{axis}: {why}"))?;
        let type_name = robot.live().type_name.clone().unwrap_or_default();
        // the request itself must be in the range
        Press::new(axis, by, percent)?;
        let press = Press::new(axis, by, percent.min(arm::percent(&type_name, axis)))?;
        let grip = self.grip(number)?;
        lock(&self.motions).press = number_of_press;
        grip.press(press).map(|()| Value::Null)
    }

    /// Ends a press of a button.
    pub(crate) fn lift(&self, number: usize) -> Answer {
        let steps = self.grip(number)?.lift();
        let (who, robot) = self.mover(number)?;
        self.audited(&who, &robot, &format!("jogged by {steps} steps"), Ok(steps))
    }

    /// Ends the jog.
    pub(crate) fn drop_grip(&self, number: usize, why: &str) -> Answer {
        self.grip(number)?.end(&safe(why));
        Ok(Value::Null)
    }
}

/// Halts the robot over the connection of HALT if the jog thread does not: its connection may hang.
async fn watch(app: Arc<App>, robot: Arc<Robot>, who: String, grip: Arc<Grip>) {
    let (mut since, mut halts) = (None, 0);
    while grip.phase() != Phase::Ended {
        sleep(LOOK).await;
        // unless a step of this jog is in progress, a halt would stop tasks of other clients
        if !grip.must_halt() {
            (since, halts) = (None, 0);
            continue;
        }
        let since = *since.get_or_insert_with(Instant::now);
        if since.elapsed() > IN_TIME && halts < HALTS {
            let outcome = robot.halter.halt().await;
            // a step that was sent earlier may begin after a halt that found the robot at rest
            halts += if outcome.as_deref().is_ok_and(|text| text != AT_REST) { HALTS } else { 1 };
            app.audit.write(&who, &robot.name, "the jog did not halt in time: HALT", &outcome);
            sleep(AGAIN).await;
        }
    }
    let (why, outcome) = (grip.ends().unwrap_or_default(), grip.outcome().unwrap_or(Err("the jog panicked".into())));
    let what = format!("the jog ends: {why}; {}", outcome.as_deref().unwrap_or("then"));
    app.audit.write(&who, &robot.name, &what, &outcome);
}
