//! `bcap rac`: variables over RAC, the text protocol.

use std::io;
use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::rac::client::{Client, ClientError, Config, Event};
use bcap_core::rac::{MAX_VALUE, Request, Variable, VariableKind};
use bcap_core::variant::Variant;
use bcap_std::Options;
use bcap_std::blocking::{self, TcpTransport, Transport};

use crate::args::{Get, LinkArgs, Put, Rac, RacCommand};
use crate::connection::{broken, not_connected};
use crate::error::Failure;
use crate::item::print_line;
use crate::plain;
use crate::target::Target;
use crate::value::Value;
use crate::variables::{expected, shown};

/// Runs `bcap rac get` or `bcap rac put`.
pub(crate) fn rac(args: &Rac, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    match &args.command {
        RacCommand::Get(args) => get(args, link, json),
        RacCommand::Put(args) => put(args, link, json),
    }
}

fn get(args: &Get, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let variables = args.names.iter().map(|name| variable(name)).collect::<Result<Vec<_>, _>>()?;
    let mut session = Session::open(link)?;
    let mut refused = 0;
    for (name, variable) in args.names.iter().zip(&variables) {
        match session.get(*variable) {
            Ok(value) => print_line(&shown(name, &value, json))?,
            // the others can still be had
            Err(failure @ Failure::Refused { .. }) if variables.len() > 1 => {
                failure.print(json, Some(name));
                refused += 1;
            }
            Err(failure) => return Err(failure),
        }
    }
    if refused > 0 { Err(Failure::SomeRefused { refused, asked: variables.len() }) } else { Ok(()) }
}

fn put(args: &Put, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let variable = variable(&args.name)?;
    let model = model(variable.kind)?;
    let value = plain::from_input(&args.value, model.as_variant())
        .map_err(|error| Failure::Input(format!("{}: {error}{}", args.value, expected(model.as_variant()))))?;
    Session::open(link)?.put(variable, &value)?;
    print_line(&shown(&args.name, &value, json))
}

/// Reads `I10` or `I[10]`.
fn variable(name: &str) -> Result<Variable, Failure> {
    let digits = name.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(name.len());
    let (kind, index) = name.split_at(digits);
    let index = index.strip_prefix('[').and_then(|index| index.strip_suffix(']')).unwrap_or(index);
    match (VariableKind::from_name(kind), index.parse()) {
        (Some(kind), Ok(index)) if !index_has_sign(name) => Ok(Variable { kind, index }),
        _ => Err(Failure::Input(format!(
            "{name}: RAC reads and writes I F D V P J T S IO with a number, such as I10 or IO128; other variables are to \
             be had over b-CAP"
        ))),
    }
}

/// A number may have a plus sign for Rust, but a name may not.
fn index_has_sign(name: &str) -> bool {
    name.contains('+')
}

/// Returns a value as such a variable holds it: the type and the number of elements are fixed.
fn model(kind: VariableKind) -> Result<Value, Failure> {
    let value = match kind {
        VariableKind::I => Value::new(&0_i32),
        VariableKind::F => Value::new(&0_f32),
        VariableKind::D => Value::new(&0_f64),
        VariableKind::S => Value::new(""),
        VariableKind::Io => Value::new(&false),
        VariableKind::V | VariableKind::P | VariableKind::J | VariableKind::T => {
            Value::new(vec![0_f32; kind.elements()].as_slice())
        }
    };
    value.map_err(|error| Failure::Input(error.to_string()))
}

/// A connection, with the client of the core.
pub(crate) struct Session<X> {
    transport: X,
    client: Client<[u8; MAX_VALUE]>,
    target: Target,
}

impl Session<TcpTransport> {
    fn open(link: &LinkArgs) -> Result<Self, Failure> {
        let target = link.rac_target()?;
        Ok(Self::new(Self::connect(&target, link.timeout())?, target, link.timeout()))
    }

    /// Connects.
    pub(crate) fn connect(target: &Target, timeout: Duration) -> Result<TcpTransport, Failure> {
        let options = Options::default().timeout(timeout);
        let mut connected = blocking::connect_tcp((target.host.as_str(), target.port), &options)
            .map_err(|error| not_connected(&error, target))?;
        Ok(TcpTransport::new(connected.transport().stream().try_clone()?))
    }
}

impl<X: Transport<Error = io::Error>> Session<X> {
    pub(crate) fn new(transport: X, target: Target, timeout: Duration) -> Self {
        Self { transport, client: Client::new(Config { timeout }, [0; MAX_VALUE]), target }
    }

    pub(crate) fn transport(&mut self) -> &mut X {
        &mut self.transport
    }

    /// Reads a variable.
    pub(crate) fn get(&mut self, variable: Variable) -> Result<Value, Failure> {
        self.request(&Request::Get(variable))?;
        let value = self.client.reply().and_then(|reply| reply.value).unwrap_or(Variant::Empty);
        Value::new(&value).map_err(|error| Failure::Input(error.to_string()))
    }

    /// Writes a variable.
    pub(crate) fn put(&mut self, variable: Variable, value: &Value) -> Result<(), Failure> {
        self.request(&Request::Put(variable, value.as_variant()))
    }

    /// Sends a request and waits for a reply of success.
    fn request(&mut self, request: &Request<'_>) -> Result<(), Failure> {
        let what = match request {
            Request::Get(variable) => format!("GET {variable}"),
            Request::Put(variable, _) => format!("PUT {variable}"),
        };
        self.client.start(request, self.transport.now()).map_err(|error| self.failed(error, &what))?;
        while let Some(until) = self.client.poll_timeout() {
            let moved = match self.client.transmit() {
                [] => match self.transport.receive(self.client.receive_buffer(), until) {
                    Ok(Some(0)) => return Err(self.closed(&what)),
                    Ok(count) => count.inspect(|count| self.client.received(*count)).is_some(),
                    Err(error) => return Err(broken(&error, &self.target)),
                },
                bytes => match self.transport.send(bytes, until) {
                    Ok(count) => count.inspect(|count| self.client.transmitted(*count)).is_some(),
                    Err(error) => return Err(broken(&error, &self.target)),
                },
            };
            let now = self.transport.now();
            let event = self.client.poll_event(now);
            let event = if event.is_none() && !moved { self.client.handle_timeout(now) } else { event };
            match event {
                Some(Event::Replied(code)) => return accepted(code, &what),
                Some(Event::Failed(error)) => return Err(self.failed(error, &what)),
                Some(Event::Stale) | None => {}
            }
        }
        Err(self.failed(ClientError::Closed, &what))
    }

    fn closed(&self, what: &str) -> Failure {
        Failure::Connection {
            message: format!("{} has closed the connection during {what}", self.target),
            hint: "the controller may have no connection to spare; try again".into(),
        }
    }

    fn failed(&self, error: ClientError, what: &str) -> Failure {
        match error {
            ClientError::Request(error) => Failure::Input(format!("{what}: {error}")),
            ClientError::Timeout(_) => Failure::Timeout {
                message: format!(
                    "{} did not answer {what} within {} ms",
                    self.target,
                    self.client.config().timeout.as_millis()
                ),
                hint: "check that this is the port of the RAC server, or allow more time with --timeout".into(),
            },
            error => Failure::Connection {
                message: format!("{what}: {error}"),
                hint: format!("check that {} is a RAC server", self.target),
            },
        }
    }
}

fn accepted(code: HResult, what: &str) -> Result<(), Failure> {
    if code.is_ok() { Ok(()) } else { Err(Failure::Refused { doing: what.to_owned(), code }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_are_named_as_over_b_cap() {
        for (name, kind, index) in
            [("I1", VariableKind::I, 1), ("io128", VariableKind::Io, 128), ("P[10]", VariableKind::P, 10)]
        {
            assert_eq!(variable(name).unwrap(), Variable { kind, index }, "{name}");
        }
        for name in ["", "I", "1", "X1", "I-1", "I+1", "I[1", "I 1", "@MODE", "I99999999999"] {
            assert!(variable(name).is_err(), "{name}");
        }
    }

    #[test]
    fn models_fit_their_variables() {
        for kind in VariableKind::ALL {
            assert!(kind.fits(&model(kind).unwrap().as_variant()), "{kind}");
        }
    }
}
