//! The lines of the specifications that `docs/spec-notes.md` cites.
//!
//! The specifications are not in this repository. `citations.tsv` has facts about their texts: a line, and a word that it has.
//! Each citation of the page needs a fact within its lines, and each fact a citation. `just citations FOLDER` compares the
//! facts with the texts `bcap-rc9.txt` and `rac-rc8.txt` of a folder.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::path::Path;

const PAGE: &str = include_str!("../../docs/spec-notes.md");
const FACTS: &str = include_str!("citations.tsv");

/// A word of a line of a document.
#[derive(Clone, Copy, Debug)]
struct Fact {
    document: &'static str,
    line: usize,
    word: &'static str,
}

fn facts() -> Vec<Fact> {
    let lines = FACTS.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| match line.split('\t').collect::<Vec<_>>()[..] {
            [document, number, word] => Fact { document, line: number.parse().expect("a line"), word },
            _ => panic!("{line:?} has a document, a line and a word"),
        })
        .collect()
}

/// A citation: the document, its lines, and the word that the page gives for them, if it does.
#[derive(Clone, Debug)]
struct Citation {
    document: &'static str,
    lines: RangeInclusive<usize>,
    word: Option<&'static str>,
}

/// Returns the number at the start of a text, and the rest.
fn number(text: &str) -> Option<(usize, &str)> {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    Some((text[..end].parse().ok()?, &text[end..]))
}

/// Finds the citations in the text, such as `S2:1487` and `S0:63-65`.
fn cited() -> Vec<Citation> {
    let mut citations = Vec::new();
    for document in ["S0", "S2"] {
        for (at, start) in PAGE.match_indices(&format!("{document}:")) {
            let Some((from, rest)) = number(&PAGE[at + start.len()..]) else { continue };
            let to = rest.strip_prefix('-').and_then(number).map_or(from, |(to, _)| to);
            citations.push(Citation { document, lines: from..=to, word: None });
        }
    }
    citations
}

/// Reads the table of the first lines of sections and tables: `4.1.1: 202`.
fn sections() -> Vec<Citation> {
    let rows = PAGE.lines().filter(|line| line.starts_with('|') && line.contains(" specification (S"));
    let entries = rows.flat_map(|row| {
        let cells: Vec<_> = row.trim_matches('|').split('|').collect();
        let document = if cells[0].contains("(S2)") { "S2" } else { "S0" };
        cells[1].split(',').map(move |entry| (document, entry.trim()))
    });
    entries
        .map(|(document, entry)| {
            let (name, line) = entry.rsplit_once(": ").unwrap_or_else(|| panic!("{entry:?} has a line"));
            let line = line.parse().expect("a line");
            Citation { document, lines: line..=line, word: Some(name) }
        })
        .collect()
}

#[test]
fn each_cited_line_has_a_fact_and_each_fact_is_cited() {
    let (facts, mut used) = (facts(), BTreeSet::new());
    let citations = [cited(), sections()].concat();
    assert!(citations.len() > 100, "{} citations", citations.len());
    for citation in &citations {
        let is_fact = |fact: &Fact| {
            fact.document == citation.document
                && citation.lines.contains(&fact.line)
                && citation.word.is_none_or(|word| word == fact.word)
        };
        let found: Vec<_> = (0..facts.len()).filter(|place| is_fact(&facts[*place])).collect();
        assert!(!found.is_empty(), "no fact for {citation:?}: add a line to tests/tests/citations.tsv");
        used.extend(found);
    }
    let unused: Vec<_> = (0..facts.len()).filter(|place| !used.contains(place)).map(|place| facts[place]).collect();
    assert!(unused.is_empty(), "facts that the page does not cite: {unused:?}");
}

#[test]
#[ignore = "needs the texts of the specifications, which are not in this repository: just citations FOLDER"]
fn the_facts_are_those_of_the_texts() {
    let folder = std::env::var("BCAP_SPECIFICATIONS").expect("the folder of the texts in BCAP_SPECIFICATIONS");
    for (document, file) in [("S0", "rac-rc8.txt"), ("S2", "bcap-rc9.txt")] {
        let text = std::fs::read_to_string(Path::new(&folder).join(file)).expect("the text of a specification");
        let lines: Vec<_> = text.lines().collect();
        for fact in facts().iter().filter(|fact| fact.document == document) {
            let line = lines.get(fact.line - 1).unwrap_or_else(|| panic!("{fact:?}: the text ends before"));
            assert!(line.contains(fact.word), "{fact:?}: {line:?}");
        }
    }
}
