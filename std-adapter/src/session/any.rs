//! A session for tools: calls and objects that are known only at run time.

use std::io;
use std::marker::PhantomData;

use bcap_core::bcap::call::{Any, Call, ControllerHandle, Maybe, Reply, RobotHandle, VariableHandle};
use bcap_core::bcap::{Decoder, FrameWriter, FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::io::asynch::{Connection, Transport};
use bcap_core::procedure;
use bcap_core::variant::{Encode, FromVariant, OwnedVariant, Variant};

use super::arm::{ArmEffect, ArmState};
use super::{Objects, Release, Session, is_motor_switch};
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
    // the bytes of the writer can be read
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
        self.objects.opened.iter().any(|(object, _)| *object == Object::Controller)
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
        if let Some(released) = function.releases() {
            self.end_arm_before(released, arguments.first().and_then(handle)).await?;
        }
        let (effect, before) = (self.arm_effect(function, arguments), self.arm);
        if let Some(effect) = effect {
            self.arm_begins(effect, function, arguments);
        }
        let called = self.call(object, &call).await.map(R::owned);
        if let Some(effect) = effect {
            self.arm_ended(effect, before, called.as_ref().map(drop));
        }
        let value = called?;
        match (function.opens(), function.releases()) {
            (Some(Object::Service), _) => self.objects.opened.push((Object::Service, 0)),
            (_, Some(Object::Service)) => {
                self.objects = Objects::default();
                self.arm = ArmState::default();
            }
            (Some(opened), _) => {
                let first = self.connection.client().reply().and_then(|reply| reply.args.get(0));
                let new = first.as_ref().and_then(handle_of);
                let name = arguments.get(1).and_then(|name| name.as_variant().as_bstr().map(|name| name.to_string()));
                new.into_iter().for_each(|new| self.record(opened, new, name.as_deref()));
            }
            (_, Some(object)) => {
                arguments.first().and_then(handle).into_iter().for_each(|old| self.forget(object, old))
            }
            (None, None) => {}
        }
        Ok(value)
    }

    /// Records an object that a call has opened. Calls refer to the controller that was connected last.
    fn record(&mut self, object: Object, handle: i32, name: Option<&str>) {
        if object == Object::Controller {
            self.forget_handles();
            self.handle = ControllerHandle(handle);
        }
        if object == Object::Variable && name.is_some_and(is_motor_switch) {
            self.objects.motor_switches.push(VariableHandle(handle));
        }
        self.objects.opened.push((object, handle));
    }

    /// Executes a command of the controller or a robot for the caller. Its effect on the arm is recorded, so that the end of the
    /// session undoes it.
    pub(crate) async fn execute_recorded<T: for<'a> FromVariant<'a>>(
        &mut self,
        (function, owner): (FunctionId, i32),
        command: &str,
        parameter: impl Encode,
    ) -> Result<T, Error> {
        let arguments = [OwnedVariant::new(&owner)?, OwnedVariant::new(command)?, OwnedVariant::new(&parameter)?];
        let value = self.call_recorded(command, RuntimeCall::<Any, _>::new(function, &arguments)).await?;
        value.convert().map_err(|source| Error::Value { object: command.to_owned(), source })
    }

    /// Returns the effect of a call on the arm.
    fn arm_effect(&self, function: FunctionId, arguments: &[OwnedVariant]) -> Option<ArmEffect> {
        let argument = |index: usize| arguments.get(index).map_or(Variant::Empty, OwnedVariant::as_variant);
        if function == FunctionId::VARIABLE_PUT_VALUE {
            let variable = VariableHandle(handle_of(&argument(0))?);
            let on = argument(1).as_bool() != Some(false);
            return self.objects.motor_switches.contains(&variable).then_some(ArmEffect::Motor(on));
        }
        let command = argument(1).as_bstr().map(|command| command.to_string()).unwrap_or_default();
        ArmEffect::of(function, &command, argument(2))
    }

    /// Records a call before it is sent, because it may be executed although it is abandoned or has no reply.
    fn arm_begins(&mut self, effect: ArmEffect, function: FunctionId, arguments: &[OwnedVariant]) {
        let takes = matches!(effect, ArmEffect::Take | ArmEffect::Motor(true)) && !self.has_arm();
        if takes && function == FunctionId::ROBOT_EXECUTE {
            // its effect is undone over the same handle of the robot
            self.objects.robot = arguments.first().and_then(handle).map(RobotHandle).or(self.objects.robot);
            self.objects.paths.clear();
        }
        self.arm.begin(effect);
    }

    /// Records a call that was answered, or was not sent; `before` is the state before it.
    pub(super) fn arm_ended(&mut self, effect: ArmEffect, before: ArmState, ended: Result<(), &Error>) {
        match (effect, ended) {
            (effect, Ok(())) => self.arm.succeed(effect),
            // abandoned; it may still be executed
            (_, Err(Error::Refused { code: HResult::E_TIMEOUT, .. })) => {}
            (ArmEffect::Take | ArmEffect::Motor(true), Err(Error::Refused { .. } | Error::NotConnected { .. })) => {
                self.arm = before;
            }
            _ => {}
        }
    }

    /// Returns whether this session has taken the arm, and has not tried to give it back.
    pub(crate) const fn has_arm(&self) -> bool {
        self.arm.taken && !self.arm.unanswered
    }

    /// Returns whether the end of this session has something to undo on the robot.
    #[cfg(feature = "tokio")]
    pub(crate) const fn uses_robot(&self) -> bool {
        self.arm.is_used()
    }

    /// Returns whether this session has switched the motor on.
    pub(crate) const fn has_motor(&self) -> bool {
        self.arm.motor
    }

    /// Leaves the motor as it is at the end of this session, if the arm is not taken. Returns whether it was switched on here.
    pub(crate) const fn leave_motor(&mut self) -> bool {
        let leaves = self.arm.motor && !self.arm.taken;
        self.arm.motor &= !leaves;
        leaves
    }

    /// Undoes the effects on the robot before the release of an object that the undo needs.
    async fn end_arm_before(&mut self, released: Object, handle: Option<i32>) -> Result<(), Error> {
        let is_needed = match released {
            Object::Robot => handle.map(RobotHandle) == self.objects.robot,
            Object::Service | Object::Controller => true,
            _ => false,
        };
        if is_needed { self.end_arm().await } else { Ok(()) }
    }

    /// Opens all objects of a path, and returns the handle of the last object.
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
        if path.object() == Object::Variable && is_motor_switch(&name) {
            self.objects.motor_switches.push(VariableHandle(handle));
        }
        self.objects.opened.extend_from_slice(&opened);
        Ok(handle)
    }

    /// Releases an object of this session; another handle is ignored.
    pub(crate) async fn release_object(&mut self, object: Object, handle: i32) -> Result<(), Error> {
        if !self.objects.opened.contains(&(object, handle)) {
            return Ok(());
        }
        self.end_arm_before(object, Some(handle)).await?;
        self.forget(object, handle);
        self.call(object.name(), Release { object, handle }).await
    }

    /// Removes an object that the controller has released.
    fn forget(&mut self, object: Object, handle: i32) {
        self.objects.opened.retain(|opened| *opened != (object, handle));
        self.objects.paths.clear();
        match object {
            Object::Variable => {
                self.objects.variables.values_mut().for_each(|names| names.retain(|_, variable| variable.0 != handle));
                self.objects.motor_switches.retain(|variable| variable.0 != handle);
            }
            Object::Robot | Object::Controller => {
                // releasing the robot that owns the arm gives the arm back
                if object == Object::Controller || self.objects.robot == Some(RobotHandle(handle)) {
                    self.arm = self.arm.without_arm();
                }
                self.forget_handles();
            }
            _ => {
                self.objects.variables.remove(&(object, handle));
                self.objects.others.retain(|(kind, ..), open| (*kind, *open) != (object, handle));
            }
        }
    }

    /// Removes the handles that are kept for the next use. Their objects stay open until the end of the session.
    fn forget_handles(&mut self) {
        self.objects.robot = None;
        self.objects.variables.clear();
        self.objects.paths.clear();
        self.objects.others.clear();
    }
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
