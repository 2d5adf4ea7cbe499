//! Any of the 137 functions, over a session of the page for these calls alone.
//!
//! The function table of the core defines the form, and its effects determine which calls a page may make: a call that reads
//! needs no permission, a call that writes needs `allow_write` and the control, a call that moves needs `allow_motion` and the
//! control. A call that would end a stream of Slave Mode is not sent. The session ends with the screen, which halts the robot
//! and gives the arm back.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use bcap_capture::Role;
use bcap_capture::trace::Packets;
use bcap_capture::value::{data, to_text};
use bcap_core::bcap::{Effect, FunctionId, Kind};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_live::calls::Failure;
use bcap_live::link::{Error, Link};
use bcap_live::request::Request;
use serde_json::{Value, json};

use crate::app::App;
use crate::robot::{Permit, Robot, reason};
use crate::text::safe;
use crate::threads::lock;
use crate::view::{self, dissected};

/// Returns the function table, for the form.
pub(crate) fn functions() -> Value {
    let row = |function: FunctionId| {
        let kinds = function.signature().map(|signature| signature.arguments).unwrap_or_default();
        let arguments: Vec<_> =
            function.argument_names().iter().zip(kinds).map(|(name, kind)| [name, kind_name(*kind)]).collect();
        let commands = function.commands().map(|command| {
            json!([command.name, command.properties.effect.name(), command.properties.in_slave_mode.name()])
        });
        json!({
            "number": function.0,
            "name": function.to_string(),
            "arguments": arguments,
            "help": function.help().collect::<Vec<_>>(),
            "effect": function.effect().name(),
            "stream": function.in_slave_mode().name(),
            "commands": commands.collect::<Vec<_>>(),
        })
    };
    FunctionId::all().map(row).collect()
}

/// Returns the type of an argument; for a handle, the kind of its object.
const fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Handle(object) => object.name(),
        Kind::Int => "I4",
        Kind::Float => "R4",
        Kind::Text => "BSTR",
        Kind::Any | Kind::Nothing | Kind::Maybe => "VARIANT",
    }
}

/// The session of a page for the calls of its user.
pub(crate) struct Desk {
    pub(crate) number: usize,
    robot: Arc<Robot>,
    link: Mutex<Option<Link>>,
    packets: Packets,
    /// Whether a call that moves the robot is running.
    moves: AtomicBool,
    has_ended: AtomicBool,
}

impl Desk {
    pub(crate) fn new(number: usize, robot: Arc<Robot>) -> Self {
        let (moves, has_ended) = (AtomicBool::new(false), AtomicBool::new(false));
        Self { number, robot, link: Mutex::default(), packets: Packets::new(), moves, has_ended }
    }

    /// Makes a call; the first call opens the session.
    pub(crate) fn make(&self, request: &Request, permit: &mut Permit) -> Result<(HResult, Value), String> {
        let mut link = lock(&self.link);
        self.check_open().map_err(|error| error.to_string())?;
        let session = match link.take() {
            Some(session) => Ok(session),
            None => Link::for_calls(&self.robot.access, &self.packets),
        };
        let mut session = session.map_err(|error| format!("nothing was done: {error}"))?;
        let start = Instant::now();
        let made = request.perform(&mut session, || {
            // before the check, so that an end after the check sees the call
            self.moves.store(request.effect() == Effect::Moves, Ordering::SeqCst);
            self.check_open()?;
            match request.effect() {
                Effect::Session | Effect::Reads => Ok(()),
                Effect::Writes => permit.check(),
                _ => permit.check_move(),
            }
        });
        let took = start.elapsed();
        self.moves.store(false, Ordering::SeqCst);
        let ends = matches!(request.function, FunctionId::SERVICE_STOP | FunctionId::CONTROLLER_DISCONNECT);
        let ended = if made.as_ref().is_err_and(Failure::is_lost) || ends {
            ended(session)
        } else {
            *link = Some(session);
            Ok(())
        };
        let (code, value) = made.map_err(|error| match &ended {
            Ok(()) => reason(&error),
            Err(left) => format!("{}; {left}", reason(&error)),
        })?;
        let value = value.as_ref().map(OwnedVariant::as_variant);
        let mut reply = view::error(code, "");
        reply["ok"] = json!(!code.is_err());
        reply["value"] = json!(value.map(|value| safe(&data::format(value))));
        reply["typed"] = json!(value.and_then(|value| to_text(value).ok()).map(|text| safe(&text)));
        reply["ms"] = json!(took.as_secs_f64() * 1000.0);
        let (sent, received) = (self.packets.last_sent(), self.packets.last_received());
        reply["packets"] = json!([dissected(Role::Request, &sent), dissected(Role::Response, &received)]);
        Ok((code, reply))
    }

    fn check_open(&self) -> Result<(), Error> {
        let has_ended = self.has_ended.load(Ordering::SeqCst);
        (!has_ended).then_some(()).ok_or_else(|| Error::Skipped("the screen was left; nothing was done".into()))
    }

    /// Ends the session. A call that moves is halted; the end of the session halts the arm that it has, and gives it back.
    pub(crate) fn end(self: Arc<Self>, app: &Arc<App>) {
        self.has_ended.store(true, Ordering::SeqCst);
        let of = Arc::clone(app);
        // without a thread the session ends here
        let _ = app.spawn("end of calls", move || {
            self.robot.halt_while(&of.audit, "its screen was left during a call that moves", || {
                self.moves.load(Ordering::SeqCst)
            });
            if let Some(Err(why)) = lock(&self.link).take().map(ended) {
                of.audit.write("a page", &self.robot.name, "the end of the raw calls", &Err::<(), _>(why));
            }
        });
    }
}

/// Ends a session. The error is for people.
fn ended(session: Link) -> Result<(), String> {
    let unknown = "IT IS UNKNOWN whether the robot rests, the motor is off and the arm is free";
    session.end().map_err(|error| format!("{unknown}: {error}"))
}
