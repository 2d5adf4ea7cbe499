//! Which file of a crate needs which, and which module.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{Names, Source, child};

/// Arrows from a module to the modules that it needs.
pub(crate) type Arrows = BTreeMap<String, BTreeSet<String>>;

/// A path leads to re-exports of re-exports at most this often.
const MAX_REEXPORTS: usize = 8;

/// Returns the arrows between the files of a crate. An item that a module re-exports is looked for where it is defined.
pub(crate) fn files(source: &Source) -> Arrows {
    let mut arrows: Arrows = source.modules.values().map(|file| (file.clone(), BTreeSet::new())).collect();
    let mut add = |scope: &Names, target: Option<&String>| {
        let (from, Some(to)) = (&source.modules[scope], target) else { return };
        if from != to {
            arrows.entry(from.clone()).or_default().insert(to.clone());
        }
    };
    for mention in &source.mentions {
        add(&mention.scope, item(source, &mention.scope, &mention.path, MAX_REEXPORTS));
    }
    // a module needs its re-exports only if it names them
    for (scope, name) in &source.identifiers {
        if let Some(import) = source.import(scope, name).filter(|import| import.is_reexport) {
            add(scope, item(source, scope, &import.path, MAX_REEXPORTS));
        }
    }
    arrows
}

/// Returns the file that defines the item a path names. A path into another crate has none, and neither has a path to a
/// module: the paths through it count.
fn item<'s>(source: &'s Source, scope: &[String], path: &[String], depth: usize) -> Option<&'s String> {
    let (first, names) = path.split_first()?;
    let (mut module, mut names) = match first.as_str() {
        "crate" => (Names::new(), names),
        "self" => (scope.to_vec(), names),
        "super" => (scope.split_last()?.1.to_vec(), names),
        name if source.modules.contains_key(&child(scope, name)) || source.import(scope, name).is_some() => {
            (scope.to_vec(), path)
        }
        // of another crate, or a type of this module
        _ => return None,
    };
    while let Some((name, rest)) = names.split_first() {
        if name == "super" {
            module.pop();
        } else if source.modules.contains_key(&child(&module, name)) {
            module = child(&module, name);
        } else if let (1.., Some(import)) = (depth, source.import(&module, name)) {
            return item(source, &module, &[import.path.as_slice(), rest].concat(), depth - 1);
        } else {
            return source.modules.get(&module);
        }
        names = rest;
    }
    None
}

/// Returns the arrows between modules at the root of a crate, from those between files.
pub(crate) fn modules(files: &Arrows) -> Arrows {
    let mut arrows = Arrows::new();
    for (from, targets) in files {
        let found = arrows.entry(module_of(from)).or_default();
        found.extend(targets.iter().map(|to| module_of(to)).filter(|to| *to != module_of(from)));
    }
    arrows
}

/// Returns the module at the root of the crate that a file belongs to.
fn module_of(file: &str) -> String {
    file.split(['/', '.']).next().unwrap_or(file).to_owned()
}

/// Returns the groups of nodes that reach each other.
pub(crate) fn circles(arrows: &Arrows) -> Vec<BTreeSet<&String>> {
    let reached: BTreeMap<_, _> = arrows.keys().map(|node| (node, reachable(arrows, node))).collect();
    let mut circles: Vec<BTreeSet<&String>> = Vec::new();
    for (node, targets) in &reached {
        let circle: BTreeSet<_> = targets.iter().copied().filter(|to| reached[to].contains(node)).collect();
        if !circle.is_empty() && !circles.contains(&circle) {
            circles.push(circle);
        }
    }
    circles
}

/// Returns the nodes that can be reached from a node by one arrow or more.
fn reachable<'a>(arrows: &'a Arrows, node: &'a String) -> BTreeSet<&'a String> {
    let (mut found, mut left) = (BTreeSet::new(), vec![node]);
    while let Some(node) = left.pop() {
        left.extend(arrows.get(node).into_iter().flatten().filter(|to| found.insert(*to)));
    }
    found
}

/// Returns the layers in topological order, the highest first; there must be no cycle.
pub(crate) fn order(arrows: &Arrows) -> Vec<Vec<&str>> {
    let mut layers = Vec::new();
    let mut left: BTreeSet<_> = arrows.keys().map(String::as_str).collect();
    while !left.is_empty() {
        let lowest: Vec<_> =
            left.iter().copied().filter(|node| arrows[*node].iter().all(|to| !left.contains(to.as_str()))).collect();
        assert!(!lowest.is_empty(), "a circle among {left:?}");
        left.retain(|node| !lowest.contains(node));
        layers.insert(0, lowest);
    }
    layers
}
