//! A call of any function as written by a user, and its effect.

use std::fmt;

use bcap_capture::hex;
use bcap_capture::json::LIMITS;
use bcap_capture::value::data;
use bcap_core::bcap::{Decoder, Effect, FunctionId, Kind};
use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::variant::OwnedVariant;
use bcap_std::ObjectPath;

use crate::calls::{Calls, Failure};
use crate::stream::StreamCheck;
use crate::variables::is_system_variable;

/// An argument of a call.
#[derive(Debug)]
enum Argument {
    Value(OwnedVariant),
    /// The handle of this object, which is opened first.
    Object(ObjectPath),
}

/// A call of a user.
#[derive(Debug)]
pub struct Request {
    /// The function.
    pub function: FunctionId,
    arguments: Vec<Argument>,
}

/// Writes `Variable_GetValue(variable:I1)`.
impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}(", self.function)?;
        for (n, argument) in self.arguments.iter().enumerate() {
            let separator = if n > 0 { ", " } else { "" };
            match argument {
                Argument::Value(value) => write!(f, "{separator}{:?}", value.as_variant())?,
                Argument::Object(path) => write!(f, "{separator}{path}")?,
            }
        }
        f.write_str(")")
    }
}

impl Request {
    /// Parses a function and its arguments: `TYPE,DATA`, or the name of an object for a handle.
    ///
    /// # Errors
    ///
    /// A sentence with the fault.
    pub fn parse(function: &str, arguments: &[String]) -> Result<Self, String> {
        let function = FunctionId::parse(function).ok_or_else(|| format!("there is no function {function}"))?;
        let kinds = function.signature().map(|signature| signature.arguments).unwrap_or_default();
        let parse = |(n, text): (usize, &String)| match kinds.get(n) {
            Some(Kind::Handle(object)) if ObjectPath::is_path(text) => {
                let path: ObjectPath = text.parse().map_err(|error| format!("{text}: {error}"))?;
                if path.object() == *object {
                    return Ok(Argument::Object(path));
                }
                Err(format!("{text} is not a {}, which {function} takes here", object.name().to_ascii_lowercase()))
            }
            _ => data::from_typed_input(text).map(Argument::Value),
        };
        let arguments = arguments.iter().enumerate().map(parse).collect::<Result<_, _>>()?;
        Ok(Self { function, arguments })
    }

    /// Decodes a packet in hexadecimal. Its serial number is ignored.
    ///
    /// # Errors
    ///
    /// A sentence with the fault of a packet that is not valid.
    pub fn decode(packet: &str) -> Result<Self, String> {
        let bytes = hex::parse(packet.as_bytes()).map_err(|error| error.to_string())?;
        let decoder = Decoder { limits: LIMITS, strictness: Strictness::Strict, crc: false };
        let frame = decoder.decode_datagram(&bytes).map_err(|error| {
            format!("the packet is refused: {error}; `bcap raw` also sends packets that are not valid")
        })?;
        let value = |value| OwnedVariant::new(&value).map(Argument::Value).map_err(|error| error.to_string());
        Ok(Self { function: frame.function(), arguments: frame.args.iter().map(value).collect::<Result<_, _>>()? })
    }

    /// Returns an argument if it is a text.
    fn text(&self, n: usize) -> Option<String> {
        let Argument::Value(value) = self.arguments.get(n)? else { return None };
        value.as_variant().as_bstr().map(|text| text.to_string())
    }

    /// Returns the effect; the strongest possible effect if a command, an option or a variable is unknown.
    #[must_use]
    pub fn effect(&self) -> Effect {
        let writes_system = || match self.arguments.first() {
            Some(Argument::Object(path)) => is_system_variable(path),
            // a handle may be any variable's
            _ => true,
        };
        if self.function == FunctionId::VARIABLE_PUT_VALUE && writes_system() {
            return Effect::Moves;
        }
        self.function.properties(self.text(1).as_deref(), self.text(2).as_deref()).effect
    }

    /// Makes the call, unless it would end a stream. A refusal is a reply. `may` is called directly before the call, after the
    /// objects are open.
    ///
    /// # Errors
    ///
    /// [`Failure::skipped`] while a stream runs, the error of `may`, or the error of a call.
    pub fn perform<C: Calls>(
        &self,
        calls: &mut C,
        may: impl FnOnce() -> Result<(), C::Error>,
    ) -> Result<(HResult, Option<OwnedVariant>), C::Error> {
        let mut check = StreamCheck::default();
        let mut values = Vec::new();
        for argument in &self.arguments {
            values.push(match argument {
                Argument::Value(value) => value.clone(),
                Argument::Object(path) => {
                    check.require_open(calls, path)?;
                    OwnedVariant::new(&calls.object(path)?)?
                }
            });
        }
        check.require(calls, self.function, self.text(1).as_deref())?;
        may()?;
        match calls.call("", self.function, &values) {
            Err(error) if error.code().is_some() && !error.is_lost() => Ok((error.code().unwrap_or_default(), None)),
            made => made,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effect(function: &str, arguments: &[&str]) -> Effect {
        let arguments: Vec<String> = arguments.iter().map(|text| (*text).to_owned()).collect();
        Request::parse(function, &arguments).unwrap().effect()
    }

    #[test]
    fn an_unknown_command_or_option_counts_as_the_strongest() {
        assert_eq!(effect("Controller_Execute", &["controller", "8, getcurerrorcount "]), Effect::Reads);
        assert_eq!(effect("Controller_Execute", &["controller", "8,ClearError"]), Effect::Writes);
        for command in ["8,", "8,GetCurErrorCount2", "0,", "3,5"] {
            assert_eq!(effect("Controller_Execute", &["controller", command]), Effect::Moves, "{command}");
        }
        assert_eq!(effect("Controller_Execute", &[]), Effect::Moves);
        assert_eq!(effect("Controller_GetFile", &["controller", "8,a.pcs", "8,"]), Effect::Session);
        for option in ["8,@Create=1", "0,"] {
            assert_eq!(effect("Controller_GetFile", &["controller", "8,a.pcs", option]), Effect::Writes, "{option}");
        }
    }

    #[test]
    fn a_system_variable_may_start_a_program_or_switch_the_motor() {
        for variable in ["task:Pro1/variable:@START", "robot/variable:@SERVO_ON", "robot/variable: @SERVO_ON", "3,2"] {
            assert_eq!(effect("Variable_PutValue", &[variable, "3,2"]), Effect::Moves, "{variable}");
        }
        assert_eq!(effect("Variable_PutValue", &["variable:I1", "3,2"]), Effect::Writes);
        assert_eq!(effect("Variable_GetValue", &["robot/variable:@SERVO_ON"]), Effect::Reads);
    }

    #[test]
    fn a_handle_is_the_name_of_an_object_or_a_number() {
        let parse =
            |argument: &str| Request::parse("Robot_Halt", &[argument.to_owned()]).map(|request| request.to_string());
        assert_eq!(parse("robot").unwrap(), "Robot_Halt(robot)");
        assert_eq!(parse("3,7").unwrap(), "Robot_Halt(I4(7))");
        assert_eq!(parse("variable:I1").unwrap_err(), "variable:I1 is not a robot, which Robot_Halt takes here");
    }
}
