//! A serial line as text: `serial:PATH[?baud=N&parity=none|even|odd&stop=1|2]`.

use std::fmt;
use std::time::Duration;

#[cfg(feature = "serial")]
use bcap_core::bcap::client::{Config, Timing};
#[cfg(feature = "serial")]
use bcap_core::limits::SERIAL_MAX;

/// The baud rates that an address may name.
const BAUD: std::ops::RangeInclusive<u32> = 300..=4_000_000;

/// The parity bit of a [`SerialLine`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Parity {
    /// No parity bit.
    #[default]
    None,
    /// Even parity.
    Even,
    /// Odd parity.
    Odd,
}

/// The stop bits of a [`SerialLine`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum StopBits {
    /// One stop bit.
    #[default]
    One,
    /// Two stop bits.
    Two,
}

/// The device and the settings of a serial line. A character has eight data bits, and there is no flow control.
///
/// The specification names no settings. The defaults are 115200 baud, no parity and one stop bit: 115200 baud is the
/// highest rate that every PC and USB adapter supports. Both ends must have the same settings.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct SerialLine {
    /// The device, such as `/dev/ttyUSB0` or `COM3`.
    pub path: String,
    /// The rate in bits per second.
    pub baud: u32,
    /// The parity bit.
    pub parity: Parity,
    /// The stop bits.
    pub stop_bits: StopBits,
}

impl SerialLine {
    /// Returns a line with the default settings.
    #[must_use]
    pub fn new(path: impl Into<String>) -> Self {
        Self { path: path.into(), baud: 115_200, parity: Parity::None, stop_bits: StopBits::One }
    }

    /// Sets the rate in bits per second.
    #[must_use]
    pub fn baud(self, baud: u32) -> Self {
        Self { baud, ..self }
    }

    /// Sets the parity bit.
    #[must_use]
    pub fn parity(self, parity: Parity) -> Self {
        Self { parity, ..self }
    }

    /// Sets the stop bits.
    #[must_use]
    pub fn stop_bits(self, stop_bits: StopBits) -> Self {
        Self { stop_bits, ..self }
    }

    /// Returns the transmission time of a number of bytes in one direction.
    #[must_use]
    pub fn transfer_time(&self, bytes: u32) -> Duration {
        let bits = u64::from(bytes) * u64::from(self.byte_bits());
        Duration::from_micros((bits * 1_000_000).div_ceil(u64::from(self.baud.max(1))))
    }

    /// Returns how many bits the line sends for a byte: a start bit, eight data bits, parity and stop bits.
    #[must_use]
    pub fn byte_bits(&self) -> u32 {
        let parity = if self.parity == Parity::None { 0 } else { 1 };
        let stop = if self.stop_bits == StopBits::One { 1 } else { 2 };
        9 + parity + stop
    }

    /// Parses `PATH[?OPTIONS]`; `text` is the whole address, for messages.
    pub(crate) fn parse(text: &str, rest: &str) -> Result<Self, String> {
        let (path, options) = rest.split_once('?').unwrap_or((rest, ""));
        if path.is_empty() {
            return Err(format!("{text}: the device is missing; write serial:PATH, such as serial:/dev/ttyUSB0"));
        }
        let mut line = Self::new(path);
        let mut found = Vec::new();
        for option in options.split('&').filter(|option| !option.is_empty()) {
            let (name, value) = option.split_once('=').unwrap_or((option, ""));
            if found.contains(&name) {
                return Err(format!("{text}: the option {name} is given twice"));
            }
            found.push(name);
            line.set(name, value).map_err(|error| format!("{text}: {error}"))?;
        }
        Ok(line)
    }

    /// Sets an option of an address.
    fn set(&mut self, name: &str, value: &str) -> Result<(), String> {
        let (min, max) = BAUD.into_inner();
        match (name, value) {
            ("baud", rate) => match rate.parse() {
                Ok(baud) if BAUD.contains(&baud) => self.baud = baud,
                _ => return Err(format!("{rate:?} is not a baud rate; write a number from {min} to {max}")),
            },
            ("parity", "none") => self.parity = Parity::None,
            ("parity", "even") => self.parity = Parity::Even,
            ("parity", "odd") => self.parity = Parity::Odd,
            ("parity", other) => return Err(format!("{other:?} is not a parity; write none, even or odd")),
            ("stop", "1") => self.stop_bits = StopBits::One,
            ("stop", "2") => self.stop_bits = StopBits::Two,
            ("stop", other) => return Err(format!("{other:?} is not a number of stop bits; write 1 or 2")),
            (other, _) => {
                return Err(format!("{other:?} is not an option of a serial line; write baud, parity or stop"));
            }
        }
        Ok(())
    }
}

/// Writes the line as it is parsed, without `serial:` and without the default parity and stop bits.
impl fmt::Display for SerialLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}?baud={}", self.path, self.baud)?;
        match self.parity {
            Parity::None => {}
            Parity::Even => f.write_str("&parity=even")?,
            Parity::Odd => f.write_str("&parity=odd")?,
        }
        match self.stop_bits {
            StopBits::One => Ok(()),
            StopBits::Two => f.write_str("&stop=2"),
        }
    }
}

#[cfg(feature = "serial")]
impl SerialLine {
    /// Returns a client's configuration for this line: an attempt also waits for the largest request and reply to pass.
    pub(crate) fn config(&self, config: Config) -> Config {
        let largest = u32::try_from(SERIAL_MAX).unwrap_or(u32::MAX);
        let attempt_timeout = config.timing.attempt_timeout.saturating_add(self.transfer_time(largest) * 2);
        Config { timing: Timing { attempt_timeout, ..config.timing }, ..config }
    }

    /// Returns the settings as the operating system's port takes them.
    pub(crate) fn builder(&self) -> serialport::SerialPortBuilder {
        serialport::new(self.path.as_str(), self.baud)
            .parity(match self.parity {
                Parity::None => serialport::Parity::None,
                Parity::Even => serialport::Parity::Even,
                Parity::Odd => serialport::Parity::Odd,
            })
            .stop_bits(match self.stop_bits {
                StopBits::One => serialport::StopBits::One,
                StopBits::Two => serialport::StopBits::Two,
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_limits_follow_the_baud_rate() {
        let line = SerialLine::new("/dev/ttyS0");
        assert_eq!(line.transfer_time(1152), Duration::from_millis(100));
        let slow = line.clone().baud(9600).parity(Parity::Even).stop_bits(StopBits::Two);
        assert_eq!(slow.transfer_time(800), Duration::from_secs(1));
        #[cfg(feature = "serial")]
        // 503 bytes of ten bits in both directions: 87 ms at 115200 baud
        for (line, micros) in [(line, 587_328), (slow, 1_757_500)] {
            assert_eq!(line.config(Config::SERIAL).timing.attempt_timeout, Duration::from_micros(micros), "{line}");
        }
    }
}
