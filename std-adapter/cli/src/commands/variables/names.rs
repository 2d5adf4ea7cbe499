//! `bcap names`: the names that the controller lists.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_std::ObjectPath;
use clap::Args;

use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;
use crate::session::variables::list;
use bcap_live::stream::spare;

/// Lists the variables, robots, tasks, files, extensions and commands of the controller
///
/// The other commands accept the names as they are printed. A list that the controller does not implement (E_NOTIMPL) is
/// omitted. Any other list that cannot be read is an error, and the exit code is 1. Over UDP a list must fit one datagram of
/// at most 504 bytes; TCP carries longer lists.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap names
  bcap names robot
  bcap names --json --robot tcp:192.168.0.1")]
pub(crate) struct Names {
    /// Only names that contain this text; case does not matter
    #[arg(value_name = "TEXT", default_value = "", hide_default_value = true)]
    pub(crate) filter: String,
}

/// The functions that list names, with the kind of the listed objects.
const LISTS: [(Object, FunctionId); 6] = [
    (Object::Variable, FunctionId::CONTROLLER_GET_VARIABLE_NAMES),
    (Object::Robot, FunctionId::CONTROLLER_GET_ROBOT_NAMES),
    (Object::Task, FunctionId::CONTROLLER_GET_TASK_NAMES),
    (Object::File, FunctionId::CONTROLLER_GET_FILE_NAMES),
    (Object::Extension, FunctionId::CONTROLLER_GET_EXTENSION_NAMES),
    (Object::Command, FunctionId::CONTROLLER_GET_COMMAND_NAMES),
];

/// Runs `bcap names`.
pub(crate) fn names(args: &Names, session: &mut Session, json: bool) -> Result<(), Failure> {
    spare(session, FunctionId::CONTROLLER_GET_VARIABLE_NAMES, None)?;
    let mut lists = Lists { session, filter: args.filter.to_lowercase(), json, total: 0, missing: 0, refused: 0 };
    let controller = ObjectPath::controller();
    for (object, function) in LISTS {
        for path in lists.print(&controller, object, function)? {
            let inner = match object {
                Object::Robot => FunctionId::ROBOT_GET_VARIABLE_NAMES,
                Object::Task => FunctionId::TASK_GET_VARIABLE_NAMES,
                _ => continue,
            };
            lists.print(&path, Object::Variable, inner)?;
        }
    }
    lists.end()
}

/// Returns the names of all lists that the controller has, for completion; `None` while they cannot be read.
pub(crate) fn all_names(session: &mut Session) -> Option<Vec<String>> {
    spare(session, FunctionId::CONTROLLER_GET_VARIABLE_NAMES, None).ok()?;
    let mut all = Vec::new();
    let controller = ObjectPath::controller();
    for (object, function) in LISTS {
        for name in list(session, &controller, function).unwrap_or_default() {
            let path = controller.clone().join(object, name);
            if object == Object::Robot {
                let inner = list(session, &path, FunctionId::ROBOT_GET_VARIABLE_NAMES).unwrap_or_default();
                all.extend(inner.into_iter().map(|name| format!("robot/{name}")));
            }
            all.push(path.to_string());
        }
    }
    Some(all)
}

/// Prints the lists of `bcap names`, each either complete or not at all. A refused list is reported, unless the controller does
/// not implement it.
struct Lists<'a> {
    session: &'a mut Session,
    /// Only names with this text are printed.
    filter: String,
    json: bool,
    total: usize,
    /// The number of lists that the controller does not implement.
    missing: usize,
    refused: usize,
}

impl Lists<'_> {
    /// Prints a list of the names of `owner`'s objects, and returns the paths to them.
    fn print(&mut self, owner: &ObjectPath, object: Object, function: FunctionId) -> Result<Vec<ObjectPath>, Failure> {
        self.total += 1;
        let names = match list(self.session, owner, function) {
            Err(Failure::Refused { code: HResult::E_NOTIMPL, .. }) => {
                self.missing += 1;
                return Ok(Vec::new());
            }
            Err(failure @ Failure::Refused { .. }) => {
                // for example E_TOO_MUCH_DATA for a list that does not fit a datagram
                failure.print(self.json, None);
                self.refused += 1;
                return Ok(Vec::new());
            }
            names => names?,
        };
        let paths: Vec<ObjectPath> = names.into_iter().map(|name| owner.clone().join(object, name)).collect();
        let kind = object.name().to_ascii_lowercase();
        let names = paths.iter().map(ToString::to_string);
        for name in names.filter(|name| name.to_lowercase().contains(&self.filter)) {
            print_result(self.json, &serde_json::json!({ "kind": kind, "name": name }), &name)?;
        }
        Ok(paths)
    }

    /// Returns an error if a list was refused, or if the controller implements no list.
    fn end(self) -> Result<(), Failure> {
        match self {
            Self { refused: 0, missing, total, .. } if missing < total => Ok(()),
            Self { refused: 0, .. } => {
                Err(Failure::Refused { doing: "the lists of names".into(), code: HResult::E_NOTIMPL })
            }
            Self { refused, total, .. } => Err(Failure::Reported(format!(
                "{refused} of {total} lists of names were refused; the output is not complete"
            ))),
        }
    }
}
