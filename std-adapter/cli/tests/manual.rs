//! `bcap generate man` and the pages of the book: a page for each command, with its options and its examples on separate lines.

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

#[test]
fn the_book_gets_a_page_for_each_command() {
    let directory = tempfile::tempdir().unwrap();
    let list = bcap(&["generate", "pages", directory.path().to_str().unwrap()]);
    assert_eq!((list.err.as_str(), list.code), ("", 0));
    let help = bcap(&["--help"]).out;
    for line in list.out.lines() {
        let (name, rest) = line.strip_prefix("- [bcap ").unwrap().split_once("](commands/").unwrap();
        assert!(help.contains(name) && rest.split_once(".md): ").unwrap().1.len() > 10, "{line}");
        let page = fs::read_to_string(directory.path().join(name).with_extension("md")).unwrap();
        assert!(page.starts_with(&format!("# bcap {name}\n\n")) && page.contains("```text,help\nbcap"), "{page}");
    }
    assert_eq!(list.out.lines().count(), fs::read_dir(directory.path()).unwrap().count());
    let page = |name: &str| fs::read_to_string(directory.path().join(name)).unwrap();
    let play = page("slave.md").split_once("\n## bcap slave play\n").unwrap().1.to_owned();
    for text in ["`--mode <MODE>`\n: How", "Values: `0`, `1`, `2`.", "Default: `2`."] {
        assert!(play.contains(text), "{text}: {play}");
    }
    assert!(page("get.md").contains("; [`bcap help connection`](connection.md) has"), "{}", page("get.md"));
    assert!(page("get.md").contains("\n  bcap get I1\n") && page("connection.md").contains("\n`--provider "));
}
