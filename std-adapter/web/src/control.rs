//! The control of a robot: one page at a time has it, under a visible name.

use std::sync::Mutex;

use crate::threads::lock;

/// The number of an open page, which is used once.
pub(crate) type Client = u64;

/// Maximum length of a name.
const LONGEST: usize = 40;

/// The holder of the control of a robot.
#[derive(Default)]
pub(crate) struct Control(Mutex<Option<(Client, String)>>);

impl Control {
    /// Takes the control. Only its release, or the loss of the holder's page, frees it for another page.
    pub(crate) fn take(&self, client: Client, name: &str) -> Result<(), String> {
        let name = cleaned(name);
        if name.is_empty() {
            return Err("write your name, so that others see who has the control".into());
        }
        match &mut *lock(&self.0) {
            Some((other, name)) if *other != client => Err(taken(name)),
            holder => {
                *holder = Some((client, name));
                Ok(())
            }
        }
    }

    /// Releases the control if this page has it. Returns the name of its user.
    pub(crate) fn release(&self, client: Client) -> Option<String> {
        lock(&self.0).take_if(|(other, _)| *other == client).map(|(_, name)| name)
    }

    /// Returns the name of the holder.
    pub(crate) fn holder(&self) -> Option<String> {
        lock(&self.0).as_ref().map(|(_, name)| name.clone())
    }

    /// Returns the name of this page's user, or why this page does not have the control.
    pub(crate) fn user(&self, client: Client) -> Result<String, String> {
        match &*lock(&self.0) {
            Some((holder, name)) if *holder == client => Ok(name.clone()),
            Some((_, name)) => Err(taken(name)),
            None => Err("take the control first".into()),
        }
    }
}

fn taken(name: &str) -> String {
    format!("{name} has the control; ask for its release")
}

/// Returns a name that cannot hide the text next to it: shortened, and without characters that act on a terminal.
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
        assert_eq!(control.user(1), Err("take the control first".into()));
        assert_eq!(control.take(1, " An\u{202e}na "), Ok(()));
        assert_eq!(control.take(2, "Bob"), Err("Anna has the control; ask for its release".into()));
        assert_eq!(control.release(2), None);
        assert_eq!((control.holder(), control.user(1)), (Some("Anna".into()), Ok("Anna".into())));
        assert_eq!(control.user(2), Err("Anna has the control; ask for its release".into()));
        assert_eq!(control.release(1).as_deref(), Some("Anna"));
        assert_eq!(control.take(2, "Bob"), Ok(()));
    }
}
