//! The async functions of a crate, read from its sources, so that a test can check that it covers all of them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// How a test covers an async function.
#[derive(Clone, Copy, Debug)]
pub enum Coverage {
    /// It is dropped at every await point, under this name.
    Swept(&'static str),
    /// It is private; this function, which is covered, awaits it.
    Through(&'static str),
    /// It is not, for this reason.
    Exempt(&'static str),
}

/// Checks a table against the sources below `src` and the await points at which functions were dropped.
///
/// A name that ends with `*` matches the unlisted functions with that prefix, except functions that users of the crate can
/// call.
///
/// # Errors
///
/// Functions that are missing in the table, that are only in the table, and that no test has dropped.
pub fn check(
    src: &Path,
    table: &[(&'static str, Coverage)],
    points: &BTreeMap<&'static str, usize>,
) -> Result<(), String> {
    let found = functions(src);
    let listed: BTreeSet<&str> = table.iter().map(|(name, _)| *name).collect();
    let stands_for = |entry: &str, (name, is_public): (&String, &bool)| match entry.strip_suffix('*') {
        Some(start) => name.starts_with(start) && !is_public && !listed.contains(name.as_str()),
        None => name == entry,
    };
    let mut wrong = Vec::new();
    let is_covered = |function: &(&String, &bool)| listed.iter().any(|entry| stands_for(entry, *function));
    wrong.extend(
        found.iter().filter(|function| !is_covered(function)).map(|(name, _)| format!("{name} is not covered")),
    );
    let exists = |entry: &&&str| found.iter().any(|function| stands_for(entry, function));
    wrong.extend(listed.iter().filter(|entry| !exists(entry)).map(|name| format!("{name} does not exist")));
    for (name, coverage) in table {
        match coverage {
            Coverage::Swept(sweep) if points.get(sweep).is_none_or(|points| *points == 0) => {
                wrong.push(format!("{name} has not been dropped: {sweep}"));
            }
            Coverage::Through(caller) if !listed.contains(caller) => wrong.push(format!("{name}: no {caller}")),
            Coverage::Swept(_) | Coverage::Through(_) => {}
            Coverage::Exempt(reason) => assert!(!reason.is_empty(), "{name}"),
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("\n")) }
}

/// Returns the async functions below a folder, as `file.rs: Type::function`, and whether each is public; functions of tests are
/// left out.
fn functions(src: &Path) -> BTreeMap<String, bool> {
    let mut found = BTreeMap::new();
    let mut folders = vec![src.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("the sources are there") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            match path.extension() {
                None if name != "tests" => folders.push(path),
                Some(extension) if extension == "rs" && name != "tests.rs" => {
                    let text = std::fs::read_to_string(&path).expect("a source");
                    let file = path.strip_prefix(src).expect("it is below").display().to_string();
                    found.extend(
                        in_file(&text).into_iter().map(|(name, is_public)| (format!("{file}: {name}"), is_public)),
                    );
                }
                _ => {}
            }
        }
    }
    found
}

/// Returns the async functions of a source, with the type or trait that they belong to, and whether each is public.
fn in_file(text: &str) -> Vec<(String, bool)> {
    let (mut found, mut owner, mut open) = (Vec::new(), String::new(), None::<(String, bool, bool)>);
    // in a macro, `$($async)?` becomes `async`; unit tests are at the end of a file, or in a separate file
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    for line in code.lines().filter(|line| !line.trim_start().starts_with("//")) {
        if line.starts_with("impl") || line.contains("trait ") && !line.starts_with(' ') {
            owner = if line.ends_with('}') { String::new() } else { owner_of(line) };
        } else if line.starts_with('}') {
            owner.clear();
        }
        if let Some((before, after)) = line.split_once("fn ")
            && before
                .split_whitespace()
                .all(|word| word.starts_with("pub") || ["async", "const", "super)", "$($async)?"].contains(&word))
        {
            let name: String = after.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            let name = if owner.is_empty() { name } else { format!("{owner}::{name}") };
            open = Some((name, before.contains("async"), before.trim_start().starts_with("pub ")));
        }
        let Some((name, is_async, is_public)) = &mut open else { continue };
        *is_async |= line.contains("-> impl Future");
        if line.ends_with('{') || line.ends_with(';') || line.ends_with('}') {
            if *is_async {
                found.push((std::mem::take(name), *is_public));
            }
            open = None;
        }
    }
    found
}

/// Returns the name of the type that an `impl` is for, or of the trait.
fn owner_of(line: &str) -> String {
    let head = line.split(" where").next().unwrap_or(line);
    let after = match (head.split_once(" for "), head.split_once("trait ")) {
        (Some((before, owner)), _) if before.starts_with("impl") => owner,
        (_, Some((_, owner))) => owner,
        _ => after_generics(head),
    };
    after.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

/// Returns the text after `impl<...>`.
fn after_generics(head: &str) -> &str {
    let head = head.strip_prefix("impl").unwrap_or(head);
    let mut depth = 0_u32;
    for (at, c) in head.char_indices() {
        match c {
            '<' => depth += 1,
            '>' if !head[..at].ends_with('-') => depth -= 1,
            _ => {}
        }
        if depth == 0 && c != '<' {
            return head[at..].trim_start_matches('>');
        }
    }
    head
}

#[cfg(test)]
mod tests {
    use super::in_file;

    #[test]
    fn async_functions_are_found_with_their_types() {
        let source = "pub async fn free() {}\n\
            pub trait T {\n    fn a(&self) -> u8;\n    fn b(\n        &self,\n    ) -> impl Future<Output = ()>;\n}\n\
            impl<X: Fn() -> u8, const N: usize> One<X> {\n    // async fn no()\n    pub(super) async fn c(\n        x: u8,\n    ) -> u8 {\n\
            \n    }\n    fn d(work: impl Future<Output = ()>) {}\n}\n\
            impl<X> T for Two<'_, X> {\n    async fn send(&self) -> u8 {\n    }\n}\n\
            #[cfg(test)]\nmod tests {\n    async fn test() {}\n}\n";
        let expected = [("free", true), ("T::b", false), ("One::c", false), ("Two::send", false)];
        assert_eq!(in_file(source), expected.map(|(name, is_public)| (name.to_owned(), is_public)));
    }
}
