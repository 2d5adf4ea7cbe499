//! The map from coils and registers to variables, and its text.
//!
//! ```text
//! registers = address "=" kind [ "/" index [ "-" index ] ] [ ":" format ] [ ":low" ]
//! coils     = address "=IO" [ "/" index [ "-" index ] ]
//! address   = 1*DIGIT                        ; the protocol's, from 0 on: 0 is the register 40001 of many manuals
//! format    = "i16" / "u16" / "i32" / "f32" / "f64"
//! ```
//!
//! | kind            | format without one | others     | registers of a variable   |
//! |-----------------|--------------------|------------|---------------------------|
//! | `I`             | `i32`              | `i16` `u16`| 2; 1 for `i16` and `u16`  |
//! | `F`             | `f32`              |            | 2                         |
//! | `D`             | `f64`              | `f32`      | 4; 2 for `f32`            |
//! | `V` `P` `J` `T` | `f32`              |            | 6, 14, 16, 20             |
//!
//! `FIRST-LAST` maps these variables to successive addresses; without an index, variable 0 is mapped. The first register of a
//! number is its highest one; with `low` it is its lowest one.

use core::fmt;

use bcap_core::rac::{Variable, VariableKind};

/// The tables of Modbus: read-only and writable ones share their addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Table {
    /// Coils and discrete inputs: functions 1, 2, 5 and 15.
    Coils,
    /// Holding and input registers: functions 3, 4, 6 and 16.
    Registers,
}

/// How a number lies in registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum Format {
    Coil,
    I16,
    U16,
    I32,
    F32,
    F64,
}

impl Format {
    const fn of(kind: VariableKind) -> Option<Self> {
        Some(match kind {
            VariableKind::I => Self::I32,
            VariableKind::D => Self::F64,
            VariableKind::F | VariableKind::V | VariableKind::P | VariableKind::J | VariableKind::T => Self::F32,
            VariableKind::Io | VariableKind::S => return None,
        })
    }

    fn from_name(name: &str, kind: VariableKind) -> Option<Self> {
        Some(match (name, kind) {
            ("i16", VariableKind::I) => Self::I16,
            ("u16", VariableKind::I) => Self::U16,
            ("f32", VariableKind::D) => Self::F32,
            ("i32", VariableKind::I) | ("f64", VariableKind::D) => return Self::of(kind),
            ("f32", _) => return Self::of(kind).filter(|format| *format == Self::F32),
            _ => return None,
        })
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Coil => "coil",
            Self::I16 => "i16",
            Self::U16 => "u16",
            Self::I32 => "i32",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    const fn registers(self) -> u16 {
        match self {
            Self::Coil | Self::I16 | Self::U16 => 1,
            Self::I32 | Self::F32 => 2,
            Self::F64 => 4,
        }
    }
}

/// Variables of one kind at successive addresses of a table.
///
/// # Examples
///
/// ```
/// use bcap_gateway::modbus::Entry;
///
/// let entry = Entry::registers("100=I/10-19:i16")?;
/// assert_eq!(entry.addresses(), (100, 109));
/// let error = Entry::registers("100=S/1").unwrap_err();
/// assert_eq!(error.to_string(), "a variable of kind S cannot be in registers: expected one of I F D V P J T");
/// # Ok::<(), bcap_gateway::modbus::EntryError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Entry {
    table: Table,
    first: u16,
    last: u16,
    pub(super) kind: VariableKind,
    index: u32,
    pub(super) format: Format,
    pub(super) low_first: bool,
}

/// Writes the text of the entry, without the format if it is the default of the kind.
impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, kind, index, format, .. } = *self;
        write!(f, "{first}={kind}/{index}")?;
        let others = last.saturating_sub(first).checked_div(self.width()).unwrap_or(0);
        if others > 0 {
            write!(f, "-{}", index.saturating_add(others.into()))?;
        }
        if format != Format::Coil && Format::of(kind) != Some(format) {
            write!(f, ":{}", format.name())?;
        }
        f.write_str(if self.low_first { ":low" } else { "" })
    }
}

/// The variable at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) entry: Entry,
    pub(super) variable: Variable,
    /// The number of the variable's registers before the address.
    pub(super) offset: u16,
}

impl Entry {
    /// Parses the text of an entry for registers.
    ///
    /// # Errors
    ///
    /// An [`EntryError`].
    pub fn registers(text: &str) -> Result<Self, EntryError> {
        let (address, variables) = text.split_once('=').ok_or(EntryError::Address)?;
        let mut parts = variables.split(':');
        let (kind, index) = parse_variables(parts.next().unwrap_or_default())?;
        let mut format = Format::of(kind).ok_or(EntryError::Kind(kind))?;
        let mut part = parts.next();
        if let Some(name) = part.filter(|name| *name != "low") {
            format = Format::from_name(name, kind).ok_or(EntryError::Format(kind))?;
            part = parts.next();
        }
        match (part, parts.next()) {
            (None | Some("low"), None) => {}
            _ => return Err(EntryError::Order),
        }
        Self::new(Table::Registers, address, kind, index, format, part.is_some())
    }

    /// Parses the text of an entry for coils.
    ///
    /// # Errors
    ///
    /// An [`EntryError`].
    pub fn coils(text: &str) -> Result<Self, EntryError> {
        let (address, variables) = text.split_once('=').ok_or(EntryError::Address)?;
        let (kind, index) = parse_variables(variables)?;
        if kind != VariableKind::Io {
            return Err(EntryError::CoilKind(kind));
        }
        Self::new(Table::Coils, address, kind, index, Format::Coil, false)
    }

    fn new(
        table: Table,
        address: &str,
        kind: VariableKind,
        (index, end): (u32, u32),
        format: Format,
        low_first: bool,
    ) -> Result<Self, EntryError> {
        let first = address.parse().map_err(|_| EntryError::Address)?;
        let entry = Self { table, first, last: first, kind, index, format, low_first };
        let count = end.checked_sub(index).ok_or(EntryError::Index)?.checked_add(1);
        let registers = count.and_then(|count| count.checked_mul(entry.width().into()));
        let last = registers.and_then(|registers| u32::from(first).checked_add(registers)?.checked_sub(1));
        let last = last.and_then(|last| u16::try_from(last).ok()).ok_or(EntryError::Addresses)?;
        Ok(Self { last, ..entry })
    }

    /// Returns the first and the last address.
    #[must_use]
    pub const fn addresses(&self) -> (u16, u16) {
        (self.first, self.last)
    }

    /// Returns the table of the addresses.
    #[must_use]
    pub const fn table(&self) -> Table {
        self.table
    }

    /// Returns whether an address of this entry is also one of another.
    #[must_use]
    pub fn overlaps(&self, other: &Self) -> bool {
        self.table == other.table && self.first <= other.last && other.first <= self.last
    }

    /// Returns the number of addresses of a variable.
    pub(super) fn width(&self) -> u16 {
        let elements = u16::try_from(self.kind.elements()).unwrap_or(u16::MAX);
        self.format.registers().saturating_mul(elements)
    }

    fn find(&self, table: Table, address: u16) -> Option<Place> {
        let at = address.checked_sub(self.first).filter(|_| self.table == table && address <= self.last)?;
        let number = at.checked_div(self.width())?;
        let index = self.index.checked_add(number.into())?;
        let variable = Variable::new(self.kind, index);
        Some(Place { entry: *self, variable, offset: at.checked_rem(self.width())? })
    }
}

/// Finds the variable at an address.
pub(super) fn find(map: &[Entry], table: Table, address: u16) -> Option<Place> {
    map.iter().find_map(|entry| entry.find(table, address))
}

/// `kind [ "/" index [ "-" index ] ]`
fn parse_variables(text: &str) -> Result<(VariableKind, (u32, u32)), EntryError> {
    let (name, range) = text.split_once('/').unwrap_or((text, "0"));
    let kind = VariableKind::from_name(name).ok_or(EntryError::Name)?;
    let (first, last) = range.split_once('-').unwrap_or((range, range));
    let number = |text: &str| {
        text.bytes().all(|byte| byte.is_ascii_digit()).then(|| text.parse().ok()).flatten().ok_or(EntryError::Index)
    };
    Ok((kind, (number(first)?, number(last)?)))
}

/// Why the text of an entry is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum EntryError {
    /// It does not begin with an address and `=`.
    Address,
    /// The variables do not begin with a kind of variable.
    Name,
    /// A variable of this kind cannot be in registers.
    Kind(VariableKind),
    /// A variable of this kind cannot be a coil.
    CoilKind(VariableKind),
    /// An index is not a decimal number of at most 32 bits, or the first is above the last.
    Index,
    /// A variable of this kind does not have this format.
    Format(VariableKind),
    /// Something other than `low` is after the format.
    Order,
    /// The last address is above 65535.
    Addresses,
}

impl fmt::Display for EntryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Address => "expected ADDRESS=VARIABLES with an address from 0 to 65535, such as 100=I/10-19",
            Self::Name => "unknown kind of variable: expected one of I F D V P J T in registers, IO in coils",
            Self::Kind(kind) => {
                return write!(f, "a variable of kind {kind} cannot be in registers: expected one of I F D V P J T");
            }
            Self::CoilKind(kind) => return write!(f, "a variable of kind {kind} cannot be a coil: expected IO"),
            Self::Index => "invalid index: expected FIRST or FIRST-LAST, with LAST not below FIRST",
            Self::Format(kind) => {
                let formats = match kind {
                    VariableKind::I => "i16, u16 or i32",
                    VariableKind::D => "f32 or f64",
                    _ => "f32",
                };
                return write!(f, "invalid format for a variable of kind {kind}: expected {formats}");
            }
            Self::Order => "expected :low or nothing after the format",
            Self::Addresses => "the variables need addresses above 65535",
        })
    }
}

impl core::error::Error for EntryError {}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::string::ToString;

    #[test]
    fn an_address_is_a_variable_and_an_offset() {
        let map = [
            Entry::registers("100=I/10-19:i16").unwrap(),
            Entry::registers("200=P/3-4:low").unwrap(),
            Entry::registers("65535=I/7:u16").unwrap(),
            Entry::coils("100=io/128-143").unwrap(),
        ];
        let found = |table, address| {
            find(&map, table, address).map(|place| (place.variable.kind, place.variable.index, place.offset))
        };
        assert_eq!(found(Table::Registers, 99), None);
        assert_eq!(found(Table::Registers, 100), Some((VariableKind::I, 10, 0)));
        assert_eq!(found(Table::Registers, 109), Some((VariableKind::I, 19, 0)));
        assert_eq!(found(Table::Registers, 110), None);
        assert_eq!(found(Table::Registers, 213), Some((VariableKind::P, 3, 13)));
        assert_eq!(found(Table::Registers, 214), Some((VariableKind::P, 4, 0)));
        assert_eq!(found(Table::Registers, 228), None);
        assert_eq!(found(Table::Registers, 65_535), Some((VariableKind::I, 7, 0)));
        assert_eq!(found(Table::Coils, 115), Some((VariableKind::Io, 143, 0)));
        assert_eq!(found(Table::Coils, 200), None);
        assert_eq!(map.map(|entry| entry.width()), [1, 14, 1, 1]);
        assert!(!map[0].overlaps(&map[3]), "they are in two tables");
        assert!(map[0].overlaps(&Entry::registers("109=F").unwrap()));
        assert!(!map[0].overlaps(&Entry::registers("110=F").unwrap()));
    }

    #[test]
    fn an_entry_is_written_as_it_is_read() {
        for (text, written) in [
            ("100=I/10-19:i16", "100=I/10-19:i16"),
            ("100=i:i32", "100=I/0"),
            ("0=D/1-2:f32:low", "0=D/1-2:f32:low"),
            ("7=D:f64:low", "7=D/0:low"),
            ("0=P/3-4", "0=P/3-4"),
            ("0=T/3", "0=T/3"),
        ] {
            assert_eq!(Entry::registers(text).unwrap().to_string(), written);
            assert_eq!(Entry::registers(written), Entry::registers(text));
        }
        assert_eq!(Entry::coils("0=IO/128-143").unwrap().to_string(), "0=IO/128-143");
    }

    #[test]
    fn invalid_entries_say_what_is_wrong() {
        for (text, error) in [
            ("100", EntryError::Address),
            ("=I", EntryError::Address),
            ("65536=I", EntryError::Address),
            ("-1=I", EntryError::Address),
            ("1=X", EntryError::Name),
            ("1=", EntryError::Name),
            ("1=IO/3", EntryError::Kind(VariableKind::Io)),
            ("1=S", EntryError::Kind(VariableKind::S)),
            ("1=I/", EntryError::Index),
            ("1=I/4-3", EntryError::Index),
            ("1=I/+1", EntryError::Index),
            ("1=I/0-4294967295", EntryError::Addresses),
            ("1=I:f32", EntryError::Format(VariableKind::I)),
            ("1=P:i16", EntryError::Format(VariableKind::P)),
            ("1=I:", EntryError::Format(VariableKind::I)),
            ("1=I:i16:high", EntryError::Order),
            ("1=I:low:i16", EntryError::Order),
            ("1=I:low:low", EntryError::Order),
            ("65535=F", EntryError::Addresses),
            ("1=I/0-65535", EntryError::Addresses),
            ("1=I/0-4000000000", EntryError::Addresses),
        ] {
            assert_eq!(Entry::registers(text), Err(error), "{text}");
        }
        assert_eq!(Entry::coils("1=I/3"), Err(EntryError::CoilKind(VariableKind::I)));
        assert_eq!(
            EntryError::Format(VariableKind::D).to_string(),
            "invalid format for a variable of kind D: expected f32 or f64"
        );
        assert_eq!(Entry::registers("7=D/1:f64:low"), Entry::registers("7=D/1:low"));
        assert_eq!(Entry::registers("0=T/0:f32").unwrap().addresses(), (0, 19));
    }
}
