//! What a page moves. It ends also while an order of the page is under way.

use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::Duration;

use bcap_live::jog::Grip;
use bcap_live::recovery::Recovery;

use crate::app::App;
use crate::raw::Desk;
use crate::robot::Robot;
use crate::threads::lock;

/// How often a call that has not ended is halted, and the pause between two halts.
pub(crate) const HALTS: u32 = 3;
pub(crate) const AGAIN: Duration = Duration::from_millis(200);

/// What a page moves, each with its robot.
#[derive(Default)]
pub(crate) struct Held {
    pub(crate) grip: Option<(usize, Arc<Grip>)>,
    /// The number of the last press of a button of the jog.
    pub(crate) press: u64,
    pub(crate) recovery: Option<(usize, Arc<Recovery>)>,
    /// The session for the calls of the user.
    pub(crate) desk: Option<Arc<Desk>>,
}

/// What a page moves, for its orders and for its WebSocket.
pub(crate) type Shared = Arc<Mutex<Held>>;

/// Ends all of it.
pub(crate) fn end(held: &Shared, app: &Arc<App>, why: &str) {
    let Held { grip, recovery, desk, .. } = std::mem::take(&mut *lock(held));
    if let Some((_, grip)) = grip {
        grip.end(why);
    }
    if let Some((robot, recovery)) = recovery {
        end_recovery(app, robot, recovery, why);
    }
    if let Some(desk) = desk {
        desk.end(app);
    }
}

/// Ends a recovery, and halts a step that moves.
pub(crate) fn end_recovery(app: &Arc<App>, robot: usize, recovery: Arc<Recovery>, why: &str) {
    let is_first = recovery.end(why);
    let Some(robot) = app.robots.get(robot).filter(|_| is_first && recovery.moves()).cloned() else { return };
    let (of, what) = (Arc::clone(app), format!("a step that moves ends: {why}: HALT"));
    // without a thread the step ends as the controller ends it
    let _ = app.spawn("end of a step", move || halt_while(&of, &robot, &what, || recovery.moves()));
}

/// Halts a robot while a call is under way: it may be sent at this moment, and come after the first halt. `what` is for the audit.
pub(crate) fn halt_while(app: &App, robot: &Robot, what: &str, moves: impl Fn() -> bool) {
    for _ in 0..HALTS {
        if !moves() {
            break;
        }
        let outcome = robot.halter.halt_now();
        app.audit.write("a page", &robot.name, what, &outcome);
        sleep(AGAIN);
    }
}
