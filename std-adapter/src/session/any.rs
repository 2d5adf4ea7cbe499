//! A session for tools: calls and objects that are known only at run time.

use std::io;
use std::marker::PhantomData;

use bcap_core::bcap::call::{Call, ControllerHandle, Maybe, Reply, RobotHandle};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::io::asynch::{Connection, Transport};
use bcap_core::procedure;
use bcap_core::variant::{OwnedVariant, Variant};

use super::{Release, Session};
use crate::error::Error;
use crate::path::ObjectPath;
use crate::reply::OwnedReply;

/// A call whose function and arguments are values, with the reply `R`.
#[derive(Debug)]
pub(crate) struct RuntimeCall<R = Maybe, A = Vec<OwnedVariant>> {
    pub(crate) function: FunctionId,
    pub(crate) arguments: A,
    reply: PhantomData<fn() -> R>,
}

impl<R: Reply, A: AsRef<[OwnedVariant]>> RuntimeCall<R, A> {
    pub(crate) const fn new(function: FunctionId, arguments: A) -> Self {
        Self { function, arguments, reply: PhantomData }
    }
}

impl<R: Reply> RuntimeCall<R> {
    /// Copies a typed call, whose arguments may borrow.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an argument that cannot be sent.
    pub(crate) fn of(call: &impl Call<Reply = R>) -> Result<Self, Error> {
        let mut memory = vec![0; 512];
        let arguments = loop {
            match encoded(call, &mut memory) {
                Err(EncodeError::Full) if memory.len() < MAX_CALL => memory.resize(memory.len() * 8, 0),
                arguments => break arguments.map_err(Error::Argument)?,
            }
        };
        Ok(Self::new(call.function(), arguments))
    }
}

/// The maximum size of a request: 16 MiB and its header.
const MAX_CALL: usize = 17 << 20;

/// Encodes the arguments of a call, and copies them.
fn encoded(call: &impl Call, memory: &mut [u8]) -> Result<Vec<OwnedVariant>, EncodeError> {
    let mut frame = FrameWriter::new(memory)?;
    call.arguments(&mut frame)?;
    let bytes = frame.finish(0, 0, call.function().0)?;
    // what the writer has written can be read
    let frame = Decoder::TCP.decode_datagram(bytes).map_err(|_| EncodeError::Full)?;
    Ok(frame.args.iter().map(OwnedVariant::from).collect())
}

impl<R: Reply, A: AsRef<[OwnedVariant]>> Call for RuntimeCall<R, A> {
    type Reply = R;

    fn function(&self) -> FunctionId {
        self.function
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.arguments.as_ref().iter().try_for_each(|argument| frame.argument(argument))
    }
}

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Returns the connection, for its timing and its transport.
    pub(crate) const fn connection(&mut self) -> &mut Connection<X, Vec<u8>> {
        &mut self.connection
    }

    /// Returns whether Controller_Connect has succeeded.
    pub(crate) fn is_connected(&self) -> bool {
        self.opened.iter().any(|(object, _)| *object == Object::Controller)
    }

    /// Makes a call, and returns its code and a copy of its value. Objects that it opens or releases are recorded.
    pub(crate) async fn call_any(
        &mut self,
        object: &str,
        function: FunctionId,
        arguments: &[OwnedVariant],
    ) -> Result<(HResult, Option<OwnedVariant>), Error> {
        let value = self.call_recorded(object, RuntimeCall::<Maybe, _>::new(function, arguments)).await?;
        Ok((self.connection.last_result().unwrap_or_default(), value))
    }

    /// Makes a call, and returns a copy of its value. Objects that it opens or releases are recorded, as are its effects on the
    /// arm.
    pub(crate) async fn call_recorded<R: OwnedReply, A: AsRef<[OwnedVariant]>>(
        &mut self,
        object: &str,
        call: RuntimeCall<R, A>,
    ) -> Result<R::Owned, Error> {
        let (function, arguments) = (call.function, call.arguments.as_ref());
        let called = self.call(object, &call).await.map(R::owned);
        let may_have_run = !matches!(called, Err(Error::Refused { .. } | Error::NotConnected { .. }));
        self.record_arm(function, arguments, called.is_ok(), may_have_run);
        let value = called?;
        match (function.opens(), function.releases()) {
            (Some(Object::Service), _) => self.opened.push((Object::Service, 0)),
            (_, Some(Object::Service)) => {
                self.opened.clear();
                self.arm = None;
                self.forget_handles();
            }
            (Some(opened), _) => {
                let first = self.connection.client().reply().and_then(|reply| reply.args.get(0));
                let new = first.as_ref().and_then(handle_of);
                new.into_iter().for_each(|new| self.record(opened, new));
            }
            (_, Some(object)) => {
                arguments.first().and_then(handle).into_iter().for_each(|old| self.forget(object, old))
            }
            (None, None) => {}
        }
        Ok(value)
    }

    /// Records an object that a call has opened. Calls refer to the controller that was connected last.
    fn record(&mut self, object: Object, handle: i32) {
        if object == Object::Controller {
            self.forget_handles();
            self.handle = ControllerHandle(handle);
        }
        self.opened.push((object, handle));
    }

    /// Records what a call of the robot does to the arm, so that the end of the session gives it back.
    ///
    /// A call without a reply may have been executed.
    fn record_arm(&mut self, function: FunctionId, arguments: &[OwnedVariant], succeeded: bool, may_have_run: bool) {
        let text = |index: usize| arguments.get(index).and_then(|value| value.as_variant().as_bstr());
        let command = text(1).map(|command| command.to_string().to_ascii_lowercase()).unwrap_or_default();
        match (function, command.as_str()) {
            (FunctionId::ROBOT_EXECUTE, "takearm") if may_have_run => {
                // the arm is given back over the robot that has it
                self.robot = arguments.first().and_then(handle).map(RobotHandle).or(self.robot);
                self.arm.get_or_insert_default();
            }
            (FunctionId::ROBOT_EXECUTE, "givearm") if succeeded => self.arm = None,
            (FunctionId::ROBOT_EXECUTE, "motor") => {
                let on = arguments.get(2).is_some_and(|parameter| is_on(parameter.as_variant()));
                if let Some(arm) = self.arm.as_mut().filter(|_| on || succeeded) {
                    arm.motor = on;
                }
            }
            (FunctionId::ROBOT_EXECUTE, "takearm") => {}
            (FunctionId::ROBOT_EXECUTE, "slvchangemode") => {
                let mode = arguments.get(2).and_then(handle);
                self.set_streaming(mode != Some(0) || !succeeded);
            }
            (
                FunctionId::ROBOT_EXECUTE
                | FunctionId::ROBOT_MOVE
                | FunctionId::ROBOT_DRIVE
                | FunctionId::ROBOT_ROTATE
                | FunctionId::ROBOT_GO_HOME,
                _,
            ) => self.set_moving(true),
            _ => {}
        }
    }

    /// Returns whether this session has taken the arm.
    pub(crate) const fn has_arm(&self) -> bool {
        self.arm.is_some()
    }

    /// Opens all objects of a path, and returns the handle of the last one.
    pub(crate) async fn open_object(&mut self, path: &ObjectPath) -> Result<i32, Error> {
        let (name, steps) = (path.to_string(), path.steps());
        let wrong = |error: procedure::PathError| Error::Reply {
            function: FunctionId::CONTROLLER_CONNECT,
            object: name.clone(),
            reason: error.to_string(),
        };
        let opening = procedure::open_path(self.handle, &steps).map_err(wrong)?;
        let opened = self.run(&name, opening).await?;
        let handle = opened.handle().unwrap_or(self.handle.0);
        self.opened.extend_from_slice(&opened);
        Ok(handle)
    }

    /// Releases an object of this session; another handle is ignored.
    pub(crate) async fn release_object(&mut self, object: Object, handle: i32) -> Result<(), Error> {
        if !self.opened.contains(&(object, handle)) {
            return Ok(());
        }
        self.forget(object, handle);
        self.call(object.name(), Release { object, handle }).await
    }

    /// Removes an object that the controller has released.
    fn forget(&mut self, object: Object, handle: i32) {
        self.opened.retain(|opened| *opened != (object, handle));
        match object {
            Object::Variable => {
                self.variables.values_mut().for_each(|names| names.retain(|_, variable| variable.0 != handle));
            }
            Object::Robot | Object::Controller => {
                // the controller gives the arm back with the robot that has it
                if object == Object::Controller || self.robot == Some(RobotHandle(handle)) {
                    self.arm = None;
                }
                self.forget_handles();
            }
            _ => {
                self.variables.remove(&(object, handle));
                self.objects.retain(|(kind, ..), open| (*kind, *open) != (object, handle));
            }
        }
    }

    /// Removes the handles that are kept for the next use. Their objects stay open until the end of the session.
    fn forget_handles(&mut self) {
        self.robot = None;
        self.variables.clear();
        self.objects.clear();
    }
}

/// Returns whether the parameter of the command `Motor` switches the motor on: its first number is not 0.
fn is_on(parameter: Variant<'_>) -> bool {
    let first = parameter.as_array().map_or(Some(parameter), |array| array.iter().next());
    first.and_then(|number| number.as_i32()) != Some(0)
}

/// Returns a handle: an I4, or a UI4 of the same bits.
fn handle(value: &OwnedVariant) -> Option<i32> {
    handle_of(&value.as_variant())
}

fn handle_of(value: &Variant<'_>) -> Option<i32> {
    match value {
        Variant::Ui4(handle) => Some(handle.cast_signed()),
        value => value.as_i32(),
    }
}
