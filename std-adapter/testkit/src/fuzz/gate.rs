//! Selects the packets that a device may get, by the effects in the function table of the core.

use bcap_core::bcap::{Command, FunctionId};
use bcap_core::rac::{Request, Variable, VariableKind};

use crate::frame::{TestFrame, field};
use crate::grammar::Grammar;
use crate::step::{Argument, Step};
use crate::value::Value;

/// From this number on, no firmware has functions; lower numbers may be functions that no public source describes.
const NO_FUNCTION: i32 = 65_536;

/// Variables of one kind, from the first index to the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Range {
    /// Their kind.
    pub kind: VariableKind,
    /// The first index.
    pub first: u32,
    /// The last index.
    pub last: u32,
}

/// The packets that may be sent.
#[derive(Debug)]
pub struct Gate {
    writable: Vec<Range>,
    with_motion: bool,
}

impl Gate {
    /// Allows calls that read, writes to these variables, and any call if `with_motion`.
    #[must_use]
    pub const fn new(writable: Vec<Range>, with_motion: bool) -> Self {
        Self { writable, with_motion }
    }

    /// Returns the grammar of permitted steps. The gate checks every packet nevertheless.
    #[must_use]
    pub fn grammar(&self, provider: &str) -> Grammar {
        let named = |command: &Command| (command.function, String::from(command.name));
        let mut grammar = Grammar {
            provider: provider.into(),
            commands: commands().filter(|command| self.with_motion || is_reading(command)).map(named).collect(),
            ..Grammar::reading()
        };
        for rule in &self.writable {
            let last = rule.last.min(rule.first.saturating_add(9));
            grammar.writable.extend([rule.first, last].map(|index| (rule.kind.name(), index)));
            grammar.names.extend((rule.first..=last).map(|index| format!("{}{index}", rule.kind.name())));
        }
        if self.with_motion {
            grammar.functions = FunctionId::all().collect();
            grammar.unknown.extend([138, 200, 1000]);
            grammar.options.extend(["NEXT", "SPEED=20", "@Create"].map(String::from));
            return grammar;
        }
        grammar.functions.retain(|function| reads(function.0));
        // with an option it may create a file, which the gate refuses
        grammar.functions.push(FunctionId::CONTROLLER_GET_FILE);
        let executes = |function: &FunctionId| commands().any(|c| c.function == *function && is_reading(c));
        grammar.functions.extend(FunctionId::all().filter(executes));
        if !self.writable.is_empty() {
            grammar.functions.push(FunctionId::VARIABLE_PUT_VALUE);
        }
        grammar
    }

    /// Returns whether a call may be sent; `variable` is the name of the variable whose handle is its first argument.
    pub(super) fn has_call(&self, frame: &TestFrame, variable: Option<&str>) -> bool {
        self.with_motion || (self.has_function(frame, variable) && is_safe_inside(&frame.to_wire(false)))
    }

    fn has_function(&self, frame: &TestFrame, variable: Option<&str>) -> bool {
        let function = FunctionId(frame.code);
        if function == FunctionId::VARIABLE_PUT_VALUE {
            return variable.and_then(|name| name.parse().ok()).is_some_and(|variable| self.writes(variable));
        }
        is_no_function(frame.code) || call_reads(frame) || executes_reading(frame)
    }

    /// Returns whether bytes that are not a valid frame may be sent: no frame that a receiver may find in them calls a
    /// function that does more than read.
    pub(super) fn has_bytes(&self, bytes: &[u8]) -> bool {
        self.with_motion || (code_at(bytes, 0).is_none_or(is_safe) && is_safe_inside(bytes))
    }

    /// Returns whether bytes may be sent after `tail`, the last bytes that were sent on the connection: no frame that begins in the
    /// tail calls a function that does more than read.
    pub(super) fn has_joint(&self, tail: &[u8], bytes: &[u8]) -> bool {
        let starts = tail.len().saturating_sub(TAIL)..tail.len();
        let joint = [tail, bytes].concat();
        self.with_motion || starts.into_iter().all(|at| is_harmless_at(&joint, at))
    }

    /// Returns whether a step may be sent. Whether a write is permitted depends on the variable that is then open, so a step
    /// that writes passes if any variable may be written. It is checked again when it is sent.
    #[must_use]
    pub fn may_pass(&self, step: &Step) -> bool {
        let any = self.writable.first().map(|range| format!("{}{}", range.kind.name(), range.first));
        match step {
            Step::Call(call) => self.has_call(&call.to_frame(1, |_: &Argument| 0), any.as_deref()),
            Step::Bytes(bytes) => self.has_bytes(bytes),
            Step::Line(line) => self.has_lines(line),
            Step::Reconnect => true,
        }
    }

    /// Returns whether lines of RAC may be sent. The last line needs its CR, so that it does not continue in the next step.
    pub(super) fn has_lines(&self, lines: &[u8]) -> bool {
        let Some(lines) = lines.strip_suffix(b"\r") else { return self.with_motion };
        self.with_motion || lines.split(|byte| *byte == b'\r').all(|line| self.has_line(line))
    }

    /// Returns whether a line without its CR may be sent: it reads, it writes an allowed variable, or it cannot contain a
    /// keyword.
    fn has_line(&self, line: &[u8]) -> bool {
        let has_word = line.windows(2).any(|pair| matches!(pair, [first, second] if first != second));
        let verb = line.trim_ascii_start().get(..4).unwrap_or_default();
        if verb.eq_ignore_ascii_case(b"GET:") || !has_word {
            // a device may end a line elsewhere, so the rest must not be a request to write
            return !line.windows(3).any(|word| word.eq_ignore_ascii_case(b"PUT"));
        }
        let mut memory = [0; 1024];
        let request = Request::parse(line, &mut memory);
        verb == b"PUT:" && matches!(request, Ok(Request::Put(variable, _)) if self.writes(variable))
    }

    fn writes(&self, variable: Variable) -> bool {
        let has = |range: &Range| range.kind == variable.kind && (range.first..=range.last).contains(&variable.index);
        self.writable.iter().any(has)
    }
}

/// The number of bytes before a packet in which a receiver that lost synchronisation may see the beginning of a frame that ends
/// in the packet.
pub(super) const TAIL: usize = 12;

const fn is_no_function(code: i32) -> bool {
    code < 1 || code >= NO_FUNCTION
}

/// Returns the commands of all Execute functions.
fn commands() -> impl Iterator<Item = &'static Command> {
    FunctionId::all().flat_map(FunctionId::commands)
}

const fn is_reading(command: &Command) -> bool {
    command.properties.effect.is_harmless()
}

/// Returns whether a call executes a command that only reads.
fn executes_reading(frame: &TestFrame) -> bool {
    // a device may trim or fold a name in its own way, so the name must be exact
    let is_named = |command: &Command| frame.args.get(1) == Some(&Value::text(command.name));
    FunctionId(frame.code).commands().any(|command| is_named(command) && is_reading(command))
}

/// Returns whether a call only opens, reads or releases, so that it may be sent again while no reply arrives.
pub(super) fn call_reads(frame: &TestFrame) -> bool {
    let has_no_option = frame.args.get(2).is_none_or(|option| *option == Value::text(""));
    FunctionId(frame.code).properties(None, has_no_option.then_some("")).effect.is_harmless()
}

/// Returns whether a call of the function only reads, whatever its arguments are.
fn reads(code: i32) -> bool {
    FunctionId(code).effect().is_harmless()
}

fn is_safe(code: i32) -> bool {
    is_no_function(code) || reads(code)
}

/// Returns the code of a frame that begins at this position.
fn code_at(bytes: &[u8], at: usize) -> Option<i32> {
    bytes.get(at..).and_then(field::code)
}

/// Returns whether a receiver that lost synchronisation, and takes a later byte for the beginning of a frame, sees no known
/// function that does more than read. Numbers that no public source describes are too common among lengths and values to refuse
/// them here.
fn is_safe_inside(bytes: &[u8]) -> bool {
    (1..bytes.len()).all(|at| is_harmless_at(bytes, at))
}

/// Returns whether no frame that begins at `at` calls a known function that does more than read.
fn is_harmless_at(bytes: &[u8], at: usize) -> bool {
    const SOH: u8 = 1;
    let is_harmless = |code| is_safe(code) || FunctionId(code).signature().is_none();
    bytes.get(at) != Some(&SOH) || code_at(bytes, at).is_none_or(is_harmless)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(function: FunctionId, args: Vec<Value>) -> TestFrame {
        TestFrame { serial: 1, reserved: 0, code: function.0, args }
    }

    fn gate(writable: &[Range]) -> Gate {
        Gate::new(writable.to_vec(), false)
    }

    const I90_TO_99: Range = Range { kind: VariableKind::I, first: 90, last: 99 };

    #[test]
    fn only_calls_that_read_pass() {
        let gate = gate(&[]);
        let passes = |function, args| gate.has_call(&frame(function, args), None);
        assert!(passes(FunctionId::SERVICE_START, vec![Value::text("")]));
        assert!(passes(FunctionId::VARIABLE_GET_VALUE, vec![Value::I4(3)]));
        assert!(passes(FunctionId::ROBOT_EXECUTE, vec![Value::I4(3), Value::text("CurPos"), Value::Empty]));
        assert!(passes(FunctionId(65_536), vec![]));
        for function in FunctionId::all().filter(|function| reads(function.0)) {
            assert!(passes(function, vec![Value::I4(0)]), "{function}");
        }
        let robot = Value::I4(3);
        // commands, by the core's table
        let executes = |function, name| passes(function, vec![robot.clone(), Value::text(name), Value::Empty]);
        assert!(executes(FunctionId::CONTROLLER_EXECUTE, "GetCurErrorCount"));
        assert!(executes(FunctionId::ROBOT_EXECUTE, "GetSrvData"));
        assert!(!executes(FunctionId::ROBOT_EXECUTE, "NoSuchCommand"));
        assert!(!executes(FunctionId::CONTROLLER_EXECUTE, "KillAll"));
        // GetFile reads without its option
        let opens_file = |function: FunctionId| function.to_string().ends_with("_GetFile");
        let is_refused = |function: &FunctionId| !reads(function.0) && !opens_file(*function);
        for function in FunctionId::all().filter(is_refused) {
            assert!(!passes(function, vec![]), "{function}");
            assert!(!passes(function, vec![robot.clone(), Value::text("TakeArm"), Value::Empty]), "{function}");
        }
        assert!(!passes(FunctionId::ROBOT_MOVE, vec![robot.clone(), Value::I4(1), Value::text("P1"), Value::text("")]));
        assert!(!passes(FunctionId(138), vec![]));
        let file = |option| vec![Value::I4(1), Value::text("a"), option];
        assert!(passes(FunctionId::CONTROLLER_GET_FILE, file(Value::text(""))));
        assert!(!passes(FunctionId::CONTROLLER_GET_FILE, file(Value::text("@Create"))));
    }

    #[test]
    fn no_frame_inside_bytes_calls_a_function_that_moves() {
        let gate = gate(&[]);
        let movement = frame(FunctionId::ROBOT_MOVE, vec![Value::I4(3)]).to_wire(false);
        let read = frame(FunctionId::VARIABLE_GET_VALUE, vec![Value::I4(3)]).to_wire(false);
        assert!(gate.has_bytes(&read) && gate.has_bytes(&read[..7]));
        assert!(!gate.has_bytes(&movement));
        assert!(!gate.has_bytes(&[&[7][..], &movement].concat()));
        assert!(!gate.has_bytes(&[&[9][..], &movement[1..]].concat()), "a receiver may ignore the first byte");
        let inside = Value::Array(17, movement.iter().map(|byte| Value::Ui1(*byte)).collect());
        assert!(!gate.has_call(&frame(FunctionId::VARIABLE_GET_VALUE, vec![inside]), None));
        assert!(Gate::new(vec![], true).has_bytes(&movement));
        for at in 1..TAIL {
            assert!(!gate.has_joint(&movement[..at], &movement[at..]), "a frame in two packets, from byte {at} on");
            assert!(gate.has_joint(&read[..at], &read[at..]), "{at}");
        }
        assert!(gate.has_joint(&[], &movement), "the packet itself is checked by has_bytes");
    }

    #[test]
    fn writes_need_a_range() {
        let put = frame(FunctionId::VARIABLE_PUT_VALUE, vec![Value::I4(3), Value::I4(1)]);
        let (none, some) = (gate(&[]), gate(&[I90_TO_99]));
        assert!(!none.has_call(&put, Some("I90")));
        for (name, passes) in
            [("I90", true), ("I99", true), ("I100", false), ("F90", false), ("I*", false), ("@SPEED", false)]
        {
            assert_eq!(some.has_call(&put, Some(name)), passes, "{name}");
        }
        assert!(!some.has_call(&put, None));
        assert!(none.has_lines(b"GET:RC8:1:I:\r") && !none.has_lines(b"PUT:RC8:90:I:3,1\r"));
        assert!(some.has_lines(b"PUT:RC8:90:I:3,1\r") && !some.has_lines(b"PUT:RC8:1:I:3,1\r"));
        assert!(!some.has_lines(b"put:RC8:90:I:3,1\r"), "only a line that is certain to write the range");
        assert!(!some.has_lines(b"PUT:RC8:90:I:3,1\rPUT:RC8:1:I:3,1\r"));
        for line in [" \tGET:RC8:1:I:\r", "GET:RC8:1:I:\rGET:RC8:x:I:\r", "GGGG\r", "\r"] {
            assert!(none.has_lines(line.as_bytes()), "{line:?}");
        }
        for line in ["", "GET:RC8:1:I:", "SET:RC8:1:I:3,1\r", "GET:RC8:1:I:\nPUT:RC8:1:I:3,1\r", "RUN\r"] {
            assert!(!some.has_lines(line.as_bytes()), "{line:?}");
        }
    }

    #[test]
    fn the_calls_that_open_a_session_pass() {
        for gate in [gate(&[]), gate(&[I90_TO_99])] {
            for step in gate.grammar("CaoProv.DENSO.VRC").opening() {
                let Step::Call(call) = step else { panic!("{step}") };
                assert!(gate.has_call(&call.to_frame(1, |_| 0), None), "{call}");
            }
        }
    }
}
