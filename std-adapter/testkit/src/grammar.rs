//! Generates requests of a client to a server: valid, nearly valid and hostile calls, bytes and lines.
//!
//! A [`Grammar`] contains the functions, names and commands to choose from, so the caller determines which requests a device
//! may receive. The same bytes give the same steps.
//!
//! # Examples
//!
//! ```
//! use arbitrary::Unstructured;
//! use bcap_testkit::generate::bytes;
//! use bcap_testkit::grammar::Grammar;
//!
//! let (grammar, seed) = (Grammar::reading(), bytes(1, 4096));
//! let steps = grammar.session(&mut Unstructured::new(&seed))?;
//! assert_eq!(steps, grammar.session(&mut Unstructured::new(&seed))?);
//! steps.iter().for_each(|step| println!("{step}"));
//! # Ok::<(), arbitrary::Error>(())
//! ```

use arbitrary::{Result, Unstructured};
use bcap_core::bcap::{FunctionId, Kind, Object};

use crate::damage::{Damage, damaged};
use crate::frame::{TestFrame, field};
use crate::step::{Argument, Call, Delivery, OBJECTS, Step};
use crate::value::{ARRAY, VARIANT, Value};

/// The maximum number of steps of a session after those that open it.
const STEPS: usize = 12;
/// The lengths of long strings: around 16 bits of bytes, of characters, and of twice their number.
const LONG: [usize; 5] = [255, 16_383, 16_384, 32_768, 65_536];
/// Lengths of datagrams: around the limits of b-CAP and of an Ethernet frame, and the longest even one of IPv4. All are even,
/// because a letter has two bytes.
const DATAGRAMS: [usize; 8] = [488, 490, 504, 506, 1472, 1474, 9000, 65_506];
/// The bytes of a frame with an I4 and an empty BSTR.
const WITHOUT_LETTERS: usize = 44;

/// The material of steps.
#[derive(Clone, Debug)]
pub struct Grammar {
    /// The functions to call; without a function there are only bytes and lines.
    pub functions: Vec<FunctionId>,
    /// Numbers of functions that do not exist.
    pub unknown: Vec<i32>,
    /// Names of objects.
    pub names: Vec<String>,
    /// Commands of functions that execute one.
    pub commands: Vec<(FunctionId, String)>,
    /// Variables that may be written, as kind and index; without one there is no PUT.
    pub writable: Vec<(&'static str, u32)>,
    /// Options of objects that are opened.
    pub options: Vec<String>,
    /// The provider of Controller_Connect.
    pub provider: String,
    /// Whether packets are datagrams: then calls are also retransmitted, and bytes may be too long for a datagram of b-CAP.
    pub datagrams: bool,
}

impl Grammar {
    /// Functions that open, read and release objects, and no command.
    #[must_use]
    pub fn reading() -> Self {
        let reads = |function: &FunctionId| {
            let name = function.name().unwrap_or_default();
            let is_session = function.0 <= FunctionId::CONTROLLER_DISCONNECT.0;
            is_session || name.contains("Get") || name.ends_with("Release")
        };
        let names = [
            "",
            "I1",
            "I*",
            "F8",
            "P1",
            "J2",
            "T1",
            "V3",
            "S5",
            "D7",
            "IO24",
            "I[5]",
            "@MODE",
            "@TIME",
            "@ERROR_CODE",
            "@CURRENT_POSITION",
            "Arm",
            "Arm0",
            "Pro1",
            "Pro2",
            "Hand0",
            "Tool1",
            "Work1",
            "a.txt",
        ];
        Self {
            functions: FunctionId::all().filter(reads).collect(),
            // no firmware has such numbers
            unknown: vec![0, -1, i32::MIN, i32::MAX, 65_536, 0x0100_0000],
            names: names.map(String::from).into(),
            commands: Vec::new(),
            writable: Vec::new(),
            options: vec![String::new()],
            provider: "CaoProv.DENSO.VRC".into(),
            datagrams: false,
        }
    }

    /// Returns the calls that open a session.
    #[must_use]
    pub fn opening(&self) -> Vec<Step> {
        let text = |text: &str| Argument::Value(Value::text(text));
        let connect = [text(""), text(&self.provider), text("localhost"), text("")];
        vec![
            Step::Call(Call::new(FunctionId::SERVICE_START, vec![text("")])),
            Step::Call(Call::new(FunctionId::CONTROLLER_CONNECT, connect.into())),
        ]
    }

    /// Generates the steps of a connection: mostly a session that is opened, some objects, and calls; sometimes hostile bytes at
    /// the end.
    ///
    /// # Errors
    ///
    /// When the bytes do not suffice.
    pub fn session(&self, u: &mut Unstructured<'_>) -> Result<Vec<Step>> {
        let mut steps = if u.ratio(15, 16)? { self.opening() } else { Vec::new() };
        for object in [Object::Robot, Object::Task, Object::Variable, Object::File, Object::Extension] {
            if u.ratio(1, 3)? {
                steps.extend(self.open(object, u)?.map(Step::Call));
            }
        }
        if !self.writable.is_empty() && self.functions.contains(&FunctionId::VARIABLE_PUT_VALUE) && u.ratio(1, 2)? {
            steps.extend(self.write(u)?.map(Step::Call));
        }
        if !self.functions.is_empty() {
            for _ in 0..u.int_in_range(0..=STEPS)? {
                steps.push(Step::Call(self.call(u)?));
            }
        }
        if !self.functions.is_empty() && u.ratio(1, 8)? {
            steps.extend(self.stale(u)?.into_iter().map(Step::Call));
        }
        if u.ratio(2, 5)? {
            steps.push(Step::Bytes(self.attack(u)?));
        }
        Ok(steps)
    }

    /// Generates an object that is opened and released repeatedly, which a server with a leak refuses at some time. In every
    /// second such session the end of the connection releases the objects.
    ///
    /// # Errors
    ///
    /// When the bytes do not suffice.
    pub fn openings(&self, u: &mut Unstructured<'_>) -> Result<Vec<Step>> {
        let objects = [Object::Variable, Object::Robot, Object::Task];
        let open = match self.open(*u.choose(&objects)?, u)? {
            Some(open) => Step::Call(open),
            None => return Ok(self.opening()),
        };
        if u.arbitrary()? {
            let round = [&self.opening()[..], &[open, Step::Reconnect]].concat();
            return Ok(vec![round; 80].concat());
        }
        let Step::Call(call) = &open else { return Ok(self.opening()) };
        let object = FunctionId(call.function).opens().unwrap_or(Object::Variable);
        let release = Step::Call(Call::new(object.released_by(), vec![Argument::Handle(object)]));
        Ok([self.opening(), vec![[open, release]; 300].concat()].concat())
    }

    /// Generates the calls that open a variable that may be written, and write it.
    fn write(&self, u: &mut Unstructured<'_>) -> Result<[Call; 2]> {
        let (kind, index) = u.choose(&self.writable)?;
        let (controller, name) = (Argument::Handle(Object::Controller), Value::text(&format!("{kind}{index}")));
        let open = vec![controller, Argument::Value(name), Argument::Value(Value::text(""))];
        let value = match u.int_in_range(0..=3)? {
            0 => u.arbitrary()?,
            1 => Value::R4(f32::from(u.arbitrary::<i16>()?).to_bits()),
            _ => Value::I4(u.arbitrary()?),
        };
        Ok([
            Call::new(FunctionId::CONTROLLER_GET_VARIABLE, open),
            Call::new(FunctionId::VARIABLE_PUT_VALUE, vec![Argument::Handle(Object::Variable), Argument::Value(value)]),
        ])
    }

    /// Generates calls that open an object, release it, and use it again.
    fn stale(&self, u: &mut Unstructured<'_>) -> Result<Vec<Call>> {
        let object = *u.choose(&[Object::Robot, Object::Task, Object::Variable, Object::File])?;
        let on_object = |function: &&FunctionId| {
            function.signature().is_some_and(|signature| signature.arguments.first() == Some(&Kind::Handle(object)))
        };
        let functions: Vec<_> = self.functions.iter().filter(on_object).collect();
        let (Some(open), false) = (self.open(object, u)?, functions.is_empty()) else { return Ok(Vec::new()) };
        let function = **u.choose(&functions)?;
        let kinds = function.signature().map_or(&[][..], |signature| signature.arguments);
        let mut again = Call::new(function, vec![Argument::Released(object)]);
        for (place, kind) in kinds.iter().enumerate().skip(1) {
            again.arguments.push(self.argument(function, place, *kind, u)?);
        }
        Ok(vec![open, Call::new(object.released_by(), vec![Argument::Handle(object)]), again])
    }

    /// Generates the call that opens an object by its name on the controller.
    fn open(&self, object: Object, u: &mut Unstructured<'_>) -> Result<Option<Call>> {
        let function = object.opened_from(Object::Controller).filter(|open| self.functions.contains(open));
        let Some(function) = function else { return Ok(None) };
        let name = Argument::Value(Value::text(u.choose(&self.names)?));
        let option = Argument::Value(Value::text(""));
        Ok(Some(Call::new(function, vec![Argument::Handle(Object::Controller), name, option])))
    }

    /// Generates a call: mostly valid, sometimes with one fault.
    ///
    /// # Errors
    ///
    /// When the bytes do not suffice.
    pub fn call(&self, u: &mut Unstructured<'_>) -> Result<Call> {
        let function = *u.choose(&self.functions)?;
        let kinds = function.signature().map_or(&[][..], |signature| signature.arguments);
        let mut call = Call::new(function, Vec::new());
        for (place, kind) in kinds.iter().enumerate() {
            call.arguments.push(self.argument(function, place, *kind, u)?);
        }
        if u.ratio(2, 5)? {
            self.spoil(&mut call, u)?;
        }
        call.serial = match u.int_in_range(0..=31)? {
            0 => Some(*u.choose(&[0, 1, 0x7fff, 0x8000, 0xfffe, 0xffff])?),
            _ => None,
        };
        call.is_retry = u.ratio(1, 16)?;
        call.delivery = match u.int_in_range(0..=15)? {
            0 => Delivery::Split(u.int_in_range(1..=40)?),
            1 | 2 if self.datagrams => Delivery::Again,
            1 => Delivery::Joined,
            _ => Delivery::Whole,
        };
        Ok(call)
    }

    fn argument(&self, function: FunctionId, place: usize, kind: Kind, u: &mut Unstructured<'_>) -> Result<Argument> {
        Ok(Argument::Value(match kind {
            Kind::Handle(object) => return Ok(Argument::Handle(object)),
            Kind::Int => Value::I4(u.int_in_range(-2..=16)?),
            Kind::Float => Value::R4(f32::from(u.arbitrary::<i8>()?).to_bits()),
            Kind::Text => self.text(function, place, u)?,
            Kind::Any | Kind::Maybe | Kind::Nothing => match u.int_in_range(0..=3)? {
                0 => Value::Empty,
                1 => Value::I4(u.int_in_range(0..=16)?),
                2 => Value::text(u.choose(&self.names)?),
                _ => u.arbitrary()?,
            },
        }))
    }

    fn text(&self, function: FunctionId, place: usize, u: &mut Unstructured<'_>) -> Result<Value> {
        let commands: Vec<_> = self.commands.iter().filter(|(owner, _)| *owner == function).collect();
        if !commands.is_empty() && place == 1 {
            return Ok(Value::text(&u.choose(&commands)?.1));
        }
        if function.argument_names().get(place) == Some(&"option") {
            return Ok(if self.options.is_empty() { Value::text("") } else { Value::text(u.choose(&self.options)?) });
        }
        Ok(match u.int_in_range(0..=15)? {
            0 => Value::Bstr((0..u.int_in_range(1..=4)?).map(|_| u.arbitrary()).collect::<Result<_>>()?),
            1 => Value::Bstr(vec![0xd800]),
            2 => Value::Bstr(vec![0x41; *u.choose(&LONG)?]),
            3 => Value::Empty,
            _ => Value::text(u.choose(&self.names)?),
        })
    }

    /// Adds one fault to a call.
    fn spoil(&self, call: &mut Call, u: &mut Unstructured<'_>) -> Result<()> {
        let place = u.choose_index(call.arguments.len().max(1))?;
        let object = *u.choose(&OBJECTS)?;
        match u.int_in_range(0..=6)? {
            0 if !self.unknown.is_empty() => call.function = *u.choose(&self.unknown)?,
            1 => drop(call.arguments.pop()),
            2 => call.arguments.push(Argument::Value(u.arbitrary()?)),
            kind => {
                let Some(argument) = call.arguments.get_mut(place) else { return Ok(()) };
                let is_handle = matches!(argument, Argument::Handle(_));
                *argument = match kind {
                    3 if is_handle => Argument::Released(object),
                    4 if is_handle => Argument::Handle(object),
                    5 if is_handle => Argument::Value(Value::I4(*u.choose(&[0, -1, i32::MAX, i32::MIN, 1000])?)),
                    _ => Argument::Value(u.arbitrary()?),
                };
            }
        }
        Ok(())
    }

    /// Generates bytes that a server must survive: false lengths and counts, deep nesting, damage, the beginning of a frame.
    ///
    /// # Errors
    ///
    /// When the bytes do not suffice.
    pub fn attack(&self, u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
        const EXTREMES: [u32; 12] =
            [0, 1, 2, 15, 0xff, 0x7fff, 0xffff, 0x1_0000, 0x0100_0001, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff];
        let code = if self.functions.is_empty() { FunctionId::SERVICE_START } else { *u.choose(&self.functions)? };
        let frame = |args: Vec<Value>| TestFrame { serial: 9, reserved: 0, code: code.0, args };
        let handle = Value::I4(u.int_in_range(0..=4)?);
        let extreme = *u.choose(&EXTREMES)?;
        if self.datagrams && u.ratio(1, 4)? {
            let letters = (*u.choose(&DATAGRAMS)? - WITHOUT_LETTERS) / 2;
            return Ok(frame(vec![handle, Value::text(&"a".repeat(letters))]).to_wire(false));
        }
        let patched = |args: Vec<Value>, place: std::ops::Range<usize>, bytes: &[u8]| {
            let mut wire = frame(args).to_wire(false);
            wire[place].copy_from_slice(bytes);
            wire
        };
        Ok(match u.int_in_range(0..=11)? {
            0 => patched(vec![handle], field::LENGTH, &extreme.to_le_bytes()),
            1 => patched(vec![handle], field::COUNT, &(extreme as u16).to_le_bytes()),
            2 => patched(vec![handle], field::ARGUMENT, &extreme.to_le_bytes()),
            3 => patched(vec![handle], field::VARTYPE, &(extreme as u16).to_le_bytes()),
            4 => patched(vec![Value::Array(3, vec![handle])], field::ELEMENTS, &extreme.to_le_bytes()),
            // the length of a string
            5 => patched(vec![Value::text("I1")], field::DATA, &extreme.to_le_bytes()),
            // an odd one
            6 => patched(vec![Value::text("I1"), handle], field::DATA, &3_u32.to_le_bytes()),
            // a wrong last byte
            7 => {
                let mut wire = frame(vec![handle]).to_wire(false);
                *wire.last_mut().expect("a frame has bytes") = u.arbitrary()?;
                wire
            }
            8 => frame(vec![nested(*u.choose(&[8_usize, 9, 16, 17, 100, 5000])?, u.arbitrary()?)]).to_wire(false),
            // an array of values without data
            9 => patched(vec![Value::Array(0, vec![])], field::ELEMENTS, &extreme.to_le_bytes()),
            10 => {
                let mut wire = frame(vec![handle, Value::text("I1")]).to_wire(false);
                wire.truncate(u.int_in_range(1..=wire.len() - 1)?);
                wire
            }
            _ => {
                let damages = (0..u.int_in_range(1..=3)?).map(|_| u.arbitrary()).collect::<Result<Vec<Damage>>>()?;
                let args = vec![handle, u.arbitrary()?, Value::text(u.choose(&self.names)?)];
                damaged(&frame(args), &damages, u.arbitrary()?)
            }
        })
    }

    /// Generates lines of RAC: mostly requests, sometimes nearly valid ones, sometimes too long or not text.
    ///
    /// # Errors
    ///
    /// When the bytes do not suffice.
    pub fn line(&self, u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
        const KINDS: [&str; 11] = ["I", "F", "D", "S", "V", "P", "J", "T", "IO", "X", ""];
        const INDICES: [&str; 8] = ["0", "1", "99", "4294967295", "4294967296", "-1", "01", "*"];
        const VALUES: [&str; 8] = ["3,1", "4,1.5", "8,text", "8195,(1,2)", "12,(12,(3,1))", "3,", "99,1", ","];
        let (kind, index) = (*u.choose(&KINDS)?, *u.choose(&INDICES)?);
        let mut line = match u.int_in_range(0..=9)? {
            0 if !self.writable.is_empty() => {
                let (kind, index) = *u.choose(&self.writable)?;
                format!("PUT:RC8:{index}:{kind}:{}", u.choose(&VALUES)?).into_bytes()
            }
            1 => format!("GET:RC8:{index}:{kind}:{}", u.choose(&VALUES)?).into_bytes(),
            2 => format!("GET:RC9:{index}:{kind}:").into_bytes(),
            3 => format!(" \tGET:RC8:{index}:{kind}:").into_bytes(),
            4 => format!("GET:RC8:{index}:{kind}").into_bytes(),
            5 => vec![*u.choose(b"G0: \x00\xff")?; *u.choose(&[1_usize, 255, 256, 257, 5000])?],
            _ => format!("GET:RC8:{}:{}:", u.int_in_range(0..=120)?, u.choose(&KINDS[..9])?).into_bytes(),
        };
        if u.ratio(1, 8)? {
            u.arbitrary::<Damage>()?.apply(&mut line);
        }
        line.push(b'\r');
        Ok(line)
    }
}

/// VARIANTs in VARIANTs, as arrays or as scalars.
fn nested(depth: usize, as_arrays: bool) -> Value {
    // a tree of this depth would overflow the stack of its encoder, so the bytes are repeated
    let header = if as_arrays { ARRAY | VARIANT } else { VARIANT };
    let level = [&header.to_le_bytes()[..], &1_u32.to_le_bytes()].concat();
    let bytes = [level.repeat(depth), Value::I4(1).to_wire()].concat();
    Value::Opaque(header, bytes[2..].to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::bytes;

    #[test]
    fn long_datagrams_have_their_lengths() {
        let grammar = Grammar { datagrams: true, ..Grammar::reading() };
        let attack = |seed| grammar.attack(&mut Unstructured::new(&bytes(seed, 256))).map_or(0, |bytes| bytes.len());
        let lengths: std::collections::BTreeSet<_> = (0..2000).map(attack).collect();
        for length in DATAGRAMS {
            assert!(lengths.contains(&length), "{length}: {lengths:?}");
        }
    }
}
