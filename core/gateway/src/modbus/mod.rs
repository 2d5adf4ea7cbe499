//! Sessions of clients that speak Modbus TCP: they turn requests into lines of RAC, and the replies into responses.
//!
//! ```text
//!  client ─ room, received ────────►┌───────┐─ line, line_taken ─► a server of RAC, such as a slot of a gateway
//!         ◄─ transmit, transmitted ─│Session│◄─ replied ──────────
//!                                   └───────┘
//! ```
//!
//! Holding registers and coils are mapped to variables by a list of [`Entry`]s. A request that covers several variables becomes
//! a sequence of lines, one for each of them. So rules, rates, logs and counters of a gateway apply to these clients as they
//! are, and a variable is read-only unless a rule allows a PUT.
//!
//! * **Reads** may begin and end within a variable. Each variable is read at its own time.
//! * **Writes** must cover variables completely. If a rule refuses one of the variables of a request, none is written. If the
//!   robot or the rate limit refuses one, the preceding variables have been written.
//! * **Functions** 1 to 6, 15, 16, 22, 23 and 43 (device identification, which needs no line). Input registers are the holding
//!   registers, discrete inputs are the coils. Every unit identifier is accepted. Function 22 is a GET and a PUT: a change
//!   between the two is overwritten.
//! * **Refusals** are [`Exception`]s. For a request without a variable, the session sends the invalid line `MODBUS:3:100:2`,
//!   with function, first address and count, so that a gateway logs and counts it.
//! * **Bytes that are not Modbus TCP** end the connection ([`Session::is_broken`]).
//!
//! The codec is written here: rmodbus 0.13 panics on a frame of 13 bytes that announces more registers than it has, and
//! refuses the longest write.
//!
//! Source: MODBUS Application Protocol V1.1b3, MODBUS Messaging on TCP/IP V1.0b.
//!
//! # Examples
//!
//! ```
//! use bcap_gateway::modbus::{Entry, Session};
//!
//! let map = [Entry::registers("100=I/10-19")?];
//! let mut session = Session::new(&map);
//! // reads the registers 100 and 101
//! session.received(&[0, 1, 0, 0, 0, 6, 1, 3, 0, 100, 0, 2], |_| true);
//! assert_eq!(session.line(), b"GET:RC8:10:I:\r");
//! session.line_taken(session.line().len());
//! session.replied(b"0,3,70000\r", |_| true);
//! assert_eq!(session.transmit(), [0, 1, 0, 0, 0, 7, 1, 3, 4, 0x00, 0x01, 0x11, 0x70]);
//! # Ok::<(), bcap_gateway::modbus::EntryError>(())
//! ```

mod frame;
mod map;
mod words;

use heapless::Vec;

use self::frame::{Command, FRAME, HEADER, Work};
use self::map::{Place, find};
use bcap_core::error::TextError;
use bcap_core::rac::{MAX_LINE, Request, Response};
use bcap_core::storage::shift_down;
use bcap_core::variant::{Variant, VariantBuf, Writer, write_integer};

pub use self::frame::Exception;
pub use self::map::{Entry, EntryError, Table};

/// The TCP port of Modbus.
pub const PORT: u16 = 502;

/// Bytes of memory for a value in a reply. A longer one does not fit registers.
const VALUE: usize = 96;

/// The session of one client.
#[derive(Debug)]
pub struct Session<'a> {
    map: &'a [Entry],
    /// The request that runs, and bytes after it.
    request: [u8; FRAME],
    received: usize,
    running: Option<Running>,
    line: Vec<u8, MAX_LINE>,
    line_taken: usize,
    reply: Vec<u8, MAX_LINE>,
    /// The response; while a read runs, its first bytes.
    response: Vec<u8, FRAME>,
    sent: usize,
    is_broken: bool,
}

/// The request that runs.
#[derive(Clone, Copy, Debug)]
struct Running {
    /// The length of its frame.
    length: usize,
    /// `None` if it is invalid.
    command: Option<Command>,
    /// The command after it.
    then: Option<Command>,
    /// The register that function 22 writes.
    masked: [u8; 2],
    /// The number of registers or coils of the command that are done.
    done: u16,
    /// The response after the reply to the current line, whatever that reply is.
    refusal: Option<Exception>,
    /// Whether the rules refuse the current line, so that the request ends with its reply.
    is_forbidden: bool,
    /// Whether the rules permit all lines of the request, so that the robot refuses an access or a value.
    is_permitted: bool,
}

impl<'a> Session<'a> {
    /// Creates a session for a new connection. If entries of the map overlap, the first of them applies.
    #[must_use]
    pub const fn new(map: &'a [Entry]) -> Self {
        Self {
            map,
            request: [0; FRAME],
            received: 0,
            running: None,
            line: Vec::new(),
            line_taken: 0,
            reply: Vec::new(),
            response: Vec::new(),
            sent: 0,
            is_broken: false,
        }
    }

    /// Returns whether the client sent bytes that are not Modbus TCP. The connection must be closed then.
    #[must_use]
    pub const fn is_broken(&self) -> bool {
        self.is_broken
    }

    /// Returns whether a request runs.
    #[must_use]
    pub const fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Returns whether bytes of a request have arrived that does not run yet.
    #[must_use]
    pub const fn is_receiving(&self) -> bool {
        self.running.is_none() && self.received > 0
    }

    /// Returns how many bytes from the client there is room for. It is 0 only while a request runs.
    #[must_use]
    pub const fn room(&self) -> usize {
        FRAME.saturating_sub(self.received)
    }

    /// Takes bytes from the client, as many as there is [`room`](Self::room) for.
    ///
    /// `permits` returns whether the rules of the gateway permit a request ([`Rules::permits`](crate::Rules::permits)); a write
    /// of several variables begins only if all are permitted.
    pub fn received(&mut self, bytes: &[u8], permits: impl Fn(&Request<'_>) -> bool) {
        for (to, from) in self.request.iter_mut().skip(self.received).zip(bytes) {
            *to = *from;
            self.received = self.received.saturating_add(1);
        }
        self.begin(permits);
    }

    /// Returns the bytes to send to the client.
    #[must_use]
    pub fn transmit(&self) -> &[u8] {
        match self.running {
            Some(_) => &[],
            None => self.response.get(self.sent..).unwrap_or_default(),
        }
    }

    /// Records that the client's connection has taken `count` bytes of [`transmit`](Self::transmit). After the last byte, call
    /// [`received`](Self::received), even with no bytes: the next request may have arrived already.
    pub const fn transmitted(&mut self, count: usize) {
        self.sent = self.sent.saturating_add(count);
    }

    /// Returns the bytes of a line for the server of RAC.
    #[must_use]
    pub fn line(&self) -> &[u8] {
        self.line.get(self.line_taken..).unwrap_or_default()
    }

    /// Records that the server has taken `count` bytes of [`line`](Self::line).
    pub const fn line_taken(&mut self, count: usize) {
        self.line_taken = self.line_taken.saturating_add(count);
    }

    /// Takes bytes of a reply from the server. `permits` is as in [`received`](Self::received).
    pub fn replied(&mut self, bytes: &[u8], permits: impl Fn(&Request<'_>) -> bool) {
        for byte in bytes {
            if *byte == b'\r' {
                self.complete();
                self.reply.clear();
            } else if self.reply.push(*byte).is_err() {
                // longer than a line, which no server sends; the rest of it has no result code
                self.reply.clear();
            }
        }
        self.begin(permits);
    }

    /// Begins the next request, if it is complete and the previous response was sent.
    fn begin(&mut self, permits: impl Fn(&Request<'_>) -> bool) {
        if self.is_broken || self.running.is_some() || !self.transmit().is_empty() {
            return;
        }
        let frame = self.request.get(..self.received).unwrap_or_default();
        let length = match frame::length(frame) {
            Ok(Some(length)) if length <= frame.len() => length,
            Ok(_) => return,
            Err(()) => {
                self.is_broken = true;
                return;
            }
        };
        let function = self.request.get(HEADER..length).unwrap_or_default();
        let checked = match frame::identification(function) {
            Ok(Some(objects)) => return self.identify(length, objects),
            Ok(None) => frame::parse(function),
            Err(exception) => Err(exception),
        };
        let checked = checked.and_then(|Work { command, bytes, then }| {
            check(self.map, command)?;
            then.map_or(Ok(()), |then| check(self.map, then))?;
            if command.is_write {
                // the read of function 23 too, because its lines follow those of the write
                for part in [Some(command), then].into_iter().flatten() {
                    if let Some(at) = refused(self.map, part, bytes, &permits)? {
                        return Ok((part, None, Some(at)));
                    }
                }
            }
            Ok((command, then, None))
        });
        let (then, masked, done) = Default::default();
        let (refusal, is_forbidden, is_permitted) = Default::default();
        let mut running = Running { length, command: None, then, masked, done, refusal, is_forbidden, is_permitted };
        match checked {
            Ok((command, then, refused)) => {
                (running.command, running.then) = (Some(command), then);
                running.is_permitted = command.is_write && refused.is_none();
                if let Some(at) = refused {
                    // only the line that the rules refuse, so that the gateway logs it
                    (running.done, running.is_forbidden) = (at, true);
                }
                let shown = then.filter(|then| !then.is_write).unwrap_or(command);
                self.prepare(shown, function.first().copied().unwrap_or_default());
            }
            Err(exception) => running.refusal = Some(exception),
        }
        self.running = Some(running);
        self.put_line(running);
    }

    /// Prepares the response to a read, which replies fill, or to a write.
    fn prepare(&mut self, command: Command, function: u8) {
        self.head(function);
        if command.is_write {
            let [[a, b], [c, d]] = [command.first, command.count].map(u16::to_be_bytes);
            let single = self.request.get(HEADER.saturating_add(3)..HEADER.saturating_add(5));
            let end = match function {
                5 | 6 => single.unwrap_or_default(),
                _ => &[c, d],
            };
            let end = <[u8; 2]>::try_from(end).unwrap_or_default();
            append(&mut self.response, &[a, b]);
            append(&mut self.response, &end);
        } else {
            let count = u8::try_from(command.bytes()).unwrap_or(u8::MAX);
            append(&mut self.response, &[count]);
            let len = self.response.len().saturating_add(command.bytes());
            // a frame has room for the most registers of a read
            let _ = self.response.resize_default(len);
        }
    }

    /// Begins a response with the header of the request and a function.
    fn head(&mut self, function: u8) {
        self.response.clear();
        self.sent = 0;
        let [transaction @ .., _, _, unit] = self.request.first_chunk::<HEADER>().copied().unwrap_or_default();
        // the length is known at the end
        append(&mut self.response, &transaction);
        append(&mut self.response, &[0, 0, unit, function]);
    }

    /// Writes the next line of the running request.
    fn put_line(&mut self, running: Running) {
        let function = self.request.get(HEADER..running.length).unwrap_or_default();
        let mut memory = [0; MAX_LINE];
        let mut out = Writer::new(&mut memory);
        let written = match (running.command, frame::parse(function)) {
            (Some(command), Ok(Work { bytes, .. })) => {
                let bytes = if function.first() == Some(&22) { &running.masked } else { bytes };
                with_request(self.map, command, bytes, running.done, |_, request| request.write_line(&mut out).is_ok())
            }
            _ => None,
        };
        if written != Some(true) {
            // a value without a text, such as NaN, or an invalid request
            out = Writer::new(&mut memory);
            let _ = put_refused(function, &mut out);
            let exception = running.refusal.unwrap_or(Exception::IllegalDataValue);
            self.running = Some(Running { refusal: Some(exception), ..running });
        }
        self.line.clear();
        self.line_taken = 0;
        append(&mut self.line, out.into_bytes());
    }

    /// Handles a complete reply.
    fn complete(&mut self) {
        let Some(mut running) = self.running else { return };
        let mut memory = [0; VALUE];
        let reply = Response::parse(&self.reply, &mut memory);
        let (exception, value) = match reply {
            Ok(Response { result, .. }) if result.is_err() => {
                let exception = match Exception::from(result) {
                    // these two are for the rules
                    Exception::IllegalDataAddress | Exception::IllegalDataValue if running.is_permitted => {
                        Exception::ServerDeviceFailure
                    }
                    exception => exception,
                };
                (Some(running.refusal.unwrap_or(exception)), None)
            }
            Ok(_) if running.is_forbidden => (Some(Exception::IllegalDataAddress), None),
            Ok(Response { value, .. }) => (running.refusal, value),
            Err(_) => (Some(running.refusal.unwrap_or(Exception::ServerDeviceFailure)), None),
        };
        let advanced = match (exception, running.command) {
            (None, Some(command)) => self.advance(command, running.done, value.unwrap_or(Variant::Empty)),
            (exception, _) => Err(exception.unwrap_or(Exception::ServerDeviceFailure)),
        };
        match advanced {
            Ok(Some(done)) => {
                running.done = done;
                self.running = Some(running);
                self.put_line(running);
            }
            Ok(None) => match running.then.take() {
                Some(then) => {
                    if then.is_write {
                        running.masked = self.mask(running.length);
                    }
                    (running.command, running.done) = (Some(then), 0);
                    self.running = Some(running);
                    self.put_line(running);
                }
                None => self.finish(running.length),
            },
            Err(exception) => {
                let function = self.request.get(HEADER).copied().unwrap_or_default();
                self.head(function | 0x80);
                append(&mut self.response, &[exception.code()]);
                self.finish(running.length);
            }
        }
    }

    /// Applies the masks of function 22 to the register in the response to its read, and makes the response to the function.
    fn mask(&mut self, length: usize) -> [u8; 2] {
        let register = self.response.get(HEADER.saturating_add(2)..).and_then(|data| data.first_chunk()).copied();
        let [high, low]: [u8; 2] = register.unwrap_or_default();
        let function = self.request.get(HEADER..length).and_then(|function| function.first_chunk()).copied();
        let [function, a, b, and_high, and_low, or_high, or_low]: [u8; 7] = function.unwrap_or_default();
        self.head(function);
        append(&mut self.response, &[a, b, and_high, and_low, or_high, or_low]);
        [high & and_high | or_high & !and_high, low & and_low | or_low & !and_low]
    }

    /// Answers a request for the identification of this device.
    fn identify(&mut self, length: usize, objects: impl Iterator<Item = (u8, &'static str)> + Clone) {
        let code = self.request.get(HEADER.saturating_add(2)).copied().unwrap_or_default();
        self.head(43);
        // basic identification, as a stream and by object; nothing follows
        let count = u8::try_from(objects.clone().count()).unwrap_or(u8::MAX);
        append(&mut self.response, &[14, code, 0x81, 0, 0, count]);
        for (number, text) in objects {
            append(&mut self.response, &[number, u8::try_from(text.len()).unwrap_or(u8::MAX)]);
            append(&mut self.response, text.as_bytes());
        }
        self.finish(length);
    }

    /// Stores the value of a variable in the response to a read. Returns the number of registers or coils that are done; `None`
    /// after the last.
    fn advance(&mut self, command: Command, done: u16, value: Variant<'_>) -> Result<Option<u16>, Exception> {
        let place = place(self.map, command, done).ok_or(Exception::IllegalDataAddress)?;
        let count = share(place, command, done);
        if !command.is_write {
            // after the function and the number of bytes
            let data = self.response.get_mut(HEADER.saturating_add(2)..).unwrap_or_default();
            let stored = match command.table {
                Table::Coils => value.as_bool().map(|on| {
                    if on {
                        frame::set_coil(data, done)
                    }
                }),
                Table::Registers => store(place, &value, data, done, count),
            };
            stored.ok_or(Exception::ServerDeviceFailure)?;
        }
        Ok(Some(done.saturating_add(count)).filter(|done| *done < command.count))
    }

    /// Completes the response, and removes the request.
    fn finish(&mut self, length: usize) {
        let counted = u16::try_from(self.response.len().saturating_sub(HEADER.saturating_sub(1))).unwrap_or(u16::MAX);
        if let Some(bytes) = self.response.get_mut(4..6).and_then(|bytes| bytes.first_chunk_mut()) {
            *bytes = counted.to_be_bytes();
        }
        self.running = None;
        self.sent = 0;
        shift_down(self.request.get_mut(..self.received).unwrap_or_default(), length);
        self.received = self.received.saturating_sub(length);
    }
}

/// Appends bytes that fit, because a frame has room for every response, and a line for every request.
fn append<const N: usize>(out: &mut Vec<u8, N>, bytes: &[u8]) {
    let _ = out.extend_from_slice(bytes);
}

/// Returns the variable at the address that follows `done` registers or coils.
fn place(map: &[Entry], command: Command, done: u16) -> Option<Place> {
    find(map, command.table, command.first.checked_add(done)?)
}

/// Returns the number of registers or coils of the request that belong to a variable.
fn share(place: Place, command: Command, done: u16) -> u16 {
    let of_variable = place.entry.width().saturating_sub(place.offset);
    // never 0, so that each reply brings the request nearer to its end
    of_variable.min(command.count.saturating_sub(done)).max(1)
}

/// Checks that each address has a variable, and that a write covers its variables completely.
fn check(map: &[Entry], command: Command) -> Result<(), Exception> {
    let mut done = 0;
    while done < command.count {
        let place = place(map, command, done).ok_or(Exception::IllegalDataAddress)?;
        let count = share(place, command, done);
        if command.is_write && count != place.entry.width() {
            return Err(Exception::IllegalDataAddress);
        }
        done = done.saturating_add(count);
    }
    Ok(())
}

/// Returns where the first variable of a command begins that the rules refuse.
fn refused(
    map: &[Entry],
    command: Command,
    bytes: &[u8],
    permits: impl Fn(&Request<'_>) -> bool,
) -> Result<Option<u16>, Exception> {
    let mut done = 0;
    while done < command.count {
        let permitted = with_request(map, command, bytes, done, |place, request| {
            // before the first line is sent, so that a value without a text leaves nothing half written
            let has_text = request.write_line(&mut Writer::new(&mut [0; MAX_LINE])).is_ok();
            has_text.then(|| permits(request).then(|| share(place, command, done)))
        });
        match permitted.flatten().ok_or(Exception::IllegalDataValue)? {
            Some(count) => done = done.saturating_add(count),
            None => return Ok(Some(done)),
        }
    }
    Ok(None)
}

/// Calls `work` with the request for the variable that follows `done` registers or coils.
fn with_request<T>(
    map: &[Entry],
    command: Command,
    bytes: &[u8],
    done: u16,
    work: impl FnOnce(Place, &Request<'_>) -> T,
) -> Option<T> {
    let place = place(map, command, done)?;
    if !command.is_write {
        return Some(work(place, &Request::Get(place.variable)));
    }
    let value = match command.table {
        Table::Coils => VariantBuf::new(&frame::coil(bytes, done)).ok()?,
        Table::Registers => words::load(&place.entry, bytes.get(usize::from(done).saturating_mul(2)..)?)?,
    };
    Some(work(place, &Request::Put(place.variable, value.as_variant())))
}

/// Copies the requested registers of a variable to the data of a response.
fn store(place: Place, value: &Variant<'_>, data: &mut [u8], done: u16, count: u16) -> Option<()> {
    // ten elements of two registers
    let mut registers = [0; 40];
    let registers = registers.get_mut(..bytes_of(place.entry.width()))?;
    words::store(&place.entry, value, registers)?;
    let registers = registers.get(bytes_of(place.offset)..)?.get(..bytes_of(count))?;
    for (to, from) in data.get_mut(bytes_of(done)..)?.iter_mut().zip(registers) {
        *to = *from;
    }
    Some(())
}

fn bytes_of(registers: u16) -> usize {
    usize::from(registers).saturating_mul(2)
}

/// Writes the line for a request that has none: `MODBUS:3:100:2` with function, first address and count.
fn put_refused(function: &[u8], out: &mut Writer<'_>) -> Result<(), TextError> {
    let number = |at: usize| {
        let bytes = function.get(at..).and_then(|bytes| bytes.first_chunk()).copied();
        u64::from(u16::from_be_bytes(bytes.unwrap_or_default()))
    };
    out.put_slice(b"MODBUS:")?;
    write_integer(function.first().copied().unwrap_or_default().into(), out)?;
    for at in [1, 3] {
        out.put_slice(b":")?;
        write_integer(number(at), out)?;
    }
    out.put_slice(b"\r")?;
    Ok(())
}

#[cfg(test)]
mod tests;
