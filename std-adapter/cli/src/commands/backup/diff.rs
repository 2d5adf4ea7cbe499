//! `bcap diff`: compares two backups, or a backup with a controller.

use std::path::Path;

use bcap_capture::value::to_json;
use clap::Args;
use serde_json::json;

use bcap_backup::compare::{self, Difference};
use bcap_backup::contents::{Contents, Omission};
use bcap_backup::{controller, folder};

use crate::failure::{Failure, with_finding};
use crate::output::print;
use crate::session::{Session, with_session};
use bcap_capture::value::named::Entry;

/// Compares two backups, or a backup with a controller
///
/// A and B are folders of `bcap dump`, addresses such as tcp:192.168.0.1, or robot: for the controller of --robot. A
/// line is `I5: 3 -> 7`, first the value of A; with --json {"name":"I5","a":{"vt":3,"v":3},"b":{"vt":3,"v":7}}, where
/// null is a variable or a file that does not exist. System variables show the controller's state, so they are compared
/// only with --system. An item that one side lacks because its controller refused it is not compared: a line says so.
///
/// The exit code is 0 if everything was compared and is equal, 1 if there is a difference, and 2 or more after an error or a
/// refusal, or if a part was not compared and the rest is equal.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap diff backup
  bcap diff backup cell1-monday
  bcap diff --system backup tcp:192.168.0.1")]
pub(crate) struct Diff {
    /// The first backup or controller
    pub(crate) a: String,

    /// The second one
    #[arg(default_value = "robot:")]
    pub(crate) b: String,

    /// Compares the system variables too, except the clocks
    #[arg(long)]
    pub(crate) system: bool,
}

/// Runs `bcap diff`.
pub(crate) fn diff(args: &Diff, session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut read = |word| read(word, session).map_err(|failure| Failure::NotCompared(Box::new(failure)));
    let (a, b) = (read(&args.a)?, read(&args.b)?);
    let (variables, files) = (compare::variables(&a, &b, args.system), compare::files(&a, &b));
    let omitted = Vec::from_iter(compare::omitted(&a, &b, args.system));
    let of_variable = |difference| if json { variable_json(difference) } else { difference.to_string() };
    let of_file = |difference| if json { file_json(difference) } else { difference.to_string() };
    let lines = variables.iter().map(of_variable).chain(files.iter().map(of_file));
    let mut lines = lines.chain(omitted.iter().map(|part| not_compared(*part, json)));
    let printed = lines.try_for_each(|line| print(&line, json));
    let found = match omitted.len() {
        _ if !variables.is_empty() || !files.is_empty() => Err(Failure::Different),
        0 => Ok(()),
        omitted => Err(Failure::NotCompared(Box::new(Failure::unfit(
            format!("there is no difference in what could be compared, and {omitted} parts could not"),
            "over UDP, use TCP instead",
        )))),
    };
    with_finding(printed.map_err(Failure::from), found)
}

/// Returns the line of a part that a side does not have.
fn not_compared((is_first, Omission { reason, .. }): (bool, &Omission), json: bool) -> String {
    let (side, words) = if is_first { ("a", "first") } else { ("b", "second") };
    match json {
        true => json!({ "not_compared": reason, "side": side }).to_string(),
        false => format!("not compared: {reason}, in the {words}"),
    }
}

/// Reads a folder, or the controller at an address.
fn read(word: &str, session: &mut Session) -> Result<Contents, Failure> {
    let is_address = |scheme: &str| ["tcp", "udp", "serial"].iter().any(|known| scheme.eq_ignore_ascii_case(known));
    match word.split_once(':') {
        Some((robot, "")) if robot.eq_ignore_ascii_case("robot") => {
            session.begin()?;
            contents(session)
        }
        Some((scheme, _)) if is_address(scheme) => with_session(&session.link().at(word), contents),
        _ => Ok(folder::load(Path::new(word))?),
    }
}

fn contents(session: &mut Session) -> Result<Contents, Failure> {
    controller::contents(session, |_| Ok(()))
}

fn variable_json(Difference { name, a, b }: &Difference<String, &Entry>) -> String {
    let side = |entry: &Option<&Entry>| match entry {
        Some(Entry::Value(value)) => to_json(value.as_variant()),
        Some(Entry::Refused(code)) => format!("{{\"refused\":{}}}", code.0),
        None => "null".into(),
    };
    format!("{{\"name\":{},\"a\":{},\"b\":{}}}", serde_json::Value::from(name.as_str()), side(a), side(b))
}

fn file_json(Difference { name, a, b }: &Difference<&String, &Vec<u8>>) -> String {
    let side = |bytes: &Option<&Vec<u8>>| bytes.map(|bytes| json!({ "size": bytes.len() }));
    json!({ "file": name, "a": side(a), "b": side(b) }).to_string()
}
