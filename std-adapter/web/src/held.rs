//! What a page moves. It ends also while an order of the page is under way.

use std::sync::{Arc, Mutex};

use bcap_live::jog::Grip;
use bcap_live::recovery::Recovery;

use crate::app::App;
use crate::raw::Desk;
use crate::threads::lock;

/// What a page moves, each with its robot.
#[derive(Default)]
pub(crate) struct Held {
    pub(crate) grip: Option<(usize, Arc<Grip>)>,
    pub(crate) recovery: Option<(usize, Arc<Recovery>)>,
    /// The session for the calls of the user.
    pub(crate) desk: Option<Arc<Desk>>,
}

/// What a page moves, for its orders and for its WebSocket.
pub(crate) type Shared = Arc<Mutex<Held>>;

/// Ends all of it.
pub(crate) fn end(held: &Shared, app: &Arc<App>, why: &str) {
    let Held { grip, recovery, desk } = std::mem::take(&mut *lock(held));
    if let Some((_, grip)) = grip {
        grip.end(why);
    }
    if let Some((_, recovery)) = recovery {
        recovery.end(why);
    }
    if let Some(desk) = desk {
        desk.end(app);
    }
}
