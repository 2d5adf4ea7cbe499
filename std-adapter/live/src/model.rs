//! The state that was read, with the last changes. It reads no clock: the caller sets the time.

use std::collections::VecDeque;
use std::time::Duration;

use bcap_capture::Role;
use bcap_core::hresult::HResult;
use bcap_core::variant::{OwnedVariant, Variant};

use crate::log::{CallLog, MARKED};
use crate::variables::shown;

/// The last values of a variable that are kept.
const HISTORY: usize = 60;

/// The messages that are kept.
const MESSAGES: usize = 200;

/// The state of a controller.
#[derive(Debug)]
pub struct Model {
    /// Why there is no connection.
    pub lost: Option<String>,
    /// The words of the controller's state, such as `RC8`, `auto`, `ok`, `motor`, `moving`.
    pub words: Vec<String>,
    /// Whether the controller has an error.
    pub has_error: bool,
    /// The variables, in the order of the reader.
    pub variables: Vec<Variable>,
    /// The robot.
    pub robot: Robot,
    /// The tasks with their states.
    pub tasks: Vec<(String, String)>,
    /// The errors, the first cause first; `Err` says why they were not read.
    pub errors: Result<Vec<Fault>, String>,
    /// The messages in chronological order.
    pub messages: VecDeque<String>,
    /// The packets.
    pub log: CallLog,
    /// The time since the start.
    pub now: Duration,
}

/// An error of the controller: its code, and the controller's text.
pub type Fault = (HResult, String);

/// A variable and its last values.
#[derive(Clone, Debug, Default)]
pub struct Variable {
    /// The name.
    pub name: String,
    /// The value, or why it was not read.
    pub text: String,
    /// The value; `None` until it is read, and after a refusal.
    pub value: Option<OwnedVariant>,
    /// When the value last changed.
    pub changed: Option<Duration>,
    /// The last numbers.
    pub history: Vec<f64>,
}

impl Variable {
    /// Returns whether the value changed recently.
    #[must_use]
    pub fn has_changed(&self, now: Duration) -> bool {
        self.changed.is_some_and(|at| now < at + MARKED)
    }
}

/// The robot. Values that the controller does not have are missing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Robot {
    /// The angles of the joints, in degrees.
    pub joints: Vec<f64>,
    /// The position of the tool centre point: X, Y, Z in mm, RX, RY, RZ in degrees, FIG.
    pub position: Vec<f64>,
    /// The number of the tool.
    pub tool: Option<String>,
    /// The number of the work coordinates.
    pub work: Option<String>,
    /// The external speed in percent.
    pub speed: Option<String>,
}

/// A result of the reader.
#[derive(Debug)]
pub enum Update {
    /// The connection is open, and these are the variables.
    Connected(Vec<String>),
    /// The connection is lost.
    Lost(String),
    /// A variable was read, or refused.
    Value(usize, Result<OwnedVariant, String>),
    /// The words of the controller's state, and whether it has an error.
    State(Vec<String>, bool),
    /// The robot was read.
    Robot(Robot),
    /// The tasks with their states.
    Tasks(Vec<(String, String)>),
    /// The errors, the first cause first; `Err` says why they were not read.
    Errors(Result<Vec<Fault>, String>),
    /// A message of the controller.
    Message(String),
    /// A packet, formatted as text.
    Packet(Role, String),
}

impl Default for Model {
    fn default() -> Self {
        Self {
            lost: Some("connecting".into()),
            words: Vec::new(),
            has_error: false,
            variables: Vec::new(),
            robot: Robot::default(),
            tasks: Vec::new(),
            errors: Err("not read yet".into()),
            messages: VecDeque::new(),
            log: CallLog::default(),
            now: Duration::ZERO,
        }
    }
}

impl Model {
    /// Applies a result of the reader.
    pub fn apply(&mut self, update: Update) {
        match update {
            Update::Connected(names) => self.connected(names),
            Update::Lost(why) => self.lose(why),
            Update::Value(n, value) => self.value(n, value),
            Update::State(words, has_error) => (self.words, self.has_error) = (words, has_error),
            Update::Robot(robot) => self.robot = robot,
            Update::Tasks(tasks) => self.tasks = tasks,
            Update::Errors(errors) => self.errors = errors,
            Update::Message(text) => {
                if self.messages.len() >= MESSAGES {
                    self.messages.pop_front();
                }
                self.messages.push_back(text);
            }
            Update::Packet(role, text) => self.log.packet(role, &text, self.now),
        }
    }

    /// The connection is lost: values that were read are no longer shown as current. Variables keep their history.
    fn lose(&mut self, why: String) {
        (self.lost, self.errors) = (Some(why), Err("the connection is lost".into()));
        (self.words, self.has_error, self.robot, self.tasks) = Default::default();
        for variable in &mut self.variables {
            (variable.text, variable.value) = ("not read since the connection was lost".into(), None);
        }
    }

    /// The connection is open. Variables that were shown before keep their history.
    fn connected(&mut self, names: Vec<String>) {
        self.lost = None;
        if names.iter().eq(self.variables.iter().map(|variable| &variable.name)) {
            return;
        }
        let mut before = std::mem::take(&mut self.variables);
        let mut known = |name: &str| {
            let found = before.iter().position(|variable| variable.name == name)?;
            Some(before.swap_remove(found))
        };
        let variable = |name: String| known(&name).unwrap_or_else(|| Variable { name, ..Variable::default() });
        self.variables = names.into_iter().map(variable).collect();
    }

    fn value(&mut self, n: usize, value: Result<OwnedVariant, String>) {
        let Some(variable) = self.variables.get_mut(n) else { return };
        let value = match value {
            Ok(value) => value,
            Err(why) => {
                (variable.text, variable.value) = (why, None);
                return;
            }
        };
        if variable.value.as_ref().is_some_and(|before| *before != value) {
            variable.changed = Some(self.now);
        }
        variable.text = shown(&value);
        if let Some(number) = number(value.as_variant()) {
            if variable.history.len() >= HISTORY {
                variable.history.remove(0);
            }
            variable.history.push(number);
        }
        variable.value = Some(value);
    }
}

/// Returns the number of a scalar, for a sparkline.
fn number(value: Variant<'_>) -> Option<f64> {
    match value {
        Variant::Bool(on) => Some(f64::from(u8::from(on))),
        value => value.as_f64(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(n: i32) -> Result<OwnedVariant, String> {
        Ok(OwnedVariant::new(&n).unwrap())
    }

    #[test]
    fn a_variable_keeps_its_history_when_others_come_and_go() {
        let mut model = Model::default();
        model.apply(Update::Connected(vec!["I1".into(), "I2".into()]));
        model.apply(Update::Value(1, value(3)));
        model.now = Duration::from_secs(1);
        model.apply(Update::Value(1, value(4)));
        model.apply(Update::Connected(vec!["I2".into(), "I3".into()]));
        assert_eq!((model.variables[0].history.as_slice(), model.variables[1].history.len()), (&[3.0, 4.0][..], 0));
        assert!(model.variables[0].has_changed(Duration::from_secs(2)));
        assert!(!model.variables[0].has_changed(Duration::from_secs(3)));
        model.apply(Update::Value(0, Err("refused".into())));
        // a value after a refusal is not a change
        model.now = Duration::from_secs(9);
        model.apply(Update::Value(0, value(5)));
        assert_eq!(model.variables[0].changed, Some(Duration::from_secs(1)));
    }

    #[test]
    fn nothing_is_known_after_a_lost_connection() {
        let mut model = Model::default();
        assert_eq!(model.errors, Err("not read yet".into()));
        let names = || vec!["I1".into()];
        model.apply(Update::Connected(names()));
        model.apply(Update::Value(0, value(3)));
        model.apply(Update::State(vec!["auto".into(), "moving".into()], true));
        model.apply(Update::Robot(Robot { joints: vec![1.0], ..Robot::default() }));
        model.apply(Update::Tasks(vec![("Pro1".into(), "running".into())]));
        model.apply(Update::Errors(Ok(Vec::new())));
        model.apply(Update::Lost("the cable is broken".into()));
        model.apply(Update::Connected(names()));
        assert_eq!(model.errors, Err("the connection is lost".into()));
        assert!(model.words.is_empty() && !model.has_error && model.tasks.is_empty());
        assert_eq!((&model.robot, &model.variables[0].value), (&Robot::default(), &None));
        assert_eq!(model.variables[0].text, "not read since the connection was lost");
        assert_eq!(model.variables[0].history, [3.0]);
    }

    #[test]
    fn old_messages_are_dropped() {
        let mut model = Model::default();
        for n in 0..250 {
            model.apply(Update::Message(n.to_string()));
        }
        assert_eq!((model.messages.len(), model.messages[0].as_str()), (200, "50"));
    }
}
