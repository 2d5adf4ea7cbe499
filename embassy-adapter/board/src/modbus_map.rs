//! The map from the registers and coils of Modbus to variables, as the `register` and `coil` lines have it.

use bcap_gateway::modbus::Entry;
use heapless::Vec;

use crate::SettingError;

/// The most `register` and `coil` lines.
const ENTRIES: usize = 32;

/// The entries of the map.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ModbusMap {
    entries: Vec<Entry, ENTRIES>,
}

impl ModbusMap {
    pub(crate) fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Adds an entry, unless it overlaps another entry.
    pub(crate) fn add(&mut self, entry: Entry) -> Result<(), SettingError> {
        if self.entries.iter().any(|other| other.overlaps(&entry)) {
            return Err(SettingError::Overlap);
        }
        self.entries.push(entry).map_err(|_| SettingError::TooManyEntries)
    }
}

#[cfg(test)]
mod tests {
    use crate::Settings;
    use bcap_gateway::modbus::Entry;
    use std::string::{String, ToString};
    use std::vec::Vec;

    #[test]
    fn the_map_is_read_in_the_order_of_its_lines() {
        let text = b"modbus=502\nregister=100=I/10-19:i16\ncoil=0=IO/128-143\nregister=200=P/1:low\n";
        let settings = Settings::read(text, |line, _| panic!("{}", String::from_utf8_lossy(line)));
        assert_eq!(settings.modbus, Some(502));
        let registers = |text| Entry::registers(text).unwrap();
        let coils = Entry::coils("0=IO/128-143").unwrap();
        assert_eq!(settings.modbus_map(), [registers("100=I/10-19:i16"), coils, registers("200=P/1:low")]);
        assert_eq!(Settings::default().modbus, None, "off without a setting");
    }

    #[test]
    fn an_invalid_entry_says_why_and_where() {
        let too_many: String = (0..33).map(|at| std::format!("coil={at}=IO/{at}\n")).collect();
        for (text, column, error) in [
            ("register=100=S/1", 10, "a variable of kind S cannot be in registers: expected one of I F D V P J T"),
            ("coil=1=IO/1\ncoil=0=IO/0-1", 6, "some of these addresses are in another line, too"),
            (&too_many, 1, "too many entries: a board has memory for 32 register and coil lines"),
        ] {
            let invalid = Settings::check(text.as_bytes()).unwrap_err();
            assert_eq!((invalid.column(), invalid.error.to_string().as_str()), (column, error));
        }
        let mut reported = Vec::new();
        let settings = Settings::read(b"put=I\nregister=1=I:f32\n", |line, _| reported.push(line));
        assert_eq!(reported, [b"register=1=I:f32"]);
        assert!(settings.rules(&mut crate::RuleMemory::new()).put.is_empty(), "an invalid line forbids every PUT");
    }
}
