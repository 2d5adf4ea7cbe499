//! The settings of the terminal, which a prompt changes: it reads each key without an echo.

/// The settings of the standard input when it is a terminal.
#[derive(Debug)]
pub(crate) struct Terminal {
    #[cfg(unix)]
    settings: Option<rustix::termios::Termios>,
}

#[cfg(unix)]
impl Terminal {
    /// Saves the current settings.
    pub(crate) fn saved() -> Self {
        Self { settings: rustix::termios::tcgetattr(std::io::stdin()).ok() }
    }

    /// Restores them.
    pub(crate) fn restore(&self) {
        if let Some(settings) = &self.settings {
            // a terminal that has gone needs no settings
            let _ = rustix::termios::tcsetattr(std::io::stdin(), rustix::termios::OptionalActions::Now, settings);
        }
    }
}

#[cfg(not(unix))]
impl Terminal {
    pub(crate) fn saved() -> Self {
        Self {}
    }

    pub(crate) fn restore(&self) {}
}
