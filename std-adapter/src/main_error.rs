//! The error of `main`.

use std::error::Error;
use std::fmt;

/// An error for `main` to return: the program then prints its text and causes, not its fields.
///
/// Rust prints the error of `main` by `Debug`, which for an [`Error`](crate::Error) shows its fields. `?` converts any error
/// into this type.
///
/// # Examples
///
/// ```no_run
/// use bcap_std::blocking::Controller;
/// use bcap_std::{MainError, Settings};
///
/// fn main() -> Result<(), MainError> {
///     let mut cell = Controller::connect("tcp:192.168.0.1", &Settings::rc9())?;
///     // prints: Error: Controller_GetVariable of I99999: the controller refused: 0x80000204 ...
///     println!("{}", cell.read::<i32>("I99999")?);
///     Ok(())
/// }
/// ```
pub struct MainError(Box<dyn Error + Send + Sync>);

impl<E: Error + Send + Sync + 'static> From<E> for MainError {
    fn from(error: E) -> Self {
        Self(Box::new(error))
    }
}

/// Writes the text, and each cause that the text before does not contain.
impl fmt::Debug for MainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut written = self.0.to_string();
        f.write_str(&written)?;
        let mut source = self.0.source();
        while let Some(error) = source {
            let cause = error.to_string();
            if !written.contains(&cause) {
                write!(f, "\n  caused by: {cause}")?;
                written = cause;
            }
            source = error.source();
        }
        Ok(())
    }
}

impl fmt::Display for MainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.0, f)
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use bcap_core::bcap::FunctionId;

    use super::*;
    use crate::{CallError, ConnectError};

    #[test]
    fn main_prints_the_text_and_new_causes() {
        let source = CallError::Io(io::Error::other("the cable is cut"));
        let lost = crate::Error::NoReply { function: FunctionId::ROBOT_HALT, object: "the robot".into(), source };
        assert_eq!(
            format!("{:?}", MainError::from(lost)),
            "Robot_Halt of the robot: the connection failed: the cable is cut"
        );
        let setup = ConnectError::Setup(io::Error::other("no sockets"));
        let text = format!("{:?}", MainError::from(crate::Error::from(setup)));
        assert_eq!(text.matches("no sockets").count(), 1, "{text}");
    }
}
