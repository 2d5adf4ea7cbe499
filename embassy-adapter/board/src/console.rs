//! Changes the settings in flash over a serial line.
//!
//! A host sends a request as a line, which ends with a line feed, a carriage return or both. The board answers with a line that
//! starts with `ok` or `error`. It ignores empty lines.
//!
//! | request          | action of the board                                              | answer            |
//! |------------------|------------------------------------------------------------------|-------------------|
//! | `hello`          | identifies the protocol                                          | `ok bcap-board 1` |
//! | `show`           | sends the settings, a line `setting KEY=VALUE` for each          | `ok flash` or `ok image`, their place |
//! | `new`            | starts empty settings                                            | `ok`              |
//! | `add KEY=VALUE`  | adds a line to them, if it is valid                              | `ok`              |
//! | `save CRC32`     | writes them into the flash, if that is their CRC-32, in hexadecimal | `ok`           |
//! | `factory`        | removes the settings from the flash, so the image's defaults apply | `ok`              |
//! | `restart`        | restarts: the settings are read at the start                     | `ok`              |
//!
//! The settings of the board change with `save` and `factory` only, and a power cut in either leaves the earlier settings or
//! the new ones ([`slots`](crate::slots)).
//!
//! With the feature `update`, on a board with partitions for updates:
//!
//! | request          | action of the board                                              | answer            |
//! |------------------|------------------------------------------------------------------|-------------------|
//! | `status`         | reports its name, its version and the outcome of the last update | `ok BOARD VERSION PHASE` |
//! | `update BOARD VERSION LENGTH CRC32` | begins to receive an image of `LENGTH` bytes, if it is for this board | `ok` |
//! | `sign SHA512 SIGNATURE` | checks the signature of the image, in hexadecimal; before the first block ([`signature`](crate::signature)) | `ok` |
//! | `block NUMBER CRC32 HEX` | writes 128 bytes; the CRC-32 also covers the number (u32, little-endian) | `ok NUMBER` |
//! | `install`        | checks the CRC-32 of the image in the flash; the next start swaps it in | `ok`       |
//!
//! A board with a key needs `sign`, and takes an older image only if the word `older` follows the CRC-32 of `update`. These
//! requests are also accepted over TCP ([`remote`](crate::remote)), except for `older`; `restart` is, after `install`.
//!
//! Blocks have the numbers 0, 1, 2 and so on; the last block of an image can have fewer bytes. After an error, or without an
//! answer, the host sends the block again.

use core::str;

use embedded_io::{Read, Write};
use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;

#[cfg(feature = "health")]
use crate::SettingError;
use crate::answer::{answer, result};
use crate::crc::Crc32;
#[cfg(feature = "health")]
use crate::settings::is_secret;
use crate::slots::{Slots, TEXT};
#[cfg(all(feature = "update", any(feature = "health", feature = "port")))]
use crate::update::Phase;
#[cfg(feature = "update")]
use crate::update::Updater;
use crate::{InvalidLine, Settings};

/// The maximum size of a request in bytes.
pub const LINE: usize = 512;
/// The answer to `hello`.
pub const HELLO: &str = "ok bcap-board 1";

/// Why settings from a page are not saved.
#[cfg(feature = "health")]
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum NotSaved {
    /// A line is invalid.
    Line {
        /// The number of the line, counted from 1.
        number: usize,
        /// The column, in bytes counted from 1.
        column: usize,
        /// The fault.
        error: SettingError,
    },
    /// A line with this number is a secret one, which only the console sets.
    Secret {
        /// The number of the line, counted from 1.
        number: usize,
    },
    /// All lines together are longer than [`TEXT`].
    TooLong,
    /// The settings change how hosts reach the board, and the line `reach=yes` is missing.
    Reach,
    /// The settings in the flash are not those that the board runs with.
    Changed,
    /// An update is on trial, which a restart would roll back.
    OnTrial,
    /// The flash failed; it has the earlier settings.
    Flash,
}

/// The line by which a page confirms that hosts will reach the board in another way.
#[cfg(feature = "health")]
pub const REACH: &str = "reach=yes";

/// Why a line is not a part of the new settings.
enum NotAdded<'a> {
    TooLong { end: usize },
    Invalid(InvalidLine<'a>),
}

/// The task that a command leaves to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Action {
    /// Restart, once the answer has left.
    Restart,
}

/// The settings that `show` sends in parts, so that an answer needs little memory.
#[derive(Debug)]
struct Shown {
    /// Whether they are in the memory for new settings; otherwise they are those in the image.
    is_flash: bool,
    next: usize,
    end: usize,
}

/// The maximum number of bytes of a setting in one part.
const PART: usize = 256;

/// The board's side of the protocol.
#[derive(Debug)]
pub struct Console<'a, F> {
    slots: Slots<F>,
    /// The settings of the image.
    image: &'a [u8],
    /// The request that arrives.
    request: Vec<u8, LINE>,
    is_too_long: bool,
    /// The settings that the host sends.
    new: [u8; TEXT],
    len: usize,
    /// The settings that are being sent.
    shown: Option<Shown>,
    /// Whether the flash has other settings than at the start.
    is_changed: bool,
    #[cfg(feature = "update")]
    updater: Option<Updater>,
}

impl<'a, F: NorFlash> Console<'a, F> {
    /// Serves these slots; `image` has the settings that are used without valid slots.
    #[must_use]
    pub const fn new(slots: Slots<F>, image: &'a [u8]) -> Self {
        Self {
            slots,
            image,
            request: Vec::new(),
            is_too_long: false,
            new: [0; TEXT],
            len: 0,
            shown: None,
            is_changed: false,
            #[cfg(feature = "update")]
            updater: None,
        }
    }

    /// Takes a received byte; at the end of a request, performs it and writes the answer to `port`.
    ///
    /// # Errors
    ///
    /// An error of `port`.
    pub fn receive<W: Write>(&mut self, byte: u8, port: &mut W) -> Result<Option<Action>, W::Error> {
        let action = self.receive_byte(byte, port)?;
        while self.shown.is_some() {
            self.show_more(port)?;
        }
        Ok(action)
    }

    /// Like [`receive`](Self::receive), but writes only the first part of the answer; [`show_more`](Self::show_more) writes the
    /// next part.
    pub(crate) fn receive_byte<W: Write>(&mut self, byte: u8, port: &mut W) -> Result<Option<Action>, W::Error> {
        if !matches!(byte, b'\r' | b'\n') {
            self.is_too_long |= self.request.push(byte).is_err();
            return Ok(None);
        }
        self.shown = None;
        let request = core::mem::take(&mut self.request);
        if core::mem::take(&mut self.is_too_long) {
            answer(port, format_args!("error the request is longer than {LINE} bytes"))?;
            return Ok(None);
        }
        if request.is_empty() {
            return Ok(None);
        }
        self.perform(&request, port)
    }

    /// Serves a port until the host requests a restart, or the port ends.
    ///
    /// # Errors
    ///
    /// An error of `port`.
    pub fn run<P: Read + Write>(&mut self, port: &mut P) -> Result<Option<Action>, P::Error> {
        let mut byte = [0];
        while port.read(&mut byte)? > 0 {
            if let Some(action) = self.receive(byte[0], port)? {
                return Ok(Some(action));
            }
        }
        Ok(None)
    }

    fn perform<W: Write>(&mut self, request: &[u8], port: &mut W) -> Result<Option<Action>, W::Error> {
        let Ok(request) = str::from_utf8(request) else {
            answer(port, format_args!("error the request is not UTF-8"))?;
            return Ok(None);
        };
        let (verb, argument) = request.split_once(' ').unwrap_or((request, ""));
        let mut action = None;
        match verb {
            "hello" => answer(port, format_args!("{HELLO}"))?,
            "show" => self.show(port)?,
            "new" => {
                self.len = 0;
                answer(port, format_args!("ok"))?;
            }
            "add" => self.add(argument.as_bytes(), port)?,
            "save" => self.save(argument, port)?,
            "factory" => {
                self.is_changed = true;
                result(port, self.slots.clear())?;
            }
            "restart" => {
                action = Some(Action::Restart);
                answer(port, format_args!("ok"))?;
            }
            #[cfg(feature = "update")]
            "status" | "update" | "sign" | "block" | "install" => self.update(verb, argument, port)?,
            _ => answer(port, format_args!("error unknown request \"{}\"", verb.escape_debug()))?,
        }
        Ok(action)
    }

    /// Begins to send the settings. It reads them into the memory of the new ones, which are lost.
    fn show<W: Write>(&mut self, port: &mut W) -> Result<(), W::Error> {
        self.len = 0;
        let (text, is_flash) = match self.slots.read(&mut self.new) {
            Ok(Some(text)) => (text, true),
            Ok(None) => (self.image, false),
            Err(error) => return answer(port, format_args!("error {error}")),
        };
        let end = text.iter().position(|byte| *byte == 0).unwrap_or(text.len());
        self.shown = Some(Shown { is_flash, next: 0, end });
        self.show_more(port)
    }

    /// Sends a part of the settings, or the end of the answer; nothing if no settings are being sent.
    pub(crate) fn show_more<W: Write>(&mut self, port: &mut W) -> Result<(), W::Error> {
        let Some(Shown { is_flash, next, end }) = &mut self.shown else { return Ok(()) };
        let text = if *is_flash { &self.new } else { self.image }.get(..*end).unwrap_or_default();
        let starts_line = *next == 0 || text.get(*next - 1) == Some(&b'\n');
        while starts_line && text.get(*next) == Some(&b'\n') {
            *next += 1;
        }
        let Some(rest) = text.get(*next..).filter(|rest| !rest.is_empty()) else {
            let place = if *is_flash { "flash" } else { "image" };
            self.shown = None;
            return answer(port, format_args!("ok {place}"));
        };
        if starts_line {
            port.write_all(b"setting ")?;
        }
        let line = rest.iter().position(|byte| *byte == b'\n').map_or(rest.len(), |len| len + 1);
        let part = rest.get(..line.min(PART)).unwrap_or_default();
        *next += part.len();
        let is_last = *next == *end && !part.ends_with(b"\n");
        port.write_all(part)?;
        if is_last { port.write_all(b"\n") } else { Ok(()) }
    }

    /// Adds a line to the new settings.
    fn add<W: Write>(&mut self, line: &[u8], port: &mut W) -> Result<(), W::Error> {
        if line.is_empty() {
            return answer(port, format_args!("error add needs KEY=VALUE"));
        }
        match self.push([line, b""]) {
            Err(NotAdded::TooLong { end }) => {
                answer(port, format_args!("error the settings take {end} bytes of {TEXT}"))
            }
            Err(NotAdded::Invalid(error)) => answer(port, format_args!("error {error}")),
            Ok(()) => answer(port, format_args!("ok")),
        }
    }

    /// Adds a line of two parts to the new settings.
    fn push(&mut self, parts: [&[u8]; 2]) -> Result<(), NotAdded<'_>> {
        let mut end = self.len;
        for part in parts.into_iter().chain([&b"\n"[..]]) {
            let start = end;
            end += part.len();
            let Some(room) = self.new.get_mut(start..end) else {
                let end = self.len + parts.map(<[u8]>::len).into_iter().sum::<usize>() + 1;
                return Err(NotAdded::TooLong { end });
            };
            room.copy_from_slice(part);
        }
        // all lines together, because the memory for rules is limited
        match Settings::check(self.new.get(..end).unwrap_or_default()) {
            Err(error) => Err(NotAdded::Invalid(error)),
            Ok(()) => {
                self.len = end;
                Ok(())
            }
        }
    }

    fn save<W: Write>(&mut self, crc: &str, port: &mut W) -> Result<(), W::Error> {
        let text = self.new.get(..self.len).unwrap_or_default();
        let found = Crc32::new().and(text).value();
        if u32::from_str_radix(crc, 16) != Ok(found) {
            return answer(port, format_args!("error the settings have the CRC-32 {found:08x}"));
        }
        self.is_changed = true;
        let written = self.slots.write(text);
        result(port, written)
    }
}

#[cfg(feature = "health")]
impl<F: NorFlash> Console<'_, F> {
    /// Replaces the settings in the flash by the lines of a page, and keeps the secrets of `running`, the settings that the
    /// board runs with. Empty lines and lines that begin with `#` are dropped. Values are not changed, even with a `#` or
    /// blanks at their end.
    ///
    /// # Errors
    ///
    /// [`NotSaved`]; the flash then has the earlier settings.
    pub fn replace(&mut self, page: &str, running: &Settings<'_>) -> Result<(), NotSaved> {
        if self.is_changed {
            return Err(NotSaved::Changed);
        }
        #[cfg(feature = "update")]
        if self.updater.as_ref().is_some_and(|updater| updater.phase() == Phase::OnTrial) {
            return Err(NotSaved::OnTrial);
        }
        (self.len, self.shown) = (0, None);
        let mut may_change_reach = false;
        for secret in running.secrets() {
            self.push(secret.map(str::as_bytes)).map_err(|error| not_saved(error, 0))?;
        }
        for (number, line) in (1..).zip(page.lines()) {
            // blanks before a key are removed
            match line.trim_start() {
                "" => {}
                REACH => may_change_reach = true,
                line if line.starts_with('#') => {}
                line if is_secret(line) => return Err(NotSaved::Secret { number }),
                line => self.push([line.as_bytes(), b""]).map_err(|error| not_saved(error, number))?,
            }
        }
        let text = self.new.get(..self.len).unwrap_or_default();
        if !may_change_reach && !running.is_reached_with(text) {
            return Err(NotSaved::Reach);
        }
        self.slots.write(text).map_err(|_| NotSaved::Flash)?;
        self.is_changed = true;
        Ok(())
    }
}

#[cfg(feature = "health")]
fn not_saved(error: NotAdded<'_>, number: usize) -> NotSaved {
    match error {
        NotAdded::TooLong { .. } => NotSaved::TooLong,
        NotAdded::Invalid(line) => NotSaved::Line { number, column: line.column(), error: line.error },
    }
}

#[cfg(feature = "update")]
impl<F: NorFlash> Console<'_, F> {
    /// Also serves updates.
    #[must_use]
    pub fn with_updates(self, updater: Option<Updater>) -> Self {
        Self { updater, ..self }
    }

    /// Returns the part for updates, if the board has one, and the flash.
    pub fn updater(&mut self) -> Option<(&mut Updater, &mut F)> {
        Some((self.updater.as_mut()?, self.slots.flash()))
    }

    /// Performs a request of a host on the network, and returns whether to restart.
    #[cfg(feature = "port")]
    pub(crate) fn perform_remote<W: Write>(&mut self, request: &[u8], port: &mut W) -> Result<bool, W::Error> {
        let request = str::from_utf8(request).unwrap_or_default();
        let (verb, argument) = request.split_once(' ').unwrap_or((request, ""));
        match verb {
            "hello" => answer(port, format_args!("{HELLO}"))?,
            "update" if argument.ends_with(" older") => {
                answer(port, format_args!("error an older image is received over the serial port only"))?;
            }
            // a board whose settings are lost would not be reached again
            "update" if !self.slots.read(&mut self.new).is_ok_and(|stored| stored.is_some()) => {
                answer(
                    port,
                    format_args!(
                        "error the settings of the board are not in its flash, so an update would replace them"
                    ),
                )?;
            }
            "status" | "update" | "sign" | "block" | "install" => self.update(verb, argument, port)?,
            "restart" if self.updater.as_ref().is_some_and(|updater| updater.phase() == Phase::Installed) => {
                answer(port, format_args!("ok"))?;
                return Ok(true);
            }
            "restart" => answer(port, format_args!("error no update was installed, so the board does not restart"))?,
            _ => answer(port, format_args!("error unknown request"))?,
        }
        Ok(false)
    }

    fn update<W: Write>(&mut self, verb: &str, argument: &str, port: &mut W) -> Result<(), W::Error> {
        let Some((updater, flash)) = self.updater() else {
            return answer(port, format_args!("error this image has no partition for updates"));
        };
        crate::update::perform(updater, flash, verb, argument, port)
    }
}
