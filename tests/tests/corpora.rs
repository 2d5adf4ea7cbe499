//! The fuzzers' corpora, as ordinary tests: every input that reached something new, through the body of its target; and
//! the inputs that once broke a promise, each with its name.

use std::fs;
use std::path::{Path, PathBuf};

use bcap_fuzz::TARGETS;

/// Lists the files of `folder/target`, none where there is no such folder.
fn inputs(folder: &str, target: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz").join(folder).join(target);
    let Ok(entries) = fs::read_dir(&folder) else { return Vec::new() };
    let mut paths: Vec<_> = entries.map(|entry| entry.expect("a folder that can be read").path()).collect();
    paths.sort();
    paths
}

/// Runs a target on all its inputs and returns their number.
fn replay(name: &str) -> usize {
    let (_, body) = TARGETS.iter().find(|target| target.0 == name).expect("a target of this name");
    let paths: Vec<_> = ["corpus", "regressions"].iter().flat_map(|folder| inputs(folder, name)).collect();
    for path in &paths {
        // shown only when it fails
        println!("{}", path.display());
        body(&fs::read(path).expect("a file that can be read"));
    }
    paths.len()
}

macro_rules! replays {
    ($($name:ident)*) => {
        $(#[test]
        fn $name() {
            let count = replay(stringify!($name));
            assert!(count >= 50, "only {count} inputs: is fuzz/corpus there?");
        })*

        #[test]
        fn every_target_is_replayed() {
            assert_eq!(TARGETS.map(|target| target.0), [$(stringify!($name)),*]);
        }
    };
}

replays! { frame variant text rac_line roundtrip_binary roundtrip_text stream rac_client client server gateway sim slave }
