//! The log: events of the libraries go to a callback.

use std::ffi::{CString, c_char, c_void};
use std::fmt::{Debug, Write as _};
use std::io::{self, Write as _};
use std::sync::{Once, PoisonError, RwLock};

use tracing::field::Field;
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

use super::{IN_CALLBACK, enter, is_in_callback};
use crate::status::bcap_status;

/// A failure.
pub const BCAP_LOG_ERROR: i32 = 1;
/// A surprise, such as a robot that was not halted.
pub const BCAP_LOG_WARN: i32 = 2;
/// Connections and sessions.
pub const BCAP_LOG_INFO: i32 = 3;
/// Calls.
pub const BCAP_LOG_DEBUG: i32 = 4;

/// A callback of the log. It gets one of `BCAP_LOG_...` and a text that is valid until it returns. Any thread may call it. It must not
/// call the library, and must not unwind.
pub type bcap_log = Option<unsafe extern "C" fn(level: i32, message: *const c_char, user: *mut c_void)>;

#[derive(Clone, Copy)]
struct Sink {
    callback: unsafe extern "C" fn(i32, *const c_char, *mut c_void),
    user: *mut c_void,
    level: i32,
}

// SAFETY: the library only passes the pointer on; the header says that any thread calls the callback
unsafe impl Send for Sink {}
// SAFETY: as above
unsafe impl Sync for Sink {}

static SINK: RwLock<Option<Sink>> = RwLock::new(None);

/// Sends the log of a level and of more serious ones to a callback; null ends it. When it returns, an earlier callback no longer runs.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_set_log(callback: bcap_log, level: i32, user: *mut c_void) -> bcap_status {
    static ONCE: Once = Once::new();
    enter(|| {
        *SINK.write().unwrap_or_else(PoisonError::into_inner) = callback.map(|callback| Sink { callback, user, level });
        // another subscriber of the program has its own log
        ONCE.call_once(|| drop(tracing::subscriber::set_global_default(Log)));
        Ok(())
    })
}

/// Passes events to the callback.
struct Log;

const fn number(level: Level) -> i32 {
    match level {
        Level::ERROR => BCAP_LOG_ERROR,
        Level::WARN => BCAP_LOG_WARN,
        Level::INFO => BCAP_LOG_INFO,
        _ => BCAP_LOG_DEBUG,
    }
}

/// Returns the message of an event, then its fields as `name=value`.
fn text(event: &Event<'_>) -> String {
    let (mut message, mut fields) = (String::new(), String::new());
    event.record(&mut |field: &Field, value: &dyn Debug| {
        // a String takes all text
        let _ = match field.name() {
            "message" => write!(message, "{value:?}"),
            name => write!(fields, " {name}={value:?}"),
        };
    });
    message + &fields
}

impl Subscriber for Log {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn event(&self, event: &Event<'_>) {
        let level = number(*event.metadata().level());
        if is_in_callback() {
            // the callback has called `exit`, and this thread has the lock
            if level <= BCAP_LOG_WARN {
                let _ = writeln!(io::stderr(), "bcap: {}", text(event));
            }
            return;
        }
        let sink = SINK.read().unwrap_or_else(PoisonError::into_inner);
        let Some(sink) = sink.filter(|sink| level <= sink.level) else { return };
        let Ok(text) = CString::new(text(event).replace('\0', " ")) else { return };
        let _ = IN_CALLBACK.try_with(|running| running.set(true));
        // SAFETY: the caller of `bcap_set_log` promises that it can be called until another callback is set, which needs the lock
        unsafe { (sink.callback)(level, text.as_ptr(), sink.user) };
        let _ = IN_CALLBACK.try_with(|running| running.set(false));
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}
    fn record_follows_from(&self, _: &Id, _: &Id) {}
    fn enter(&self, _: &Id) {}
    fn exit(&self, _: &Id) {}
}
