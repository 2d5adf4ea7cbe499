//! The rules of a gateway as the block has them: `get` and `put` lines, in the grammar of [`AllowBuf`].

use bcap_core::rac::VariableKind;
use bcap_gateway::{Allow, AllowBuf, Bounds, Network, Rate, Rules};
use heapless::Vec;

use crate::SettingError;

/// The maximum number of `get` and `put` lines, and of ranges of values in all of them.
const RULES: usize = 32;
const BOUNDS: usize = 64;
/// The most `allow` lines.
const NETWORKS: usize = 16;

/// Memory for rules as the gateway takes them.
#[derive(Debug, Default)]
pub struct RuleMemory<'a> {
    rules: Vec<Allow<'a>, RULES>,
}

impl RuleMemory<'_> {
    /// Creates memory without rules.
    #[must_use]
    pub const fn new() -> Self {
        Self { rules: Vec::new() }
    }
}

/// The rules for reading and writing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct List {
    rules: Vec<Rule, RULES>,
    /// The ranges of all rules: most rules have none, so the rules share this memory.
    bounds: Vec<Bounds, BOUNDS>,
    /// The networks whose clients may connect.
    networks: Vec<Network, NETWORKS>,
    /// Whether a line was invalid.
    distrusted: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Rule {
    puts: bool,
    kind: VariableKind,
    first: u32,
    last: u32,
    /// Its part of [`List::bounds`]: the first range, and the number of ranges.
    bounds: (usize, usize),
    clients: Network,
}

impl List {
    /// Records that a line was invalid; it may have been a line that forbids something.
    pub(crate) fn distrust(&mut self) {
        self.distrusted = true;
    }

    /// Returns whether a line was invalid.
    pub(crate) const fn is_distrusted(&self) -> bool {
        self.distrusted
    }

    /// Adds a rule for reading, which has no values.
    pub(crate) fn allow_get(&mut self, text: &str) -> Result<(), SettingError> {
        let rule = AllowBuf::parse(text)?;
        match rule.as_allow().values {
            [] => self.push(false, &rule.as_allow()),
            _ => Err(SettingError::GetWithValues),
        }
    }

    /// Adds a rule for writing by the clients of a network.
    pub(crate) fn allow_put(&mut self, clients: Network, text: &str) -> Result<(), SettingError> {
        self.push(true, &Allow { clients, ..AllowBuf::parse(text)?.as_allow() })
    }

    /// Adds a network whose clients may connect.
    pub(crate) fn allow_clients(&mut self, network: Network) -> Result<(), SettingError> {
        self.networks.push(network).map_err(|_| SettingError::TooManyNetworks)
    }

    /// Returns the networks whose clients may connect.
    #[cfg(feature = "health")]
    pub(crate) fn networks(&self) -> &[Network] {
        &self.networks
    }

    fn push(&mut self, puts: bool, allow: &Allow<'_>) -> Result<(), SettingError> {
        let Allow { kind, first, last, values, clients } = *allow;
        let rule = Rule { puts, kind, first, last, bounds: (self.bounds.len(), values.len()), clients };
        self.bounds.extend_from_slice(values).map_err(|_| SettingError::TooManyRules)?;
        self.rules.push(rule).map_err(|_| SettingError::TooManyRules)
    }

    /// Returns the rules, those for reading first.
    pub(crate) fn rules<'r, 's: 'r>(&'s self, memory: &'r mut RuleMemory<'s>, convert: bool, rate: Rate) -> Rules<'r> {
        memory.rules.clear();
        let gets = self.rules.iter().filter(|rule| !rule.puts);
        let puts = self.rules.iter().filter(|rule| rule.puts && !self.distrusted);
        let count = gets.clone().count();
        // `memory` has room for as many rules as a list
        memory.rules.extend(gets.chain(puts).map(|rule| self.allow(rule)));
        let (get, put) = memory.rules.split_at_checked(count).unwrap_or_default();
        let get = if get.is_empty() { &Allow::EVERYTHING } else { get };
        Rules { clients: &self.networks, get, put, convert, rate }
    }

    fn allow(&self, rule: &Rule) -> Allow<'_> {
        let Rule { kind, first, last, bounds: (start, count), clients, .. } = *rule;
        let values = self.bounds.get(start..start + count).unwrap_or_default();
        Allow { kind, first, last, values, clients }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use std::string::{String, ToString};
    use std::vec::Vec;

    fn with_rules(text: &str, check: impl FnOnce(Rules<'_>)) {
        let settings = Settings::read(text.as_bytes(), |line, _| panic!("{}", String::from_utf8_lossy(line)));
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
    fn clients_are_networks_and_a_put_can_name_one() {
        with_rules("allow=10.0.0.0/8\nput=I\nput@10.0.0.7=F/1-2=0..1\nallow=192.168.0.1\nput@10.1.0.0/16=D", |rules| {
            let network = |text| Network::parse(text).unwrap();
            assert_eq!(rules.clients, [network("10.0.0.0/8"), network("192.168.0.1/32")]);
            let clients = ["0.0.0.0/0", "10.0.0.7/32", "10.1.0.0/16"].map(network);
            assert!(rules.put.iter().map(|allow| allow.clients).eq(clients));
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
    fn an_invalid_rule_is_reported_and_forbids_every_put() {
        for (text, error) in [
            ("get=X", "unknown kind of variable: expected one of I F D S V P J T IO"),
            ("get=I=1..2", "a get has no ranges of values; only a put has"),
            ("put=I/3-1", "invalid index range 3-1: the first index is above the last"),
            ("put=I=1", "invalid value range: expected MIN..MAX, such as -10..10"),
            ("put=I=2..1", "invalid value range 2..1: the minimum is above the maximum"),
        ] {
            let mut reported = Vec::new();
            let text = [text, "\nput=I\n"].concat();
            let settings = Settings::read(text.as_bytes(), |_, error| reported.push(error.to_string()));
            assert_eq!(reported, [error]);
            assert_eq!(settings.rules(&mut RuleMemory::new()).put, []);
        }
    }

    #[test]
    fn rules_and_ranges_beyond_the_memory_are_reported() {
        let ranges = ["put=T=", &"0..1,".repeat(9), "0..1\n"].concat().repeat(BOUNDS / 10 + 1);
        for (text, count) in [("put=I\n".repeat(RULES + 2), 2), (ranges, 1)] {
            let mut reported = Vec::new();
            let settings = Settings::read(text.as_bytes(), |_, error| reported.push(error));
            assert_eq!(reported, std::vec![SettingError::TooManyRules; count]);
            assert_eq!(settings.rules(&mut RuleMemory::new()), Rules::READ_ONLY);
        }
    }
}
