//! `bcap rac`: variables over RAC, the text protocol.

use std::time::Duration;

use bcap_core::rac::client::ClientError;
use bcap_core::rac::{Variable, VariableKind};
use bcap_std::blocking::{self, RacClient};
use bcap_std::{Options, RacError};

use crate::args::{Get, LinkArgs, Put, Rac, RacCommand};
use crate::connection::{broken, not_connected};
use crate::error::Failure;
use crate::item::print_line;
use crate::plain;
use crate::target::Target;
use crate::value::Value;
use crate::variables::{expected, print_each, shown};

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
    print_each(&args.names, &variables, json, |variable| session.get(*variable))
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
        // for Rust a number may have a plus sign, for a name it may not
        (Some(kind), Ok(index)) if !name.contains('+') => Ok(Variable { kind, index }),
        _ => Err(Failure::Input(format!(
            "{name}: RAC reads and writes I F D V P J T S IO with a number, such as I10 or IO128; other variables are to \
             be had over b-CAP"
        ))),
    }
}

/// Returns a value as such a variable holds it: the type and the number of elements are fixed.
fn model(kind: VariableKind) -> Result<Value, Failure> {
    Ok(match kind {
        VariableKind::I => Value::new(&0_i32),
        VariableKind::F => Value::new(&0_f32),
        VariableKind::D => Value::new(&0_f64),
        VariableKind::S => Value::new(""),
        VariableKind::Io => Value::new(&false),
        VariableKind::V | VariableKind::P | VariableKind::J | VariableKind::T => {
            Value::new(vec![0_f32; kind.elements()].as_slice())
        }
    }?)
}

/// A connection, its failures told in words.
struct Session {
    client: RacClient,
    target: Target,
    timeout: Duration,
}

impl Session {
    fn open(link: &LinkArgs) -> Result<Self, Failure> {
        let (target, timeout) = (link.rac_target()?, link.timeout());
        let client = blocking::connect_rac((target.host.as_str(), target.port), &Options::default().timeout(timeout))
            .map_err(|error| not_connected(&error, &target))?;
        Ok(Self { client, target, timeout })
    }

    fn get(&mut self, variable: Variable) -> Result<Value, Failure> {
        let Self { client, target, timeout } = self;
        let value =
            client.get(variable).map_err(|error| failed(error, &format!("GET {variable}"), target, *timeout))?;
        Ok(Value::new(&value)?)
    }

    fn put(&mut self, variable: Variable, value: &Value) -> Result<(), Failure> {
        let Self { client, target, timeout } = self;
        let done = client.put(variable, value.as_variant());
        done.map_err(|error| failed(error, &format!("PUT {variable}"), target, *timeout))
    }
}

/// Tells a failed request in words.
fn failed(error: RacError, what: &str, target: &Target, timeout: Duration) -> Failure {
    match error {
        RacError::Refused(code) => Failure::Refused { doing: what.to_owned(), code },
        RacError::Io(error) => broken(&error, target),
        RacError::Disconnected => Failure::Connection {
            message: format!("{target} has closed the connection during {what}"),
            hint: "the controller may have no connection to spare; try again".into(),
        },
        RacError::Client(ClientError::Request(error)) => Failure::Input(format!("{what}: {error}")),
        RacError::Client(ClientError::Timeout(_)) => Failure::Timeout {
            message: format!("{target} did not answer {what} within {} ms", timeout.as_millis()),
            hint: "check that this is the port of the RAC server, or allow more time with --timeout".into(),
        },
        RacError::Client(error) => Failure::Connection {
            message: format!("{what}: {error}"),
            hint: format!("check that {target} is a RAC server"),
        },
    }
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
