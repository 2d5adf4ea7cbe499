//! A device as a table of variables: a handler of both protocols in a few lines.
//!
//! A [`Device`] serves the variables of its table over b-CAP and RAC. It answers Service_Start, Controller_Connect, the
//! functions that open, list, read, write and release variables, and no others. A custom
//! [`Handler`] can offer more.

use crate::bcap::server::{Handler, Request};
use crate::bcap::{FunctionId, Object};
use crate::error::EncodeError;
use crate::handler::{Outcome, PeerId, ReplyValue};
use crate::hresult::HResult;
use crate::num::to_u32;
use crate::rac;
use crate::time::Instant;
use crate::variant::{FromVariant, Variant};

/// Reads a variable: sets its value in the reply.
pub type Get<S> = fn(&S, &mut ReplyValue<'_>) -> Result<(), EncodeError>;
/// Writes a variable, or refuses the value with a code.
pub type Put<S> = fn(&mut S, Variant<'_>) -> Result<(), HResult>;

/// Writes a value to its place in the state, for [`DeviceVariable::writable`].
///
/// # Errors
///
/// [`HResult::E_INVALIDARGTYPE`] for a value of another type, or one that does not fit.
pub fn assign<T: for<'a> FromVariant<'a>>(place: &mut T, value: Variant<'_>) -> Result<(), HResult> {
    *place = value.convert().map_err(|_| HResult::E_INVALIDARGTYPE)?;
    Ok(())
}

/// A variable of a [`Device`] with the state `S`.
#[derive(Clone, Copy, Debug)]
pub struct DeviceVariable<S> {
    name: &'static str,
    get: Get<S>,
    put: Option<Put<S>>,
}

impl<S> DeviceVariable<S> {
    /// A variable that can only be read. Over RAC it is found if its name is a type and a number, such as `IO128`.
    #[must_use]
    pub const fn new(name: &'static str, get: Get<S>) -> Self {
        Self { name, get, put: None }
    }

    /// Returns the same variable with a function that writes it.
    #[must_use]
    pub const fn writable(self, put: Put<S>) -> Self {
        Self { put: Some(put), ..self }
    }

    /// Returns whether this is the name of the variable in RAC.
    fn is(&self, variable: rac::Variable) -> bool {
        self.name.parse() == Ok(variable)
    }
}

/// A state, and its variables that clients can access.
///
/// # Examples
///
/// ```
/// use bcap_core::device::{Device, DeviceVariable, assign};
///
/// #[derive(Default)]
/// struct Conveyor {
///     speed: f32,
///     parts: i32,
/// }
///
/// let device = Device::new(Conveyor::default(), [
///     DeviceVariable::new("I1", |conveyor: &Conveyor, reply| reply.set(&conveyor.parts)),
///     DeviceVariable::new("F1", |conveyor: &Conveyor, reply| reply.set(&conveyor.speed))
///         .writable(|conveyor, value| assign(&mut conveyor.speed, value)),
/// ]);
/// assert_eq!(device.state.parts, 0);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Device<S, const N: usize> {
    /// The state.
    pub state: S,
    variables: [DeviceVariable<S>; N],
    /// Number of handles that were issued.
    opened: u16,
}

impl<S, const N: usize> Device<S, N> {
    /// Combines a state and its variables.
    #[must_use]
    pub const fn new(state: S, variables: [DeviceVariable<S>; N]) -> Self {
        Self { state, variables, opened: 0 }
    }

    /// Returns a new handle for the slot of the controller, 0, or of a variable, its index plus 1.
    fn open(&mut self, slot: usize) -> i32 {
        self.opened = self.opened.wrapping_add(1);
        let first = u32::from(self.opened).wrapping_mul(Self::slots());
        first.wrapping_add(to_u32(slot)).cast_signed()
    }

    fn slots() -> u32 {
        to_u32(N).saturating_add(1)
    }

    /// Returns the variable of a handle.
    fn of_handle(&self, handle: i32) -> Option<&DeviceVariable<S>> {
        let slot = handle.cast_unsigned().checked_rem(Self::slots())?.checked_sub(1)?;
        self.variables.get(usize::try_from(slot).ok()?)
    }

    fn get(&self, variable: Option<&DeviceVariable<S>>, reply: &mut ReplyValue<'_>) -> HResult {
        let Some(variable) = variable else { return HResult::E_CAO_OBJECT_NOTFOUND };
        (variable.get)(&self.state, reply).map_or(HResult::E_TOO_MUCH_DATA, |()| HResult::S_OK)
    }
}

/// Returns the function that writes a variable, or the code of the refusal.
fn put_of<S>(variable: Option<&DeviceVariable<S>>) -> Result<Put<S>, HResult> {
    variable.ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?.put.ok_or(HResult::E_ACCESSDENIED)
}

impl<S, const N: usize> Handler for Device<S, N> {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let set = match request.function {
            FunctionId::SERVICE_START | FunctionId::SERVICE_STOP => Ok(()),
            FunctionId::CONTROLLER_CONNECT => reply.set(&self.open(0)),
            FunctionId::CONTROLLER_GET_VARIABLE => {
                let name = request.text(1);
                match self.variables.iter().position(|variable| name.eq_ignore_ascii_case(variable.name)) {
                    Some(index) => reply.set(&self.open(index.saturating_add(1))),
                    None => return HResult::E_CAO_OBJECT_NOTFOUND.into(),
                }
            }
            FunctionId::CONTROLLER_GET_VARIABLE_NAMES => {
                reply.set(&self.variables.each_ref().map(|variable| variable.name)[..])
            }
            FunctionId::VARIABLE_GET_NAME => {
                self.of_handle(request.handle()).map_or(Ok(()), |variable| reply.set(variable.name))
            }
            FunctionId::VARIABLE_GET_VALUE => return self.get(self.of_handle(request.handle()), reply).into(),
            FunctionId::VARIABLE_PUT_VALUE => {
                let put = put_of(self.of_handle(request.handle()));
                return put
                    .and_then(|put| put(&mut self.state, request.value(1)))
                    .err()
                    .unwrap_or(HResult::S_OK)
                    .into();
            }
            // the server has checked the handle, and discards it
            function if matches!(function.releases(), Some(Object::Controller | Object::Variable)) => Ok(()),
            _ => return HResult::E_NOTIMPL.into(),
        };
        set.map_or(HResult::E_TOO_MUCH_DATA, |()| HResult::S_OK).into()
    }
}

impl<S, const N: usize> rac::server::Handler for Device<S, N> {
    fn call(&mut self, _: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let wanted = request.variable();
        let variable = self.variables.iter().find(|variable| variable.is(wanted));
        match request.value() {
            Some(value) => put_of(variable).and_then(|put| put(&mut self.state, value)).err().unwrap_or(HResult::S_OK),
            None => self.get(variable, reply),
        }
        .into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bcap::call::{self, Call};
    use crate::bcap::{Decoder, FrameWriter};

    const PEER: PeerId = PeerId(1);

    #[derive(Default)]
    struct State {
        parts: i32,
        speed: f32,
    }

    fn device() -> Device<State, 2> {
        Device::new(
            State::default(),
            [
                DeviceVariable::new("I1", |state: &State, reply| reply.set(&state.parts)),
                DeviceVariable::new("F12", |state: &State, reply| reply.set(&state.speed))
                    .writable(|state, value| assign(&mut state.speed, value)),
            ],
        )
    }

    fn call(device: &mut Device<State, 2>, call: impl Call) -> (Outcome, Option<i32>) {
        let (mut frame, mut buffer) = ([0; 256], [0; 256]);
        let mut writer = FrameWriter::new(&mut frame).unwrap();
        call.arguments(&mut writer).unwrap();
        let bytes = writer.finish(1, 0, call.function().0).unwrap();
        let frame = Decoder::TCP.decode_datagram(bytes).unwrap();
        let request = Request { function: frame.function(), args: frame.args };
        let mut reply = ReplyValue::new(&mut buffer);
        let outcome = Handler::call(device, PEER, &request, &mut reply, Instant::ZERO);
        let value = reply.get();
        if let Some(names) = value.and_then(|value| value.as_array()) {
            assert_eq!(names.iter().map(|name| name.as_bstr().unwrap().len()).sum::<usize>(), 5);
        }
        (outcome, value.and_then(|value| value.as_i32()))
    }

    const DONE: Outcome = Outcome::Done(HResult::S_OK);

    #[test]
    fn a_table_is_served_over_bcap() {
        let mut device = device();
        assert_eq!(call(&mut device, call::service_start("")), (DONE, None));
        let controller =
            call(&mut device, call::controller_connect("", "", "", "")).1.map(call::ControllerHandle).unwrap();
        assert_eq!(call(&mut device, call::controller_get_variable_names(controller, "")).0, DONE);
        let open = |device: &mut _, name| {
            call(device, call::controller_get_variable(controller, name, "")).1.map(call::VariableHandle)
        };
        let (parts, speed) = (open(&mut device, "i1").unwrap(), open(&mut device, "F12").unwrap());
        assert_ne!(open(&mut device, "F12").unwrap(), speed, "each handle is released on its own");
        assert_eq!(open(&mut device, "F1"), None);
        device.state.parts = 7;
        assert_eq!(call(&mut device, call::variable_get_value(parts)), (DONE, Some(7)));
        assert_eq!(call(&mut device, call::variable_put_value(speed, 2)), (DONE, None));
        assert_eq!(device.state.speed, 2.0);
        let refused = |code: HResult| (Outcome::from(code), None);
        assert_eq!(call(&mut device, call::variable_put_value(parts, 1)), refused(HResult::E_ACCESSDENIED));
        assert_eq!(call(&mut device, call::variable_put_value(speed, "x")), refused(HResult::E_INVALIDARGTYPE));
        assert_eq!(call(&mut device, call::variable_release(speed)), (DONE, None));
        assert_eq!(call(&mut device, call::controller_get_robot_names(controller, "")), refused(HResult::E_NOTIMPL));
    }

    #[test]
    fn a_table_is_served_over_rac() {
        let mut device = device();
        device.state.parts = 9;
        let mut buffer = [0; 64];
        let mut serve = |device: &mut _, request| {
            let mut reply = ReplyValue::new(&mut buffer);
            let outcome = rac::server::Handler::call(device, PEER, &request, &mut reply, Instant::ZERO);
            (outcome, reply.get().and_then(|value| value.as_i32()))
        };
        let (i1, f12) = (rac::Variable::new(rac::VariableKind::I, 1), rac::Variable::new(rac::VariableKind::F, 12));
        assert_eq!(serve(&mut device, rac::Request::Get(i1)), (DONE, Some(9)));
        assert_eq!(serve(&mut device, rac::Request::Put(f12, Variant::R4(1.5))), (DONE, None));
        assert_eq!(device.state.speed, 1.5);
        let missing = rac::Request::Get(rac::Variable::new(rac::VariableKind::F, 1));
        assert_eq!(serve(&mut device, missing), (HResult::E_CAO_OBJECT_NOTFOUND.into(), None));
    }
}
