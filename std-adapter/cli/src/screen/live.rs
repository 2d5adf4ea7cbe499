//! A live screen of a command that serves: a thread draws it beside the runtime.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use tokio::sync::oneshot;

use super::{Screen, Terminal};

/// The time from one drawing to the next.
const FRAME: Duration = Duration::from_millis(100);

/// The thread that draws; dropping this ends it and restores the terminal.
pub(crate) struct Live {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Live {
    /// Opens the screen. `screen` gets the keys that were pressed since it was last called, and returns what is drawn. When the
    /// user quits, `quit` is dropped.
    pub(crate) fn open(
        quit: oneshot::Sender<()>,
        mut screen: impl FnMut(&[KeyCode]) -> Screen + Send + 'static,
    ) -> io::Result<Self> {
        let mut terminal = Terminal::open()?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new().name("screen".into()).spawn(move || {
            let (_quit, mut keys) = (quit, Vec::new());
            while !stopped.load(Ordering::SeqCst) {
                match terminal.draw(&screen(&keys)).and_then(|()| pressed(&terminal)) {
                    Ok(Some(pressed)) => keys = pressed,
                    Ok(None) | Err(_) => return,
                }
            }
        })?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            // a panic of the thread has printed its message
            let _ = thread.join();
        }
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
