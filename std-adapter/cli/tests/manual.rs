//! `bcap generate man`: a page for each command, with its options and its examples on separate lines.

use std::fs;

use crate::common::bcap;

#[test]
fn every_command_has_a_page_with_its_examples() {
    let directory = tempfile::tempdir().unwrap();
    let pages = directory.path().join("man1");
    let run = bcap(&["generate", "man", pages.to_str().unwrap()]);
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("", "", 0));
    let mut names: Vec<_> =
        fs::read_dir(&pages).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    for name in ["bcap.1", "bcap-get.1", "bcap-slave-play.1", "bcap-gateway.1", "bcap-explain.1"] {
        assert!(names.iter().any(|page| page == name), "{name}: {names:?}");
    }
    assert!(names.iter().all(|page| !page.starts_with("bcap-help")), "{names:?}");
    let page = fs::read_to_string(pages.join("bcap-get.1")).unwrap();
    assert!(page.starts_with(".ie") && page.contains(".TH bcap-get 1"), "{page}");
    for line in ["bcap get I1", "\\-\\-json", "\\-\\-robot"] {
        assert!(page.contains(line), "{line}: {page}");
    }
}

#[test]
fn a_directory_that_cannot_be_written_is_named() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let run = bcap(&["generate", "man", file.path().to_str().unwrap()]);
    assert!(run.code == 2 && run.err.contains("cannot write manual pages to /"), "{run:?}");
}
