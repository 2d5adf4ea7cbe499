//! The effect of a call on the controller, and whether Slave Mode allows it.
//!
//! A controller in Slave Mode refuses most calls of every client, and the refusal ends Slave Mode: the robot stops and
//! `slvMove` answers E_SLVMODE_OFF. This was seen on RC8, COBOTTA and COBOTTA PRO (the vendor's ROS driver, issues 6, 42 and
//! 12; nkawa/Denso_CobottaPro900_MQTT_Control). So a program that only reads needs a list of the calls that it may send.
//!
//! | calls                                                            | in Slave Mode | source                           |
//! |------------------------------------------------------------------|---------------|----------------------------------|
//! | Service, Connect, Disconnect, all Release                        | allowed       | second clients do this while a stream runs; a lost connection also releases |
//! | Controller_GetRobot, Controller_GetVariable, Robot_GetVariable   | allowed       | opened by these clients          |
//! | Variable_GetValue                                                | allowed       | RC8: each cycle of a stream (start-jsk/denso); unmarked in the RC8 provider guide |
//! | Robot_Halt                                                       | allowed       | it ends Slave Mode on purpose; a halt is never withheld |
//! | Robot_Accelerate, Change, Move, Rotate, Speed                    | refused       | RC8 provider guide: "not available in Slave Mode" |
//! | commands of an Execute function                                  | each its own  | [`Command`](super::Command)      |
//! | all other functions, and all other commands                      | unknown       | no source; treated as refused    |

use crate::hresult::HResult;
use core::fmt;

/// The strongest effect that a call has on the controller. The order is by strength.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Effect {
    /// Begins or ends a session, or opens or releases an object of this client.
    Session,
    /// Reads a value or a list of names.
    Reads,
    /// Changes a variable, a file, a setting or a list of errors. A variable may start a program (`@START`) or be an output.
    Writes,
    /// Moves or stops the robot, a hand or a program, switches a motor, takes or gives the arm, or sets how the robot moves.
    Moves,
}

impl Effect {
    /// Returns the name: `session`, `reads`, `writes` or `moves`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Session => "session",
            Self::Reads => "reads",
            Self::Writes => "writes",
            Self::Moves => "moves",
        }
    }

    /// Returns whether a call of this effect neither writes nor moves.
    #[must_use]
    pub const fn is_harmless(self) -> bool {
        matches!(self, Self::Session | Self::Reads)
    }
}

/// Whether a controller in Slave Mode executes a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum InSlaveMode {
    /// A source saw the call executed in Slave Mode.
    Allowed,
    /// A source observed that the call ends Slave Mode, or the vendor's guide says that it is not available.
    Refused,
    /// No source. Such a call is treated as refused.
    Unknown,
}

impl InSlaveMode {
    /// Returns the name: `allowed`, `refused` or `unknown`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Allowed => "allowed",
            Self::Refused => "refused",
            Self::Unknown => "unknown",
        }
    }

    /// Returns whether the call may be sent while a stream runs; `Unknown` may not.
    #[must_use]
    pub const fn is_allowed(self) -> bool {
        matches!(self, Self::Allowed)
    }
}

/// The effect of a call, and whether Slave Mode allows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Properties {
    /// Its effect.
    pub effect: Effect,
    /// Whether a controller in Slave Mode executes it.
    pub in_slave_mode: InSlaveMode,
}

impl Properties {
    /// The properties of a function or command that this table does not have.
    pub const UNKNOWN: Self = Self { effect: Effect::Moves, in_slave_mode: InSlaveMode::Unknown };
}

/// Whether a stream of Slave Mode runs, from the reply to `slvGetMode`.
///
/// A stream may begin between this reply and the next call. A program that must not interrupt a stream sends slvGetMode before
/// each call that Slave Mode refuses. This limits the gap to one round trip, but does not close it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum StreamState {
    /// No stream runs.
    Off,
    /// The controller has no Slave Mode: there is no licence, or the command does not exist. The query need not be repeated.
    Absent,
    /// A stream runs.
    Runs,
    /// The controller refused to say it, with this code; a stream may run.
    Unknown(HResult),
}

impl StreamState {
    /// The command of Robot_Execute that reads the mode.
    pub const COMMAND: &'static str = "slvGetMode";

    /// Returns the state for the result of `slvGetMode` and the number in its reply; 0 is off.
    #[must_use]
    pub const fn from_reply(result: HResult, mode: Option<i32>) -> Self {
        /// A Slave Mode licence is missing, in the list of codes of an RC8.
        const NO_SLAVE_LICENSE: HResult = HResult::from_u32(0x8350_0126);
        match (result, mode) {
            (HResult::E_NO_LICENSE | NO_SLAVE_LICENSE | HResult::E_INVALID_CMD_NAME | HResult::E_NOTIMPL, _) => {
                Self::Absent
            }
            (result, Some(0)) if result.is_ok() => Self::Off,
            (result, Some(_)) if result.is_ok() => Self::Runs,
            (result, _) => Self::Unknown(result),
        }
    }

    /// Returns whether a call may be sent.
    #[must_use]
    pub const fn allows(self, call: Properties) -> bool {
        call.in_slave_mode.is_allowed() || matches!(self, Self::Off | Self::Absent)
    }

    /// Returns why a call is skipped, as a sentence; `None` if it may be sent. `name` is the function or command.
    #[must_use]
    pub const fn skip(self, name: &str, call: Properties) -> Option<Skipped<'_>> {
        if self.allows(call) { None } else { Some(Skipped { state: self, name, in_slave_mode: call.in_slave_mode }) }
    }
}

/// A call that was not sent, because it would end a stream of Slave Mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skipped<'a> {
    state: StreamState,
    name: &'a str,
    in_slave_mode: InSlaveMode,
}

/// Writes `a stream of Slave Mode runs, and SysState would end it`.
impl fmt::Display for Skipped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.state {
            StreamState::Unknown(code) => {
                write!(f, "slvGetMode was refused with {code}, so a stream of Slave Mode may run")?;
            }
            _ => f.write_str("a stream of Slave Mode runs")?,
        }
        let verb = if self.in_slave_mode == InSlaveMode::Refused { "would" } else { "may" };
        write!(f, ", and {} {verb} end it", self.name)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_stream_is_off_only_if_the_controller_says_so_or_cannot_have_one() {
        let state = StreamState::from_reply;
        assert_eq!(state(HResult::S_OK, Some(0)), StreamState::Off);
        assert_eq!(state(HResult::S_OK, Some(0x202)), StreamState::Runs);
        assert_eq!(state(HResult::S_OK, None), StreamState::Unknown(HResult::S_OK));
        assert_eq!(state(HResult::E_FAIL, Some(0)), StreamState::Unknown(HResult::E_FAIL));
        for code in [HResult::E_NO_LICENSE, HResult::E_NOTIMPL, HResult::E_INVALID_CMD_NAME] {
            assert_eq!(state(code, None), StreamState::Absent, "{code}");
        }
    }

    #[test]
    fn a_skipped_call_says_why() {
        let call = |in_slave_mode| Properties { effect: Effect::Reads, in_slave_mode };
        let skip = |state: StreamState, in_slave_mode| {
            state.skip("SysState", call(in_slave_mode)).map(|skipped| skipped.to_string())
        };
        let runs = skip(StreamState::Runs, InSlaveMode::Refused).unwrap();
        assert_eq!(runs, "a stream of Slave Mode runs, and SysState would end it");
        let unknown = skip(StreamState::Unknown(HResult::E_FAIL), InSlaveMode::Unknown).unwrap();
        assert!(unknown.starts_with("slvGetMode was refused with 0x80004005"), "{unknown}");
        assert!(unknown.ends_with("may run, and SysState may end it"), "{unknown}");
        assert_eq!(skip(StreamState::Off, InSlaveMode::Refused), None);
        assert_eq!(skip(StreamState::Absent, InSlaveMode::Unknown), None);
        assert_eq!(skip(StreamState::Runs, InSlaveMode::Allowed), None);
    }
}
