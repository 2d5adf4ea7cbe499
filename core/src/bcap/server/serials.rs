//! Classifies a request on a lossy link by its serials: as new, as a copy, or as the start of a session.
//!
//! Every attempt of a call carries the serial of the first attempt, its *marker* (b-CAP specification, Table 6-1). A copy of a
//! call has the marker and the function of the original. `docs/udp-sessions.md` lists every case; `cells.rs` tests each of
//! them.

use core::time::Duration;

use crate::bcap::FunctionId;
use crate::time::Instant;

/// A marker up to this far below the newest one of a session belongs to an older call of the session.
const OLD_MARKERS: u16 = 1024;

/// How long after the first call of a session the network may deliver copies of its Service_Start.
const RESTART_AFTER: Duration = Duration::from_secs(2);

/// One attempt of a call.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attempt {
    pub(super) function: FunctionId,
    /// The serial of the call's first attempt.
    pub(super) marker: u16,
    pub(super) serial: u16,
    /// A checksum of the arguments of Service_Start; 0 for other functions.
    pub(super) arguments: u16,
}

impl Attempt {
    /// Returns whether it has the marker and the function of a call.
    fn is_of(&self, marker: u16, function: FunctionId) -> bool {
        (self.marker, self.function) == (marker, function)
    }
}

/// The treatment of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Execute it, or refuse it while another call runs.
    New,
    /// End the previous session and execute it: a Service_Start that begins a session.
    Begin,
    /// Reply S_EXECUTING.
    Executing,
    /// Send the last reply again.
    Repeat,
    /// Drop it: the call has ended, and its client has sent another call since.
    Drop,
}

/// The serials of a session's latest requests.
#[derive(Clone, Copy, Debug)]
pub(super) struct Serials {
    /// Whether the link preserves the order of frames.
    is_ordered: bool,
    last: Option<Last>,
    /// The checksum of the arguments of the last Service_Start.
    start_arguments: u16,
    service: Option<Service>,
}

/// The last call that got a reply.
#[derive(Clone, Copy, Debug)]
struct Last {
    marker: u16,
    function: FunctionId,
    /// Whether its reply can be sent again.
    is_kept: bool,
}

/// A session, from a successful Service_Start to Service_Stop.
#[derive(Clone, Copy, Debug)]
struct Service {
    /// The marker of Service_Start.
    marker: u16,
    /// The newest call that was executed. Refused calls do not count: otherwise one forged request could make the client's
    /// calls look old.
    newest: (u16, FunctionId),
    /// The first call after Service_Start: when it arrived, and its marker.
    first_call: Option<(Instant, u16)>,
}

impl Serials {
    pub(super) const fn new(is_ordered: bool) -> Self {
        Self { is_ordered, last: None, start_arguments: 0, service: None }
    }

    /// Classifies a request while the call with the marker and function of `running` runs.
    pub(super) fn judge(&self, attempt: &Attempt, running: Option<(u16, FunctionId)>, now: Instant) -> Verdict {
        let is_running = running.is_some_and(|(marker, function)| attempt.is_of(marker, function));
        if attempt.function == FunctionId::SERVICE_START {
            return if is_running && attempt.arguments == self.start_arguments {
                Verdict::Executing
            } else {
                self.judge_start(attempt, now)
            };
        }
        if is_running {
            return Verdict::Executing;
        }
        if running.is_none() && self.is_last_and_kept(attempt) {
            return Verdict::Repeat;
        }
        let is_lost = running.is_none() && self.is_last(attempt);
        match &self.service {
            Some(service) if is_lost || service.is_old(attempt) => Verdict::Drop,
            // without a session nothing is a copy, so a forged request cannot suppress a client's requests
            _ => Verdict::New,
        }
    }

    /// Classifies a Service_Start that is not an attempt of the running call.
    fn judge_start(&self, attempt: &Attempt, now: Instant) -> Verdict {
        let Some(service) = self.service else { return Verdict::Begin };
        if attempt.marker != service.marker || attempt.arguments != self.start_arguments {
            return Verdict::Begin;
        }
        let Some((at, next)) = service.first_call else {
            return if self.is_last_and_kept(attempt) { Verdict::Repeat } else { Verdict::Begin };
        };
        // each attempt takes the next serial, so the serials of Service_Start are below the marker of the first call
        let could_be_a_copy = attempt.serial.wrapping_sub(service.marker) < next.wrapping_sub(service.marker);
        if could_be_a_copy && !self.is_ordered && now.saturating_since(at) < RESTART_AFTER {
            Verdict::Drop
        } else {
            Verdict::Begin
        }
    }

    fn is_last(&self, attempt: &Attempt) -> bool {
        self.last.is_some_and(|last| attempt.is_of(last.marker, last.function))
    }

    fn is_last_and_kept(&self, attempt: &Attempt) -> bool {
        self.is_last(attempt) && self.last.is_some_and(|last| last.is_kept)
    }

    /// Records that the handler is called for a request.
    pub(super) fn began(&mut self, attempt: &Attempt, now: Instant) {
        if attempt.function == FunctionId::SERVICE_START {
            self.start_arguments = attempt.arguments;
        } else if let Some(service) = &mut self.service {
            service.newest = (attempt.marker, attempt.function);
            service.first_call.get_or_insert((now, attempt.marker));
        }
    }

    /// Records that a call got its reply, and whether it succeeded.
    pub(super) fn answered(&mut self, marker: u16, function: FunctionId, is_done: bool) {
        if function == FunctionId::SERVICE_START {
            if !is_done {
                // not sent again: it could be mistaken for the reply to one with the same marker and other options
                return self.forget_reply();
            }
            self.service = Some(Service { marker, newest: (marker, function), first_call: None });
        }
        self.last = Some(Last { marker, function, is_kept: true });
    }

    /// Records that the last reply cannot be sent again.
    pub(super) const fn forget_reply(&mut self) {
        if let Some(last) = &mut self.last {
            last.is_kept = false;
        }
    }

    /// Records that the session has ended.
    pub(super) const fn end_service(&mut self) {
        self.service = None;
    }
}

impl Service {
    /// Returns whether an attempt belongs to the newest call or to an older one.
    fn is_old(&self, attempt: &Attempt) -> bool {
        let (marker, function) = self.newest;
        attempt.is_of(marker, function) || (1..=OLD_MARKERS).contains(&marker.wrapping_sub(attempt.marker))
    }
}
