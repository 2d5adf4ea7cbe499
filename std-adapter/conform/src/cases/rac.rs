//! RAC: lines and their answers.

use bcap_core::hresult::HResult;

use crate::bench::{Bench, Stop, fail, skip};
use crate::case::Setup::Rac;
use crate::case::{Body, Case, Group, Level, LineWant, Step, case, steps};
use crate::line::{answer, ask, check_answer, connect};

const fn line(name: &'static str, source: &'static str, rule: &'static str, table: &'static [Step]) -> Case {
    case(Group::Rac, name, source, rule, Rac, steps(table))
}

const fn run(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    run: fn(&mut Bench<'_>) -> Result<(), Stop>,
) -> Case {
    case(Group::Rac, name, source, rule, Rac, Body::Run(run))
}

const INVALID: LineWant = LineWant::Refused;
const I4: LineWant = LineWant::Type(3, 0);

/// A written value is read back: the value, and the two lines.
macro_rules! put {
    ($name:literal, $source:literal, $kind:literal, $value:literal, $answer:literal) => {
        run($name, $source, "PUT sets a variable, and GET reads it", |bench| put_and_get(bench, $kind, $value, $answer))
            .at(Level::Write)
    };
}

pub(super) const CASES: &[Case] = &[
    line("get-i", "RAC specification, section 4.1", "GET of I answers type 3", &[Step::Line("GET:RC8:1:I:\r", I4)]),
    line(
        "get-f",
        "RAC specification, section 4.1",
        "GET of F answers type 4",
        &[Step::Line("GET:RC8:1:F:\r", LineWant::Type(4, 0))],
    ),
    line(
        "get-d",
        "RAC specification, section 4.1",
        "GET of D answers type 5",
        &[Step::Line("GET:RC8:1:D:\r", LineWant::Type(5, 0))],
    ),
    line(
        "get-s",
        "RAC specification, section 4.1",
        "GET of S answers type 8",
        &[Step::Line("GET:RC8:1:S:\r", LineWant::Type(8, 0))],
    ),
    line(
        "get-v",
        "RAC specification, section 4.1",
        "GET of V answers 3 numbers of type 8196",
        &[Step::Line("GET:RC8:1:V:\r", LineWant::Type(4, 3))],
    ),
    line(
        "get-p",
        "RAC specification, section 4.1",
        "GET of P answers 7 numbers of type 8196",
        &[Step::Line("GET:RC8:1:P:\r", LineWant::Type(4, 7))],
    ),
    line(
        "get-j",
        "RAC specification, section 4.1",
        "GET of J answers 8 numbers of type 8196",
        &[Step::Line("GET:RC8:1:J:\r", LineWant::Type(4, 8))],
    ),
    line(
        "get-t",
        "RAC specification, section 4.1",
        "GET of T answers 10 numbers of type 8196",
        &[Step::Line("GET:RC8:1:T:\r", LineWant::Type(4, 10))],
    ),
    line(
        "get-io",
        "RAC specification, section 4.1",
        "GET of IO answers type 11",
        &[Step::Line("GET:RC8:128:IO:\r", LineWant::Type(11, 0))],
    ),
    line(
        "blank-at-the-head",
        "RAC specification, section 2.1.1",
        "blanks at the head of a line are ignored",
        &[Step::Line("  GET:RC8:1:I:\r", I4)],
    ),
    line(
        "tab-at-the-head",
        "RAC specification, section 2.1.1",
        "a TAB at the head of a line is ignored",
        &[Step::Line("\tGET:RC8:1:I:\r", I4)],
    ),
    run("empty-line", "beyond the specification", "an empty line is E_INVALIDCOMMAND", |bench| {
        beyond(crate::line::check(bench, "\r", INVALID))
    }),
    line(
        "unknown-command",
        "RAC specification, Table 2-3",
        "only GET and PUT are commands",
        &[Step::Line("SET:RC8:1:I:\r", LineWant::Code(&[HResult::E_INVALIDCOMMAND]))],
    ),
    line(
        "words",
        "RAC specification, Table 2-3",
        "a line that is no command is E_INVALIDCOMMAND",
        &[Step::Line("HELLO\r", LineWant::Code(&[HResult::E_INVALIDCOMMAND]))],
    ),
    line("other-part", "RAC specification, section 2.1.2", "the part is RC8", &[Step::Line("GET:RC9:1:I:\r", INVALID)]),
    line(
        "unknown-kind",
        "RAC specification, section 2.1.2",
        "the kinds of variables are I F D S V P J T IO",
        &[Step::Line("GET:RC8:1:X:\r", INVALID)],
    ),
    line(
        "no-kind",
        "RAC specification, section 2.1.2",
        "a variable has a kind",
        &[Step::Line("GET:RC8:1::\r", INVALID)],
    ),
    line(
        "no-index",
        "RAC specification, section 2.1.2",
        "a variable has an index",
        &[Step::Line("GET:RC8::I:\r", INVALID)],
    ),
    line(
        "index-is-a-word",
        "RAC specification, section 2.1.2",
        "an index is a number",
        &[Step::Line("GET:RC8:x:I:\r", INVALID)],
    ),
    line(
        "index-negative",
        "RAC specification, section 2.1.2",
        "an index is not negative",
        &[Step::Line("GET:RC8:-1:I:\r", INVALID)],
    ),
    line(
        "index-too-large",
        "RAC specification, section 2.1.2",
        "an index above the last one is refused",
        &[Step::Line("GET:RC8:99999999:I:\r", INVALID)],
    ),
    line(
        "index-wraps",
        "RAC specification, section 2.1.2",
        "an index does not wrap at 32 bits",
        &[Step::Line("GET:RC8:4294967297:I:\r", INVALID)],
    ),
    line(
        "too-few-colons",
        "RAC specification, section 2.1.2",
        "a request has four colons",
        &[Step::Line("GET:RC8:1\r", INVALID)],
    ),
    line(
        "257-bytes",
        "RAC specification, section 2.1.1",
        "a command has at most 256 bytes",
        &[Step::Line(LONG, INVALID)],
    ),
    line(
        "put-without-value",
        "RAC specification, section 2.1.2",
        "PUT has a value",
        &[Step::Line("PUT:RC8:{n}:I:\r", INVALID)],
    )
    .at(Level::Write),
    line(
        "put-of-a-word",
        "RAC specification, Table 2-3",
        "the data of type 3 is a number",
        &[Step::Line("PUT:RC8:{n}:I:3,x\r", INVALID)],
    )
    .at(Level::Write),
    line(
        "put-too-large",
        "RAC specification, Table 2-3",
        "a number has to fit its type",
        &[Step::Line("PUT:RC8:{n}:I:3,2147483648\r", INVALID)],
    )
    .at(Level::Write),
    line(
        "put-of-unknown-type",
        "RAC specification, Table 2-1",
        "type 99 does not exist",
        &[Step::Line("PUT:RC8:{n}:I:99,1\r", INVALID)],
    )
    .at(Level::Write),
    line(
        "put-of-text-to-i",
        "RAC specification, Table 2-3",
        "a value of another type is refused",
        &[Step::Line("PUT:RC8:{n}:I:8,abc\r", INVALID)],
    )
    .at(Level::Write),
    line(
        "put-of-short-array",
        "RAC specification, section 4.2",
        "P has 7 elements",
        &[Step::Line("PUT:RC8:{n}:P:8196,1,2\r", INVALID)],
    )
    .at(Level::Write),
    line(
        "put-to-unknown-kind",
        "RAC specification, section 2.1.2",
        "the kinds of variables are I F D S V P J T IO",
        &[Step::Line("PUT:RC8:{n}:X:3,1\r", INVALID)],
    )
    .at(Level::Write),
    put!("put-i", "RAC specification, section 4.2", "I", "3,-123", "0,3,-123"),
    put!("put-f", "RAC specification, section 4.2", "F", "4,123.01", "0,4,123.01"),
    put!("put-d", "RAC specification, section 4.2", "D", "5,0.1", "0,5,0.1"),
    put!("put-s", "RAC specification, section 4.2", "S", "8,Test", "0,8,Test"),
    put!("put-v", "RAC specification, section 4.2", "V", "8196,1,2,3", "0,8196,1,2,3"),
    put!("put-p", "RAC specification, section 4.2", "P", "8196,1,2,3,4,5,6,-1", "0,8196,1,2,3,4,5,6,-1"),
    put!("put-j", "RAC specification, section 4.2", "J", "8196,1,2,3,4,5,6,7,8", "0,8196,1,2,3,4,5,6,7,8"),
    put!("put-t", "RAC specification, section 4.2", "T", "8196,1,2,3,4,5,6,7,8,9,-1", "0,8196,1,2,3,4,5,6,7,8,9,-1"),
    put!("put-with-blanks", "RAC specification, section 4.2", "I", "3, 77", "0,3,77"),
    put!("put-string-with-commas", "RAC specification, section 2.2", "S", "8,Sample,Test", "0,8,Sample,Test"),
    run("error-then-answer", "RAC specification, section 3.1", "an error does not end the session", error_then_answer),
    run("two-lines-at-once", "beyond the specification", "each line is answered once, in order", |bench| {
        beyond(two_lines(bench))
    }),
    run("line-in-pieces", "RAC specification, section 3.1", "a line may arrive in pieces", pieces),
    run("pause-within-a-line", "RAC specification, section 3.1", "a pause within a line loses nothing", pause),
    run("line-feed-is-no-end", "RAC specification, section 2.1.3", "a line ends with CR, not with LF", line_feed),
    run(
        "half-a-line-and-the-end",
        "RAC specification, section 3.2",
        "a connection that ends within a line does not disturb others",
        half_a_line,
    ),
    run("two-sessions", "RAC specification, section 3.1", "two sessions work at the same time", two_sessions),
];

/// A GET with blanks in it, 257 bytes in all.
const LONG: &str = concat!(
    "GET:RC8:1:I:",
    "                                                                                                    ",
    "                                                                                                    ",
    "                                            ",
    "\r"
);

const GET: &str = "GET:RC8:1:I:\r";

/// Whether an error of the first PUT says that the device lets nothing be written.
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
    let put = ask(bench, &mut wire, &format!("PUT:RC8:{index}:{kind}:{value}\r"))?;
    if is_read_only(&put) {
        return skip(format!("{kind}{index} cannot be written: {put}"));
    }
    let after = ask(bench, &mut wire, &get)?;
    let restored = ask(bench, &mut wire, &format!("PUT:RC8:{index}:{kind}:{old}\r"))?;
    check_answer(&put, LineWant::Done)?;
    let compact = after.replace(", ", ",");
    if compact != wanted {
        return fail(format!("{wanted:?}"), after);
    }
    check_answer(&restored, LineWant::Done)
}

/// Turns a failure into a skip, because the specification does not ask for the reaction.
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
