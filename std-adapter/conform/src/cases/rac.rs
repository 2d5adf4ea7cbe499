//! RAC: lines and their answers.

use bcap_core::hresult::HResult;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::{LineWant, Run};
use crate::line::{answer, ask, check_answer, connect, restore, with_restored};

const I4: LineWant = LineWant::Type(3, 0);
/// The cases of `rac.cases` that are functions.
pub(super) const FUNCTIONS: &[(&str, Run)] = &[
    ("empty-line", |bench| beyond(crate::line::check(bench, "\r", LineWant::Refused))),
    ("put-i", |bench| put_and_get(bench, "I", "3,-123", "0,3,-123")),
    ("put-f", |bench| put_and_get(bench, "F", "4,123.01", "0,4,123.01")),
    ("put-d", |bench| put_and_get(bench, "D", "5,0.1", "0,5,0.1")),
    ("put-s", |bench| put_and_get(bench, "S", "8,Test", "0,8,Test")),
    ("put-v", |bench| put_and_get(bench, "V", "8196,1,2,3", "0,8196,1,2,3")),
    ("put-p", |bench| put_and_get(bench, "P", "8196,1,2,3,4,5,6,-1", "0,8196,1,2,3,4,5,6,-1")),
    ("put-j", |bench| put_and_get(bench, "J", "8196,1,2,3,4,5,6,7,8", "0,8196,1,2,3,4,5,6,7,8")),
    ("put-t", |bench| put_and_get(bench, "T", "8196,1,2,3,4,5,6,7,8,9,-1", "0,8196,1,2,3,4,5,6,7,8,9,-1")),
    ("put-with-blanks", |bench| put_and_get(bench, "I", "3, 77", "0,3,77")),
    ("put-string-with-commas", |bench| put_and_get(bench, "S", "8,Sample,Test", "0,8,Sample,Test")),
    ("error-then-answer", error_then_answer),
    ("two-lines-at-once", |bench| beyond(two_lines(bench))),
    ("line-in-pieces", pieces),
    ("pause-within-a-line", pause),
    ("line-feed-is-no-end", line_feed),
    ("half-a-line-and-the-end", half_a_line),
    ("two-sessions", two_sessions),
];

const GET: &str = "GET:RC8:1:I:\r";

/// Returns whether an error of the first PUT means that the device does not allow writes.
fn is_read_only(answer: &str) -> bool {
    let denied = [HResult::E_ACCESSDENIED, HResult::E_CAO_OBJECT_NOTFOUND, HResult::DISP_E_BADINDEX];
    denied.iter().any(|code| answer == code.0.to_string())
}

fn put_and_get(bench: &mut Bench<'_>, kind: &str, value: &str, wanted: &str) -> Result<(), Stop> {
    bench.save_over_bcap(kind)?;
    let mut wire = connect(bench)?;
    let index = bench.options.scratch;
    let get = format!("GET:RC8:{index}:{kind}:\r");
    let before = ask(bench, &mut wire, &get)?;
    let Some(old) = before.strip_prefix("0,") else { return skip(format!("{kind}{index}: {before}")) };
    let put = ask(bench, &mut wire, &format!("PUT:RC8:{index}:{kind}:{value}\r"));
    if let Ok(answer) = &put
        && is_read_only(answer)
    {
        return skip(format!("{kind}{index} cannot be written: {answer}"));
    }
    // a PUT without an answer may have written the variable too
    let answers = put.and_then(|put| Ok((put, ask(bench, &mut wire, &get)?)));
    let wire = answers.is_ok().then_some(wire);
    let restored = restore(bench, wire, &format!("PUT:RC8:{index}:{kind}:{old}\r"));
    with_restored(answers.and_then(|(put, after)| check_put(&put, after, wanted)), restored)
}

/// Checks the answers of a PUT and of the GET after it.
fn check_put(put: &str, after: String, wanted: &str) -> Result<(), Stop> {
    check_answer(put, LineWant::Done)?;
    match after.replace(", ", ",") == wanted {
        true => Ok(()),
        false => fail(format!("{wanted:?}"), after),
    }
}

/// Turns a failure into a skip, because the specification does not require the reaction.
fn beyond(result: Result<(), Stop>) -> Result<(), Stop> {
    match result {
        Err(Stop::Fail { expected, came }) => {
            skip(format!("beyond the specification: {expected} is usual, but this came: {came}"))
        }
        other => other,
    }
}

fn error_then_answer(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut wire = connect(bench)?;
    let refused = ask(bench, &mut wire, "HELLO\r")?;
    check_answer(&refused, LineWant::Refused)?;
    let answer = ask(bench, &mut wire, GET)?;
    check_answer(&answer, I4)
}

fn two_lines(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut wire = connect(bench)?;
    let first = ask(bench, &mut wire, "HELLO\rGET:RC8:1:I:\r")?;
    check_answer(&first, LineWant::Refused)?;
    let second = answer(bench, &mut wire)?;
    check_answer(&second, I4)
}

/// Sends a line in two parts.
fn parts(bench: &mut Bench<'_>, at: usize, pause: std::time::Duration) -> Result<(), Stop> {
    let mut wire = connect(bench)?;
    bench.log.push(format!("-> {:?}, then the rest", &GET[..at]));
    if let Err(error) = wire.send(&GET.as_bytes()[..at]) {
        return fail("the device receives the line", error.to_string());
    }
    std::thread::sleep(pause);
    let answer = ask(bench, &mut wire, &GET[at..])?;
    check_answer(&answer, I4)
}

fn pieces(bench: &mut Bench<'_>) -> Result<(), Stop> {
    [1, 5, 9, 12].iter().try_for_each(|at| parts(bench, *at, std::time::Duration::from_millis(20)))
}

fn pause(bench: &mut Bench<'_>) -> Result<(), Stop> {
    parts(bench, 6, std::time::Duration::from_millis(500))
}

fn line_feed(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut wire = connect(bench)?;
    // the device sees one line with a LF in it
    let answer = ask(bench, &mut wire, "GET:RC8:1:I:\nGET:RC8:1:F:\r")?;
    check_answer(&answer, LineWant::Refused)
}

fn half_a_line(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let mut wire = connect(bench)?;
    if let Err(error) = wire.send(b"GET:RC8:") {
        return fail("the device receives the line", error.to_string());
    }
    drop(wire);
    let mut wire = connect(bench)?;
    let answer = ask(bench, &mut wire, GET)?;
    check_answer(&answer, I4)
}

fn two_sessions(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let (mut first, mut second) = (connect(bench)?, connect(bench)?);
    for _ in 0..3 {
        let answer = ask(bench, &mut first, GET)?;
        check_answer(&answer, I4)?;
        let answer = ask(bench, &mut second, "HELLO\r")?;
        check_answer(&answer, LineWant::Refused)?;
    }
    Ok(())
}
