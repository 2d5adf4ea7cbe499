//! Names of variables as the user writes them: one variable, a range (`I1-I50`), or all variables of a kind (`I*`).

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::Range;

use bcap_core::rac::{Variable, VariableKind};
use bcap_std::ObjectPath;
use thiserror::Error;

/// The maximum number of variables of a kind: an index has 16 bits.
const LONGEST: u32 = 1 << 16;

/// A name that selects no variable: what is wrong, and what to write.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct SelectionError(String);

/// One word of the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Selection {
    /// A variable.
    One(String),
    /// The variables of a kind, from the first to the last index.
    Range(VariableKind, u32, u32),
    /// All variables of a kind.
    All(VariableKind),
}

impl Selection {
    /// Parses every word.
    ///
    /// # Errors
    ///
    /// The error of the first word that selects no variable.
    pub fn parse_each(words: &[String]) -> Result<Vec<Self>, SelectionError> {
        words.iter().map(|word| Self::parse(word)).collect()
    }

    /// Parses a word.
    ///
    /// # Errors
    ///
    /// When it selects no variable.
    pub fn parse(word: &str) -> Result<Self, SelectionError> {
        if let Some(kind) = word.strip_suffix('*').and_then(VariableKind::from_name) {
            return Ok(Self::All(kind));
        }
        if let Some((first, last)) = word.split_once('-')
            && let Ok(first) = first.parse()
        {
            return range(word, first, last);
        }
        // a wrong path is reported before the command connects
        ObjectPath::variable(word).map_err(|error| SelectionError(error.to_string()))?;
        Ok(Self::One(word.to_owned()))
    }
}

/// The variables of a selection, before their names are built.
enum Selected<'a> {
    One(&'a str),
    Indices(VariableKind, Range<u32>),
}

impl Selected<'_> {
    fn len(&self) -> usize {
        match self {
            Self::One(_) => 1,
            Self::Indices(_, indices) => indices.len(),
        }
    }

    fn extend(self, names: &mut Vec<String>) {
        match self {
            Self::One(name) => names.push(name.to_owned()),
            Self::Indices(kind, indices) => names.extend(indices.map(|index| format!("{}{index}", kind.name()))),
        }
    }
}

/// Returns the names of all selected variables, in order; `count` returns the number of variables of a kind, and is called once
/// for each kind.
///
/// # Errors
///
/// The error of `count`.
pub fn names_of<E>(
    selections: &[Selection],
    count: impl FnMut(VariableKind) -> Result<u32, E>,
) -> Result<Vec<String>, E> {
    selected(selections, count).map(names)
}

/// Returns the names as [`names_of`] does if there are at most `limit`, and otherwise their number. It counts before it builds
/// any name: a few words can select millions of variables.
///
/// # Errors
///
/// The error of `count`.
pub fn names_within<E>(
    selections: &[Selection],
    limit: usize,
    count: impl FnMut(VariableKind) -> Result<u32, E>,
) -> Result<Result<Vec<String>, usize>, E> {
    let selected = selected(selections, count)?;
    let len = selected.iter().map(Selected::len).fold(0, usize::saturating_add);
    Ok(if len > limit { Err(len) } else { Ok(names(selected)) })
}

fn selected<E>(
    selections: &[Selection],
    mut count: impl FnMut(VariableKind) -> Result<u32, E>,
) -> Result<Vec<Selected<'_>>, E> {
    let mut counts = BTreeMap::new();
    let mut selected = Vec::with_capacity(selections.len());
    for selection in selections {
        selected.push(match selection {
            Selection::One(name) => Selected::One(name),
            Selection::Range(kind, first, last) => Selected::Indices(*kind, *first..last.saturating_add(1)),
            Selection::All(kind) => {
                let len = match counts.entry(*kind) {
                    Entry::Occupied(known) => *known.get(),
                    Entry::Vacant(unknown) => *unknown.insert(count(*kind)?),
                };
                Selected::Indices(*kind, 0..len)
            }
        });
    }
    Ok(selected)
}

fn names(selected: Vec<Selected<'_>>) -> Vec<String> {
    let mut names = Vec::new();
    for each in selected {
        each.extend(&mut names);
    }
    names
}

/// Returns whether a name is a user variable or a wildcard, such as `I1`, `I*` and `IOB*`.
#[must_use]
pub fn is_user_variable(name: &str) -> bool {
    name.ends_with('*') || name.parse::<Variable>().is_ok()
}

fn range(word: &str, first: Variable, last: &str) -> Result<Selection, SelectionError> {
    let Variable { kind, index: first } = first;
    let name = kind.name();
    let with_kind =
        if last.starts_with(|c: char| c.is_ascii_digit()) { format!("{name}{last}") } else { last.to_owned() };
    let wrong = |reason: &str| {
        Err(SelectionError(format!("{word}: {reason}; write {name}{first}-{name}{}", first.saturating_add(7))))
    };
    match with_kind.parse::<Variable>().map(|last| (last.kind, last.index)) {
        Ok((other, _)) if other != kind => wrong("the variables of a range are of one kind"),
        Ok((_, last)) if last < first => wrong(&format!("the first index is above the last, {last}")),
        Ok((_, last)) if last - first >= LONGEST => wrong(&format!("a range has at most {LONGEST} variables")),
        Ok((_, last)) => Ok(Selection::Range(kind, first, last)),
        Err(_) => wrong("the end of the range is not a variable"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_have_one_kind_and_rising_indices() {
        let parse = |word: &str| Selection::parse(word);
        for word in ["I1-I50", "i1-50", "I1-i50"] {
            assert_eq!(parse(word).unwrap(), Selection::Range(VariableKind::I, 1, 50), "{word}");
        }
        assert_eq!(parse("io*").unwrap(), Selection::All(VariableKind::Io));
        for name in ["I1", "@MODE", "robot/@TYPE-X", "IOB1", "a-b", "I[1]", "X1-X2"] {
            assert_eq!(parse(name).unwrap(), Selection::One(name.into()));
        }
        for (word, reason) in [
            ("I1-J5", "one kind"),
            ("I5-I1", "above the last, 1; write I5-I12"),
            ("I1-", "not a variable"),
            ("I1-I", "not a variable"),
            ("I0-I65536", "at most 65536"),
            ("I1-5-9", "not a variable"),
        ] {
            let Err(SelectionError(message)) = parse(word) else { panic!("{word} was accepted") };
            assert!(message.starts_with(word) && message.contains(reason), "{message}");
        }
    }

    #[test]
    fn a_selection_gives_the_names_in_order() {
        let selections = Selection::parse_each(&["IO128-130".into(), "@MODE".into(), "I*".into()]).unwrap();
        let names = names_of(&selections, |_| Ok::<_, ()>(2)).unwrap();
        assert_eq!(names, ["IO128", "IO129", "IO130", "@MODE", "I0", "I1"]);
    }

    #[test]
    fn a_limit_is_checked_before_names_are_built() {
        let parse = |word: &str| Selection::parse(word).unwrap();
        let within = |selections: &[Selection], limit| names_within(selections, limit, |_| Ok::<_, ()>(2)).unwrap();
        let few = ["IO128-130", "@MODE", "I*"].map(parse);
        assert_eq!(within(&few, 6).map(|names| names.len()), Ok(6));
        assert_eq!(within(&few, 5), Err(6));
        assert_eq!(within(&[], 0), Ok(Vec::new()));
        // about 350 million names, which would take more than 10 GB
        assert_eq!(within(&vec![parse("I0-I65535"); 5400], 1000), Err(5400 << 16));
        let impossible = Selection::Range(VariableKind::I, 0, u32::MAX);
        assert_eq!(within(&[impossible], 1000), Err(u32::MAX as usize));
        // the controller is queried once for each kind, whatever the number of words
        let mut asked = Vec::new();
        let all = [vec![parse("I*"); 10_000], vec![parse("IO*"); 10_000]].concat();
        let names = names_within(&all, 1000, |kind| {
            asked.push(kind);
            Ok::<_, ()>(1 << 16)
        });
        assert_eq!(names, Ok(Err(20_000 << 16)));
        assert_eq!(asked, [VariableKind::I, VariableKind::Io]);
        assert_eq!(names_within(&all, 1000, |_| Err(())), Err(()));
    }
}
