//! The rules of a gateway and its map of Modbus: a file in TOML, and additions of the command line.
//!
//! ```toml
//! clients = ["10.0.0.0/24", "10.0.1.7"]      # the networks whose clients may connect; left out, all clients may
//! convert = true                            # a PUT of 3,5 to an F variable becomes 5.0; only where nothing is lost
//! rate = { per_second = 50, burst = 10 }    # for each client
//!
//! register = ["100=I/10-19:i16"]            # the map of Modbus, in the grammar of the core
//! coil = ["0=IO/128-143"]
//!
//! [[get]]                                   # without any [[get]] everything may be read
//! kind = "P"
//!
//! [[put]]                                   # without any [[put]] nothing may be written
//! kind = "I"
//! index = [0, 99]                           # or one number; left out, all of them
//! values = [-10, 10]                        # left out, any value
//!
//! [[put]]
//! kind = "P"
//! index = 7
//! values = [[-400, 400], [-400, 400], [0, 600], [-180, 180]]    # by element; the last also for the elements after it
//! clients = "10.0.0.7"                      # for the clients of this network only
//! ```

use std::fs;
use std::path::Path;

use bcap_core::rac::VariableKind;
use bcap_gateway::modbus::{Entry as ModbusEntry, EntryError, Table};
use bcap_gateway::{Allow, AllowBuf, Bounds, Network, Rate, RuleErrorKind, Rules};
use serde::Deserialize;

/// The files that a gateway reads at its start. They are valid until the command ends.
#[derive(Debug, PartialEq)]
pub struct Setup {
    /// The rules.
    pub rules: Rules<'static>,
    /// The map of Modbus.
    pub map: Vec<ModbusEntry>,
}

impl Setup {
    /// Reads a file, and adds the rules of the command line.
    ///
    /// # Errors
    ///
    /// The fault, with the file and its line or with the rule.
    pub fn read(
        file: Option<&Path>,
        clients: &[Network],
        allow_put: &[AllowPut],
        more: &[ModbusEntry],
    ) -> Result<Self, String> {
        let mut setup = match file {
            Some(path) => {
                let text = fs::read_to_string(path)
                    .map_err(|error| format!("cannot read the rules in {}: {error}", path.display()))?;
                Self::parse(&text).map_err(|error| format!("the rules in {}: {error}", path.display()))?
            }
            None => Self { rules: Rules::READ_ONLY, map: Vec::new() },
        };
        setup.rules.clients = Vec::leak([setup.rules.clients, clients].concat());
        let put = allow_put.iter().flat_map(|rules| &rules.0).map(|rule| Box::leak(Box::new(rule.clone())).as_allow());
        setup.rules.put = Vec::leak(setup.rules.put.iter().copied().chain(put).collect());
        setup.map.extend(more);
        match overlap(&setup.map) {
            Some(error) => Err(error),
            None => Ok(setup),
        }
    }

    /// Parses a file.
    fn parse(text: &str) -> Result<Self, String> {
        let file: File = toml::from_str(text).map_err(|error| error.to_string().trim_end().to_owned())?;
        let rules = |table: &str, entries: &[Entry]| -> Result<&'static [Allow<'static>], String> {
            let numbered = (1..).zip(entries);
            let rules =
                numbered.map(|(n, entry)| entry.to_allow().map_err(|error| format!("[[{table}]] number {n}, {error}")));
            rules.collect::<Result<Vec<_>, _>>().map(|rules| &*Vec::leak(rules))
        };
        let get = file.get.as_deref().map_or(Ok(&Allow::EVERYTHING[..]), |get| rules("get", get))?;
        let rate = file.rate.map_or(Rate::UNLIMITED, Rate::from);
        if file.clients.as_ref().is_some_and(Vec::is_empty) {
            return Err("an empty list of clients; leave it out to allow every client".to_owned());
        }
        let clients = file.clients.iter().flatten().map(|text| network(text));
        let clients: Vec<_> = clients.collect::<Result<_, _>>().map_err(|error| format!("clients, {error}"))?;
        let clients = Vec::leak(clients);
        let rules = Rules { clients, get, put: rules("put", &file.put)?, convert: file.convert, rate };
        let registers = file.register.iter().map(|text| entry("register", text, ModbusEntry::registers));
        let coils = file.coil.iter().map(|text| entry("coil", text, ModbusEntry::coils));
        Ok(Self { rules, map: registers.chain(coils).collect::<Result<_, _>>()? })
    }
}

/// Parses a network of clients, such as `10.0.0.0/24`, or the address of one client.
///
/// # Errors
///
/// The text, and the forms of a network.
pub fn network(text: &str) -> Result<Network, String> {
    let network = Network::parse(text);
    network.ok_or_else(|| format!("{text:?}: invalid network: expected an IPv4 ADDRESS[/PREFIX], such as 10.0.0.0/24"))
}

/// Parses an entry of the map of Modbus.
fn entry(key: &str, text: &str, parse: fn(&str) -> Result<ModbusEntry, EntryError>) -> Result<ModbusEntry, String> {
    parse(text).map_err(|error| format!("{key} {text:?}: {error}"))
}

/// Names the first two entries that overlap, and their first common address.
fn overlap(map: &[ModbusEntry]) -> Option<String> {
    let mut numbered = map.iter().enumerate();
    let found = numbered.find_map(|(at, entry)| map[..at].iter().find(|other| other.overlaps(entry)).zip(Some(entry)));
    found.map(|(other, entry)| {
        let table = match entry.table() {
            Table::Coils => "coil",
            Table::Registers => "register",
        };
        let address = other.addresses().0.max(entry.addresses().0);
        format!("the map of Modbus has {table} {address} in two entries, {other} and {entry}")
    })
}

/// One use of `--allow-put`: rules in the grammar of [`AllowBuf`], separated by commas.
#[derive(Clone, Debug)]
pub struct AllowPut(Vec<AllowBuf>);

impl AllowPut {
    /// Parses rules, such as `I/0-99,IO/128=0..1` or `V/7=0..1,-5..5`.
    ///
    /// A comma also separates the ranges of one rule. A rule begins with a letter; a range does not, because its minimum
    /// is a finite number.
    pub fn parse(text: &str) -> Result<Self, String> {
        let begins_range = |first: char| first.is_ascii_digit() || "-+.".contains(first);
        let commas = text.match_indices(',').map(|(comma, _)| comma);
        let commas = commas.filter(|comma| !text[comma + 1..].starts_with(begins_range));
        let ends: Vec<usize> = commas.chain([text.len()]).collect();
        let starts = std::iter::once(0).chain(ends.iter().map(|end| end + 1));
        let rules = starts.zip(&ends).map(|(start, end)| &text[start..*end]);
        let parse = |rule| AllowBuf::parse(rule).map_err(|error| format!("{rule:?}: {error}"));
        rules.map(parse).collect::<Result<_, _>>().map(Self)
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    clients: Option<Vec<String>>,
    #[serde(default)]
    convert: bool,
    rate: Option<PerClient>,
    get: Option<Vec<Entry>>,
    #[serde(default)]
    put: Vec<Entry>,
    #[serde(default)]
    register: Vec<String>,
    #[serde(default)]
    coil: Vec<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PerClient {
    per_second: u32,
    burst: Option<u32>,
}

impl From<PerClient> for Rate {
    fn from(rate: PerClient) -> Self {
        Self { per_second: rate.per_second, burst: rate.burst.unwrap_or(rate.per_second) }
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    kind: Kind,
    index: Option<Index>,
    values: Option<Values>,
    clients: Option<String>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "String")]
struct Kind(VariableKind);

impl TryFrom<String> for Kind {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let kind = VariableKind::from_name(&name).map(Self);
        kind.ok_or_else(|| format!("{name:?}: {}", RuleErrorKind::Kind))
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "an index is a number, or a range [first, last]")]
enum Index {
    One(u32),
    Range([u32; 2]),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(untagged, expecting = "values are a range [min, max], or a list of ranges, one for each element")]
enum Values {
    All([f64; 2]),
    Each(Vec<[f64; 2]>),
}

impl Entry {
    /// Creates the rule that an entry describes. It is valid until the command ends.
    fn to_allow(&self) -> Result<Allow<'static>, String> {
        let kind = self.kind.0;
        let [first, last] = match self.index {
            Some(Index::One(index)) => [index, index],
            Some(Index::Range(range)) => range,
            None => [0, u32::MAX],
        };
        let ranges = match &self.values {
            Some(Values::All(range)) => std::slice::from_ref(range),
            Some(Values::Each(ranges)) if ranges.is_empty() => {
                return Err(format!("{kind}: an empty list of values; leave it out to allow every value"));
            }
            Some(Values::Each(ranges)) => ranges,
            None => &[],
        };
        let values = Vec::leak(ranges.iter().map(|[min, max]| Bounds { min: *min, max: *max }).collect());
        let clients = self.clients.as_deref().map_or(Ok(Network::ANY), network);
        let clients = clients.map_err(|error| format!("{kind}: clients, {error}"))?;
        let allow = Allow { values, clients, ..Allow::range(kind, first, last) };
        allow.check().map_err(|error| format!("{kind}: {error}")).map(|()| allow)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rules_of_the_package_allow_no_write_until_a_line_is_uncommented() {
        let file = include_str!("../../cli/packaging/gateway.toml");
        let rules = Setup::parse(file).unwrap().rules;
        assert_eq!((rules.put.len(), rules.get.len()), (0, Allow::EVERYTHING.len()));
        let rules =
            Setup::parse(&file.replace("# [[put]]", "[[put]]").replace("# kind", "kind").replace("# index", "index"));
        let rules = rules.unwrap().rules;
        assert_eq!(rules.put.len(), 1);
    }

    #[test]
    fn an_empty_file_is_read_only() {
        assert_eq!(Setup::parse("").unwrap(), Setup { rules: Rules::READ_ONLY, map: Vec::new() });
        assert_eq!(Setup::read(None, &[], &[], &[]).unwrap().rules, Rules::READ_ONLY);
    }

    #[test]
    fn the_sample_means_what_it_says() {
        let sample: String = include_str!("rules.rs")
            .lines()
            .skip_while(|line| !line.contains("```toml"))
            .skip(1)
            .take_while(|line| !line.contains("```"))
            .map(|line| format!("{}\n", line.trim_start_matches("//!")))
            .collect();
        let Setup { rules, map } = Setup::parse(&sample).unwrap();
        let registers = ModbusEntry::registers("100=I/10-19:i16").unwrap();
        assert_eq!(map, [registers, ModbusEntry::coils("0=IO/128-143").unwrap()]);
        assert!(rules.convert);
        assert_eq!(rules.rate, Rate { per_second: 50, burst: 10 });
        assert_eq!(rules.get, [Allow::all(VariableKind::P)]);
        let bounds = |min, max| Bounds { min, max };
        let position = [bounds(-400.0, 400.0), bounds(-400.0, 400.0), bounds(0.0, 600.0), bounds(-180.0, 180.0)];
        assert_eq!(
            rules.put,
            [
                Allow { values: &[bounds(-10.0, 10.0)], ..Allow::range(VariableKind::I, 0, 99) },
                Allow {
                    values: &position,
                    clients: network("10.0.0.7").unwrap(),
                    ..Allow::range(VariableKind::P, 7, 7)
                },
            ]
        );
        assert_eq!(rules.clients, ["10.0.0.0/24", "10.0.1.7"].map(|text| network(text).unwrap()));
    }

    #[test]
    fn the_command_line_adds_to_the_file() {
        let allow = ["F,io/128-143", "I/5=-1..2.5", "V/7=0..1,-5..5,I/9"].map(|text| AllowPut::parse(text).unwrap());
        let networks = ["10.0.0.0/24", "10.0.1.7"].map(|text| network(text).unwrap());
        let rules = Setup::read(None, &networks, &allow, &[]).unwrap().rules;
        assert_eq!(rules.clients, networks);
        let range = |min, max| Bounds { min, max };
        assert_eq!(
            rules.put,
            [
                Allow::all(VariableKind::F),
                Allow::range(VariableKind::Io, 128, 143),
                Allow { values: &[range(-1.0, 2.5)], ..Allow::range(VariableKind::I, 5, 5) },
                Allow { values: &[range(0.0, 1.0), range(-5.0, 5.0)], ..Allow::range(VariableKind::V, 7, 7) },
                Allow::range(VariableKind::I, 9, 9),
            ]
        );
    }

    #[test]
    fn an_error_says_what_is_wrong_and_where() {
        for (text, word) in [
            ("[[put]]\nkind = \"X\"", "\"X\": unknown kind of variable: expected one of I F D S V P J T IO"),
            ("[[put]]\nkind = \"I\"\nindexes = 3", "indexes"),
            ("[[put]]\nkind = \"I\"\nindex = \"3\"", "a number, or a range"),
            (
                "[[put]]\nkind = \"F\"\n[[put]]\nkind = \"I\"\nindex = [3, 1]",
                "[[put]] number 2, I: invalid index range 3-1: the first index is above the last",
            ),
            ("[[get]]\nkind = \"I\"\nindex = [3, 1]", "[[get]] number 1, I: invalid index range 3-1"),
            ("[[put]]\nkind = \"I\"\nvalues = [3, 1]", "invalid value range 3..1: the minimum is above the maximum"),
            ("[[put]]\nkind = \"I\"\nvalues = [nan, nan]", "invalid value range NaN..NaN: a bound cannot be NaN"),
            ("[[put]]\nkind = \"I\"\nvalues = [[0, 1], [0, 1]]", "2, but a variable of kind I has 1 elements"),
            ("[[put]]\nkind = \"I\"\nvalues = []", "I: an empty list of values"),
            ("[[put]]\nkind = \"I\"\nvalues = 5", "values are a range"),
            ("[[put]]\nindex = 5", "kind"),
            ("rate = 5", "PerClient"),
            ("convert = 1\n", "bool"),
            ("nonsense", "line 1"),
            ("register = [\"1=S/1\"]", "register \"1=S/1\": a variable of kind S cannot be in registers"),
            ("clients = [\"10.0.0\"]", "clients, \"10.0.0\": invalid network: expected an IPv4 ADDRESS[/PREFIX]"),
            ("clients = []", "an empty list of clients"),
            ("clients = [\"fd00::/8\"]", "clients, \"fd00::/8\": invalid network"),
            ("clients = \"10.0.0.0/24\"", "clients"),
            (
                "[[put]]\nkind = \"I\"\nclients = \"10.0.0.0/33\"",
                "[[put]] number 1, I: clients, \"10.0.0.0/33\": invalid",
            ),
            ("coil = [\"1=I/1\"]", "coil \"1=I/1\": "),
        ] {
            let error = Setup::parse(text).unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
        for (text, error) in [
            ("", "\"\": unknown kind of variable: expected one of I F D S V P J T IO, at column 1"),
            ("I,", "\"\": unknown kind of variable: expected one of I F D S V P J T IO, at column 1"),
            ("I,F/3-1,V", "\"F/3-1\": invalid index range 3-1: the first index is above the last, at column 3"),
            ("I=0..1,2", "\"I=0..1,2\": invalid value range: expected MIN..MAX, such as -10..10, at column 8"),
        ] {
            assert_eq!(AllowPut::parse(text).unwrap_err(), error);
        }
        let error = Setup::read(Some(Path::new("/no/such/file.toml")), &[], &[], &[]).unwrap_err();
        assert!(error.to_string().contains("/no/such/file.toml"), "{error}");
    }
    #[test]
    fn entries_of_the_map_that_overlap_are_refused() {
        let [a, b, c] = ["0=I/0-9", "20=I/10", "19=I/10"].map(|text| ModbusEntry::registers(text).unwrap());
        assert_eq!(Setup::read(None, &[], &[], &[a, b]).unwrap().map, [a, b]);
        let error = Setup::read(None, &[], &[], &[a, b, c]).unwrap_err();
        assert_eq!(error.to_string(), "the map of Modbus has register 19 in two entries, 0=I/0-9 and 19=I/10");
    }
}
