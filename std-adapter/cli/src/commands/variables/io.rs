//! `bcap io`: inputs and outputs as a grid.

use std::path::PathBuf;

use bcap_core::variant::Variant;
use clap::Args;

use crate::commands::variables::labels;
use crate::failure::Failure;
use crate::output::{print_line, print_result};
use crate::session::Session;
use crate::session::variables::{expand, get_one, paths};
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
    let labels = args.labels.as_deref().map(labels::read).transpose()?.unwrap_or_default();
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
