//! `bcap ls`, `bcap cp` and `bcap rm`: the files of a controller.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use bcap_core::bcap::FunctionId;
use clap::Args;

use crate::failure::{Failure, of_file};
use crate::output::{print_json, print_line, print_result};
use crate::session::Session;
use crate::session::confirm::Question;
use bcap_backup::local_files;
use bcap_live::files::{self as remote_files, Item};
use bcap_live::stream::spare;

/// Lists files and folders of the controller
///
/// A folder ends with /. PATH may have the wildcards * and ?; quote them. Case does not matter there. A name that would be unsafe
/// on this machine, such as `../x`, is shown in quotes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap ls
  bcap ls --long '/*.pcs'
  bcap ls --recursive --json")]
pub(crate) struct Ls {
    /// A folder or file of the controller; robot: before it is optional
    #[arg(default_value = "/")]
    pub(crate) path: String,

    /// Lists all files below each folder
    #[arg(short, long)]
    pub(crate) recursive: bool,

    /// Prints the size of each file in bytes before its name
    #[arg(short, long)]
    pub(crate) long: bool,
}

/// Copies files to or from the controller
///
/// robot: marks the side of the controller: robot:/Pro1.pcs. A path of the controller may have the wildcards * and ?; quote
/// them. DEST is a folder if it ends with /, exists as a folder, or there are several sources. All destinations are checked
/// before the first file is copied; an existing file is replaced only with --force. A file that was written to the
/// controller is read back and compared. A file of this machine is never half written. A file of the controller whose name would
/// be unsafe on this machine is not copied; the command copies the others, names it and ends with 3.
///
/// A controller stores text: UTF-8 is sent as a string, other bytes as an array of bytes. Over UDP a file must fit one
/// datagram of at most 504 bytes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap cp Pro1.pcs robot:/
  bcap cp robot:/Pro1.pcs Pro1-copy.pcs
  bcap cp --force 'robot:/*.pcs' programs/
  bcap cp --recursive robot:/ all/")]
pub(crate) struct Cp {
    /// The files, and where to copy them
    #[arg(value_names = ["SOURCE", "DEST"], required = true, num_args = 2..)]
    pub(crate) paths: Vec<String>,

    /// Replaces files that exist
    #[arg(short, long)]
    pub(crate) force: bool,

    /// Copies folders with all files below them
    #[arg(short, long)]
    pub(crate) recursive: bool,
}

/// Deletes files of the controller
///
/// A path may have the wildcards * and ?; quote them. Folders are not deleted. All files are found first, and a real controller is
/// changed only after a question, or with --yes; without a terminal the question cannot be asked, so --yes is needed.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap rm robot:/Pro2.pcs
  bcap rm --yes 'robot:/*.bak'")]
pub(crate) struct Rm {
    /// The files, such as robot:/Pro2.pcs
    #[arg(value_name = "ROBOT_FILE", required = true)]
    pub(crate) paths: Vec<String>,

    /// Deletes without asking for confirmation
    #[arg(long)]
    pub(crate) yes: bool,
}

/// Runs `bcap rm`.
pub(crate) fn rm(args: &Rm, session: &mut Session, json: bool) -> Result<(), Failure> {
    let files = session.before_question(|session| to_delete(&args.paths, session))?;
    let shown: Vec<String> = files.iter().map(|path| format!("robot:/{path}")).collect();
    let what = format!("{} deletes {} files: {}", session.link().target()?, files.len(), shown.join(", "));
    let question = Question { what: &what, warning: "Nothing restores them.", refused: "nothing was deleted" };
    question.confirm(session, args.yes)?;
    session.begin()?;
    spare(session, FunctionId::FILE_DELETE, None)?;
    for (path, shown) in files.iter().zip(shown) {
        remote_files::delete(session, path)?;
        print_result(json, &serde_json::json!({ "deleted": shown }), &format!("{shown} is deleted"))?;
    }
    Ok(())
}

/// Returns the files that `bcap rm` deletes.
fn to_delete(paths: &[String], session: &mut Session) -> Result<BTreeSet<String>, Failure> {
    let local = |path| Failure::Input(format!("{path}: write robot:/NAME; only files of the controller are deleted"));
    let patterns = paths.iter().map(|path| Place::parse(path).remote().ok_or_else(|| local(path)));
    let files = found(session, &patterns.collect::<Result<Vec<_>, _>>()?)?;
    match files.iter().find(|item| item.is_folder || item.is_unsafe) {
        Some(item) => Err(Failure::Input(format!("{} is not deleted: write the names of files", item.shown()))),
        None => Ok(files.into_iter().map(|item| item.path).collect()),
    }
}

/// Returns what matches each path of the controller; a path without a match is an error.
fn found(session: &mut Session, patterns: &[String]) -> Result<Vec<Item>, Failure> {
    session.begin()?;
    spare(session, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
    let mut found = Vec::new();
    for pattern in patterns {
        let items = remote_files::find(session, pattern)?;
        if items.is_empty() {
            return Err(not_found(pattern));
        }
        found.extend(items);
    }
    Ok(found)
}

/// Runs `bcap ls`.
pub(crate) fn ls(args: &Ls, session: &mut Session, json: bool) -> Result<(), Failure> {
    let path = match Place::parse(&args.path) {
        Place::Remote(path) => path,
        Place::Local(path) => remote_files::normal(&path.to_string_lossy()),
    };
    for item in listed(session, &path, args.recursive)? {
        let size = if args.long && !item.is_folder && !item.is_unsafe {
            Some(remote_files::size(session, &item.path)?)
        } else {
            None
        };
        print_item(&item, size, args.long, json)?;
    }
    Ok(())
}

/// Returns the content of a folder, or what matches a path with wildcards.
fn listed(session: &mut Session, path: &str, recursive: bool) -> Result<Vec<Item>, Failure> {
    let found = found(session, &[path.to_owned()])?;
    let with_wildcards = path.contains(['*', '?']);
    let mut items = Vec::new();
    for item in found {
        match (item.is_folder && !item.is_unsafe, recursive) {
            (true, true) => {
                items.extend(remote_files::walk(session, &item.path, |_, _| Ok(()), |_, failure| Err(failure))?)
            }
            (true, false) if !with_wildcards => items.extend(remote_files::items(session, &item.path)?),
            _ => items.push(item),
        }
    }
    Ok(items)
}

fn print_item(item: &Item, size: Option<i64>, long: bool, json: bool) -> Result<(), Failure> {
    if json {
        let mut line = serde_json::json!({ "path": format!("/{}", item.path), "folder": item.is_folder });
        if let Some(size) = size {
            line["size"] = size.into();
        }
        if item.is_unsafe {
            line["unsafe"] = true.into();
        }
        return Ok(print_json(&line.to_string())?);
    }
    let (path, size) = (item.shown(), size.map(|size| size.to_string()).unwrap_or_default());
    Ok(print_line(&if long { format!("{size:>10}  {path}") } else { path })?)
}

/// Runs `bcap cp`.
pub(crate) fn cp(args: &Cp, session: &mut Session, json: bool) -> Result<(), Failure> {
    let Some((last, sources)) = args.paths.split_last() else {
        return Err(Failure::Input("write SOURCE and DEST".into()));
    };
    let mut copying = Copying { args, session, json };
    let sources: Vec<Place> = sources.iter().map(|source| Place::parse(source)).collect();
    let into_folder = last.ends_with(['/', '\\']) || sources.len() > 1;
    match Place::parse(last) {
        Place::Local(to) => {
            let patterns = sources.into_iter().map(|source| source.remote().ok_or_else(one_side));
            copying.download(&patterns.collect::<Result<Vec<_>, _>>()?, &to, into_folder)
        }
        Place::Remote(to) if to.contains(['*', '?']) => {
            Err(Failure::Input(format!("robot:/{to}: DEST has no wildcards; write the name of a file or folder")))
        }
        Place::Remote(to) => {
            let files = sources.into_iter().map(|source| source.local().ok_or_else(one_side));
            copying.upload(&files.collect::<Result<Vec<_>, _>>()?, &to, into_folder || to.is_empty())
        }
    }
}

fn one_side() -> Failure {
    Failure::Input("SOURCE or DEST is a file of the controller, and not both: write robot:/NAME for it".into())
}

fn not_found(path: &str) -> Failure {
    Failure::Input(format!("robot:/{path}: the controller has no such file or folder; `bcap ls` lists them"))
}

/// A run of `bcap cp`.
struct Copying<'a> {
    args: &'a Cp,
    session: &'a mut Session,
    json: bool,
}

impl Copying<'_> {
    fn download(&mut self, patterns: &[String], to: &Path, into: bool) -> Result<(), Failure> {
        let found = found(self.session, patterns)?;
        let into = into || to.is_dir() || found.len() > 1;
        let mut copies: Vec<(String, PathBuf)> = Vec::new();
        let (mut skipped, found): (Vec<_>, Vec<_>) = found.into_iter().partition(|item| item.is_unsafe);
        for item in &found {
            let base =
                if into && !item.path.is_empty() { to.join(remote_files::last(&item.path)) } else { to.to_owned() };
            if !item.is_folder {
                copies.push((item.path.clone(), base));
                continue;
            }
            self.needs_recursive(&format!("robot:/{}", item.path))?;
            for file in remote_files::walk(self.session, &item.path, |_, _| Ok(()), |_, failure| Err(failure))? {
                if file.is_unsafe {
                    skipped.push(file);
                    continue;
                }
                let below = file.path.strip_prefix(&item.path).unwrap_or(&file.path).trim_start_matches('/');
                let to = base.join(below);
                copies.push((file.path, to));
            }
        }
        check(copies.iter().map(|(_, to)| to.display().to_string()), self.args.force, |to| Ok(Path::new(to).exists()))?;
        for (from, to) in copies {
            // a signal during a copy would leave an empty file
            self.session.handle_signals()?.check("interrupted between two files")?;
            let bytes = remote_files::read(self.session, &from)?;
            local_files::write(&to, &bytes, self.args.force)?;
            self.print(&format!("robot:/{from}"), &to.display().to_string())?;
        }
        if skipped.is_empty() { Ok(()) } else { Err(remote_files::unsafe_names(&skipped)) }
    }

    fn upload(&mut self, files: &[PathBuf], to: &str, into: bool) -> Result<(), Failure> {
        self.session.begin()?;
        spare(self.session, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
        // only a listing distinguishes a folder from a file
        let into = into || remote_files::find(self.session, to)?.iter().any(|item| item.is_folder);
        let mut copies: Vec<(PathBuf, String)> = Vec::new();
        for file in files {
            let base = match file.file_name() {
                Some(name) if into => remote_files::normal(&format!("{to}/{}", name.to_string_lossy())),
                _ => to.to_owned(),
            };
            if !fs::metadata(file).map_err(of_file(file))?.is_dir() {
                copies.push((file.clone(), base));
                continue;
            }
            self.needs_recursive(&file.display().to_string())?;
            for below in local_files::all_below(file)? {
                let name = below.strip_prefix(file).unwrap_or(&below).to_string_lossy().into_owned();
                copies.push((below, remote_files::normal(&format!("{base}/{name}"))));
            }
        }
        check(copies.iter().map(|(_, to)| to.clone()), self.args.force, |to| remote_files::exists(self.session, to))?;
        for (from, to) in copies {
            // a signal during a copy would leave an empty file
            self.session.handle_signals()?.check("interrupted between two files")?;
            let bytes = fs::read(&from).map_err(of_file(&from))?;
            remote_files::make_folders(self.session, &to)?;
            remote_files::write(self.session, &to, &bytes)?;
            self.print(&from.display().to_string(), &format!("robot:/{to}"))?;
        }
        Ok(())
    }

    fn needs_recursive(&self, folder: &str) -> Result<(), Failure> {
        if self.args.recursive {
            Ok(())
        } else {
            Err(Failure::Input(format!("{folder} is a folder; give --recursive")))
        }
    }

    fn print(&self, from: &str, to: &str) -> Result<(), Failure> {
        Ok(print_result(self.json, &serde_json::json!({ "from": from, "to": to }), &format!("{from} -> {to}"))?)
    }
}

/// Checks all destinations before the first file is copied.
fn check(
    all: impl Iterator<Item = String>,
    force: bool,
    mut exists: impl FnMut(&str) -> Result<bool, Failure>,
) -> Result<(), Failure> {
    let mut seen = BTreeSet::new();
    for to in all {
        if !force && exists(&to)? {
            return Err(Failure::Input(format!("{to} exists; give --force to replace it. No file was copied")));
        }
        if let Some(twice) = seen.replace(to) {
            return Err(Failure::Input(format!("{twice}: two files would have this name. No file was copied")));
        }
    }
    Ok(())
}

/// A path; `robot:` marks one of the controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    Local(PathBuf),
    /// From the root, without a `/` at its beginning and end.
    Remote(String),
}

impl Place {
    /// Parses `robot:/Folder/Name`, or the path of a file of this machine.
    pub(crate) fn parse(word: &str) -> Self {
        match word.split_once(':') {
            Some((robot, path)) if robot.eq_ignore_ascii_case("robot") => Self::Remote(remote_files::normal(path)),
            _ => Self::Local(word.into()),
        }
    }

    fn local(self) -> Option<PathBuf> {
        if let Self::Local(path) = self { Some(path) } else { None }
    }

    fn remote(self) -> Option<String> {
        if let Self::Remote(path) = self { Some(path) } else { None }
    }
}
