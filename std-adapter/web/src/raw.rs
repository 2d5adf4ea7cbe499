//! Any of the 137 functions, over a session of the page for these calls alone.
//!
//! The function table of the core makes the form, and its effects decide which calls a page may make: a call that reads needs
//! nothing, one that writes needs `allow_write` and the control, one that moves needs `allow_motion` and the control. A call that
//! would end a stream of Slave Mode is not sent. The session ends with the screen, which halts the robot and gives the arm back.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Instant;

use bcap_capture::trace::Packets;
use bcap_capture::value::{data, to_text};
use bcap_capture::{Role, hex, json::LIMITS};
use bcap_core::bcap::{Decoder, Effect, FunctionId, Kind};
use bcap_core::hresult::HResult;
use bcap_core::limits::Strictness;
use bcap_core::variant::OwnedVariant;
use bcap_live::calls::{Calls as _, Failure as _};
use bcap_live::link::{Error, Link};
use bcap_live::stream::StreamCheck;
use bcap_std::ObjectPath;
use serde_json::{Value, json};

use crate::app::App;
use crate::robot::Robot;
use crate::tape::dissected;
use crate::text::safe;
use crate::view;

/// Returns the function table: what a form needs.
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

/// An argument of a call.
#[derive(Debug)]
enum Argument {
    Value(OwnedVariant),
    /// The handle of this object, which is opened first.
    Object(ObjectPath),
}

/// A call of a user.
#[derive(Debug)]
pub(crate) struct Request {
    function: FunctionId,
    arguments: Vec<Argument>,
}

/// Writes `Variable_GetValue(variable:I1)`.
impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}(", self.function)?;
        for (n, argument) in self.arguments.iter().enumerate() {
            let separator = if n > 0 { ", " } else { "" };
            match argument {
                Argument::Value(value) => write!(f, "{separator}{:?}", value.as_variant())?,
                Argument::Object(path) => write!(f, "{separator}{path}")?,
            }
        }
        f.write_str(")")
    }
}

impl Request {
    /// Parses the fields of a form: `TYPE,DATA`, or the name of an object.
    pub(crate) fn parse(function: &str, arguments: &[String]) -> Result<Self, String> {
        let function = FunctionId::parse(function).ok_or_else(|| format!("there is no function {function}"))?;
        let kinds = function.signature().map(|signature| signature.arguments).unwrap_or_default();
        let parse = |(n, text): (usize, &String)| match kinds.get(n) {
            Some(Kind::Handle(object)) if ObjectPath::is_path(text) => {
                let path: ObjectPath = text.parse().map_err(|error| format!("{text}: {error}"))?;
                if path.object() == *object {
                    return Ok(Argument::Object(path));
                }
                Err(format!("{text} is not a {}, which {function} takes here", object.name().to_ascii_lowercase()))
            }
            _ => data::from_typed_input(text).map(Argument::Value),
        };
        let arguments = arguments.iter().enumerate().map(parse).collect::<Result<_, _>>()?;
        Ok(Self { function, arguments })
    }

    /// Decodes a packet in hexadecimal. The session sets its serial number.
    pub(crate) fn decode(packet: &str) -> Result<Self, String> {
        let bytes = hex::parse(packet.as_bytes()).map_err(|error| error.to_string())?;
        let decoder = Decoder { limits: LIMITS, strictness: Strictness::Strict, crc: false };
        let frame = decoder.decode_datagram(&bytes).map_err(|error| {
            format!("the packet is refused: {error}; `bcap raw` also sends packets that are not valid")
        })?;
        let value = |value| OwnedVariant::new(&value).map(Argument::Value).map_err(|error| error.to_string());
        Ok(Self { function: frame.function(), arguments: frame.args.iter().map(value).collect::<Result<_, _>>()? })
    }

    /// Returns an argument if it is a text.
    fn text(&self, n: usize) -> Option<String> {
        let Argument::Value(value) = self.arguments.get(n)? else { return None };
        value.as_variant().as_bstr().map(|text| text.to_string())
    }

    pub(crate) fn effect(&self) -> Effect {
        self.function.properties(self.text(1).as_deref(), self.text(2).as_deref()).effect
    }

    /// Makes the call, unless it would end a stream. A refusal is a reply.
    fn perform(&self, link: &mut Link) -> Result<(HResult, Option<OwnedVariant>), Error> {
        let mut check = StreamCheck::default();
        let mut values = Vec::new();
        for argument in &self.arguments {
            values.push(match argument {
                Argument::Value(value) => value.clone(),
                Argument::Object(path) => {
                    require_open(link, &mut check, path.clone())?;
                    OwnedVariant::new(&link.object(path)?)?
                }
            });
        }
        check.require(link, self.function, self.text(1).as_deref())?;
        match link.call("", self.function, &values) {
            Err(error) if error.code().is_some() && !error.is_lost() => Ok((error.code().unwrap_or_default(), None)),
            made => made,
        }
    }
}

/// Fails if the functions that open an object would end a stream.
fn require_open(link: &mut Link, check: &mut StreamCheck, mut path: ObjectPath) -> Result<(), Error> {
    while let Some((owner, _)) = path.split_last() {
        if let Some(function) = path.object().opened_from(owner.object()) {
            check.require(link, function, None)?;
        }
        path = owner;
    }
    Ok(())
}

/// The session of a page for the calls of its user.
#[derive(Debug)]
pub(crate) struct Desk {
    pub(crate) number: usize,
    robot: Arc<Robot>,
    link: Mutex<Option<Link>>,
    packets: Packets,
    /// Whether a call that moves is under way.
    moves: AtomicBool,
    has_ended: AtomicBool,
}

impl Desk {
    pub(crate) fn new(number: usize, robot: Arc<Robot>) -> Self {
        let (moves, has_ended) = (AtomicBool::new(false), AtomicBool::new(false));
        Self { number, robot, link: Mutex::default(), packets: Packets::new(), moves, has_ended }
    }

    /// Makes a call, and opens the session for the first one.
    pub(crate) fn make(&self, request: &Request) -> Result<(HResult, Value), String> {
        let mut link = self.link.lock().unwrap_or_else(PoisonError::into_inner);
        self.moves.store(request.effect() == Effect::Moves, Ordering::SeqCst);
        if self.has_ended.load(Ordering::SeqCst) {
            return Err("the screen was left; nothing was done".into());
        }
        let session = match link.take() {
            Some(session) => Ok(session),
            None => Link::for_calls(&self.robot.access, &self.packets),
        };
        let mut session = session.map_err(|error| format!("nothing was done: {error}"))?;
        let start = Instant::now();
        let made = request.perform(&mut session);
        let took = start.elapsed();
        self.moves.store(false, Ordering::SeqCst);
        let ends = matches!(request.function, FunctionId::SERVICE_STOP | FunctionId::CONTROLLER_DISCONNECT);
        if !made.as_ref().is_err_and(bcap_live::calls::Failure::is_lost) && !ends {
            *link = Some(session);
        }
        let (code, value) = made.map_err(|error| match error.is_lost() {
            true => format!("it is unknown whether it was done: {error}"),
            false => error.to_string(),
        })?;
        let mut reply = view::error(code, "");
        reply["ok"] = json!(!code.is_err());
        reply["value"] = json!(value.as_ref().map(|value| safe(&data::format(value.as_variant()))));
        reply["typed"] =
            json!(value.as_ref().and_then(|value| to_text(value.as_variant()).ok()).map(|text| safe(&text)));
        reply["ms"] = json!(took.as_secs_f64() * 1000.0);
        let (sent, received) = (self.packets.last_sent(), self.packets.last_received());
        reply["packets"] = json!([dissected(Role::Request, &sent), dissected(Role::Response, &received)]);
        Ok((code, reply))
    }

    /// Ends the session. A call that moves is halted; the drop of the session halts the arm that it has, and gives it back.
    pub(crate) fn end(self: Arc<Self>, app: &Arc<App>) {
        self.has_ended.store(true, Ordering::SeqCst);
        let (app, halts) = (Arc::clone(app), self.moves.load(Ordering::SeqCst));
        // without a thread the session ends here
        let _ = thread::Builder::new().name("end of calls".into()).spawn(move || {
            if halts {
                let outcome = self.robot.halter.halt_now();
                app.audit.write("a page", &self.robot.name, "was left during a call that moves: HALT", &outcome);
            }
            drop(self.link.lock().unwrap_or_else(PoisonError::into_inner).take());
        });
    }
}
