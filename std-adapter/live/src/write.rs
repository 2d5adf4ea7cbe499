//! Writing a variable in two steps, so that a user sees the old value and the new value first.

use bcap_capture::value::data;
use bcap_core::bcap::FunctionId;
use bcap_core::variant::OwnedVariant;
use bcap_std::ObjectPath;

use crate::calls::{Calls, Failure};
use crate::stream::StreamCheck;
use crate::variables::{shown, value};

/// A value to write, which has been checked.
#[derive(Clone, Debug)]
pub struct Write {
    /// The variable.
    pub path: ObjectPath,
    /// The new value.
    pub value: OwnedVariant,
    /// The value when it was checked.
    pub before: OwnedVariant,
}

/// Converts text to the type of a variable, and reads its current value.
///
/// # Errors
///
/// [`Failure::invalid`] if the text is not a value of that type, [`Failure::skipped`] if reading the value would end a stream
/// of Slave Mode, or the error of a call.
pub fn check<C: Calls>(calls: &mut C, name: &str, text: &str) -> Result<Write, C::Error> {
    let path = ObjectPath::variable(name)?;
    let before = value(calls, &mut StreamCheck::default(), &path)?;
    let value = data::to_write(name, text, before.as_variant()).map_err(C::Error::invalid)?;
    Ok(Write { path, value, before })
}

/// Returns the position of the resting robot for a variable of type P.
///
/// # Errors
///
/// [`Failure::invalid`] while the robot moves, or the error of a call.
pub fn check_position<C: Calls>(calls: &mut C, name: &str) -> Result<Write, C::Error> {
    let mut stream = StreamCheck::default();
    let moves = value(calls, &mut stream, &ObjectPath::variable("robot/@BUSY_STATUS")?)?;
    if shown(&moves) != "false" {
        return Err(C::Error::invalid("the robot moves; wait until it rests".into()));
    }
    let position = value(calls, &mut stream, &ObjectPath::variable("robot/@CURRENT_POSITION")?)?;
    check(calls, name, &shown(&position))
}

impl Write {
    /// Writes the value, unless that would end a stream of Slave Mode.
    ///
    /// # Errors
    ///
    /// The error of a call. If the session is lost, it is unknown whether the value was written.
    pub fn perform<C: Calls>(&self, calls: &mut C) -> Result<(), C::Error> {
        StreamCheck::default().require(calls, FunctionId::VARIABLE_PUT_VALUE, None)?;
        calls.restart_limit();
        let variable = calls.object(&self.path)?;
        let arguments = [OwnedVariant::new(&variable)?, self.value.clone()];
        calls.call(&self.path.to_string(), FunctionId::VARIABLE_PUT_VALUE, &arguments).map(drop)
    }

    /// Writes the value if the variable still has the value from the check.
    ///
    /// # Errors
    ///
    /// [`Failure::invalid`] if the variable has changed; otherwise same as [`perform`](Self::perform).
    pub fn perform_unless_changed<C: Calls>(&self, calls: &mut C) -> Result<(), C::Error> {
        let present = value(calls, &mut StreamCheck::default(), &self.path)?;
        if present != self.before {
            let (before, present) = (shown(&self.before), shown(&present));
            let text = format!("{} has changed meanwhile from {before} to {present}; nothing was written", self.path);
            return Err(C::Error::invalid(text));
        }
        self.perform(calls)
    }
}
