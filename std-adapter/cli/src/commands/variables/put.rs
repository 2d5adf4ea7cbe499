//! `bcap put`: writes one variable or several, from the command line or from lines of JSON.
//!
//! All values are checked before the first is written.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use bcap_core::bcap::{FunctionId, Object};
use bcap_std::ObjectPath;
use clap::Args;

use crate::failure::Failure;
use crate::output::print;
use crate::session::Session;
use crate::session::variables::read;
use crate::values::{Value, integer};
use bcap_capture::value::data;
use bcap_capture::value::named::{self, Entry, Named, shown};

/// Writes variables
///
/// Several variables are written as NAME=VALUE, in order. All values are checked before the first is written. After a
/// refusal nothing more is written; each written variable has been printed.
///
/// VALUE is plain data, which take the variable's present type. A number has a decimal point; a BOOL is true, false, on, off,
/// or a number; an array has commas between its elements, as many as the variable has. With --typed VALUE is TYPE,DATA,
/// where TYPE is a VARTYPE number, and the variable is not read first: 3,5 is the I4 5. A VALUE that could be both is
/// refused, such as 3,5 without --typed. So are a number that is not finite, a BOOL such as 5, and the figure 7.5 of a position.
/// Without --typed, TYPE,DATA is accepted only for an array, with the variable's own type and length.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap put I1 5
  bcap put S1 'hello, world'
  bcap put P1 400,0,300,180,0,180,5
  bcap put --typed F1 4,2.5
  bcap put IO128 true
  bcap put I1=5 I2=7 V1=-1,2,3
  bcap get --json I1-I50 >values.jsonl
  bcap put --from values.jsonl")]
pub(crate) struct Put {
    /// The variable, as for `bcap get`, or NAME=VALUE
    #[arg(required_unless_present = "from")]
    pub(crate) name: Option<String>,

    /// The value, or the next NAME=VALUE
    #[arg(allow_hyphen_values = true)]
    pub(crate) value: Option<String>,

    /// More variables
    #[arg(value_name = "NAME=VALUE")]
    pub(crate) more: Vec<String>,

    /// Reads each VALUE as TYPE,DATA, also of another type than the variable's
    #[arg(long)]
    pub(crate) typed: bool,

    /// Writes the values of a file of lines as `bcap get --json` prints them, with their types; - is the standard input
    #[arg(long, value_name = "FILE", conflicts_with_all = ["name", "typed"])]
    pub(crate) from: Option<PathBuf>,
}

/// A variable and the value to write.
struct Write {
    name: String,
    path: ObjectPath,
    data: Data,
}

enum Data {
    /// Text of the user, which gets the type of the variable.
    Plain(String),
    Value(Value),
}

/// Runs `bcap put`.
pub(crate) fn put(args: &Put, session: &mut Session, json: bool) -> Result<(), Failure> {
    let writes = match &args.from {
        Some(path) => from_lines(path)?,
        None => from_words(args)?,
    };
    let mut prepared = Vec::with_capacity(writes.len());
    let done = write_all(&writes, &mut prepared, session, json);
    if done.as_ref().is_err_and(|failure| !failure.leaves_the_session_alive()) {
        return done;
    }
    // an error of the writes is more useful than an error of a release
    let released = prepared.iter().map(|(variable, _)| session.release(Object::Variable, *variable));
    done.and(released.collect())
}

/// Checks the arguments before the first call. A file of `--from` is read when its line runs.
pub(crate) fn check(args: &Put) -> Result<(), Failure> {
    if args.from.is_some() { Ok(()) } else { from_words(args).map(drop) }
}

/// Prepares all writes, then makes them. `prepared` gets the open variables with their values, even when an error ends
/// this.
fn write_all(
    writes: &[Write],
    prepared: &mut Vec<(i32, Value)>,
    session: &mut Session,
    json: bool,
) -> Result<(), Failure> {
    for write in writes {
        prepared.push(prepare(session, write)?);
    }
    for (done, (write, (variable, value))) in writes.iter().zip(prepared).enumerate() {
        let arguments = [integer(*variable)?, value.clone()];
        let written = session.call(&write.name, FunctionId::VARIABLE_PUT_VALUE, &arguments);
        written.map_err(|failure| after(failure, done, writes.len()))?;
        print(&shown(&write.name, value, json), json)?;
    }
    Ok(())
}

/// Opens a variable and returns its handle with the value to write.
fn prepare(session: &mut Session, write: &Write) -> Result<(i32, Value), Failure> {
    let variable = session.object(&write.path)?;
    let value = match &write.data {
        Data::Value(value) => value.clone(),
        Data::Plain(text) => {
            let current = read(session, &write.path, variable)?;
            data::to_write(&write.name, text, current.as_variant())
                .map_err(|error| Failure::Input(format!("{}: {error}", write.name)))?
        }
    };
    Ok((variable, value))
}

/// Adds to a refusal how many of several variables have been written.
fn after(failure: Failure, done: usize, total: usize) -> Failure {
    match failure {
        Failure::Refused { doing, code } if total > 1 => {
            Failure::Refused { doing: format!("{doing} ({done} of {total} are written)"), code }
        }
        failure => failure,
    }
}

fn from_words(args: &Put) -> Result<Vec<Write>, Failure> {
    let words: Vec<&String> = args.name.iter().chain(&args.value).chain(&args.more).collect();
    let pairs: Vec<(&str, &str)> = match words.as_slice() {
        [name, value] if !name.contains('=') => vec![(name, value)],
        words => words
            .iter()
            .map(|word| word.split_once('=').ok_or_else(|| no_pair(word, words)))
            .collect::<Result<_, _>>()?,
    };
    let write = |(name, text): &(&str, &str)| {
        let data = if args.typed {
            Data::Value(data::from_typed_input(text).map_err(Failure::Input)?)
        } else {
            Data::Plain((*text).to_owned())
        };
        Ok(Write { name: (*name).to_owned(), path: ObjectPath::variable(name)?, data })
    };
    pairs.iter().map(write).collect()
}

fn no_pair(word: &str, words: &[&String]) -> Failure {
    match words {
        [name] => Failure::Input(format!("{name}: the value is missing; write {name} VALUE")),
        _ => Failure::Input(format!("{word}: write several variables as NAME=VALUE, such as I1=5 I2=7")),
    }
}

/// Reads a file of lines of JSON, or the standard input for `-`.
fn from_lines(path: &Path) -> Result<Vec<Write>, Failure> {
    let lines = if path == Path::new("-") {
        named::read_lines(io::stdin().lock(), "the standard input").map_err(Failure::Input)?
    } else {
        let shown = path.display().to_string();
        let file = File::open(path).map_err(|error| Failure::Input(format!("cannot read {shown}: {error}")))?;
        named::read_lines(BufReader::new(file), &shown).map_err(Failure::Input)?
    };
    let write = |line: Named| match line.entry {
        Entry::Value(value) => {
            Ok(Write { path: ObjectPath::variable(&line.name)?, name: line.name, data: Data::Value(value) })
        }
        Entry::Refused(code) => {
            Err(Failure::Input(format!("{}: the line has no value, the controller refused it with {code}", line.name)))
        }
    };
    lines.into_iter().map(write).collect()
}
