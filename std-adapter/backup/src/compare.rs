//! The differences of two backups.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use crate::contents::{Contents, Omission, Part};
use bcap_capture::value::data;
use bcap_capture::value::named::Entry;

/// The entries of two backups under one name.
#[derive(Debug, PartialEq, Eq)]
pub struct Difference<N, T> {
    /// The name of the variable or file.
    pub name: N,
    /// Its entry in the first backup.
    pub a: Option<T>,
    /// Its entry in the second one.
    pub b: Option<T>,
}

/// Writes `I5: 3 -> 7`.
impl fmt::Display for Difference<String, &Entry> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} -> {}", self.name, entry_text(self.a), entry_text(self.b))
    }
}

/// Writes the sizes of a file, or names the backup that has it.
impl fmt::Display for Difference<&String, &Vec<u8>> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "file:{}: ", self.name)?;
        match (self.a, self.b) {
            (Some(a), Some(b)) => write!(f, "{} bytes -> {} bytes, the content differs", a.len(), b.len()),
            (Some(_), None) => f.write_str("only in the first"),
            _ => f.write_str("only in the second"),
        }
    }
}

/// System variables that count time, and always differ.
const CLOCKS: [&str; 4] = ["@TIME", "@CURRENT_TIME", "@ELAPSED_TIME", "@CYCLE_TIME"];

/// Returns the entries that differ, in the order of their names.
pub fn differences<'a, N: Ord, T: PartialEq>(
    a: &'a BTreeMap<N, T>,
    b: &'a BTreeMap<N, T>,
) -> Vec<Difference<&'a N, &'a T>> {
    let names: BTreeSet<&N> = a.keys().chain(b.keys()).collect();
    let both = names.into_iter().map(|name| Difference { name, a: a.get(name), b: b.get(name) });
    both.filter(|difference| difference.a != difference.b).collect()
}

/// Returns the differences of the variables; with `system` also of the system variables except the clocks.
pub fn variables<'a>(a: &'a Contents, b: &'a Contents, system: bool) -> Vec<Difference<String, &'a Entry>> {
    let mut user = differences(&a.variables, &b.variables);
    user.retain(|difference| is_certain(difference, a, b, |part| part.has_variable(*difference.name)));
    let user = user.into_iter().map(|Difference { name, a, b }| Difference { name: name.name(), a, b });
    let system = if system { differences(&a.system, &b.system) } else { Vec::new() };
    let is_clock = |name: &str| CLOCKS.iter().any(|clock| name.rsplit('/').next() == Some(clock));
    let system = system.into_iter().filter(|difference| !is_clock(difference.name));
    let system = system.filter(|difference| is_certain(difference, a, b, |part| *part == Part::System));
    let system = system.map(|Difference { name, a, b }| Difference { name: name.clone(), a, b });
    user.chain(system).collect()
}

/// Returns the differences of the files.
pub fn files<'a>(a: &'a Contents, b: &'a Contents) -> Vec<Difference<&'a String, &'a Vec<u8>>> {
    let mut files = differences(&a.files, &b.files);
    files.retain(|difference| is_certain(difference, a, b, |part| part.has_file(difference.name)));
    files
}

/// Returns the parts that were not compared because one side lacks them, each with `true` if the first side lacks
/// it; with `system`, the system variables too.
pub fn omitted<'a>(a: &'a Contents, b: &'a Contents, system: bool) -> impl Iterator<Item = (bool, &'a Omission)> {
    let parts = [(true, a), (false, b)]
        .into_iter()
        .flat_map(|(is_first, side)| side.omitted.iter().map(move |part| (is_first, part)));
    parts.filter(move |(_, omission)| system || omission.part != Part::System)
}

/// Returns whether a difference is certain: an entry of only one side may be omitted from the other.
fn is_certain<N, T>(
    difference: &Difference<N, T>,
    a: &Contents,
    b: &Contents,
    is_meant: impl Fn(&Part) -> bool,
) -> bool {
    let may_exist = |value: &Option<T>, side: &Contents| value.is_none() && side.omits(&is_meant);
    !may_exist(&difference.a, a) && !may_exist(&difference.b, b)
}

/// Formats an entry for people.
#[must_use]
pub fn entry_text(entry: Option<&Entry>) -> String {
    match entry {
        Some(Entry::Value(value)) => data::format(value.as_variant()),
        Some(Entry::Refused(code)) => format!("(refused with {code})"),
        None => "(does not exist)".into(),
    }
}
