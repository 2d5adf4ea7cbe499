//! The reader of `codes.tsv`, the texts of all codes.

static TABLE: &str = include_str!("codes.tsv");

/// A row of the table: codes with the same meaning and remedy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    codes: &'static str,
    /// The meaning, as one sentence; empty for a code with a constant, which has a [`meaning`](super::HResult::meaning).
    pub meaning: &'static str,
    pub(super) remedy: &'static str,
    pub(super) cause: Option<&'static str>,
    pub(super) functions: Option<&'static str>,
    pub(super) source: Option<&'static str>,
}

/// A code, or a range of codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Pattern {
    /// The first code.
    pub first: u32,
    /// The last code; for a single code it equals the first.
    pub last: u32,
    /// Whether the last digit is an axis, 1 to 8; codes with other digits do not belong to the pattern.
    pub has_axis: bool,
}

impl Row {
    /// Iterates over the table.
    pub fn all() -> impl Iterator<Item = Self> + Clone {
        TABLE.lines().filter(|line| !line.starts_with('#')).filter_map(Self::parse)
    }

    pub(super) fn parse(line: &'static str) -> Option<Self> {
        let mut columns = line.split('\t');
        let (codes, meaning, remedy) = (columns.next()?, columns.next()?, columns.next()?);
        let mut more = || columns.next().filter(|text| !text.is_empty());
        Some(Self { codes, meaning, remedy, cause: more(), functions: more(), source: more() })
    }

    /// Iterates over the codes of the row.
    pub fn patterns(self) -> impl Iterator<Item = Pattern> + Clone {
        self.codes.split(' ').filter_map(Pattern::parse)
    }

    /// Finds the row with the narrowest pattern that contains the code, and that pattern.
    pub(super) fn find(code: u32) -> Option<(Self, Pattern)> {
        let rows = Self::all().flat_map(|row| row.patterns().map(move |pattern| (row, pattern)));
        rows.filter(|(_, pattern)| pattern.contains(code)).min_by_key(|(_, pattern)| pattern.width())
    }
}

impl Pattern {
    /// Parses `83501024`, `8320407n`, `83201281..832012A0` or `854A502n..854A52Fn`.
    fn parse(text: &str) -> Option<Self> {
        let (first, last) = text.split_once("..").unwrap_or((text, text));
        let number = |digits: &str, axis: u32| match digits.strip_suffix('n') {
            Some(tens) => u32::from_str_radix(tens, 16).ok()?.checked_mul(16)?.checked_add(axis),
            None => u32::from_str_radix(digits, 16).ok(),
        };
        let (first, last) = (number(first, 1)?, number(last, 8)?);
        Some(Self { first, last, has_axis: text.ends_with('n') })
    }

    /// Returns whether a code without its reserved bit belongs to the pattern.
    #[must_use]
    pub fn contains(self, code: u32) -> bool {
        (self.first..=self.last).contains(&code) && (!self.has_axis || matches!(code & 0x0F, 1..=8))
    }

    /// Returns the axis of a code of the pattern.
    pub(super) fn axis(self, code: u32) -> Option<u8> {
        let [.., last] = code.to_be_bytes();
        self.has_axis.then_some(last & 0x0F)
    }

    pub(super) fn width(self) -> u32 {
        self.last.saturating_sub(self.first)
    }
}
