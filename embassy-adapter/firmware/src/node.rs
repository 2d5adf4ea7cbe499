//! A controller without a robot that serves the board's state as variables.
//!
//! ```text
//!  RAC                     b-CAP        value
//!  GET:RC8:0:I:            I0           seconds since the start
//!  GET:RC8:1:I:            I1           requests answered
//!  GET:RC8:2:I:            I2           requests refused
//!  GET:RC8:3:I:            I3           frames received
//!  GET:RC8:4:I:            I4           frames sent
//!  GET:RC8:5:I:            I5           high-water mark of the stack, in bytes
//!  GET:RC8:10:I: .. 19     I10 .. I19   memory, which a PUT writes
//!  GET:RC8:0:D:            D0           seconds since the start, with a fraction
//!  GET:RC8:0:S:            S0           name and version of the image
//!  GET:RC8:0:IO:           IO0          whether the robot answers
//! ```

use bcap_board::stack;
use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{self, Handler as BcapHandler};
use bcap_core::error::EncodeError;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::server::Handler as RacHandler;
use bcap_core::rac::{Request, Variable, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

use crate::lan9118;

/// The index of the first variable that can be written.
const MEMORY: u32 = 10;
/// The bits of a handle that number the opened object; the bits below are a variable's kind and its index.
const NUMBER_SHIFT: u32 = 9;
const NUMBER_MASK: u32 = 0x003f_ffff;
const KIND_SHIFT: u32 = 5;
const INDEX_MASK: u32 = 0x1f;

/// The board as a controller.
#[derive(Debug, Default)]
pub struct Node {
    answered: u32,
    refused: u32,
    memory: [i32; 10],
    /// The number of objects opened so far.
    opened: u32,
    /// Whether the robot answered the last request.
    pub robot_is_up: bool,
}

impl Node {
    /// Creates the state of a board that has just started.
    #[must_use]
    pub const fn new() -> Self {
        Self { answered: 0, refused: 0, memory: [0; 10], opened: 0, robot_is_up: false }
    }

    /// Returns the numbers of requests answered and refused.
    #[must_use]
    pub const fn counters(&self) -> (u32, u32) {
        (self.answered, self.refused)
    }

    fn get(&self, variable: Variable, reply: &mut ReplyValue<'_>, now: Instant) -> HResult {
        let set = match (variable.kind, variable.index) {
            (VariableKind::I, index) => match self.integer(index, now) {
                Some(value) => reply.set(&value),
                None => return HResult::E_INVALIDARG,
            },
            (VariableKind::D, 0) => {
                let since = now.saturating_since(Instant::ZERO);
                reply.set(&since.as_secs_f64())
            }
            (VariableKind::S, 0) => reply.set(concat!("bcap node ", env!("CARGO_PKG_VERSION"))),
            (VariableKind::Io, 0) => reply.set(&self.robot_is_up),
            _ => return HResult::E_INVALIDARG,
        };
        from_encoding(set)
    }

    fn integer(&self, index: u32, now: Instant) -> Option<i32> {
        let count = |n: u32| n.cast_signed();
        Some(match index {
            0 => i32::try_from(now.as_micros() / 1_000_000).unwrap_or(i32::MAX),
            1 => count(self.answered),
            2 => count(self.refused),
            3 => count(lan9118::counters().received),
            4 => count(lan9118::counters().sent),
            5 => i32::try_from(stack::high_water()).unwrap_or(i32::MAX),
            _ => *self.memory.get(place(index)?)?,
        })
    }

    /// Returns a new handle. Handles repeat after 4 million objects.
    fn open(&mut self, variable: u32) -> i32 {
        self.opened = self.opened.wrapping_add(1);
        ((self.opened & NUMBER_MASK) << NUMBER_SHIFT | variable).cast_signed()
    }

    fn put(&mut self, variable: Variable, value: Variant<'_>) -> HResult {
        let slot = match variable.kind {
            VariableKind::I => place(variable.index).and_then(|index| self.memory.get_mut(index)),
            _ => None,
        };
        match (slot, value) {
            (Some(slot), Variant::I4(value)) => {
                *slot = value;
                HResult::S_OK
            }
            (Some(_), _) => HResult::E_INVALIDARGTYPE,
            (None, _) => HResult::E_ACCESSDENIED,
        }
    }

    fn count(&mut self, result: HResult) -> Outcome {
        match result.is_ok() {
            true => self.answered = self.answered.wrapping_add(1),
            false => self.refused = self.refused.wrapping_add(1),
        }
        result.into()
    }
}

impl RacHandler for Node {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let result = match *request {
            Request::Get(variable) => self.get(variable, reply, now),
            Request::Put(variable, value) => self.put(variable, value),
        };
        self.count(result)
    }
}

impl BcapHandler for Node {
    fn call(&mut self, _: PeerId, request: &server::Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let variable = || from_handle(request.handle());
        let result = match request.function {
            FunctionId::SERVICE_START
            | FunctionId::SERVICE_STOP
            | FunctionId::CONTROLLER_DISCONNECT
            | FunctionId::VARIABLE_RELEASE => HResult::S_OK,
            FunctionId::CONTROLLER_CONNECT => from_encoding(reply.set(&self.open(0))),
            FunctionId::CONTROLLER_GET_VARIABLE => {
                let mut name = [0; 16];
                match request.text(1).to_str(&mut name).and_then(|name| name.parse().ok()) {
                    Some(variable) if exists(variable) => from_encoding(reply.set(&self.open(to_bits(variable)))),
                    _ => HResult::E_CAO_OBJECT_NOTFOUND,
                }
            }
            FunctionId::VARIABLE_GET_VALUE => match variable() {
                Some(variable) => self.get(variable, reply, now),
                None => HResult::E_HANDLE,
            },
            FunctionId::VARIABLE_PUT_VALUE => match variable() {
                Some(variable) => self.put(variable, request.value(1)),
                None => HResult::E_HANDLE,
            },
            _ => HResult::E_NOTIMPL,
        };
        self.count(result)
    }
}

fn from_encoding(result: Result<(), EncodeError>) -> HResult {
    result.map_or(HResult::E_FAIL, |()| HResult::S_OK)
}

fn place(index: u32) -> Option<usize> {
    usize::try_from(index.checked_sub(MEMORY)?).ok()
}

fn exists(variable: Variable) -> bool {
    match variable.kind {
        VariableKind::I => matches!(variable.index, 0..=5 | 10..=19),
        VariableKind::D | VariableKind::S | VariableKind::Io => variable.index == 0,
        _ => false,
    }
}

/// Returns the kind and the index of a variable as the lower bits of its handles.
fn to_bits(variable: Variable) -> u32 {
    let kind = VariableKind::ALL.iter().position(|kind| *kind == variable.kind).unwrap_or_default();
    u32::try_from(kind).unwrap_or_default() << KIND_SHIFT | variable.index & INDEX_MASK
}

fn from_handle(handle: i32) -> Option<Variable> {
    let bits = handle.cast_unsigned();
    let kind = usize::try_from(bits >> KIND_SHIFT & ((1 << (NUMBER_SHIFT - KIND_SHIFT)) - 1)).ok()?;
    Some(Variable::new(*VariableKind::ALL.get(kind)?, bits & INDEX_MASK))
}
