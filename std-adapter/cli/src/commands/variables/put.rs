//! `bcap put`: writes one variable or several, from the command line or from lines of JSON.
//!
//! All values are checked before the first is written.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use bcap_core::bcap::{FunctionId, Object};
use bcap_std::ObjectPath;
use clap::Args;

use crate::failure::{Failure, cannot};
use crate::output::print;
use crate::session::Session;
use crate::session::variables::{expand, read};
use bcap_capture::value::data;
use bcap_capture::value::named::{self, Entry, Named, shown};
use bcap_capture::value::selection::Selection;
use bcap_core::variant::OwnedVariant as Value;

/// Writes variables
///
/// Several variables are written as NAME=VALUE, in order. A range (I1-I50, I*) gets one value. All values are checked before
/// the first is written. After a refusal nothing more is written; each written variable has been printed.
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
  bcap put I1-I50 0
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

/// The maximum number of variables that are open at the same time: a controller has a limit.
pub(crate) const GROUP: usize = 500;

/// A variable and the value to write.
struct Write {
    name: String,
    path: ObjectPath,
    data: Data,
}

#[derive(Clone)]
enum Data {
    /// Text of the user, which gets the type of the variable.
    Plain(String),
    Value(Value),
}

impl Write {
    fn new(name: String, data: Data) -> Result<Self, Failure> {
        Ok(Self { path: ObjectPath::variable(&name)?, name, data })
    }
}

/// Runs `bcap put`.
pub(crate) fn put(args: &Put, session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut writes = match &args.from {
        Some(path) => from_lines(path)?,
        None => from_words(args)?
            .into_iter()
            .map(|(selection, data)| {
                let names = expand(session, &[selection])?;
                names.into_iter().map(|name| Write::new(name, data.clone())).collect::<Result<Vec<_>, _>>()
            })
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .flatten()
            .collect(),
    };
    let total = writes.len();
    if total > GROUP {
        for group in writes.chunks_mut(GROUP) {
            let values = with_open(session, group, |_, open| Ok(open.to_vec()))?;
            group.iter_mut().zip(values).for_each(|(write, (_, value))| write.data = Data::Value(value));
        }
    }
    for (n, group) in writes.chunks(GROUP).enumerate() {
        with_open(session, group, |session, open| {
            for (done, (write, (variable, value))) in (n * GROUP..).zip(group.iter().zip(open)) {
                let arguments = [Value::new(variable)?, value.clone()];
                let written = session.call(&write.name, FunctionId::VARIABLE_PUT_VALUE, &arguments);
                written.map_err(|failure| after(failure, done, total))?;
                print(&shown(&write.name, value, json), json).map_err(|error| after(error.into(), done + 1, total))?;
            }
            Ok(())
        })?;
    }
    Ok(())
}

/// Checks the arguments before the first call. A file of `--from` is read when its line runs.
pub(crate) fn check(args: &Put) -> Result<(), Failure> {
    if args.from.is_some() { Ok(()) } else { from_words(args).map(drop) }
}

/// Opens variables and converts the values to write, runs `body`, and releases the variables.
fn with_open<T>(
    session: &mut Session,
    writes: &[Write],
    body: impl FnOnce(&mut Session, &[(i32, Value)]) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let mut open = Vec::with_capacity(writes.len());
    let prepared = writes.iter().try_for_each(|write| {
        open.push(prepare(session, write)?);
        Ok(())
    });
    let done = prepared.and_then(|()| body(session, &open));
    if done.as_ref().is_err_and(|failure| !failure.leaves_the_session_alive()) {
        return done;
    }
    // an error of the writes is more useful than an error of a release
    let released = open.iter().try_for_each(|(variable, _)| session.release(Object::Variable, *variable));
    done.and_then(|done| released.map(|()| done))
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

/// Adds to a failure how many of several variables have been written.
fn after(failure: Failure, done: usize, total: usize) -> Failure {
    match failure {
        Failure::Refused { doing, code } if total > 1 => {
            Failure::Refused { doing: format!("{doing} ({done} of {total} are written)"), code }
        }
        Failure::Stdio(error) if total > 1 => {
            let message = format!("{error} ({done} of {total} are written)");
            Failure::Stdio(io::Error::new(error.kind(), message))
        }
        failure => failure,
    }
}

fn from_words(args: &Put) -> Result<Vec<(Selection, Data)>, Failure> {
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
        Ok((Selection::parse(name)?, data))
    };
    pairs.iter().map(write).collect()
}

fn no_pair(word: &str, words: &[&String]) -> Failure {
    match words {
        [name] => Failure::Input(format!("{name}: the value is missing; write {name} VALUE")),
        [name, numbers @ ..] if !name.contains('=') && numbers.iter().all(|number| number.parse::<f64>().is_ok()) => {
            let numbers: Vec<&str> = numbers.iter().map(|number| number.as_str()).collect();
            Failure::Input(format!("{name}: write commas between the elements: {name} {}", numbers.join(",")))
        }
        _ => Failure::Input(format!("{word}: write several variables as NAME=VALUE, such as I1=5 I2=7")),
    }
}

/// Reads a file of lines of JSON, or the standard input for `-`.
fn from_lines(path: &Path) -> Result<Vec<Write>, Failure> {
    let lines = if path == Path::new("-") {
        named::read_lines(io::stdin().lock(), "the standard input").map_err(Failure::Input)?
    } else {
        let shown = path.display().to_string();
        let file = File::open(path).map_err(cannot("read", path))?;
        named::read_lines(BufReader::new(file), &shown).map_err(Failure::Input)?
    };
    let write = |line: Named| match line.entry {
        Entry::Value(value) => Write::new(line.name, Data::Value(value)),
        Entry::Refused(code) => {
            Err(Failure::Input(format!("{}: the line has no value, the controller refused it with {code}", line.name)))
        }
    };
    lines.into_iter().map(write).collect()
}
