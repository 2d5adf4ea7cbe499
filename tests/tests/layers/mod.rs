//! Tests the layers: no module imports one above it, and the files of a crate have no import cycles.
//!
//! The order of packages and modules is the block `layers` in `docs/design.md`. `cargo test -p bcap-tests layers:: --
//! --nocapture` prints the number of cycles of each crate, and where the block is wrong, an order that the code follows.

mod graph;
mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use graph::Arrows;
use source::Source;

/// The crates whose files are read, and their folders.
const CRATES: [(&str, &str); 20] = [
    ("bcap-core", "core"),
    ("bcap-gateway", "core/gateway"),
    ("bcap-std", "std-adapter"),
    ("bcap-c", "std-adapter/c"),
    ("bcap-sim", "std-adapter/sim"),
    ("bcap-testkit", "std-adapter/testkit"),
    ("bcap-capture", "std-adapter/capture"),
    ("bcap-backup", "std-adapter/backup"),
    ("bcap-stream", "std-adapter/stream"),
    ("bcap-service", "std-adapter/service"),
    ("bcap-conform", "std-adapter/conform"),
    ("bcap-fleet", "std-adapter/fleet"),
    ("bcap-live", "std-adapter/live"),
    ("bcap-provision", "std-adapter/provision"),
    ("bcap-cli", "std-adapter/cli"),
    ("bcap-web", "std-adapter/web"),
    ("bcap-terminal", "std-adapter/terminal"),
    ("bcap-embassy", "embassy-adapter"),
    ("bcap-board", "embassy-adapter/board"),
    ("bcap-firmware", "embassy-adapter/firmware"),
];

/// Cycles of the types themselves: a value can be an array, and the elements of an array are values.
const RECURSIVE_TYPES: [(&str, [&str; 2]); 1] = [("bcap-core", ["variant/array.rs", "variant/mod.rs"])];

/// Packages whose dependencies alone are checked.
const PACKAGES: [(&str, &str); 5] = [
    ("bcap-fuzz", "fuzz"),
    ("bcap-python", "std-adapter/python"),
    ("bcap-qemu", "tests/qemu"),
    ("bcap-test-support", "tests/support"),
    ("bcap-tests", "tests"),
];

/// Layers from the highest to the lowest; a layer may use those after it.
type Layers = Vec<Vec<String>>;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Returns the arrows between the files of a crate.
fn files(folder: &str) -> Arrows {
    graph::files(&Source::read(&repository().join(folder).join("src")))
}

/// Reads the block `layers` of the design: `NAME: HIGHEST > LAYER OF SEVERAL > LOWEST`, continued on indented lines.
fn designed() -> BTreeMap<String, Layers> {
    let text = fs::read_to_string(repository().join("docs/design.md")).expect("docs/design.md");
    let (_, block) = text.split_once("```layers\n").expect("a block `layers` in docs/design.md");
    let (block, _) = block.split_once("```").expect("the end of the block");
    let block = block.replace("\n ", " ");
    let lines = block.lines().map(|line| line.split_once(':').unwrap_or_else(|| panic!("no name in {line:?}")));
    let layer = |names: &str| names.split_whitespace().map(String::from).collect();
    lines.map(|(name, layers)| (name.to_owned(), layers.split('>').map(layer).collect())).collect()
}

/// Returns the arrows that break the layers, and the nodes that are missing in one of the two.
fn violations(arrows: &Arrows, layers: &Layers) -> Vec<String> {
    let places: BTreeMap<_, _> =
        layers.iter().enumerate().flat_map(|(place, names)| names.iter().map(move |name| (name, place))).collect();
    let mut wrong: Vec<_> =
        arrows.keys().filter(|name| !places.contains_key(name)).map(|name| format!("{name} has no layer")).collect();
    wrong.extend(places.keys().filter(|name| !arrows.contains_key(**name)).map(|name| format!("there is no {name}")));
    for (from, to) in arrows.iter().flat_map(|(from, targets)| targets.iter().map(move |to| (from, to))) {
        if let (Some(above), Some(below)) = (places.get(from), places.get(to))
            && above >= below
        {
            wrong.push(format!("{from} uses {to}, which is not below it"));
        }
    }
    wrong
}

/// Returns an order that the arrows keep as the design writes it.
fn proposal(name: &str, arrows: &Arrows) -> String {
    let layers: Vec<_> = graph::order(arrows).iter().map(|names| names.join(" ")).collect();
    format!("{name}: {}", layers.join("\n    > "))
}

/// Checks arrows against the layers that the design lists under a name; returns the violations.
fn check(name: &str, arrows: &Arrows) -> Option<String> {
    let circles = graph::circles(arrows);
    if !circles.is_empty() {
        return Some(format!("{name}: circles among {circles:?}"));
    }
    let wrong = designed().get(name).map_or_else(|| vec!["no layers".into()], |layers| violations(arrows, layers));
    let proposal = || format!("{name}: {wrong:#?}\nan order that the code keeps:\n{}\n", proposal(name, arrows));
    (!wrong.is_empty()).then(proposal)
}

#[test]
fn no_module_imports_one_above_it() {
    let wrong: Vec<_> =
        CRATES.into_iter().filter_map(|(name, folder)| check(name, &graph::modules(&files(folder)))).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    for (name, folder) in CRATES {
        let files = files(folder);
        let mut circles = graph::circles(&files);
        circles
            .retain(|circle| !RECURSIVE_TYPES.iter().any(|(owner, types)| *owner == name && circle.iter().eq(types)));
        let members: usize = circles.iter().map(BTreeSet::len).sum();
        println!("{name}: {} files, {} circles of {members} files", files.len(), circles.len());
        assert!(circles.is_empty(), "{name}: circles {circles:#?}");
    }
}

#[test]
fn no_package_depends_on_one_above_it() {
    let packages = CRATES.into_iter().chain(PACKAGES);
    let names: BTreeSet<_> = packages.clone().map(|(name, _)| name).collect();
    let mut arrows = Arrows::new();
    for (package, folder) in packages {
        let manifest = fs::read_to_string(repository().join(folder).join("Cargo.toml")).expect("a manifest");
        let keys = manifest.lines().filter_map(|line| line.split([' ', '.', '=']).next());
        let dependencies = keys.filter(|key| names.contains(key) && *key != package).map(String::from);
        arrows.insert(package.to_owned(), dependencies.collect());
    }
    assert_eq!(check("packages", &arrows), None);
}

#[test]
fn arrows_upwards_and_circles_are_found() {
    let files = [
        ("lib.rs", "mod low; mod high; pub use self::high::Top;"),
        // comments, strings and tests do not count; the last line does: what `crate::Top` names is in high/top.rs
        (
            "low.rs",
            "// crate::high::mid()\n const A: &str = \"crate::high\";\n #[cfg(test)] mod tests { use crate::high::mid; }\n\
             fn f(_: crate::Top) {}",
        ),
        ("high/mod.rs", "mod top; pub use top::Top; pub(crate) fn mid() { crate::low::f() }"),
        ("high/top.rs", "pub struct Top; impl Top { fn g() { super::mid() } }"),
    ];
    let src = Path::new(env!("CARGO_TARGET_TMPDIR")).join("layers");
    fs::create_dir_all(src.join("high")).expect("a folder");
    for (name, text) in files {
        fs::write(src.join(name), text).expect("a file");
    }
    let files = graph::files(&Source::read(&src));
    let arrows: Vec<_> = files.iter().flat_map(|(from, to)| to.iter().map(move |to| format!("{from} {to}"))).collect();
    assert_eq!(arrows, ["high/mod.rs low.rs", "high/top.rs high/mod.rs", "low.rs high/top.rs"]);
    assert_eq!(graph::circles(&files).len(), 1);
    let layers = [vec!["lib".into()], vec!["high".into()], vec!["low".into()]];
    assert_eq!(violations(&graph::modules(&files), &layers.to_vec()), ["low uses high, which is not below it"]);
}
