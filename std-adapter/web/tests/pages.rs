//! The source of the page.

use std::fs;
use std::path::Path;

/// Returns the names and contents of the page's files.
fn files() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("page");
    let read =
        |entry: fs::DirEntry| (entry.file_name().into_string().unwrap(), fs::read_to_string(entry.path()).unwrap());
    fs::read_dir(folder).unwrap().map(|entry| read(entry.unwrap())).collect()
}

/// Text of a controller becomes markup or code by one of these only.
#[test]
fn no_text_becomes_markup_or_code() {
    let ways = [
        "innerHTML",
        "outerHTML",
        "insertAdjacentHTML",
        "document.write",
        "createContextualFragment",
        "DOMParser",
        "setHTMLUnsafe",
        "srcdoc",
        "eval(",
        "new Function",
        "javascript:",
        " style=\"",
        " onclick=\"",
        "http://www.w3.org/1999",
    ];
    for (name, text) in files() {
        for way in ways {
            assert!(!text.contains(way), "{name} has {way}");
        }
    }
}

#[test]
fn the_page_is_small() {
    let lines: usize = files().iter().map(|(_, text)| text.lines().count()).sum();
    assert!(lines <= 4000, "{lines} lines");
}
