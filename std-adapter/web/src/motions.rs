//! The motions of a page. They can be ended even while an order of the page is running.

use std::sync::{Arc, Mutex};

use bcap_live::jog::Grip;
use bcap_live::recovery::Recovery;

use crate::app::App;
use crate::raw::Desk;
use crate::threads::lock;

/// The motions of a page, each with its robot.
#[derive(Default)]
pub(crate) struct Motions {
    pub(crate) grip: Option<(usize, Arc<Grip>)>,
    /// The number of the last press of a button of the jog.
    pub(crate) press: u64,
    pub(crate) recovery: Option<(usize, Arc<Recovery>)>,
    /// The session for the calls of the user.
    pub(crate) desk: Option<Arc<Desk>>,
}

/// The motions of a page, for its orders and for its WebSocket.
pub(crate) type SharedMotions = Arc<Mutex<Motions>>;

/// Ends all of them.
pub(crate) fn end(motions: &SharedMotions, app: &Arc<App>, why: &str) {
    let Motions { grip, recovery, desk, .. } = std::mem::take(&mut *lock(motions));
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
    let (of, what) = (Arc::clone(app), format!("{why} during a step that moves"));
    // without a thread the step ends as the controller ends it
    let _ = app.spawn("end of a step", move || robot.halt_while(&of.audit, &what, || recovery.moves()));
}
