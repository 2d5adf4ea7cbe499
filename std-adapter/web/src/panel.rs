//! The panel of a virtual controller: its state, scenarios, and the time factor.

use std::sync::{Mutex, MutexGuard};

use bcap_sim::Scenario;
use bcap_sim::pace::Paced;
use serde_json::{Value, json};

use crate::threads::lock;

/// Locks the virtual controller of this process, and advances it to the current time.
fn advanced(controller: &Mutex<Paced>) -> MutexGuard<'_, Paced> {
    let mut paced = lock(controller);
    let (controller, time) = paced.at(bcap_std::now());
    controller.advance(time);
    paced
}

/// Returns the state of the panel.
pub(crate) fn section(controller: &Mutex<Paced>) -> Value {
    let mut paced = advanced(controller);
    let factor = paced.factor();
    let controller = paced.controller();
    let config = controller.config();
    json!({
        "model": config.model.name,
        "mode": controller.mode(),
        "emergency_stop": controller.emergency_stopped(),
        "motor": controller.motor_is_on(),
        "errors": controller.errors().count(),
        "factor": factor,
    })
}

/// Plays a scenario. A scenario without faults and tasks only changes the state; the faults of the previous scenario continue.
pub(crate) fn play(controller: &Mutex<Paced>, text: &str) -> Result<(), String> {
    let scenario = Scenario::parse(text).map_err(|error| format!("nothing was changed: {error}"))?;
    let mut paced = advanced(controller);
    let controller = paced.controller();
    scenario.check(controller.config()).map_err(|error| format!("nothing was changed: {error}"))?;
    if scenario.faults.is_empty() && scenario.tasks.is_empty() && !text.trim().is_empty() {
        controller.set_up(&scenario.controller);
    } else {
        controller.play(scenario);
    }
    Ok(())
}

/// Changes the time factor.
pub(crate) fn pace(controller: &Mutex<Paced>, factor: f64) -> Result<(), String> {
    advanced(controller).set_factor(factor, bcap_std::now())
}
