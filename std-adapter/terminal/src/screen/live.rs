//! A live screen of a program that serves: a thread draws it, while the runtime serves.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use tokio::sync::oneshot;

use super::{Screen, Terminal};

/// The interval of drawings.
const FRAME: Duration = Duration::from_millis(100);

/// The maximum wait for the thread at the end: a terminal may no longer accept output.
const CLOSE: Duration = Duration::from_millis(500);

/// The thread that draws; dropping this ends it and restores the terminal.
pub struct Live {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

impl Live {
    /// Opens the screen. `screen` gets the keys that were pressed since it was last called, and returns the content to
    /// draw. When the user quits, `quit` is dropped.
    ///
    /// # Errors
    ///
    /// When the terminal cannot be switched to a screen, or no thread can be started.
    pub fn open(
        quit: oneshot::Sender<()>,
        mut screen: impl FnMut(&[KeyCode]) -> Screen + Send + 'static,
    ) -> io::Result<Self> {
        let mut terminal = Terminal::open()?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new().name("screen".into()).spawn(move || {
            let (_quit, mut keys) = (quit, Vec::new());
            while !stopped.load(Ordering::SeqCst) {
                terminal.draw(&screen(&keys))?;
                match pressed(&terminal)? {
                    Some(pressed) => keys = pressed,
                    None => break,
                }
            }
            Ok(())
        })?;
        Ok(Self { stop, thread: Some(thread) })
    }

    /// Ends the thread and restores the terminal.
    ///
    /// # Errors
    ///
    /// The failure that has ended the thread.
    pub fn close(mut self) -> io::Result<()> {
        self.end()
    }

    fn end(&mut self) -> io::Result<()> {
        self.stop.store(true, Ordering::SeqCst);
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let until = Instant::now() + CLOSE;
        while !thread.is_finished() {
            if Instant::now() >= until {
                // a message would wait for the same terminal
                return Ok(());
            }
            thread::sleep(Duration::from_millis(1));
        }
        // a panic has printed its message
        thread.join().unwrap_or_else(|_| Err(io::Error::other("the screen has failed")))
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        // `close` returns the error
        let _ = self.end();
    }
}

/// Waits for keys until the next drawing; `None` if one of them quits.
fn pressed(terminal: &Terminal) -> io::Result<Option<Vec<KeyCode>>> {
    let mut keys = Vec::new();
    for KeyEvent { code, modifiers, .. } in terminal.keys(FRAME)? {
        match (code, modifiers.contains(KeyModifiers::CONTROL)) {
            (KeyCode::Char('c'), true) | (KeyCode::Char('q'), false) => return Ok(None),
            (key, _) => keys.push(key),
        }
    }
    Ok(Some(keys))
}
