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

/// Each row of the table of features names a screen, an option or what is missing, and commands that exist.
#[test]
fn the_table_of_features_names_screens_and_commands() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let read = |path: &str| fs::read_to_string(root.join(path)).unwrap();
    let scripts: String = files().into_iter().map(|(_, text)| text).collect();
    let titles: Vec<&str> =
        scripts.lines().filter_map(|line| line.strip_prefix("  title: \"")?.strip_suffix("\",")).collect();
    let commands = read("std-adapter/cli/src/cli.rs");
    let page = read("docs/web.md");
    let (_, table) = page.split_once("## The features of the Tester").unwrap();
    let rows: Vec<Vec<&str>> = table
        .lines()
        .filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"))
        .filter(|row| !row.starts_with("item"))
        .map(|row| row.split(" | ").collect())
        .collect();
    for row in &rows {
        let [item, here, terminal] = row[..] else { panic!("{row:?}") };
        let is_known = titles
            .iter()
            .any(|title| here.strip_prefix(title).is_some_and(|rest| rest.is_empty() || rest.starts_with([':', ','])));
        assert!(is_known || here.starts_with("missing: ") || here.starts_with("the option"), "{item}: {here}");
        for command in terminal.split("`bcap ").skip(1) {
            let name = command.split([' ', '`']).next().unwrap();
            let variant: String = name[..1].to_uppercase() + &name[1..];
            assert!(commands.contains(&format!("    {variant}(")), "{item}: bcap {name}");
        }
        assert!(terminal.contains('`') || terminal == "missing", "{item}: {terminal}");
    }
    // each item of Tables 6-1 to 6-3 and of sections 6 to 6.3
    for item in [
        "Server",
        "Provider",
        "Machine",
        "Option",
        "Message",
        "UDP",
        "Timeout",
        "TORetry",
        "Debug",
        "Conn",
        "PacketOpt",
        "EtherOpt",
        "Sync",
        "Send Packet",
        "Loop",
        "Stop",
        "VT_ARRAY",
    ] {
        assert!(rows.iter().any(|row| row[0].contains(item)), "{item}");
    }
    assert!(titles.len() >= 9 && rows.len() >= 35, "{titles:?}, {} rows", rows.len());
}
