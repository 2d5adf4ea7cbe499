//! The sans-IO server of b-CAP.

use crate::bcap::{Args, FunctionId};
use crate::handler::{Outcome, PeerId, ReplyValue};
use crate::time::Instant;
use crate::variant::{Bstr, Variant};

/// A request whose arguments have been checked against the table: their number and their kinds are right.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// What is asked for.
    pub function: FunctionId,
    /// The arguments.
    pub args: Args<'a>,
    /// Whether the handler has answered this very request with [`Outcome::Wait`] before.
    pub resumed: bool,
}

impl<'a> Request<'a> {
    /// Returns the handle that the function is called on: its first argument.
    #[must_use]
    pub fn handle(&self) -> i32 {
        match self.value(0) {
            Variant::Ui4(n) => n.cast_signed(),
            value => value.as_i32().unwrap_or(0),
        }
    }

    /// Returns an integer argument, counted from 0.
    #[must_use]
    pub fn int(&self, index: usize) -> i32 {
        self.value(index).as_i32().unwrap_or(0)
    }

    /// Returns a floating-point argument, counted from 0.
    #[must_use]
    pub fn float(&self, index: usize) -> f64 {
        self.value(index).as_f64().unwrap_or(0.0)
    }

    /// Returns a string argument, counted from 0.
    #[must_use]
    pub fn text(&self, index: usize) -> Bstr<'a> {
        self.value(index).as_bstr().unwrap_or_default()
    }

    /// Returns an argument of any type, counted from 0; EMPTY when it is not there.
    #[must_use]
    pub fn value(&self, index: usize) -> Variant<'a> {
        self.args.get(index).unwrap_or(Variant::Empty)
    }
}

/// The application behind a server of b-CAP.
pub trait Handler {
    /// Carries a request out, or goes on with it.
    ///
    /// The value of the reply is set in `reply`; [`Outcome`] says how the call ended, or when to ask again. The server
    /// has checked the arguments, and that a handle of them was given to this peer; it keeps the list of the peer's
    /// objects, and calls the releasing functions for what is left of them when the peer goes.
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome;

    /// Learns that a request that was to be asked about again will not be: it ran out of time, or the peer went.
    fn abandoned(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }

    /// Learns that a peer has gone; its objects have been released.
    fn left(&mut self, peer: PeerId, now: Instant) {
        let _ = (peer, now);
    }
}
