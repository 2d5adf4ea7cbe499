//! Names of variables as the user writes them: one variable, a range (`I1-I50`), or all variables of a kind (`I*`).

use bcap_capture::value::describe;
use bcap_core::rac::{Variable, VariableKind};
use bcap_std::ObjectPath;

use crate::failure::Failure;
use crate::session::Session;
use crate::session::variables::get_one;

/// The most variables of a kind: an index has 16 bits.
const LONGEST: u32 = 1 << 16;

/// One word of the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Selection {
    /// A variable.
    One(String),
    /// The variables of a kind, from the first to the last index.
    Range(VariableKind, u32, u32),
    /// All variables of a kind.
    All(VariableKind),
}

impl Selection {
    /// Parses every word.
    pub(crate) fn parse_each(words: &[String]) -> Result<Vec<Self>, Failure> {
        words.iter().map(|word| Self::parse(word)).collect()
    }

    pub(crate) fn parse(word: &str) -> Result<Self, Failure> {
        if let Some(kind) = word.strip_suffix('*').and_then(VariableKind::from_name) {
            return Ok(Self::All(kind));
        }
        if let Some((first, last)) = word.split_once('-')
            && let Ok(first) = first.parse()
        {
            return range(word, first, last);
        }
        // a wrong path is reported before the command connects
        ObjectPath::variable(word)?;
        Ok(Self::One(word.to_owned()))
    }

    /// Returns the names of the variables.
    fn names(&self, mut count: impl FnMut(VariableKind) -> Result<u32, Failure>) -> Result<Vec<String>, Failure> {
        let (kind, indices) = match self {
            Self::One(name) => return Ok(vec![name.clone()]),
            Self::Range(kind, first, last) => (kind, *first..last.saturating_add(1)),
            Self::All(kind) => (kind, 0..count(*kind)?),
        };
        Ok(indices.map(|index| format!("{}{index}", kind.name())).collect())
    }
}

/// Returns the names of all selected variables, in order; asks the controller how many variables a kind has.
pub(crate) fn expand(session: &mut Session, selections: &[Selection]) -> Result<Vec<String>, Failure> {
    each(selections, |kind| count(session, kind))
}

/// Returns the names of all selected variables without a session, where `I*` is an error.
pub(crate) fn expand_offline(selections: &[Selection]) -> Result<Vec<String>, Failure> {
    each(selections, |kind| {
        let name = kind.name();
        Err(Failure::Input(format!(
            "{name}*: RAC does not tell how many variables there are; write a range such as {name}1-{name}50"
        )))
    })
}

fn each(
    selections: &[Selection],
    mut count: impl FnMut(VariableKind) -> Result<u32, Failure>,
) -> Result<Vec<String>, Failure> {
    let names = selections.iter().map(|selection| selection.names(&mut count)).collect::<Result<Vec<_>, _>>()?;
    Ok(names.concat())
}

/// Reads the number of variables of a kind, such as `@VAR_I_LEN`.
pub(crate) fn count(session: &mut Session, kind: VariableKind) -> Result<u32, Failure> {
    let name = format!("@VAR_{}_LEN", kind.name());
    let value = get_one(session, &ObjectPath::variable(&name)?)?;
    value.convert().ok().filter(|count| *count <= LONGEST).ok_or_else(|| Failure::Unexpected {
        message: format!("{name} is {}, which is not a number from 0 to {LONGEST}", describe(Some(&value))),
        hint: "use a range, such as I1-I50".into(),
    })
}

/// Returns whether a name is a user variable or a wildcard, such as `I1`, `I*` and `IOB*`.
pub(crate) fn is_user_variable(name: &str) -> bool {
    name.ends_with('*') || name.parse::<Variable>().is_ok()
}

fn range(word: &str, first: Variable, last: &str) -> Result<Selection, Failure> {
    let Variable { kind, index: first } = first;
    let name = kind.name();
    let with_kind =
        if last.starts_with(|c: char| c.is_ascii_digit()) { format!("{name}{last}") } else { last.to_owned() };
    let wrong = |reason: &str| {
        Err(Failure::Input(format!("{word}: {reason}; write {name}{first}-{name}{}", first.saturating_add(7))))
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
            let Err(Failure::Input(message)) = parse(word) else { panic!("{word} was accepted") };
            assert!(message.starts_with(word) && message.contains(reason), "{message}");
        }
    }

    #[test]
    fn a_selection_gives_the_names_in_order() {
        let selections = Selection::parse_each(&["IO128-130".into(), "@MODE".into(), "I*".into()]).unwrap();
        let names = each(&selections, |_| Ok(2)).unwrap();
        assert_eq!(names, ["IO128", "IO129", "IO130", "@MODE", "I0", "I1"]);
        let Err(Failure::Input(message)) = expand_offline(&selections) else { panic!("expanded") };
        assert!(message.contains("I1-I50"), "{message}");
    }
}
