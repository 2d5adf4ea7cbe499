//! `bcap ls` and `bcap cp`: the files of a controller.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use bcap_core::bcap::FunctionId;

use crate::args::{Cp, Ls};
use crate::disk;
use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::place::Place;
use crate::remote::{self, Item};
use crate::session::Session;
use crate::stream::spare;

/// Runs `bcap ls`.
pub(crate) fn ls(args: &Ls, session: &mut Session, json: bool) -> Result<(), Failure> {
    let path = match Place::parse(&args.path) {
        Place::Remote(path) => path,
        Place::Local(path) => remote::normal(&path.to_string_lossy()),
    };
    session.begin()?;
    spare(session, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
    for item in listed(session, &path, args.recursive)? {
        let size = if args.long && !item.is_folder { Some(remote::size(session, &item.path)?) } else { None };
        print_item(&item, size, args.long, json)?;
    }
    Ok(())
}

/// Returns the content of a folder, or what matches a path with wildcards.
fn listed(session: &mut Session, path: &str, recursive: bool) -> Result<Vec<Item>, Failure> {
    let found = remote::find(session, path)?;
    if found.is_empty() {
        return Err(not_found(path));
    }
    let with_wildcards = path.contains(['*', '?']);
    let mut items = Vec::new();
    for item in found {
        match (item.is_folder, recursive) {
            (true, true) => {
                let files = remote::walk(session, &item.path, |_, failure| Err(failure))?;
                items.extend(files.into_iter().map(|path| Item { path, is_folder: false }));
            }
            (true, false) if !with_wildcards => items.extend(remote::list(session, &item.path)?),
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
        return Ok(print_json(&line.to_string())?);
    }
    let end = if item.is_folder { "/" } else { "" };
    let size = size.map(|size| size.to_string()).unwrap_or_default();
    Ok(print_line(&if long { format!("{size:>10}  /{}{end}", item.path) } else { format!("/{}{end}", item.path) })?)
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
            let patterns = sources.into_iter().map(|source| match source {
                Place::Remote(pattern) => Ok(pattern),
                Place::Local(_) => Err(one_side()),
            });
            copying.download(&patterns.collect::<Result<Vec<_>, _>>()?, &to, into_folder)
        }
        Place::Remote(to) if to.contains(['*', '?']) => {
            Err(Failure::Input(format!("robot:/{to}: DEST has no wildcards; write the name of a file or folder")))
        }
        Place::Remote(to) => {
            let files = sources.into_iter().map(|source| match source {
                Place::Local(file) => Ok(file),
                Place::Remote(_) => Err(one_side()),
            });
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
        self.session.begin()?;
        spare(self.session, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
        let mut found = Vec::new();
        for pattern in patterns {
            let items = remote::find(self.session, pattern)?;
            if items.is_empty() {
                return Err(not_found(pattern));
            }
            found.extend(items);
        }
        let into = into || to.is_dir() || found.len() > 1;
        let mut copies: Vec<(String, PathBuf)> = Vec::new();
        for item in &found {
            let base = if into && !item.path.is_empty() { to.join(remote::last(&item.path)) } else { to.to_owned() };
            if !item.is_folder {
                copies.push((item.path.clone(), base));
                continue;
            }
            self.needs_recursive(&format!("robot:/{}", item.path))?;
            for path in remote::walk(self.session, &item.path, |_, failure| Err(failure))? {
                let below = path.strip_prefix(&item.path).unwrap_or(&path).trim_start_matches('/');
                copies.push((path.clone(), base.join(below)));
            }
        }
        check(copies.iter().map(|(_, to)| to.display().to_string()), self.args.force, |to| Ok(Path::new(to).exists()))?;
        for (from, to) in copies {
            let bytes = remote::read(self.session, &from)?;
            disk::write(&to, &bytes, self.args.force)?;
            self.print(&format!("robot:/{from}"), &to.display().to_string())?;
        }
        Ok(())
    }

    fn upload(&mut self, files: &[PathBuf], to: &str, into: bool) -> Result<(), Failure> {
        self.session.begin()?;
        spare(self.session, FunctionId::CONTROLLER_GET_FILE_NAMES, None)?;
        // only a listing tells a folder from a file
        let into = into || remote::find(self.session, to)?.iter().any(|item| item.is_folder);
        let mut copies: Vec<(PathBuf, String)> = Vec::new();
        for file in files {
            let base = match file.file_name() {
                Some(name) if into => remote::normal(&format!("{to}/{}", name.to_string_lossy())),
                _ => to.to_owned(),
            };
            if !fs::metadata(file).map_err(disk::failed(file))?.is_dir() {
                copies.push((file.clone(), base));
                continue;
            }
            self.needs_recursive(&file.display().to_string())?;
            for below in local_files(file)? {
                let name = below.strip_prefix(file).unwrap_or(&below).to_string_lossy().into_owned();
                copies.push((below, remote::normal(&format!("{base}/{name}"))));
            }
        }
        check(copies.iter().map(|(_, to)| to.clone()), self.args.force, |to| remote::exists(self.session, to))?;
        for (from, to) in copies {
            let bytes = fs::read(&from).map_err(disk::failed(&from))?;
            remote::make_folders(self.session, &to)?;
            remote::write(self.session, &to, &bytes)?;
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
        if self.json {
            return Ok(print_json(&serde_json::json!({ "from": from, "to": to }).to_string())?);
        }
        Ok(print_line(&format!("{from} -> {to}"))?)
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

/// Lists the regular files of a folder of this machine and of the folders below it.
pub(crate) fn local_files(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(disk::failed(&folder))? {
            let entry = entry.map_err(disk::failed(&folder))?;
            let kind = entry.file_type().map_err(disk::failed(&folder))?;
            if kind.is_dir() {
                folders.push(entry.path());
            } else if kind.is_file() {
                files.push(entry.path());
            }
        }
    }
    files.sort();
    Ok(files)
}
