//! The rules of a gateway: a file in TOML, and what the command line adds.
//!
//! ```toml
//! convert = true                            # a PUT of 3,5 to an F variable becomes 5.0; only where nothing is lost
//! rate = { per_second = 50, burst = 10 }    # for each client
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
//! values = [[-400, 400], [-400, 400], [0, 600], [-180, 180]]    # by element; the last counts for the rest
//! ```

use std::fs;
use std::path::Path;

use bcap_core::gateway::{Allow, Bounds, Rate, Rules};
use bcap_core::rac::VariableKind;
use serde::Deserialize;

use crate::error::Failure;

/// Reads the rules; they live as long as the command.
pub(super) fn read(file: Option<&Path>, allow_put: &[AllowPut]) -> Result<Rules<'static>, Failure> {
    let file = match file {
        Some(path) => {
            let text = fs::read_to_string(path)
                .map_err(|error| Failure::Input(format!("cannot read the rules in {}: {error}", path.display())))?;
            parse(&text).map_err(|error| Failure::Input(format!("the rules in {}: {error}", path.display())))?
        }
        None => File::default(),
    };
    let mut put: Vec<Allow<'static>> = file.put.into_iter().map(Entry::leak).collect();
    put.extend(allow_put.iter().map(|allow| allow.0.clone().leak()));
    let get: &[_] = match file.get {
        Some(get) => Vec::leak(get.into_iter().map(Entry::leak).collect()),
        None => &Allow::EVERYTHING,
    };
    Ok(Rules { get, put: Vec::leak(put), convert: file.convert, rate: file.rate.map_or(Rate::UNLIMITED, Rate::from) })
}

fn parse(text: &str) -> Result<File, String> {
    let file: File = toml::from_str(text).map_err(|error| error.to_string().trim_end().to_owned())?;
    for entry in file.get.iter().flatten().chain(&file.put) {
        entry.check()?;
    }
    Ok(file)
}

/// An item of `--allow-put`: `KIND[/FIRST[-LAST]][=MIN..MAX]`.
#[derive(Clone, Debug)]
pub(crate) struct AllowPut(Entry);

impl AllowPut {
    /// Parses an item, such as `F`, `I/0-99` or `IO/128=0..1`.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let (place, values) = match text.split_once('=') {
            Some((place, values)) => (place, Some(values)),
            None => (text, None),
        };
        let (kind, index) = match place.split_once('/') {
            Some((kind, index)) => (kind, Some(index)),
            None => (place, None),
        };
        let index = index.map(|index| {
            let (first, last) = index.split_once('-').unwrap_or((index, index));
            let number = |text: &str| text.parse().map_err(|_| format!("{text:?} is not the index of a variable"));
            Ok::<_, String>(Index::Range([number(first)?, number(last)?]))
        });
        let values = values.map(|values| {
            let (min, max) = values.split_once("..").ok_or("a range of values is written MIN..MAX")?;
            let number = |text: &str| text.parse().map_err(|_| format!("{text:?} is not a number"));
            Ok::<_, String>(Values::All([number(min)?, number(max)?]))
        });
        let entry =
            Entry { kind: Kind::try_from(kind.to_owned())?, index: index.transpose()?, values: values.transpose()? };
        entry.check()?;
        Ok(Self(entry))
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    convert: bool,
    rate: Option<PerClient>,
    get: Option<Vec<Entry>>,
    #[serde(default)]
    put: Vec<Entry>,
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
}

#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "String")]
struct Kind(VariableKind);

impl TryFrom<String> for Kind {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let kind = VariableKind::from_name(&name).map(Self);
        kind.ok_or_else(|| format!("{name:?} is not a kind of variable; write one of I F D S V P J T IO"))
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
    fn indices(&self) -> [u32; 2] {
        match self.index {
            Some(Index::One(index)) => [index, index],
            Some(Index::Range(range)) => range,
            None => [0, u32::MAX],
        }
    }

    fn ranges(&self) -> &[[f64; 2]] {
        match &self.values {
            Some(Values::All(range)) => std::slice::from_ref(range),
            Some(Values::Each(ranges)) => ranges,
            None => &[],
        }
    }

    /// Checks what the types cannot say.
    fn check(&self) -> Result<(), String> {
        let kind = self.kind.0;
        let [first, last] = self.indices();
        if first > last {
            return Err(format!("{kind}: the indices {first} to {last} are none; write the lower one first"));
        }
        let (ranges, elements) = (self.ranges(), kind.elements());
        if self.values.is_some() && (ranges.is_empty() || ranges.len() > elements) {
            return Err(format!("{kind}: {} ranges of values for {elements} elements", ranges.len()));
        }
        match ranges.iter().find(|[min, max]| min.is_nan() || max.is_nan() || min > max) {
            Some([min, max]) => Err(format!("{kind}: the values {min} to {max} are none; write the lower one first")),
            None => Ok(()),
        }
    }

    fn leak(self) -> Allow<'static> {
        let [first, last] = self.indices();
        let values = self.ranges().iter().map(|[min, max]| Bounds { min: *min, max: *max }).collect();
        Allow { kind: self.kind.0, first, last, values: Vec::leak(values) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(text: &str) -> Rules<'static> {
        let file = parse(text).unwrap();
        let leak = |entries: Vec<Entry>| -> &'static [Allow<'static>] {
            Vec::leak(entries.into_iter().map(Entry::leak).collect())
        };
        let get = file.get.map_or(&Allow::EVERYTHING[..], leak);
        Rules { get, put: leak(file.put), convert: file.convert, rate: file.rate.map_or(Rate::UNLIMITED, Rate::from) }
    }

    #[test]
    fn an_empty_file_is_read_only() {
        assert_eq!(rules(""), Rules::READ_ONLY);
        assert_eq!(read(None, &[]).unwrap(), Rules::READ_ONLY);
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
        let rules = rules(&sample);
        assert!(rules.convert);
        assert_eq!(rules.rate, Rate { per_second: 50, burst: 10 });
        assert_eq!(rules.get, [Allow::all(VariableKind::P)]);
        let bounds = |min, max| Bounds { min, max };
        let position = [bounds(-400.0, 400.0), bounds(-400.0, 400.0), bounds(0.0, 600.0), bounds(-180.0, 180.0)];
        assert_eq!(
            rules.put,
            [
                Allow { values: &[bounds(-10.0, 10.0)], ..Allow::range(VariableKind::I, 0, 99) },
                Allow { values: &position, ..Allow::range(VariableKind::P, 7, 7) },
            ]
        );
    }

    #[test]
    fn the_command_line_adds_to_the_file() {
        let allow = ["F", "io/128-143", "I/5=-1..2.5"].map(|text| AllowPut::parse(text).unwrap());
        let rules = read(None, &allow).unwrap();
        let values = [Bounds { min: -1.0, max: 2.5 }];
        assert_eq!(
            rules.put,
            [
                Allow::all(VariableKind::F),
                Allow::range(VariableKind::Io, 128, 143),
                Allow { values: &values, ..Allow::range(VariableKind::I, 5, 5) },
            ]
        );
    }

    #[test]
    fn what_is_wrong_is_said() {
        for (text, word) in [
            ("[[put]]\nkind = \"X\"", "I F D S V P J T IO"),
            ("[[put]]\nkind = \"I\"\nindexes = 3", "indexes"),
            ("[[put]]\nkind = \"I\"\nindex = \"3\"", "a number, or a range"),
            ("[[put]]\nkind = \"I\"\nindex = [3, 1]", "lower one first"),
            ("[[put]]\nkind = \"I\"\nvalues = [3, 1]", "lower one first"),
            ("[[put]]\nkind = \"I\"\nvalues = [nan, nan]", "are none"),
            ("[[put]]\nkind = \"I\"\nvalues = [[0, 1], [0, 1]]", "2 ranges of values for 1 elements"),
            ("[[put]]\nkind = \"I\"\nvalues = []", "0 ranges"),
            ("[[put]]\nkind = \"I\"\nvalues = 5", "values are a range"),
            ("[[put]]\nindex = 5", "kind"),
            ("rate = 5", "PerClient"),
            ("convert = 1\n", "bool"),
            ("nonsense", "line 1"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
        for text in ["", "X", "I/", "I/a", "I/3-1", "I/1-2-3", "I=1", "I=2..1", "I=a..b", "I/-1"] {
            assert!(AllowPut::parse(text).is_err(), "{text}");
        }
        let error = read(Some(Path::new("/no/such/file.toml")), &[]).unwrap_err();
        assert!(error.to_string().contains("/no/such/file.toml"), "{error}");
    }
}
