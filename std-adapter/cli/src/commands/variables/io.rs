//! `bcap io`: inputs and outputs as a grid.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use bcap_core::variant::Variant;
use clap::Args;

use crate::failure::{Failure, of_file};
use crate::output::{print_line, print_result};
use crate::session::Session;
use crate::session::selection::expand;
use crate::session::variables::{get_one, paths};
use bcap_capture::value::selection::Selection;

/// Shows inputs and outputs, eight a line: * is on, . is off
///
/// The labels follow as lines. A file of labels has lines such as `IO130 = gripper is open`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap io
  bcap io IO128-IO143 IO200 --labels cell1.labels")]
pub(crate) struct Io {
    /// The variables, as for `bcap get`
    #[arg(value_name = "NAME", default_value = "IO128-IO191")]
    pub(crate) names: Vec<String>,

    /// The file of labels
    #[arg(long, value_name = "FILE")]
    pub(crate) labels: Option<PathBuf>,
}

/// Runs `bcap io`.
pub(crate) fn io(args: &Io, session: &mut Session, json: bool) -> Result<(), Failure> {
    let labels = args.labels.as_deref().map(labels).transpose()?.unwrap_or_default();
    let names = expand(session, &Selection::parse_each(&args.names)?)?;
    let mut labelled = Vec::new();
    for names in names.chunks(8) {
        let mut row = String::new();
        for (name, path) in names.iter().zip(paths(names)?) {
            let Variant::Bool(on) = get_one(session, &path)?.as_variant() else {
                return Err(Failure::Input(format!("{name} is no IO: `bcap get` reads other variables")));
            };
            row += if on { " *" } else { " ." };
            let label = labels.get(name);
            labelled.extend(label.map(|label| format!("{name:<8} {} {label}", if on { '*' } else { '.' })));
            if json {
                print_result(true, &serde_json::json!({ "name": name, "on": on, "label": label }), "")?;
            }
        }
        if let Some(first) = names.first().filter(|_| !json) {
            print_line(&format!("{first:<8}{row}"))?;
        }
    }
    Ok(labelled.iter().filter(|_| !json).try_for_each(|line| print_line(line))?)
}

/// Reads a file of labels.
fn labels(path: &Path) -> Result<HashMap<String, String>, Failure> {
    let text = fs::read_to_string(path).map_err(of_file(path))?;
    let lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
    let label = |(number, line): (u32, &str)| match line.split_once('=') {
        Some((name, label)) => Ok((name.trim().to_uppercase(), label.trim().to_owned())),
        None => Err(Failure::Input(format!("{}, line {number}: write IO130 = LABEL", path.display()))),
    };
    lines.map(label).collect()
}
