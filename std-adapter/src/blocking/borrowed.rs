//! A controller while its arm is taken.

use bcap_core::bcap::Object;
use bcap_core::variant::{Encode, FromVariant, OwnedVariant};

use super::moving::Moving;
use super::objects::{File, Scan, Task};
use super::robot::Arm;
use super::socket::{Blocking, ready};
use crate::error::Error;
use crate::session::Session;

/// A controller whose arm is taken, from [`Arm::controller`] and [`Moving::controller`]: its variables, commands, tasks and
/// files.
///
/// It cannot take the arm again, and it cannot end the session.
#[derive(Debug)]
pub struct ControllerRef<'a> {
    session: &'a mut Session<Blocking>,
}

impl<'a> ControllerRef<'a> {
    pub(super) const fn new(session: &'a mut Session<Blocking>) -> Self {
        Self { session }
    }

    /// Reads a variable, as [`Controller::read`](super::Controller::read).
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value has another type.
    pub fn read<T: for<'v> FromVariant<'v>>(&mut self, name: &str) -> Result<T, Error> {
        ready(self.session.read(Object::Controller, name))
    }

    /// Reads several variables of any type, as
    /// [`Controller::read_all`](super::Controller::read_all).
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that cannot be read.
    pub fn read_all<const N: usize>(&mut self, names: [&str; N]) -> Result<[OwnedVariant; N], Error> {
        let mut values = std::array::from_fn(|_| OwnedVariant::default());
        for (value, name) in values.iter_mut().zip(names) {
            *value = self.read(name)?;
        }
        Ok(values)
    }

    /// Opens variables, to read them often with [`Scan::read`].
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that does not exist.
    pub fn scan<const N: usize>(&mut self, names: [&str; N]) -> Result<Scan<N>, Error> {
        Scan::open(self.session, names)
    }

    /// Writes a variable, as [`Controller::write`](super::Controller::write).
    ///
    /// # Errors
    ///
    /// An [`Error`]. After [`Error::NoReply`] the value may have been written.
    pub fn write(&mut self, name: &str, value: impl Encode) -> Result<(), Error> {
        ready(self.session.write(Object::Controller, name, value))
    }

    /// Executes a command of the controller, as [`Controller::execute`](super::Controller::execute).
    ///
    /// # Errors
    ///
    /// An [`Error`]; [`Error::Value`] if the value of the reply has another type.
    pub fn execute<T: for<'v> FromVariant<'v>>(&mut self, command: &str, parameter: impl Encode) -> Result<T, Error> {
        ready(self.session.execute(command, parameter))
    }

    /// Returns a task, such as `Pro1`.
    ///
    /// # Errors
    ///
    /// An [`Error`] if the controller has no such task.
    pub fn task(self, name: &str) -> Result<Task<'a>, Error> {
        ready(self.session.task(name))?;
        Ok(Task::new(self.session, name))
    }

    /// Returns a file, which must exist when it is read or written. A path has `\` between its parts.
    #[must_use]
    pub fn file(self, name: &str) -> File<'a> {
        File::new(self.session, name)
    }
}

impl<const N: usize> Scan<N> {
    /// Reads the variables in their order, from `&mut Controller` or from [`Arm::controller`].
    ///
    /// # Errors
    ///
    /// An [`Error`] for the first variable that cannot be read; [`Error::OtherSession`] for another controller than that
    /// of the scan.
    pub fn read<'a>(&self, cell: impl Into<ControllerRef<'a>>) -> Result<[OwnedVariant; N], Error> {
        self.read_in(cell.into().session)
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
    /// if arm.move_to(&Move::line("P1"), Duration::from_secs(30))? == Motion::Arrived {
    ///     arm.controller().write("IO128", true)?; // closes the gripper
    ///     while !arm.controller().read::<bool>("IO129")? { /* it is not closed yet */ }
    /// }
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub const fn controller(&mut self) -> ControllerRef<'_> {
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
    /// let mut moving = arm.start(&Move::line("P1"), Duration::from_secs(30))?;
    /// moving.controller().write("IO128", false)?; // opens the gripper on the way
    /// println!("{:?}", moving.wait()?);
    /// # Ok::<(), bcap_std::Error>(())
    /// ```
    pub const fn controller(&mut self) -> ControllerRef<'_> {
        ControllerRef::new(self.session)
    }
}
