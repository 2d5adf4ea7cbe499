//! Reports a link that stops answering during a motion.
//!
//! The timeout of a call is too long for this: a person next to the robot must be warned earlier that nothing monitors it.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;
use std::{io, thread};

use bcap_capture::trace::Packets;

use crate::failure::Failure;
use crate::output::note;
use crate::session::Session;

/// Time without a reply or a keep-alive after which the link is reported as silent.
const LIMIT: Duration = Duration::from_secs(1);

/// Interval at which the link is checked.
const LOOK: Duration = Duration::from_millis(50);

/// Watches the link of a session; the drop ends that.
pub(crate) struct Silence(#[expect(dead_code, reason = "the thread ends when this end is dropped")] Sender<()>);

impl Silence {
    /// Watches the link of a session from now on.
    pub(crate) fn watch(session: &Session) -> Result<Self, Failure> {
        let target = session.link().target()?.to_string();
        let has_second = !session.link().is_serial();
        Ok(Self(watch(session.packets.clone(), target, has_second)?))
    }
}

fn watch(packets: Packets, target: String, has_second: bool) -> io::Result<Sender<()>> {
    let (sender, ended) = channel::<()>();
    thread::Builder::new().name("silence".into()).spawn(move || {
        let halt = if has_second { "Ctrl-C tries to halt it over another connection, " } else { "" };
        let mut reported = false;
        while ended.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
            let is_silent = packets.unanswered().is_some_and(|since| since.elapsed() >= LIMIT);
            if is_silent && !reported {
                note(&format!(
                    "{target} has not answered for {} s: the robot may be moving; {halt}and the emergency stop stops it",
                    LIMIT.as_secs()
                ));
            }
            if reported && !is_silent {
                note(&format!("{target} answers again"));
            }
            reported = is_silent;
        }
    })?;
    Ok(sender)
}
