//! The terminal of a live screen.

use std::env;
use std::io::{self, IsTerminal as _, Stdout, stdout};
#[cfg(unix)]
use std::os::fd::AsFd;
use std::panic;
use std::time::Duration;

use crossterm::event::{self, Event, KeyEvent, KeyEventKind};
use crossterm::execute;
use crossterm::terminal::{EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode};
use ratatui_core::terminal::Terminal as Drawing;
use ratatui_crossterm::CrosstermBackend;

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

    /// Waits for keys for at most `time`, and returns all pressed keys.
    ///
    /// # Errors
    ///
    /// When the terminal is gone, such as after a lost ssh connection.
    pub fn keys(&self, time: Duration) -> io::Result<Vec<KeyEvent>> {
        if has_input(time)? { pressed() } else { Ok(Vec::new()) }
    }
}

/// Returns the keys that were pressed.
fn pressed() -> io::Result<Vec<KeyEvent>> {
    // a wait is needed to read anything, and it must end, because a read from a lost terminal never returns
    const WAIT: Duration = Duration::from_millis(1);
    let mut keys = Vec::new();
    while event::poll(WAIT)? {
        match event::read()? {
            Event::Key(key) if key.kind != KeyEventKind::Release => keys.push(key),
            _ => {}
        }
    }
    Ok(keys)
}

#[cfg(unix)]
fn has_input(time: Duration) -> io::Result<bool> {
    has_bytes(io::stdin(), time)
}

/// Waits for bytes, because crossterm does not report that a terminal is gone.
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
    use std::fs::File;
    use std::process::{Command, Stdio};
    use std::thread::sleep;
    use std::time::Instant;

    use crossterm::event::KeyCode;
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use rustix::stdio::dup2_stdin;

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
    #[test]
    fn a_terminal_that_is_lost_while_keys_are_read_does_not_hold_the_program() {
        // another process, because it replaces its standard input
        let name = "screen::terminal::tests::a_process_whose_terminal_is_lost";
        let mut process = Command::new(env::current_exe().unwrap());
        let mut process = process.args(["--ignored", "--exact", name]).stdout(Stdio::null()).spawn().unwrap();
        let since = Instant::now();
        let status = loop {
            match process.try_wait().unwrap() {
                Some(status) => break status,
                None if since.elapsed() > Duration::from_secs(60) => {
                    process.kill().unwrap();
                    panic!("it reads a terminal that is gone without end");
                }
                None => sleep(Duration::from_millis(10)),
            }
        };
        assert!(status.success(), "{status}");
    }

    #[test]
    #[ignore = "a part of the test above"]
    fn a_process_whose_terminal_is_lost() {
        let keyboard = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&keyboard).unwrap();
        unlockpt(&keyboard).unwrap();
        let name = ptsname(&keyboard, Vec::new()).unwrap();
        let screen = File::options().read(true).write(true).open(name.to_str().unwrap()).unwrap();
        dup2_stdin(&screen).unwrap();
        drop(screen);
        assert_eq!(pressed().unwrap(), []);
        rustix::io::write(&keyboard, b"q\n").unwrap();
        let key = loop {
            if let [key, ..] = pressed().unwrap()[..] {
                break key;
            }
        };
        assert_eq!(key.code, KeyCode::Char('q'));
        drop(keyboard);
        // an error or nothing, but it returns
        assert!(pressed().is_ok_and(|keys| keys.is_empty()) || pressed().is_err());
    }
}
