//! Cases of RAC: a line, and the answer to it.

use std::io::Write as _;
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_core::rac::{Response, VariableKind};
use bcap_core::variant::VarType;

use crate::bench::{Bench, Stop, fail, skip};
use crate::language::LineWant;
use crate::wire::read_until;

/// The end of a line.
const CR: u8 = b'\r';

/// A connection that speaks RAC.
pub(crate) struct LineWire {
    stream: TcpStream,
    received: Vec<u8>,
    limit: Duration,
}

impl LineWire {
    pub(crate) fn connect(address: SocketAddr, limit: Duration) -> std::io::Result<Self> {
        let stream = TcpStream::connect_timeout(&address, limit)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(limit))?;
        Ok(Self { stream, received: Vec::new(), limit })
    }

    pub(crate) fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.stream.write_all(bytes)
    }

    /// Reads an answer without its CR; `Err` says what came instead.
    pub(crate) fn answer(&mut self) -> Result<String, String> {
        let until = Instant::now() + self.limit;
        loop {
            if let Some(end) = self.received.iter().position(|byte| *byte == CR) {
                let line: Vec<u8> = self.received.drain(..=end).collect();
                return Ok(String::from_utf8_lossy(&line[..end]).into_owned());
            }
            let mut buffer = [0; 1024];
            match read_until(&mut self.stream, &mut buffer, until) {
                Ok(Some(0)) | Err(_) => return Err("the device closed the connection".into()),
                Ok(Some(count)) => self.received.extend_from_slice(&buffer[..count]),
                Ok(None) => return Err("no answer within the time limit".into()),
            }
        }
    }
}

/// Connects to the RAC port; a device without one skips the case.
pub(crate) fn connect(bench: &mut Bench<'_>) -> Result<LineWire, Stop> {
    let Some(address) = bench.options.target.rac else { return skip("the address of RAC is not given") };
    match LineWire::connect(address, bench.options.timeout) {
        Ok(wire) => Ok(wire),
        Err(error) => skip(format!("no connection to RAC at {address}: {error}")),
    }
}

/// Sends a line and returns its answer.
pub(crate) fn ask(bench: &mut Bench<'_>, wire: &mut LineWire, line: &str) -> Result<String, Stop> {
    bench.log.push(format!("-> {}", line.escape_debug()));
    let answer = wire.send(line.as_bytes()).map_err(|error| error.to_string()).and_then(|()| wire.answer());
    match answer {
        Ok(answer) => {
            bench.log.push(format!("<- {}", answer.escape_debug()));
            Ok(answer)
        }
        Err(why) => fail("an answer that ends with CR", why),
    }
}

/// Sends a line on a connection of its own, and checks the answer. `{n}` is the scratch index; a PUT to it saves the variable
/// before.
pub(crate) fn check(bench: &mut Bench<'_>, line: &str, want: LineWant) -> Result<(), Stop> {
    if let Some(kind) = line.strip_prefix("PUT:RC8:{n}:").and_then(|rest| rest.split(':').next())
        && VariableKind::from_name(kind).is_some()
    {
        bench.save_over_bcap(kind)?;
    }
    let mut wire = connect(bench)?;
    let line = line.replace("{n}", &bench.options.scratch.to_string());
    let answer = ask(bench, &mut wire, &line)?;
    let absent = [HResult::E_CAO_OBJECT_NOTFOUND, HResult::E_ACCESSDENIED, HResult::E_NOTIMPL, HResult::E_INVALIDARG];
    // small devices have some kinds only, and refuse the others as an invalid argument; the cases need I1
    let absent = if line.contains(":I:") { &absent[..3] } else { &absent };
    if matches!(want, LineWant::Type(..)) && absent.iter().any(|code| answer == code.0.to_string()) {
        return skip(format!("the device does not have the variable: {answer}"));
    }
    check_answer(&answer, want)
}

pub(crate) fn check_answer(answer: &str, want: LineWant) -> Result<(), Stop> {
    let mut memory = vec![0; 4096];
    let response = match Response::parse(answer.as_bytes(), &mut memory) {
        Ok(response) => response,
        Err(error) => return fail("an answer of the form RESULT[,TYPE,DATA]", format!("{answer:?}: {error}")),
    };
    let is_ok = response.result.is_ok();
    let fits = match want {
        LineWant::Type(vartype, 0) => is_ok && response.value.is_some_and(|value| value.vartype() == VarType(vartype)),
        LineWant::Type(vartype, count) => {
            let array = response.value.and_then(|value| value.as_array());
            is_ok && array.is_some_and(|array| array.element() == VarType(vartype) && array.len() == count)
        }
        LineWant::Done => is_ok && response.value.is_none(),
        LineWant::Code(codes) => codes.contains(&response.result),
        LineWant::Refused => !is_ok,
    };
    if fits { Ok(()) } else { fail(want_text(want), answer) }
}

fn want_text(want: LineWant) -> String {
    match want {
        LineWant::Type(vartype, 0) => format!("0 and a value of {}", VarType(vartype)),
        LineWant::Type(vartype, count) => format!("0 and {count} elements of {}", VarType(vartype)),
        LineWant::Done => "0 without a value".into(),
        LineWant::Code(codes) => {
            codes.iter().map(|code| format!("{} ({code})", code.0)).collect::<Vec<_>>().join(" or ")
        }
        LineWant::Refused => "an error".into(),
    }
}
