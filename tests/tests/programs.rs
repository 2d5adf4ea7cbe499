//! Each file in a folder of tests is a module of its `main.rs`, or a program that Cargo.toml names: Cargo does not discover
//! any.

use std::fs;
use std::path::{Path, PathBuf};

/// Returns the folders `tests` of the packages of the workspace that have a `main.rs`.
fn folders() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let manifest = fs::read_to_string(root.join("Cargo.toml")).unwrap();
    let (_, members) = manifest.split_once("members = [").unwrap();
    let (members, _) = members.split_once(']').unwrap();
    let folders = members.split(',').map(|member| root.join(member.trim().trim_matches('"')).join("tests"));
    folders.filter(|folder| folder.join("main.rs").exists()).collect()
}

#[test]
fn every_file_of_tests_is_in_a_program() {
    let mut missing = Vec::new();
    for folder in folders() {
        let main = fs::read_to_string(folder.join("main.rs")).unwrap();
        let manifest = fs::read_to_string(folder.join("../Cargo.toml")).unwrap();
        for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            let holds_code = path.extension().is_some_and(|end| end == "rs") || path.join("mod.rs").exists();
            let name = path.file_stem().unwrap().to_str().unwrap();
            let is_listed = main.contains(&format!("mod {name};")) || manifest.contains(&format!("name = \"{name}\""));
            if holds_code && name != "main" && !is_listed {
                missing.push(path);
            }
        }
    }
    assert_eq!(missing, Vec::<PathBuf>::new());
    assert!(folders().len() >= 9, "{:?}", folders());
}
