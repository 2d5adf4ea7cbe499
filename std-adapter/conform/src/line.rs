//! Cases of RAC: a line, and the answer to it.

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_core::variant::VarType;
use bcap_testkit::text;
use bcap_testkit::value::Value;
use bcap_testkit::wire::{Received, Wire};

use crate::bench::{Bench, Stop, fail, skip};
use crate::language::LineWant;

/// Connects to the RAC port; a device without one skips the case.
pub(crate) fn connect(bench: &mut Bench<'_>) -> Result<Wire, Stop> {
    let Some(address) = bench.options.target.rac else { return skip("the address of RAC is not given") };
    match Wire::connect_rac(address, bench.options.timeout) {
        Ok(wire) => {
            bench.has_line = true;
            Ok(wire)
        }
        Err(error) if bench.has_line => fail(format!("{address} accepts the connection"), error.to_string()),
        Err(error) => {
            bench.has_no_line = true;
            skip(format!("no connection to RAC at {address}: {error}"))
        }
    }
}

/// Sends a line and returns its answer.
pub(crate) fn ask(bench: &mut Bench<'_>, wire: &mut Wire, line: &str) -> Result<String, Stop> {
    bench.log.push(format!("-> {}", line.escape_debug()));
    if let Err(error) = wire.send(line.as_bytes()) {
        return fail("the device receives the line", error.to_string());
    }
    answer(bench, wire)
}

/// Returns the next answer without its CR.
pub(crate) fn answer(bench: &mut Bench<'_>, wire: &mut Wire) -> Result<String, Stop> {
    let came = match wire.receive(bench.options.timeout) {
        Received::Packet(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Received::Closed => "the device closed the connection".into(),
        Received::Silence => "no answer within the time limit".into(),
    };
    match came.strip_suffix('\r') {
        Some(answer) => {
            bench.log.push(format!("<- {}", answer.escape_debug()));
            Ok(answer.into())
        }
        None => fail("an answer that ends with CR", came),
    }
}

/// Restores a variable by its PUT on the connection of the case, or on a new connection if that has failed.
pub(crate) fn restore(bench: &mut Bench<'_>, wire: Option<Wire>, put: &str) -> Result<(), Stop> {
    if let Some(wire) = wire
        && put_back(bench, wire, put).is_ok()
    {
        return Ok(());
    }
    let wire = connect(bench)?;
    put_back(bench, wire, put)
}

/// Reuses the connection, because a small device has no slot for a second one.
fn put_back(bench: &mut Bench<'_>, mut wire: Wire, put: &str) -> Result<(), Stop> {
    let answer = ask(bench, &mut wire, put)?;
    check_answer(&answer, LineWant::Done)
}

/// Adds to the result of a case that its variable was not restored.
pub(crate) fn with_restored(judged: Result<(), Stop>, restored: Result<(), Stop>) -> Result<(), Stop> {
    let lost = |came: &str| format!("{came}; the variable was not restored over RAC");
    match (judged, restored) {
        (Err(Stop::Fail { expected, came }), Err(Stop::Fail { came: end, .. })) => {
            fail(expected, format!("{}: {end}", lost(&came)))
        }
        (_, Err(Stop::Fail { expected, came })) => fail(expected, lost(&came)),
        (judged, restored) => judged.and(restored),
    }
}

/// Sends a line on a separate connection, and checks the answer. `{n}` is the scratch index; before a PUT to it the variable is
/// saved; without b-CAP it is restored if the PUT was not refused as expected.
pub(crate) fn check(bench: &mut Bench<'_>, line: &str, want: LineWant) -> Result<(), Stop> {
    let kind = line.strip_prefix("PUT:RC8:{n}:").and_then(|rest| rest.split(':').next());
    let kind = kind.filter(|kind| VariableKind::from_name(kind).is_some());
    if let Some(kind) = kind {
        bench.save_over_bcap(kind)?;
    }
    let mut wire = connect(bench)?;
    let index = bench.options.scratch;
    let line = line.replace("{n}", &index.to_string());
    let Some(kind) = kind.filter(|_| bench.saved.is_empty()) else {
        return check_on(bench, &mut wire, &line, want);
    };
    let before = ask(bench, &mut wire, &format!("GET:RC8:{index}:{kind}:\r"))?;
    let judged = check_on(bench, &mut wire, &line, want);
    // a PUT that is refused, as the case wants, changes nothing
    match before.strip_prefix("0,") {
        Some(old) if judged.is_err() => {
            drop(wire);
            let restored = restore(bench, None, &format!("PUT:RC8:{index}:{kind}:{old}\r"));
            with_restored(judged, restored)
        }
        _ => judged,
    }
}

/// Sends a line and checks its answer.
fn check_on(bench: &mut Bench<'_>, wire: &mut Wire, line: &str, want: LineWant) -> Result<(), Stop> {
    let answer = ask(bench, wire, line)?;
    let absent = [HResult::E_CAO_OBJECT_NOTFOUND, HResult::E_ACCESSDENIED, HResult::E_NOTIMPL, HResult::E_INVALIDARG];
    // small devices have only some kinds, and refuse other kinds as an invalid argument; the cases need I1
    let absent = if line.contains(":I:") { &absent[..3] } else { &absent };
    if matches!(want, LineWant::Type(..)) && absent.iter().any(|code| answer == code.0.to_string()) {
        return skip(format!("the device does not have the variable: {answer}"));
    }
    check_answer(&answer, want)
}

pub(crate) fn check_answer(answer: &str, want: LineWant) -> Result<(), Stop> {
    let Some((code, value)) = text::response(answer.as_bytes()) else {
        return fail("an answer of the form RESULT[,TYPE,DATA]", format!("{answer:?}"));
    };
    let code = HResult(code);
    let is_ok = code.is_ok();
    let fits = match want {
        LineWant::Type(vartype, 0) => is_ok && value.is_some_and(|value| value.vartype() == vartype),
        LineWant::Type(vartype, count) => {
            is_ok && matches!(value, Some(Value::Array(element, items)) if element == vartype && items.len() == count)
        }
        LineWant::Done => is_ok && value.is_none(),
        LineWant::Code(codes) => codes.contains(&code),
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
