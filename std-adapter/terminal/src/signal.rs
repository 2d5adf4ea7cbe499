//! The signals that end or suspend a program.

use std::io;
use std::sync::mpsc::{Receiver, channel};
use std::thread;

/// A signal. A later variant outranks an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Signal {
    /// SIGINT: Ctrl-C.
    Interrupt,
    /// SIGTSTP: Ctrl-Z.
    Suspend,
    /// SIGTERM, SIGHUP, SIGQUIT (Ctrl-\), and every other signal that ends a program without a handler and can have one.
    End,
}

/// Handles signals from now on, and returns a receiver of them. Call it before other threads are started that use the terminal.
///
/// The terminal does not stop this thread and those that it starts: for a process in the background, output appears despite
/// `stty tostop`, and input is an error. Otherwise SIGTTOU or SIGTTIN would stop the program in the middle of its work.
///
/// # Errors
///
/// When a handler cannot be installed, or no thread can be started.
pub fn receiver() -> io::Result<Receiver<Signal>> {
    ignore_terminal_stops()?;
    let (sender, receiver) = channel();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    // the handlers are in place before this returns
    let mut sources = {
        let _inside = runtime.enter();
        Sources::new(|_, _| true)?
    };
    thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async { while sender.send(sources.next().await).is_ok() {} });
    })?;
    Ok(receiver)
}

/// Blocks SIGTTIN and SIGTTOU in this thread: a handler cannot help, because the system repeats the read or the write after it.
fn ignore_terminal_stops() -> io::Result<()> {
    #[cfg(unix)]
    {
        use nix::sys::signal::{SigSet, Signal};
        [Signal::SIGTTIN, Signal::SIGTTOU].into_iter().collect::<SigSet>().thread_block()?;
    }
    Ok(())
}

/// Suspends this process, as Ctrl-Z does to a process without a handler; returns when it continues.
pub fn suspend() {
    #[cfg(unix)]
    {
        use rustix::process::{Signal, getpid, kill_process};
        // a process may always signal itself
        let _ = kill_process(getpid(), Signal::STOP);
    }
}

/// The signals that a program can handle, and what they mean; each would end or suspend a program without a handler.
///
/// Not among them: SIGPIPE, which Rust ignores, and the signals of faults, after which a program cannot continue.
#[cfg(unix)]
fn handled() -> impl Iterator<Item = (i32, Signal)> {
    use rustix::process::Signal as Raw;
    let ends = [
        Raw::TERM,
        Raw::HUP,
        Raw::QUIT,
        Raw::USR1,
        Raw::USR2,
        Raw::ALARM,
        Raw::VTALARM,
        Raw::PROF,
        Raw::XCPU,
        Raw::XFSZ,
        Raw::IO,
    ];
    #[cfg(target_os = "linux")]
    let more = [Raw::STKFLT.as_raw(), Raw::POWER.as_raw()].into_iter().chain(REAL_TIME);
    #[cfg(not(target_os = "linux"))]
    let more = std::iter::empty();
    let ends = ends.into_iter().map(Raw::as_raw).chain(more).map(|raw| (raw, Signal::End));
    [(Raw::INT.as_raw(), Signal::Interrupt), (Raw::TSTP.as_raw(), Signal::Suspend)].into_iter().chain(ends)
}

/// The real-time signals that the C library leaves to programs.
#[cfg(target_os = "linux")]
const REAL_TIME: std::ops::RangeInclusive<i32> = 34..=64;

#[cfg(unix)]
struct Sources(Vec<(Signal, tokio::signal::unix::Signal)>);

#[cfg(unix)]
impl Sources {
    /// Handles those signals that `wanted` accepts, by number and meaning.
    fn new(wanted: impl Fn(i32, Signal) -> bool) -> io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        let (mut sources, ignored) = (Vec::new(), Ignored::read());
        for (raw, meaning) in handled().filter(|(raw, meaning)| wanted(*raw, *meaning)) {
            let kind = SignalKind::from_raw(raw);
            // SIGINT and SIGTERM always end a program; a handler for any other ignored signal would end programs started with
            // `nohup`, or by a shell in the background
            let is_required = [SignalKind::interrupt(), SignalKind::terminate()].contains(&kind);
            if !is_required && ignored.has(raw) {
                continue;
            }
            match signal(kind) {
                Ok(source) => sources.push((meaning, source)),
                Err(error) if is_required => return Err(error),
                // the C library keeps it for itself
                Err(_) => {}
            }
        }
        Ok(Self(sources))
    }

    /// Waits for a signal.
    async fn next(&mut self) -> Signal {
        std::future::poll_fn(|context| {
            let received = self
                .0
                .iter_mut()
                .find_map(|(meaning, source)| source.poll_recv(context).is_ready().then_some(*meaning));
            received.map_or(std::task::Poll::Pending, std::task::Poll::Ready)
        })
        .await
    }
}

#[cfg(not(unix))]
struct Sources;

#[cfg(not(unix))]
impl Sources {
    fn new(_: impl Fn(i32, Signal) -> bool) -> io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) -> Signal {
        // without a handler there is no signal
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
        Signal::Interrupt
    }
}

/// Installs the signal handlers, and returns a future that completes on the first signal. Needs a runtime of tokio.
///
/// # Errors
///
/// When a handler cannot be installed.
#[cfg(unix)]
pub fn wait() -> io::Result<impl Future<Output = ()>> {
    // a suspended server continues later
    let mut sources = Sources::new(|_, meaning| meaning != Signal::Suspend)?;
    Ok(async move {
        let _ = sources.next().await;
    })
}

/// Same as [`wait`], but SIGHUP does not complete the future: the second value waits for it.
///
/// # Errors
///
/// When a handler cannot be installed.
#[cfg(unix)]
pub fn wait_without_hang_up() -> io::Result<(impl Future<Output = ()>, HangUp)> {
    use rustix::process::Signal as Raw;
    use tokio::signal::unix::{SignalKind, signal};
    let hang_up = Raw::HUP.as_raw();
    let mut sources = Sources::new(|raw, meaning| meaning != Signal::Suspend && raw != hang_up)?;
    let handled = if Ignored::read().has(hang_up) { None } else { Some(signal(SignalKind::hangup())?) };
    let ended = async move {
        let _ = sources.next().await;
    };
    Ok((ended, HangUp(handled)))
}

/// Same as [`wait`]: there is no SIGHUP on this platform.
///
/// # Errors
///
/// None on this platform.
#[cfg(not(unix))]
pub fn wait_without_hang_up() -> io::Result<(impl Future<Output = ()>, HangUp)> {
    Ok((wait()?, HangUp::default()))
}

/// SIGHUP, if it is handled.
#[derive(Debug, Default)]
pub struct HangUp(#[cfg(unix)] Option<tokio::signal::unix::Signal>);

impl HangUp {
    /// Waits for the signal; forever if it is not handled.
    pub async fn next(&mut self) {
        #[cfg(unix)]
        if let Some(signal) = &mut self.0
            && signal.recv().await.is_some()
        {
            return;
        }
        std::future::pending().await
    }
}

/// The signals that a process ignores: signal 1 is bit 0.
#[cfg(unix)]
struct Ignored(u64);

#[cfg(unix)]
impl Ignored {
    /// Reads the set of this process, once for all signals. Only Linux provides it.
    fn read() -> Self {
        Self::parse(&std::fs::read_to_string("/proc/self/status").unwrap_or_default())
    }

    /// Reads the hexadecimal set `SigIgn` from the text of `/proc/PID/status`.
    fn parse(status: &str) -> Self {
        let set = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
        Self(set.and_then(|set| u64::from_str_radix(set.trim(), 16).ok()).unwrap_or_default())
    }

    fn has(&self, signal: i32) -> bool {
        let bit = u32::try_from(signal - 1).ok().and_then(|shift| 1_u64.checked_shl(shift));
        bit.is_some_and(|bit| self.0 & bit != 0)
    }
}

/// Returns a future that completes on Ctrl-C.
///
/// # Errors
///
/// None on this platform.
#[cfg(not(unix))]
pub fn wait() -> io::Result<impl Future<Output = ()>> {
    Ok(async {
        let _ = tokio::signal::ctrl_c().await;
    })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn an_ignored_signal_is_a_bit_of_its_set() {
        let ignored = Ignored::parse("Name:\tbcap\nSigIgn:\t0000000000081001\nSigCgt:\t0000000000000000\n");
        assert!(ignored.has(1) && ignored.has(20) && !ignored.has(2));
        assert!(!Ignored::parse("SigIgn:\t0000000000001000\nSigCgt:\t0000000000000001\n").has(1));
        assert!(!Ignored::parse("").has(1));
    }
}
