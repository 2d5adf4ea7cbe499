//! What PLCs may do, as a block says it.

use bcap_core::gateway::{Allow, Bounds, Rate, Rules};
use bcap_core::rac::VariableKind;
use bcap_core::variant::VariantBuf;
use heapless::Vec;

/// Lines of `get` and `put`, and ranges of values in them, that there is room for.
const RULES: usize = 32;
const BOUNDS: usize = 64;

/// Memory for rules as the gateway takes them.
#[derive(Debug, Default)]
pub struct RuleMemory<'a> {
    rules: Vec<Allow<'a>, RULES>,
}

impl RuleMemory<'_> {
    /// Makes memory without rules in it.
    #[must_use]
    pub const fn new() -> Self {
        Self { rules: Vec::new() }
    }
}

/// The lists of what may be read and written.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct List {
    rules: Vec<Rule, RULES>,
    bounds: Vec<Bounds, BOUNDS>,
    /// Whether a line could not be read.
    distrusted: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Rule {
    puts: bool,
    kind: VariableKind,
    first: u32,
    last: u32,
    /// Where its ranges of values lie among all, and how many there are.
    bounds: (usize, usize),
}

impl List {
    /// Takes note that a line could not be read: it may have been one that forbids something.
    pub(crate) fn distrust(&mut self) {
        self.distrusted = true;
    }

    /// Reads `KIND[/FIRST[-LAST]]`.
    pub(crate) fn allow_get(&mut self, text: &str) -> Option<()> {
        let (kind, first, last) = place(text)?;
        self.rules.push(Rule { puts: false, kind, first, last, bounds: (0, 0) }).ok()
    }

    /// Reads `KIND[/FIRST[-LAST]][=MIN..MAX[,MIN..MAX]...]`.
    pub(crate) fn allow_put(&mut self, text: &str) -> Option<()> {
        let (text, values) = match text.split_once('=') {
            Some((place, values)) => (place, Some(values)),
            None => (text, None),
        };
        let (kind, first, last) = place(text)?;
        let start = self.bounds.len();
        for range in values.into_iter().flat_map(|values| values.split(',')) {
            self.bounds.push(bounds(range)?).ok()?;
        }
        let count = self.bounds.len() - start;
        if count > kind.elements() {
            return None;
        }
        self.rules.push(Rule { puts: true, kind, first, last, bounds: (start, count) }).ok()
    }

    /// Returns the rules, the gets first.
    pub(crate) fn rules<'r, 's: 'r>(&'s self, memory: &'r mut RuleMemory<'s>, convert: bool, rate: Rate) -> Rules<'r> {
        memory.rules.clear();
        let gets = self.rules.iter().filter(|rule| !rule.puts);
        let puts = self.rules.iter().filter(|rule| rule.puts && !self.distrusted);
        let count = gets.clone().count();
        // there is as much room here as where they come from
        memory.rules.extend(gets.chain(puts).map(|rule| self.allow(rule)));
        let (get, put) = memory.rules.split_at_checked(count).unwrap_or_default();
        Rules { get: if get.is_empty() { &Allow::EVERYTHING } else { get }, put, convert, rate }
    }

    fn allow(&self, rule: &Rule) -> Allow<'_> {
        let Rule { kind, first, last, bounds: (start, count), .. } = *rule;
        Allow { kind, first, last, values: self.bounds.get(start..start + count).unwrap_or_default() }
    }
}

fn place(text: &str) -> Option<(VariableKind, u32, u32)> {
    let Some((kind, index)) = text.split_once('/') else {
        return Some((VariableKind::from_name(text)?, 0, u32::MAX));
    };
    let (first, last) = index.split_once('-').unwrap_or((index, index));
    let (first, last) = (first.parse().ok()?, last.parse().ok()?);
    (first <= last).then_some((VariableKind::from_name(kind)?, first, last))
}

fn bounds(text: &str) -> Option<Bounds> {
    // the library's search for a text would leave a panic in the image
    let at = text.as_bytes().windows(2).position(|pair| pair == b"..")?;
    let (min, max) = text.split_at_checked(at)?;
    let (min, max) = (number(min)?, number(max.strip_prefix("..")?)?);
    (min <= max).then_some(Bounds { min, max })
}

/// Reads a number with the core's code, which is in the image anyway.
fn number(text: &str) -> Option<f64> {
    let mut item = heapless::String::<40>::new();
    item.push_str("5,").ok()?;
    item.push_str(text).ok()?;
    VariantBuf::<16>::parse_text(item.as_bytes()).ok()?.as_variant().as_f64()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use std::string::String;

    fn with_rules(text: &str, check: impl FnOnce(Rules<'_>)) {
        let settings = Settings::read(text.as_bytes(), |line| panic!("{}", String::from_utf8_lossy(line)));
        check(settings.rules(&mut RuleMemory::new()));
    }

    #[test]
    fn lists_are_read_in_any_order() {
        let text =
            "put=I/0-99=-10..10\nget=P\nput=io/128\nget=J/3-4\nput=P/7=-400..400,-4e2..400.5,0..600\nput=S=0..20";
        with_rules(text, |rules| {
            assert_eq!(rules.get, [Allow::all(VariableKind::P), Allow::range(VariableKind::J, 3, 4)]);
            let range = |min, max| Bounds { min, max };
            assert_eq!(
                rules.put,
                [
                    Allow { values: &[range(-10.0, 10.0)], ..Allow::range(VariableKind::I, 0, 99) },
                    Allow::range(VariableKind::Io, 128, 128),
                    Allow {
                        values: &[range(-400.0, 400.0), range(-400.0, 400.5), range(0.0, 600.0)],
                        ..Allow::range(VariableKind::P, 7, 7)
                    },
                    Allow { values: &[range(0.0, 20.0)], ..Allow::all(VariableKind::S) },
                ]
            );
            assert!(!rules.convert);
        });
    }

    #[test]
    fn without_a_get_everything_may_be_read() {
        with_rules("put=F\nconvert=yes\nrate=3", |rules| {
            assert_eq!(rules.get, Allow::EVERYTHING);
            assert_eq!(rules.put, [Allow::all(VariableKind::F)]);
            assert!(rules.convert);
            assert_eq!(rules.rate, Rate { per_second: 3, burst: 3 });
        });
    }

    #[test]
    fn what_is_no_rule_is_none() {
        for text in [
            "get=X",
            "get=",
            "get=I/",
            "get=I/x",
            "get=I/3-1",
            "get=I/1-2-3",
            "get=I=1..2",
            "put=I=1",
            "put=I=2..1",
            "put=I=a..b",
            "put=I=..",
            "put=I=nan..nan",
            "put=I=0..1,0..1",
            "put=P=0..1,",
            "put=I/-1",
            "put=I/4294967296",
        ] {
            let mut told = 0;
            let settings = Settings::read(text.as_bytes(), |_| told += 1);
            assert_eq!(told, 1, "{text}");
            assert_eq!(settings.rules(&mut RuleMemory::new()), Rules::READ_ONLY);
        }
    }

    #[test]
    fn more_rules_than_there_is_room_for_are_told() {
        let text = "put=I\n".repeat(RULES + 2);
        let mut told = 0;
        let settings = Settings::read(text.as_bytes(), |_| told += 1);
        assert_eq!(told, 2);
        assert_eq!(settings.rules(&mut RuleMemory::new()), Rules::READ_ONLY);
    }
}
