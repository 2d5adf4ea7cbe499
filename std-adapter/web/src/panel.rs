//! The panel of a virtual controller: its state, scenarios, and the time factor.

use std::sync::{Arc, Mutex, PoisonError};

use bcap_sim::Scenario;
use bcap_sim::pace::Paced;
use serde_json::{Value, json};

/// The virtual controller of this process.
#[derive(Clone, Debug)]
pub(crate) struct Panel(Arc<Mutex<Paced>>);

impl Panel {
    pub(crate) const fn new(controller: Arc<Mutex<Paced>>) -> Self {
        Self(controller)
    }

    fn with<T>(&self, work: impl FnOnce(&mut Paced) -> T) -> T {
        let mut paced = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (controller, time) = paced.at(bcap_std::now());
        controller.advance(time);
        work(&mut paced)
    }

    /// Returns the state of the panel.
    pub(crate) fn section(&self) -> Value {
        self.with(|paced| {
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
        })
    }

    /// Plays a scenario. One without faults and tasks changes the state, and the faults of the last one go on.
    pub(crate) fn play(&self, text: &str) -> Result<Value, String> {
        let scenario = Scenario::parse(text).map_err(|error| format!("nothing was changed: {error}"))?;
        self.with(|paced| {
            let controller = paced.controller();
            scenario.check(controller.config()).map_err(|error| format!("nothing was changed: {error}"))?;
            if scenario.faults.is_empty() && scenario.tasks.is_empty() && !text.trim().is_empty() {
                controller.set_up(&scenario.controller);
            } else {
                controller.play(scenario);
            }
            Ok(Value::Null)
        })
    }

    /// Changes the time factor.
    pub(crate) fn pace(&self, factor: f64) -> Result<Value, String> {
        self.with(|paced| paced.set_factor(factor, bcap_std::now())).map(|()| Value::Null)
    }
}
