//! The pages of the book and of the repository: each page of `docs` is in the table of contents, each program is a doc test,
//! and each relative link leads to a file and a heading that exist. No test here needs a network.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use bcap_core::bcap::FunctionId;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the pages that the table of contents lists.
fn listed() -> BTreeSet<String> {
    let summary = read(&repository().join("docs/SUMMARY.md"));
    let links: Vec<_> = summary.lines().filter_map(|line| line.split_once("](")?.1.strip_suffix(')')).collect();
    let pages: BTreeSet<_> = links.iter().map(|&name| name.to_owned()).collect();
    assert_eq!(pages.len(), links.len(), "SUMMARY.md lists a page twice");
    pages
}

/// Returns the Markdown files of the repository that people read.
fn markdown() -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![repository()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let (path, name) = (entry.path(), entry.file_name());
            let is_output = name == "target" || name == "book" || name.to_string_lossy().starts_with('.');
            if entry.file_type().unwrap().is_dir() {
                folders.extend((!is_output).then_some(path));
            } else if path.extension().is_some_and(|extension| extension == "md") {
                files.push(path);
            }
        }
    }
    files
}

/// Returns the lines outside of code blocks, without the code in them.
fn prose(text: &str) -> Vec<String> {
    let mut is_code = false;
    let lines = text.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        !is_code && !is_fence
    });
    lines.map(|line| line.split('`').step_by(2).collect()).collect()
}

/// Returns the anchor of a heading, as GitHub and mdBook make it.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|next| next.is_alphanumeric() || matches!(next, ' ' | '-' | '_'));
    kept.map(|next| if next == ' ' { '-' } else { next }).collect()
}

fn anchors(text: &str) -> BTreeSet<String> {
    let mut is_code = false;
    let headings = text.lines().filter(|line| {
        is_code ^= line.starts_with("```");
        !is_code && line.starts_with('#')
    });
    headings.map(|line| anchor(line.trim_start_matches('#'))).collect()
}

/// Returns the targets of the links of a line.
fn targets(line: &str) -> impl Iterator<Item = &str> {
    line.split("](").skip(1).filter_map(|rest| rest.split(')').next())
}

#[test]
fn every_page_is_in_the_table_of_contents() {
    let names = fs::read_dir(repository().join("docs")).unwrap().map(|entry| entry.unwrap().file_name());
    let mut pages: BTreeSet<_> =
        names.map(|name| name.into_string().unwrap()).filter(|name| name.ends_with(".md")).collect();
    pages.remove("SUMMARY.md");
    assert_eq!(pages, listed(), "left: the pages of docs; right: those of docs/SUMMARY.md");
}

#[test]
fn every_program_is_a_doc_test() {
    let tested = read(&repository().join("tests/src/lib.rs"));
    let mut programs = 0;
    for page in listed() {
        let text = read(&repository().join("docs").join(&page));
        let blocks: Vec<_> = text.lines().filter(|line| line.starts_with("```rust")).collect();
        for block in &blocks {
            assert!(!block.contains("ignore"), "{page}: {block}: the programs of the book are compiled");
        }
        let is_tested = tested.contains(&format!("include_str!(\"../../docs/{page}\")"));
        assert_eq!(!blocks.is_empty(), is_tested, "{page}: tests/src/lib.rs includes the pages with programs");
        programs += blocks.len();
    }
    println!("{programs} programs");
    assert!(programs >= 5, "{programs} programs: are the blocks still found?");
}

#[test]
fn relative_links_lead_to_files_and_headings() {
    let mut checked = 0;
    let mut faults = Vec::new();
    for file in markdown() {
        let text = read(&file);
        for line in prose(&text) {
            for target in targets(&line).filter(|target| !target.contains("://") && !target.starts_with("mailto:")) {
                let (path, heading) = target.split_once('#').unwrap_or((target, ""));
                let path = if path.is_empty() { file.clone() } else { file.parent().unwrap().join(path) };
                checked += 1;
                let exists = path.exists();
                let has_heading = heading.is_empty() || exists && anchors(&read(&path)).contains(heading);
                if !exists || !has_heading {
                    faults.push(format!("{}: {target}", file.strip_prefix(repository()).unwrap().display()));
                }
            }
        }
    }
    println!("{checked} links");
    assert!(faults.is_empty(), "{faults:#?}");
    assert!(checked >= 100, "{checked} links: are they still found?");
}

/// Returns the cells of the rows of a table, without the marks of code.
fn rows(text: &str) -> Vec<Vec<&str>> {
    let lines = text.lines().filter(|line| line.starts_with("| "));
    lines.map(|line| line.split('|').skip(1).map(|cell| cell.trim().trim_matches('`')).collect()).collect()
}

/// Returns the names of the public functions of the Rust files of a folder.
fn methods(folder: &Path) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            names.append(&mut methods(&entry));
            continue;
        }
        let text = read(&entry);
        let functions = text.lines().filter_map(|line| line.trim_start().strip_prefix("pub ")?.split_once("fn "));
        let name = |rest: &str| rest.chars().take_while(|&next| next.is_alphanumeric() || next == '_').collect();
        names.extend(functions.map(|(_, rest)| name(rest)));
    }
    names
}

/// The names in other libraries, as their public sources have them, are made of the function's name by fixed rules.
#[test]
fn every_function_has_its_names_in_other_libraries() {
    let page = read(&repository().join("docs/porting.md"));
    let (_, tables) = page.split_once("\n## Functions\n").unwrap();
    let (tables, _) = tables.split_once("\n## ").unwrap();
    let mut functions = FunctionId::all();
    for table in tables.split("\n### ").filter(|table| table.contains("| function |")) {
        let (object, table) = table.split_once('\n').unwrap();
        for cells in rows(table).into_iter().filter(|cells| cells[0] != "function") {
            let function = functions.next().unwrap_or_else(|| panic!("{} is a row too many", cells[0]));
            let (name, joined) = (function.to_string(), function.name().unwrap());
            let expected = [&name, &function.0.to_string(), &name.to_lowercase(), &format!("bCap_{joined}"), &name]
                .map(ToString::to_string);
            assert_eq!(cells[..5], expected, "left: the row; right: function, number, Python, C, C# and Java");
            assert!(
                expected.iter().all(|spelling| FunctionId::parse(spelling) == Some(function)),
                "bcap call {expected:?}"
            );
            assert_eq!(object, function.signature().unwrap().object.name(), "{name}: the table of its object");
        }
    }
    assert_eq!(functions.next(), None, "a function without a row");
}

/// The methods that the page about other libraries names in code exist; only their type is not checked.
#[test]
fn the_page_about_other_libraries_names_methods_that_exist() {
    let page = read(&repository().join("docs/porting.md"));
    let methods = methods(&repository().join("std-adapter/src"));
    let code = page.lines().filter(|line| line.starts_with("| ")).flat_map(|line| line.split('`').skip(1).step_by(2));
    let types = ["Controller", "Robot", "Arm", "Move", "Stopper", "Task", "File", "Settings", "ServiceOptions"];
    let paths = code.filter_map(|code| code.trim_start_matches("asynch::").split_once("::"));
    let mut checked = 0;
    for (owner, rest) in paths.filter(|(owner, _)| types.contains(owner)) {
        let name = rest.split('(').next().unwrap();
        assert!(methods.contains(name), "{owner}::{name} does not exist");
        checked += 1;
    }
    assert!(checked >= 137, "{checked} methods: are they still found?");
}
