//! A controller by reference: while its arm is taken, or with a time limit for each call.

use std::time::Duration;

use bcap_core::bcap::Object;
use bcap_core::bcap::call::Call;
use bcap_core::variant::{Encode, FromVariant, OwnedVariant};

use super::limited::Limited;
use super::moving::Moving;
use super::objects::{File, Scan, Task};
use super::robot::Arm;
use super::socket::Blocking;
use crate::error::Error;
use crate::reply::OwnedReply;
use crate::session::{CONTROLLER, RuntimeCall, Session, TimedReading};

/// A controller by reference: its variables, commands, tasks and files. [`Arm::controller`] and [`Moving::controller`] return it
/// while the arm is taken, and [`Controller::within`](super::Controller::within) with a time limit for each call.
///
/// It cannot take the arm again, and it cannot end the session.
#[derive(Debug)]
pub struct ControllerRef<'a> {
    calls: Limited<'a>,
}

impl<'a> ControllerRef<'a> {
    pub(super) const fn new(session: &'a mut Session<Blocking>) -> Self {
        Self { calls: Limited::new(session) }
    }

    /// Limits the time of each call of this reference, and of the tasks and files that it returns.
    ///
    /// A call without a reply in this time fails with [`Error::NoReply`]; the controller may have executed it. The connection
    /// stays usable.
    #[must_use]
    pub const fn within(self, limit: Duration) -> Self {
        Self { calls: self.calls.within(limit) }
    }

    /// Reads a variable, as [`Controller::read`](super::Controller::read).
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value has another type.
    pub fn read<T: for<'v> FromVariant<'v>>(&mut self, name: &str) -> Result<T, Error> {
        self.calls.run(async |session| session.read(Object::Controller, name).await)
    }

    /// Reads several variables of any type, as
    /// [`Controller::read_all`](super::Controller::read_all).
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that cannot be read.
    pub fn read_all<const N: usize>(&mut self, names: [&str; N]) -> Result<[OwnedVariant; N], Error> {
        self.calls.run(async |session| session.read_all(&names).await)
    }

    /// Reads several variables of any type, as [`Controller::read_each`](super::Controller::read_each).
    ///
    /// # Errors
    ///
    /// [`Error::NotConnected`] if the connection was lost before.
    pub fn read_each(&mut self, names: &[&str]) -> Result<Vec<TimedReading>, Error> {
        if let Some(error) = self.calls.session().lost() {
            return Err(error);
        }
        Ok(self.calls.run(async |session| session.read_each(names).await))
    }

    /// Reads a variable until its value meets a condition, as
    /// [`Controller::read_until`](super::Controller::read_until).
    ///
    /// # Errors
    ///
    /// [`Error::NotMet`] after `limit`; the [`Error`] of a reading that fails.
    pub fn read_until<T: for<'v> FromVariant<'v>>(
        &mut self,
        name: &str,
        mut condition: impl FnMut(&T) -> bool,
        limit: Duration,
    ) -> Result<T, Error> {
        self.calls.run(async |session| session.read_until(name, &mut condition, limit).await)
    }

    /// Opens variables, to read them often with [`Scan::read`].
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that does not exist.
    pub fn scan(&mut self, names: &[&str]) -> Result<Scan, Error> {
        self.calls.run(async |session| Scan::open(session, names).await)
    }

    /// Writes a variable, as [`Controller::write`](super::Controller::write).
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::NoReply`] the value may have been written.
    pub fn write(&mut self, name: &str, value: impl Encode) -> Result<(), Error> {
        self.calls.run(async |session| session.write(Object::Controller, name, value).await)
    }

    /// Executes a command of the controller, as [`Controller::execute`](super::Controller::execute).
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    pub fn execute<T: for<'v> FromVariant<'v>>(&mut self, command: &str, parameter: impl Encode) -> Result<T, Error> {
        self.calls.run(async |session| session.execute(command, parameter).await)
    }

    /// Calls any function, as [`Controller::call`](super::Controller::call).
    ///
    /// # Errors
    ///
    /// An [`Error`].
    pub fn call<C: Call<Reply: OwnedReply>>(&mut self, call: C) -> Result<<C::Reply as OwnedReply>::Owned, Error> {
        let call = RuntimeCall::of(&call)?;
        self.calls.run(async |session| session.call_recorded(CONTROLLER, call).await)
    }

    /// Returns a task, such as `Pro1`.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the controller has no such task.
    pub fn task(mut self, name: &str) -> Result<Task<'a>, Error> {
        self.calls.run(async |session| session.task(name).await)?;
        Ok(Task::new(self.calls, name))
    }

    /// Returns a file, which must exist when it is read or written. A path has `\` between its parts.
    #[must_use]
    pub fn file(self, name: &str) -> File<'a> {
        File::new(self.calls, name)
    }
}

impl Scan {
    /// Reads the variables in their order, from `&mut Controller` or from [`Arm::controller`].
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that cannot be read; [`Error::OtherSession`] for another controller than the
    /// scan's.
    pub fn read<'a>(&self, cell: impl Into<ControllerRef<'a>>) -> Result<Vec<OwnedVariant>, Error> {
        cell.into().calls.run(async |session| self.read_in(session).await)
    }
}

impl Arm<'_> {
    /// Returns the controller, to read and write variables while the arm is taken.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # use bcap_std::{Motion, Move, Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// # let mut arm = cell.robot()?.take_arm()?;
    /// if arm.move_to(&Move::line("P1").speed_percent(10.0), Duration::from_secs(30))? == Motion::Arrived {
    ///     arm.controller().write("IO128", true)?; // closes the gripper
    ///     arm.controller().read_until("IO129", |closed: &bool| *closed, Duration::from_secs(2))?;
    /// }
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub fn controller(&mut self) -> ControllerRef<'_> {
        ControllerRef::new(self.session())
    }
}

impl Moving<'_> {
    /// Returns the controller, to read and write variables while the robot moves.
    ///
    /// # Examples
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # use bcap_std::{Move, Settings, blocking::Controller};
    /// # let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
    /// # let mut arm = cell.robot()?.take_arm()?;
    /// let mut moving = arm.start(&Move::line("P1").speed_percent(10.0), Duration::from_secs(30))?;
    /// moving.controller().write("IO128", false)?; // opens the gripper on the way
    /// println!("{:?}", moving.wait()?);
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub const fn controller(&mut self) -> ControllerRef<'_> {
        ControllerRef::new(self.session)
    }
}
