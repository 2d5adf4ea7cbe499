//! Replays the fuzzers' corpora as ordinary tests, and the named regressions: inputs that once broke a guarantee.

use std::fs;
use std::path::Path;

use bcap_fuzz::{TARGETS, corpus};

/// Reads the files of `fuzz/regressions/TARGET`; many targets have no such folder.
fn regressions(target: &str) -> corpus::Inputs {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/regressions").join(target);
    let Ok(entries) = fs::read_dir(&folder) else { return corpus::Inputs::new() };
    let paths = entries.map(|entry| entry.expect("a folder that can be read").path());
    paths.map(|path| (path.display().to_string(), fs::read(&path).expect("a file that can be read"))).collect()
}

/// Runs a target on all its inputs and returns the number of those in its archive.
fn replay(name: &str) -> usize {
    let (_, body) = TARGETS.iter().find(|target| target.0 == name).expect("a target of this name");
    let inputs = corpus::read(name).expect("the archive of the target's corpus");
    for (input, bytes) in inputs.iter().chain(&regressions(name)) {
        // shown only when it fails
        println!("{input}");
        body(bytes);
    }
    inputs.len()
}

macro_rules! replays {
    ($($name:ident)*) => {
        $(#[test]
        fn $name() {
            let count = replay(stringify!($name));
            assert!(count >= 50, "{} has only {count} inputs", corpus::archive_path(stringify!($name)).display());
        })*

        #[test]
        fn every_target_is_replayed() {
            assert_eq!(TARGETS.map(|target| target.0), [$(stringify!($name)),*]);
        }
    };
}

replays! { frame variant text rac_line roundtrip_binary roundtrip_text stream rac_client client server gateway sim slave }

#[test]
fn packing_the_inputs_of_an_archive_gives_the_same_bytes() {
    for (target, _) in TARGETS {
        let inputs = corpus::read(target).expect("the archive of the target's corpus");
        let packed = corpus::archive(target, &inputs).expect("names that fit");
        let committed = fs::read(corpus::archive_path(target)).expect("the archive of the target's corpus");
        assert!(packed == committed, "{target}.tar was not made by `just corpora pack`");
    }
}
