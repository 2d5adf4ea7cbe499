//! Who controls a robot: one page at a time, under a visible name.

use std::sync::{Mutex, PoisonError};

/// The number of an open page, which is used once.
pub(crate) type Client = u64;

/// The longest name.
const LONGEST: usize = 40;

/// The holder of the control of a robot.
#[derive(Debug, Default)]
pub(crate) struct Control(Mutex<Option<(Client, String)>>);

impl Control {
    fn with<T>(&self, work: impl FnOnce(&mut Option<(Client, String)>) -> T) -> T {
        work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Takes the control. Only its release, or the loss of the holder's page, frees it for another one.
    pub(crate) fn take(&self, client: Client, name: &str) -> Result<(), String> {
        let name = cleaned(name);
        if name.is_empty() {
            return Err("write your name, so that others see who has the control".into());
        }
        self.with(|holder| match holder {
            Some((other, name)) if *other != client => Err(format!("{name} has the control; ask for its release")),
            holder => {
                *holder = Some((client, name));
                Ok(())
            }
        })
    }

    /// Releases the control if this page has it. Returns whether it had.
    pub(crate) fn release(&self, client: Client) -> bool {
        self.with(|holder| holder.take_if(|(other, _)| *other == client).is_some())
    }

    /// Returns the name of the holder.
    pub(crate) fn holder(&self) -> Option<String> {
        self.with(|holder| holder.as_ref().map(|(_, name)| name.clone()))
    }

    /// Returns the name if this page has the control.
    pub(crate) fn name_of(&self, client: Client) -> Option<String> {
        self.with(|holder| holder.as_ref().filter(|(other, _)| *other == client).map(|(_, name)| name.clone()))
    }
}

/// Returns a name that cannot hide what is next to it: without characters that act on it, and not long.
pub(crate) fn cleaned(name: &str) -> String {
    name.trim().chars().filter(|c| !bcap_terminal::escape::acts(*c)).take(LONGEST).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_page_has_the_control_until_it_is_released_or_lost() {
        let control = Control::default();
        assert_eq!(
            control.take(1, " \u{202e} "),
            Err("write your name, so that others see who has the control".into())
        );
        assert_eq!(control.take(1, " An\u{202e}na "), Ok(()));
        assert_eq!(control.take(2, "Bob"), Err("Anna has the control; ask for its release".into()));
        assert!(!control.release(2));
        assert_eq!((control.holder().as_deref(), control.name_of(2)), (Some("Anna"), None));
        assert!(control.release(1));
        assert_eq!(control.take(2, "Bob"), Ok(()));
    }
}
