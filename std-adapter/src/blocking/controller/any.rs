//! A controller for tools: calls and objects that are known only at run time, and time limits.

use std::io;
use std::ops::ControlFlow;

use bcap_core::bcap::client::Timing;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::procedure::{RecoveryConfig, RecoveryStep};
use bcap_core::time::Instant;
use bcap_core::variant::OwnedVariant;

use super::Controller;
use crate::address::Address;
use crate::blocking::robot::Arm;
use crate::blocking::socket::{ready, wrap};
use crate::blocking::{Connection, KeptMotion, Moving, Transport};
use crate::error::Error;
use crate::path::ObjectPath;
use crate::session::Session;
use crate::settings::{Model, Settings};

impl Controller {
    /// Wraps a connection over which nothing is started: [`call_any`](Self::call_any) makes the calls of the session.
    ///
    /// It is for tools that choose these calls themselves, or that see all bytes on their own transport. After
    /// Service_Start and Controller_Connect it is like any other controller, and releases its open objects when it is
    /// dropped.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// use bcap_std::blocking::{self, Controller};
    /// use bcap_std::core::bcap::FunctionId;
    /// use bcap_std::core::variant::OwnedVariant;
    ///
    /// let connection = blocking::connect_tcp("192.168.0.1:5007", &Default::default())?;
    /// let mut tool = Controller::unopened(connection);
    /// tool.call_any("the session", FunctionId::SERVICE_START, &[OwnedVariant::new("WDT=400")?])?;
    /// let connect = ["", "CaoProv.DENSO.VRC9", "localhost", ""].map(|text| OwnedVariant::new(text).unwrap_or_default());
    /// tool.call_any("the session", FunctionId::CONTROLLER_CONNECT, &connect)?;
    /// let task = tool.open(&"task:Pro1".parse()?)?;
    /// println!("the handle of Pro1 is {task}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn unopened<X>(connection: Connection<X, Vec<u8>>) -> Self
    where
        X: Transport<Error = io::Error> + Send + 'static,
    {
        Self { session: Session::unopened(wrap(connection)), address: None, settings: Settings::new(Model::Rc8) }
    }

    /// Sets where the drop connects once more if the connection was lost while this session had the arm, to halt the robot, switch
    /// the motor off and give the arm back. Without it, a controller over a connection of the caller cannot.
    #[must_use]
    pub fn recover_at(mut self, address: Address, settings: Settings) -> Self {
        (self.address, self.settings) = (Some(address), settings);
        self
    }

    /// Returns whether Controller_Connect has succeeded, so that [`handle`](Self::handle) is a handle.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.session.is_connected()
    }

    /// Makes any call with arguments that are known only at run time, and returns its code and its value; `object` is named
    /// in errors.
    ///
    /// Objects that the call opens are released with the session, unless another call releases them. A reply that is not the
    /// handle of the object is returned as it is.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Refused`] has the code of a refusal.
    pub fn call_any(
        &mut self,
        object: &str,
        function: FunctionId,
        arguments: &[OwnedVariant],
    ) -> Result<(HResult, Option<OwnedVariant>), Error> {
        ready(self.session.call_any(object, function, arguments))
    }

    /// Opens an object and the objects of its path, and returns its handle. Each call opens them anew.
    ///
    /// They are released with the session; [`release`](Self::release) releases one earlier.
    ///
    /// # Errors
    ///
    /// An [`Error`]; the objects of the path that were opened are released then.
    pub fn open(&mut self, path: &ObjectPath) -> Result<i32, Error> {
        ready(self.session.open_object(path))
    }

    /// Returns the arm, which is taken first unless this session has it: by the command `TakeArm` of
    /// [`call_any`](Self::call_any), or by an [`Arm`] that was [kept](Arm::keep).
    ///
    /// # Errors
    ///
    /// An [`Error`]; the arm is not taken then.
    pub fn arm(&mut self) -> Result<Arm<'_>, Error> {
        let taken = self.session.has_arm();
        let robot = self.robot()?;
        if taken { Ok(Arm::new(robot)) } else { robot.take_arm() }
    }

    /// Returns motions that were [kept](Moving::keep), to wait for their end or to halt them.
    ///
    /// # Errors
    ///
    /// [`Error::OtherSession`] for motions of another controller.
    pub fn resume(&mut self, motion: KeptMotion) -> Result<Moving<'_>, Error> {
        if motion.session != self.session.id {
            return Err(Error::OtherSession);
        }
        Ok(Moving { session: &mut self.session, queue: motion.queue })
    }

    /// Same as [`Robot::recover`](crate::blocking::Robot::recover) or, without a configuration,
    /// [`Robot::prepare`](crate::blocking::Robot::prepare), with an observer. It also works with the arm of this session.
    ///
    /// `observe` gets each step with its result: `Err` for a step that the controller does not support, and that is skipped.
    /// The procedure ends when `observe` returns [`ControlFlow::Break`], and undoes its effects.
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::NotRecovered`] with the step, the code and what to do.
    pub fn make_ready(
        &mut self,
        config: Option<RecoveryConfig>,
        observe: impl FnMut(RecoveryStep, Result<(), HResult>) -> ControlFlow<()>,
    ) -> Result<Arm<'_>, Error> {
        ready(self.session.make_ready(config, observe))?;
        Ok(Arm::new(self.robot()?))
    }

    /// Returns whether this session has switched the motor on. The end of the session switches it off.
    #[must_use]
    pub const fn has_motor(&self) -> bool {
        self.session.has_motor()
    }

    /// Leaves the motor as it is at the end of this session, if the session has switched it on without taking the arm. Returns
    /// whether that was so.
    pub const fn leave_motor(&mut self) -> bool {
        self.session.leave_motor()
    }

    /// Returns whether this session has taken the arm. The end of the session gives it back.
    #[must_use]
    pub const fn has_arm(&self) -> bool {
        self.session.has_arm()
    }

    /// Ends the effects of this session on the robot, as its drop does: halts it if it may move, switches the motor off if this
    /// session has switched it on, and gives the arm back.
    ///
    /// # Errors
    ///
    /// An [`Error`]: the robot may still move, or its motor be on. A motor that another client uses stays on without an error.
    pub fn end_arm(&mut self) -> Result<(), Error> {
        ready(self.session.end_arm())
    }

    /// Ends the session as a drop does, and reports whether its effects on the robot were ended.
    ///
    /// # Errors
    ///
    /// An [`Error`] if that was refused, or cannot be verified: the robot may move, the motor may be on, or the arm may be
    /// taken. [`Error::NotEnded`] has the findings after a lost connection.
    pub fn end(mut self) -> Result<(), Error> {
        self.end_now().robot
    }

    /// Releases an object of this session before the session ends. A handle that the session does not have is ignored.
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn release(&mut self, object: Object, handle: i32) -> Result<(), Error> {
        ready(self.session.release_object(object, handle))
    }

    /// Returns the time limits of each call.
    #[must_use]
    pub fn timing(&mut self) -> Timing {
        self.session.connection().client().timing()
    }

    /// Sets the time limits of each further call.
    pub fn set_timing(&mut self, timing: Timing) {
        self.session.connection().client().set_timing(timing);
    }

    /// Sets the moment after which nothing is sent or received, on the transport's clock; for sockets this is
    /// [`now`](crate::now). `None` is no limit.
    ///
    /// A call that has not ended then fails with the I/O error `TimedOut`, and the connection is lost: neither a halt nor
    /// the end of the session is sent. Set no deadline while a robot may move.
    pub fn set_deadline(&mut self, deadline: Option<Instant>) {
        self.session.connection().transport().set_deadline(deadline);
    }
}
