//! `bcap rac`: variables and lines over RAC, the text protocol.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use bcap_capture::trace::{Traced, Wire};
use bcap_core::rac::client::{ClientError, Config, Timeout};
use bcap_core::rac::{LineFramer, MAX_LINE, MAX_VALUE, Variable, VariableKind};
use bcap_std::blocking::{self, RacConnection, Transport};
use bcap_std::{Address, Options, RacError};
use clap::{Args, Subcommand};

use crate::commands::variables::get::{Get, print_each};
use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::output::{print, print_result};
use crate::session::budget::Budget;
use crate::session::connect::{broken, connect, exhausted};
use crate::session::traffic::{TapedTcp, packets, taped_rac};
use bcap_capture::value::data;
use bcap_capture::value::named::shown;
use bcap_capture::value::selection::{Selection, names_of};
use bcap_core::variant::OwnedVariant as Value;

/// Reads and writes variables over RAC, the text protocol
///
/// NAME is one of I F D V P J T S IO with a number: I1, P10, IO128. --robot is HOST[:PORT] here, with the default port 5006.
/// If the environment variable BCAP_ROBOT names a protocol, such as tcp:HOST:PORT, only its host is used.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap rac --robot 192.168.0.1 get I1 P10
  bcap rac --robot 192.168.0.1:5006 put S1 'hello, world'
  bcap rac raw GET:RC8:1:I: PUT:RC8:1:I:3,5")]
pub(crate) struct Rac {
    #[command(subcommand)]
    pub(crate) command: RacCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum RacCommand {
    /// Reads variables
    Get(Get),
    /// Writes a variable
    Put(RacPut),
    /// Sends lines as they are written, each with a CR, and prints the answer to each; the exit code is 0 for any answer
    Raw {
        /// The lines
        #[arg(value_name = "LINE", required = true)]
        lines: Vec<String>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct RacPut {
    /// The variable
    pub(crate) name: String,

    /// The value
    #[arg(allow_hyphen_values = true)]
    pub(crate) value: String,

    /// Reads VALUE as TYPE,DATA, also of another type than the variable's
    #[arg(long)]
    pub(crate) typed: bool,
}

/// Runs `bcap rac`.
pub(crate) fn rac(args: &Rac, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    match &args.command {
        RacCommand::Get(args) => get(args, link, json),
        RacCommand::Put(args) => put(args, link, json),
        RacCommand::Raw { lines } => raw(lines, link, json),
    }
}

/// Checks the arguments before the first call.
pub(crate) fn check(args: &Rac) -> Result<(), Failure> {
    match &args.command {
        RacCommand::Get(args) => Ok(Selection::parse_each(&args.names).map(drop)?),
        RacCommand::Put(args) => value_of(args).map(drop),
        RacCommand::Raw { lines } => check_lines(lines),
    }
}

fn get(args: &Get, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let names = names_of(&Selection::parse_each(&args.names)?, |kind| {
        let name = kind.name();
        Err(Failure::Input(format!(
            "{name}*: RAC does not tell how many variables there are; write a range such as {name}1-{name}50"
        )))
    })?;
    let variables = names.iter().map(|name| variable(name)).collect::<Result<Vec<_>, _>>()?;
    let mut robot = RacLink::open(link)?;
    print_each(&names, &variables, json, |variable| robot.get(*variable))
}

fn put(args: &RacPut, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let (variable, value) = value_of(args)?;
    RacLink::open(link)?.put(variable, &value)?;
    Ok(print(&shown(&args.name, &value, json), json)?)
}

fn raw(lines: &[String], link: &LinkArgs, json: bool) -> Result<(), Failure> {
    check_lines(lines)?;
    let RacLink { client, target, budget } = RacLink::open(link)?;
    let mut transport = client.into_parts().0;
    let mut framer = Box::new(LineFramer::<MAX_LINE>::new());
    for line in lines {
        let answer = exchange(line, &mut transport, &mut framer, budget.share(1));
        let answer = answer.map_err(|error| failed(error, line, &target, &budget))?;
        print_result(json, &serde_json::json!({ "line": line, "answer": answer }), &answer)?;
    }
    Ok(())
}

/// Refuses an empty line, and a line break inside one: then the answers do not match the lines.
fn check_lines(lines: &[String]) -> Result<(), Failure> {
    let wrong = lines.iter().find(|line| line.is_empty() || line.contains(['\r', '\n']));
    wrong
        .map_or(Ok(()), |line| Err(Failure::Input(format!("{line:?} is not one line: write its text without its end"))))
}

/// Sends a line, and returns the answer.
fn exchange(
    line: &str,
    transport: &mut impl Transport<Error = io::Error>,
    framer: &mut LineFramer<MAX_LINE>,
    limit: Duration,
) -> Result<String, RacError> {
    let until = transport.now() + limit;
    let late = || RacError::Client(ClientError::Timeout(Timeout::Reply));
    let request = format!("{line}\r");
    let mut rest = request.as_bytes();
    while !rest.is_empty() {
        let sent = transport.send(rest, until).map_err(RacError::Io)?.ok_or_else(late)?;
        rest = rest.get(sent..).unwrap_or_default();
    }
    // the head of an answer over the limit is shown as well
    while framer.poll().is_none() {
        match transport.receive(framer.receive_buffer(), until).map_err(RacError::Io)?.ok_or_else(late)? {
            0 => return Err(RacError::Disconnected),
            count => framer.received(count),
        }
    }
    Ok(String::from_utf8_lossy(framer.line()).trim_matches('\n').to_owned())
}

/// Reads a variable, to find out whether a server answers.
pub(crate) fn probe(link: &LinkArgs) -> Result<Value, Failure> {
    RacLink::open(link)?.get(Variable { kind: VariableKind::I, index: 1 })
}

/// Returns the variable and the value to write.
fn value_of(args: &RacPut) -> Result<(Variable, Value), Failure> {
    let variable = variable(&args.name)?;
    let value = if args.typed {
        data::from_typed_input(&args.value)
    } else {
        data::to_write(&args.name, &args.value, model(variable.kind)?.as_variant())
    };
    Ok((variable, value.map_err(Failure::Input)?))
}

/// Parses `I10` or `I[10]`.
fn variable(name: &str) -> Result<Variable, Failure> {
    name.parse().map_err(|_| {
        Failure::Input(format!(
            "{name}: RAC reads and writes I F D V P J T S IO with a number, such as I10 or IO128; use `bcap get` and \
             `bcap put` for other variables"
        ))
    })
}

/// Returns an example value of a variable kind, which has a fixed type and number of elements.
fn model(kind: VariableKind) -> Result<Value, Failure> {
    let zeros = vec!["0"; kind.elements()].join(",");
    data::from_data(kind.vartype(), &zeros).map_err(|error| Failure::Input(error.to_string()))
}

/// A RAC connection that reports errors as a [`Failure`].
struct RacLink {
    client: RacConnection<Traced<TapedTcp>, [u8; MAX_VALUE]>,
    target: Address,
    budget: Budget,
}

impl RacLink {
    fn open(link: &LinkArgs) -> Result<Self, Failure> {
        let (target, budget) = (link.rac_target()?, Budget::start(link));
        let connect_rac = |peer: &[SocketAddr], options: &Options| blocking::connect_rac(peer, options).map(taped_rac);
        let (transport, client) = connect(&target, &budget, connect_rac)?.into_parts();
        let client = RacConnection::new(packets(link.trace).tap(transport, Wire::Lines), client);
        let target = Address::Network(target);
        Ok(Self { client, target, budget })
    }

    /// Sets the timeout of the next request from the remaining time.
    fn prepare(&mut self, request: &str) -> Result<(), Failure> {
        let timeout = self.budget.share(1);
        if self.budget.is_exhausted() {
            return Err(exhausted(&self.target, &self.budget, request));
        }
        self.client.client().set_config(Config { timeout });
        Ok(())
    }

    fn get(&mut self, variable: Variable) -> Result<Value, Failure> {
        let request = format!("GET {variable}");
        self.prepare(&request)?;
        let Self { client, target, budget } = self;
        let value = client.get(variable).map_err(|error| failed(error, &request, target, budget))?;
        if value.is_empty() {
            return Err(Failure::Unexpected {
                message: format!("{request}: the reply has no value"),
                hint: format!("check that {target} is a RAC server"),
            });
        }
        Ok(Value::new(&value)?)
    }

    fn put(&mut self, variable: Variable, value: &Value) -> Result<(), Failure> {
        let request = format!("PUT {variable}");
        self.prepare(&request)?;
        let Self { client, target, budget } = self;
        client.put(variable, value.as_variant()).map_err(|error| failed(error, &request, target, budget))
    }
}

/// Converts the error of a request.
fn failed(error: RacError, what: &str, target: &Address, budget: &Budget) -> Failure {
    match error {
        RacError::Refused(code) => Failure::Refused { doing: what.to_owned(), code },
        RacError::Io(error) => broken(&error, target),
        RacError::Disconnected => Failure::Connection {
            message: format!("{target} closed the connection during {what}"),
            hint: "the controller may have reached its limit of connections; close others or try again".into(),
        },
        RacError::Client(ClientError::Request(error)) => Failure::Input(format!("{what}: {error}")),
        RacError::Client(ClientError::Timeout(_)) if budget.total().is_some() => exhausted(target, budget, what),
        RacError::Client(ClientError::Timeout(_)) => Failure::Timeout {
            message: format!("{target} did not answer {what} within {} ms", budget.answer().as_millis()),
            hint: "check that the RAC server uses this port, or allow more time with --timeout".into(),
        },
        error => Failure::Connection {
            message: format!("{what}: {error}"),
            hint: format!("check that {target} is a RAC server"),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variable_names_are_parsed() {
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
    fn example_values_fit_their_variables() {
        for kind in VariableKind::ALL {
            assert!(kind.fits(&model(kind).unwrap().as_variant()), "{kind}");
        }
    }
}
