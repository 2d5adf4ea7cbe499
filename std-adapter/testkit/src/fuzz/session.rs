//! The state of a connection: its handles, and which calls may succeed.

use std::collections::HashMap;

use bcap_core::bcap::{FunctionId, Kind as ArgumentKind, Object};
use bcap_core::hresult::HResult;

use super::finding::{Finding, Kind};
use crate::frame::TestFrame;
use crate::step::{Argument, Call};
use crate::value::Value;

/// A handle that the device gave.
#[derive(Debug)]
struct Open {
    object: Object,
    handle: i32,
    /// The name of a variable of the controller, otherwise empty.
    name: String,
}

/// The state of a connection.
#[derive(Debug, Default)]
pub(super) struct Session {
    serial: u16,
    open: Vec<Open>,
    released: HashMap<&'static str, i32>,
    /// Whether the service was stopped, so that the device may close the connection.
    pub(super) is_stopped: bool,
    calls: usize,
}

impl Session {
    /// Returns the serial number of the next packet.
    pub(super) fn next_serial(&mut self) -> u16 {
        self.serial = self.serial.checked_add(1).unwrap_or(1);
        self.serial
    }

    /// Creates the frame of a call.
    pub(super) fn frame(&mut self, call: &Call) -> TestFrame {
        let serial = self.next_serial();
        let handle = |argument: &Argument| match argument {
            Argument::Handle(object) => {
                let latest = self.open.iter().rev().find(|open| open.object == *object);
                latest.map_or(0, |open| open.handle)
            }
            Argument::Released(object) => self.released.get(object.name()).copied().unwrap_or(0),
            Argument::Value(_) => 0,
        };
        call.to_frame(serial, handle)
    }

    /// Returns the name of the variable whose handle is the first argument.
    pub(super) fn variable(&self, frame: &TestFrame) -> Option<&str> {
        let handle = handle_of(frame)?;
        let open = self.open.iter().rev().find(|open| open.object == Object::Variable && open.handle == handle);
        open.map(|open| open.name.as_str())
    }

    /// Records a reply with a correct form.
    pub(super) fn replied(&mut self, request: &TestFrame, reply: &TestFrame) -> Option<Finding> {
        self.calls += 1;
        let function = FunctionId(request.code);
        if HResult(reply.code).is_err() {
            return None;
        }
        let finding = self.invalid_handle(request);
        match function {
            FunctionId::SERVICE_START => self.is_stopped = false,
            FunctionId::SERVICE_STOP => {
                self.is_stopped = true;
                self.open.clear();
            }
            _ => {}
        }
        if let (Some(object), Some(Value::I4(handle))) = (function.opens(), reply.args.first()) {
            // a variable of a task or a robot may have the name of one of the controller
            let name = match request.args.get(1) {
                Some(Value::Bstr(units)) if function == FunctionId::CONTROLLER_GET_VARIABLE => {
                    String::from_utf16_lossy(units)
                }
                _ => String::new(),
            };
            self.open.push(Open { object, handle: *handle, name });
        }
        if let (Some(object), Some(handle)) = (function.releases(), handle_of(request))
            && let Some(place) = self.open.iter().rposition(|open| open.object == object && open.handle == handle)
        {
            self.open.remove(place);
            self.released.insert(object.name(), handle);
        }
        finding
    }

    /// Returns a finding if the successful call was made on a handle that is not open.
    fn invalid_handle(&self, request: &TestFrame) -> Option<Finding> {
        let function = FunctionId(request.code);
        let Some(ArgumentKind::Handle(object)) = function.signature()?.arguments.first().copied() else { return None };
        let handle = handle_of(request)?;
        if self.open.iter().any(|open| open.object == object && open.handle == handle) {
            return None;
        }
        let was_released = self.released.get(object.name()) == Some(&handle);
        let why = if was_released { "was released" } else { "was never given for such an object" };
        Some(Finding::of_function(
            Kind::Handle,
            request.code,
            format!("the call succeeds with handle {handle}, which {why}"),
        ))
    }

    /// Returns a key for a call that opens an object; `None` for other calls. If a call with the same key is refused later, the
    /// device leaks. The key is the same only if the session is in the same state.
    pub(super) fn opening(&self, request: &TestFrame) -> Option<String> {
        let function = FunctionId(request.code);
        let object = function.opens()?;
        let is_by_name = object.opened_from(Object::Controller) == Some(function);
        let is_first = [FunctionId::SERVICE_START, FunctionId::CONTROLLER_CONNECT].get(self.calls) == Some(&function);
        let has_owner =
            self.open.iter().any(|open| open.object == Object::Controller && handle_of(request) == Some(open.handle));
        let values = request.args.get(usize::from(is_by_name)..)?;
        // with fewer open objects than before, the call would still be comparable
        let is_comparable = is_first || (is_by_name && has_owner && self.open.len() == 1);
        is_comparable.then(|| format!("{function} {values:?}"))
    }
}

fn handle_of(frame: &TestFrame) -> Option<i32> {
    match frame.args.first()? {
        Value::I4(handle) => Some(*handle),
        _ => None,
    }
}
