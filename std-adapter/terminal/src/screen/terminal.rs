//! The terminal of a live screen.

use std::env;
use std::io::{self, IsTerminal as _, Stdout, stdout};
#[cfg(unix)]
use std::os::fd::AsFd;
use std::panic;
use std::time::Duration;

use ratatui_core::terminal::Terminal as Drawing;
use ratatui_crossterm::CrosstermBackend;
use ratatui_crossterm::crossterm::event::{self, Event, KeyEvent, KeyEventKind};
use ratatui_crossterm::crossterm::execute;
use ratatui_crossterm::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};

use super::draw::{Look, draw};
use super::parts::Screen;

/// A terminal that shows a live screen; dropping this restores it. A panic and a signal restore it too.
pub struct Terminal {
    inner: Drawing<CrosstermBackend<Stdout>>,
    look: Look,
}

/// Checks that the output is a terminal that can move its cursor; `instead` names the alternative.
///
/// # Errors
///
/// A message with the reason and with `instead`.
pub fn require(instead: &str) -> Result<(), String> {
    let terminal = env::var("TERM").unwrap_or_default();
    if terminal == "dumb" {
        return Err(format!(
            "TERM=dumb: this terminal cannot move its cursor, which a live screen needs; set TERM to what the terminal is, or \
             {instead}"
        ));
    }
    if !io::stdout().is_terminal() || !io::stdin().is_terminal() {
        return Err(format!("a live screen needs a terminal as input and output; {instead}"));
    }
    Ok(())
}

impl Terminal {
    /// Switches to the alternate screen. A panic restores the terminal before its message is printed.
    ///
    /// # Errors
    ///
    /// When the terminal cannot be switched.
    pub fn open() -> io::Result<Self> {
        let hook = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            // the message of the panic is more useful than an error of the terminal
            let _ = restore();
            hook(info);
        }));
        enable_raw_mode()?;
        execute!(stdout(), EnterAlternateScreen)?;
        Ok(Self { inner: Drawing::new(CrosstermBackend::new(stdout()))?, look: look() })
    }

    /// Draws a screen.
    ///
    /// # Errors
    ///
    /// When the terminal does not accept output.
    pub fn draw(&mut self, screen: &Screen) -> io::Result<()> {
        self.inner.draw(|frame| draw(screen, self.look, frame)).map(drop)
    }

    /// Waits for keys at most this long, and returns all that were pressed.
    ///
    /// # Errors
    ///
    /// When the terminal is gone, such as after a lost ssh connection.
    pub fn keys(&self, time: Duration) -> io::Result<Vec<KeyEvent>> {
        let mut keys = Vec::new();
        if !has_input(time)? {
            return Ok(keys);
        }
        while event::poll(Duration::ZERO)? {
            match event::read()? {
                Event::Key(key) if key.kind != KeyEventKind::Release => keys.push(key),
                _ => {}
            }
        }
        Ok(keys)
    }
}

#[cfg(unix)]
fn has_input(time: Duration) -> io::Result<bool> {
    has_bytes(io::stdin(), time)
}

/// Waits for bytes. crossterm would read a terminal that is gone without end, so it is asked only when there are some: not after a
/// signal has ended the wait, because that is the signal of a terminal that is gone.
#[cfg(unix)]
fn has_bytes(input: impl AsFd, time: Duration) -> io::Result<bool> {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let mut inputs = [PollFd::new(&input, PollFlags::IN)];
    let time = Timespec::try_from(time).map_err(io::Error::other)?;
    match poll(&mut inputs, Some(&time)) {
        Ok(_) => {}
        Err(rustix::io::Errno::INTR) => return Ok(false),
        Err(error) => return Err(error.into()),
    }
    let found = inputs[0].revents();
    if found.intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL) {
        return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the terminal is gone"));
    }
    Ok(found.contains(PollFlags::IN))
}

#[cfg(not(unix))]
fn has_input(time: Duration) -> io::Result<bool> {
    event::poll(time)
}

fn restore() -> io::Result<()> {
    disable_raw_mode()?;
    execute!(stdout(), LeaveAlternateScreen)
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // a terminal that is gone cannot be restored
        let _ = restore();
    }
}

/// Reads the capabilities of the terminal: `NO_COLOR`, and the character set of the locale.
fn look() -> Look {
    let set = |name: &str| env::var(name).ok().filter(|value| !value.is_empty());
    let locale = set("LC_ALL").or_else(|| set("LC_CTYPE")).or_else(|| set("LANG")).unwrap_or_default().to_lowercase();
    let unicode = !cfg!(unix) || locale.contains("utf-8") || locale.contains("utf8");
    Look { colour: set("NO_COLOR").is_none(), unicode }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_that_is_gone_is_an_error_and_never_asked_for_keys() {
        use std::io::Write as _;
        let (input, mut keyboard) = std::os::unix::net::UnixStream::pair().unwrap();
        assert!(!has_bytes(&input, Duration::ZERO).unwrap());
        keyboard.write_all(b"q").unwrap();
        assert!(has_bytes(&input, Duration::ZERO).unwrap());
        drop(keyboard);
        // even with a key that was pressed before
        assert_eq!(has_bytes(&input, Duration::ZERO).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
    }
}
