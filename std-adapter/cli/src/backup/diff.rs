//! `bcap diff`: compares two backups, or a backup with a controller.

use std::path::Path;

use serde_json::json;

use super::compare::{self, Difference, differences};
use super::contents::Contents;
use super::{folder, live};
use crate::args::{Diff, LinkArgs};
use crate::error::Failure;
use crate::named::Entry;
use crate::output::{print_json, print_line};
use crate::plain;
use crate::session::with_session;
use crate::value::to_json;

/// Runs `bcap diff`.
pub(crate) fn diff(args: &Diff, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let (a, b) = (read(&args.a, link)?, read(&args.b, link)?);
    let variables = compare::variables(&a, &b, args.system);
    for difference in &variables {
        print(&if json { variable_json(difference) } else { variable_line(difference) }, json)?;
    }
    let files = differences(&a.files, &b.files);
    for difference in &files {
        print(&if json { file_json(difference) } else { file_line(difference) }, json)?;
    }
    if variables.is_empty() && files.is_empty() { Ok(()) } else { Err(Failure::Different) }
}

/// Reads a folder, or the controller at an address.
fn read(word: &str, link: &LinkArgs) -> Result<Contents, Failure> {
    let is_address = |scheme: &str| ["tcp", "udp", "serial"].iter().any(|known| scheme.eq_ignore_ascii_case(known));
    match word.split_once(':') {
        Some((robot, "")) if robot.eq_ignore_ascii_case("robot") => with_session(link, live::contents),
        Some((scheme, _)) if is_address(scheme) => with_session(&link.at(word), live::contents),
        _ => folder::load(Path::new(word)),
    }
}

fn print(line: &str, json: bool) -> Result<(), Failure> {
    Ok(if json { print_json(line) } else { print_line(line) }?)
}

/// Formats an entry for people.
pub(super) fn entry_text(entry: Option<&Entry>) -> String {
    match entry {
        Some(Entry::Value(value)) => plain::to_plain(value.as_variant()),
        Some(Entry::Refused(code)) => format!("(refused with {code})"),
        None => "(does not exist)".into(),
    }
}

fn variable_line(Difference { name, a, b }: &Difference<String, &Entry>) -> String {
    format!("{name}: {} -> {}", entry_text(*a), entry_text(*b))
}

fn variable_json(Difference { name, a, b }: &Difference<String, &Entry>) -> String {
    let side = |entry: &Option<&Entry>| match entry {
        Some(Entry::Value(value)) => to_json(value),
        Some(Entry::Refused(code)) => format!("{{\"refused\":{}}}", code.0),
        None => "null".into(),
    };
    format!("{{\"name\":{},\"a\":{},\"b\":{}}}", serde_json::Value::from(name.as_str()), side(a), side(b))
}

fn file_line(Difference { name, a, b }: &Difference<&String, &Vec<u8>>) -> String {
    match (a, b) {
        (Some(a), Some(b)) => format!("file:{name}: {} bytes -> {} bytes, the content differs", a.len(), b.len()),
        (Some(_), None) => format!("file:{name}: only in the first"),
        _ => format!("file:{name}: only in the second"),
    }
}

fn file_json(Difference { name, a, b }: &Difference<&String, &Vec<u8>>) -> String {
    let side = |bytes: &Option<&Vec<u8>>| bytes.map(|bytes| json!({ "size": bytes.len() }));
    json!({ "file": name, "a": side(a), "b": side(b) }).to_string()
}
