//! Reads the tables of cases, `*.cases` in this folder.
//!
//! ```text
//! # a comment
//! NAME | SETUP [write|motion] [tcp|udp] [rc8] [rc9] [cobotta] [cobotta-pro] | SOURCE | RULE
//!     call Variable_GetValue @A -> I4              a function that the device does not have skips the case
//!     must Service_Start "WDT=400" -> void         a function that every device has
//!     open A Controller_GetVariable @Controller "I1" ""     keeps the handle as @A
//!     differ A B                                   two handles differ
//!     edit serial=5 last=05 -> refused             a changed Service_Start
//!     pieces 1 2                                   Service_Start in pieces of these lengths, and the rest
//!     copy                                         the last request with another serial
//!     duplicate                                    the last request again
//!     reconnect, reconnect controller, connect     another session; with the controller; the controller once more
//!     save I                                       restores the scratch variable of this kind after the case
//!     line "GET:RC8:1:I:\r" -> I4                  a line of RAC
//!     other STEP                                   the step of another client, in a new session
//!     here, slvmove -> R8[8]                       keeps the present joints; sends them as a pose of Slave Mode
//! ```
//!
//! Functions and values are written as in the steps of `bcap-testkit`; `@A:UI4` sends a handle as UI4, and `{n}` in a text is
//! the index of the scratch variables. After `->` follows the required reply: `ok`, `void`, a type as `I4`, `R4[7]` or
//! `BSTR[]`, `= 3,77` a value, `E_HANDLE|83501024` codes, `refused` any error. The bytes of an edit are pairs of digits;
//! `41*590` repeats them, and `+` joins parts. A case without steps is a function in the Rust file of its group.

use std::borrow::Cow;

use bcap_core::hresult::HResult;
use bcap_core::variant::VarType;
use bcap_testkit::step::{function, unhex, unquote, value, words};
use bcap_testkit::text;
use bcap_testkit::wire::Link;

use crate::case::{Arg, Body, Case, Edit, Group, Level, LineWant, Model, Reaction, Run, Setup, Slot, Step, Want};

/// Reads the cases of a group, whose functions are those of the cases without steps.
///
/// # Panics
///
/// When a line is wrong; tests read all tables.
pub(super) fn read(group: Group, text: &'static str, functions: &[(&str, Run)]) -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.is_empty() && !line.starts_with('#')) {
        let read = match (line.strip_prefix("    "), cases.last_mut()) {
            (Some(line), Some(Case { body: Body::Steps(steps), .. })) => {
                step(line).map(|step| steps.to_mut().push(step))
            }
            (Some(_), _) => Err("a step without a case".into()),
            (None, _) => head(group, line).map(|case| cases.push(case)),
        };
        read.unwrap_or_else(|error| panic!("{group}.cases, line {number}: {error}"));
    }
    for case in &mut cases {
        if matches!(&case.body, Body::Steps(steps) if steps.is_empty()) {
            let run = functions.iter().find(|(name, _)| *name == case.name);
            case.body = Body::Run(run.unwrap_or_else(|| panic!("{group}/{} has no steps", case.name)).1);
        }
    }
    cases
}

fn head(group: Group, line: &'static str) -> Result<Case, String> {
    let fields: Vec<_> = line.splitn(4, " | ").collect();
    let [name, words, source, rule] = fields[..] else { return Err(format!("{line:?} is no case")) };
    let (setup, options) = words.split_once(' ').unwrap_or((words, ""));
    let mut case = Case {
        name: Cow::Borrowed(name),
        group,
        level: Level::Read,
        source,
        rule,
        only: None,
        models: Vec::new(),
        setup: match setup {
            "rac" => Setup::Rac,
            "connected" => Setup::Connected,
            "started" => Setup::Started,
            "controller" => Setup::Controller,
            "robot" => Setup::Robot,
            "task" => Setup::Task,
            "arm" => Setup::Arm,
            _ => return Err(format!("{setup:?} is no setup")),
        },
        body: Body::Steps(Cow::Owned(Vec::new())),
    };
    for option in options.split_whitespace() {
        match option {
            "write" => case.level = Level::Write,
            "motion" => case.level = Level::Motion,
            "tcp" => case.only = Some(Link::Tcp),
            "udp" => case.only = Some(Link::Udp),
            _ => match Model::WORDS.iter().find(|(word, _)| *word == option) {
                Some((_, model)) => case.models.push(*model),
                None => return Err(format!("{option:?} is neither a level, nor a link, nor a model")),
            },
        }
    }
    if (group == Group::Seen) == case.models.is_empty() {
        return Err(format!("{name}: answers that were seen, and only they, have a model"));
    }
    Ok(case)
}

fn step(line: &'static str) -> Result<Step, String> {
    if let Some(other) = line.strip_prefix("other ") {
        return Ok(Step::Other(Box::leak(Box::new(step(other)?))));
    }
    let (line, wanted) = line.rsplit_once(" -> ").map_or((line, None), |(line, wanted)| (line, Some(wanted)));
    let words = words(line)?;
    let wanted = || wanted.ok_or_else(|| format!("{line:?} needs -> and what must be replied"));
    Ok(match words[..] {
        ["call", name, ref args @ ..] => Step::Call(function(name)?, arguments(args)?, want(wanted()?)?),
        ["must", name, ref args @ ..] => Step::Must(function(name)?, arguments(args)?, want(wanted()?)?),
        ["open", place, name, ref args @ ..] => Step::Open(slot(place)?, function(name)?, arguments(args)?),
        ["differ", a, b] => Step::Differ(slot(a)?, slot(b)?),
        ["edit", ref edits @ ..] => {
            let edits = edits.iter().map(|word| edit(word)).collect::<Result<Vec<_>, _>>()?;
            Step::Edited(edits.leak(), reaction(wanted()?)?)
        }
        ["pieces", ref sizes @ ..] => {
            let sizes = sizes.iter().map(|word| repeated(word)).collect::<Result<Vec<_>, _>>()?.concat();
            Step::Pieces(sizes.leak())
        }
        ["copy"] => Step::Copy { renumbered: true },
        ["duplicate"] => Step::Copy { renumbered: false },
        ["reconnect"] => Step::Reconnect,
        ["reconnect", "controller"] => Step::ReconnectController,
        ["connect"] => Step::ConnectController,
        ["save", kind] => Step::Save(kind),
        ["here"] => Step::Here,
        ["slvmove"] => Step::SlvMove(want(wanted()?)?),
        ["line", line] => Step::Line(unquote(line)?.leak(), line_want(wanted()?)?),
        _ => return Err(format!("{line:?} is no step")),
    })
}

/// The tables are read once, so their parts may be static.
fn arguments(words: &[&'static str]) -> Result<&'static [Arg], String> {
    let args = words.iter().map(|word| argument(word)).collect::<Result<Vec<_>, String>>()?;
    Ok(args.leak())
}

fn argument(word: &'static str) -> Result<Arg, String> {
    if let Some(place) = word.strip_prefix('@') {
        return Ok(match place.strip_suffix(":UI4") {
            Some(place) => Arg::Unsigned(slot(place)?),
            None => Arg::H(slot(place)?),
        });
    }
    if word.starts_with('"') {
        let text: &'static str = unquote(word)?.leak();
        return Ok(text.strip_suffix("{n}").map_or(Arg::S(text), Arg::Scratch));
    }
    value(word).map(|_| Arg::V(word))
}

fn slot(name: &str) -> Result<Slot, String> {
    Ok(match name {
        "Controller" => Slot::Controller,
        "Robot" => Slot::Robot,
        "Task" => Slot::Task,
        "A" => Slot::A,
        "B" => Slot::B,
        _ => return Err(format!("{name:?} keeps no handle")),
    })
}

fn want(text: &'static str) -> Result<Want, String> {
    Ok(match text {
        "ok" => Want::Ok,
        "void" => Want::NoValue,
        "refused" => Want::Refused,
        _ => match (text.strip_prefix("= "), vartype(text)) {
            (Some(text), _) => text::parse(text.as_bytes()).map(|_| Want::Value(text)).ok_or("no value after =")?,
            (None, Some((vartype, None))) => Want::Type(vartype),
            (None, Some((element, Some(count)))) => Want::Array(element, count),
            (None, None) => Want::Code(codes(text)?),
        },
    })
}

fn line_want(text: &str) -> Result<LineWant, String> {
    Ok(match text {
        "void" => LineWant::Done,
        "refused" => LineWant::Refused,
        _ => match vartype(text) {
            Some((vartype, count)) => LineWant::Type(vartype, count.unwrap_or(0)),
            None => LineWant::Code(codes(text)?),
        },
    })
}

/// Parses a type as `I4` or `R4[7]`; 0 is any number of elements.
fn vartype(text: &str) -> Option<(u16, Option<usize>)> {
    let (name, count) = match text.split_once('[') {
        Some((name, count)) => (name, Some(count.strip_suffix(']')?)),
        None => (text, None),
    };
    let is_named = |vartype: &u16| VarType(*vartype).name().and_then(|known| known.strip_prefix("VT_")) == Some(name);
    let count = match count {
        Some("") => Some(0),
        Some(count) => Some(count.parse().ok()?),
        None => None,
    };
    (0..=21).find(is_named).map(|vartype| (vartype, count))
}

fn codes(text: &str) -> Result<&'static [HResult], String> {
    let number =
        |digits: &str| u32::from_str_radix(digits, 16).ok().filter(|_| digits.len() == 8).map(HResult::from_u32);
    let code = |name| {
        HResult::from_name(name)
            .or_else(|| number(name))
            .ok_or_else(|| format!("{name:?} is neither a type nor a code"))
    };
    let codes = text.split('|').map(code).collect::<Result<Vec<_>, _>>()?;
    Ok(codes.leak())
}

fn reaction(text: &str) -> Result<Reaction, String> {
    Ok(match text {
        "served" => Reaction::Served,
        "refused" => Reaction::Refused,
        "ends" => Reaction::Ends,
        "resync" => Reaction::Resync,
        _ => return Err(format!("{text:?} is no reaction")),
    })
}

fn edit(word: &str) -> Result<Edit, String> {
    let (name, text) = word.split_once('=').ok_or_else(|| format!("{word:?} is no edit"))?;
    Ok(match name {
        "function" => Edit::Function(function(text)?),
        "body" => {
            let (count, text) = text.split_once(':').ok_or("a body has a number and bytes")?;
            Edit::Body(number(count)?, bytes(text)?)
        }
        "byte" => {
            let (at, value) = text.split_once(':').ok_or("a byte has a place and a value")?;
            Edit::Byte(number(at)?, byte(value)?)
        }
        "last" => Edit::Last(byte(text)?),
        "length" => Edit::Length(number(text)?),
        "longer" => Edit::Longer(number(text)?),
        "count" => Edit::Count(number(text)?),
        "reserved" => Edit::Reserved(number(text)?),
        "serial" => Edit::Serial(number(text)?),
        "before" => Edit::Before(bytes(text)?),
        "after" => Edit::After(bytes(text)?),
        "cut" => Edit::Cut(number(text)?),
        "nested" => Edit::Nested(number(text)?),
        _ => return Err(format!("{name:?} is no edit")),
    })
}

fn number<N: std::str::FromStr>(text: &str) -> Result<N, String> {
    text.parse().map_err(|_| format!("{text:?} is no number of this field"))
}

fn byte(text: &str) -> Result<u8, String> {
    u8::from_str_radix(text, 16).map_err(|_| format!("{text:?} is no byte"))
}

/// Parses parts such as `0a00+41*590`.
fn bytes(text: &str) -> Result<&'static [u8], String> {
    let part = |part: &str| match part.split_once('*') {
        Some((digits, times)) => Ok(unhex(digits)?.repeat(number(times)?)),
        None => unhex(part),
    };
    let parts = text.split('+').map(part).collect::<Result<Vec<_>, String>>()?;
    Ok(parts.concat().leak())
}

/// Parses `5`, or `1*42` for 42 times 1.
fn repeated(word: &str) -> Result<Vec<usize>, String> {
    let (size, times) = word.split_once('*').unwrap_or((word, "1"));
    Ok(vec![number(size)?; number(times)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_without_a_meaning_are_refused() {
        let is_read = |case: &'static str| {
            std::panic::catch_unwind(|| read(Group::Frames, case, &[])).is_ok_and(|cases| cases.len() == 1)
        };
        assert!(is_read("a | connected write | source | rule\n    call Service_Start \"x -> y\" 3,1 -> void"));
        for wrong in [
            "a | connected | source\n    copy",
            "a | joined | source | rule\n    copy",
            "a | connected everything | source | rule\n    copy",
            "a | connected | source | rule",
            "    copy",
            "a | connected | source | rule\n    paste",
            "a | connected | source | rule\n    call Service_None -> void",
            "a | connected | source | rule\n    call Service_Start",
            "a | connected | source | rule\n    call Service_Start -> viod",
            "a | connected | source | rule\n    call Service_Start -> I4[x]",
            "a | connected | source | rule\n    call Service_Start -> = 3,x",
            "a | connected | source | rule\n    call Service_Start 3,x -> void",
            "a | connected | source | rule\n    call Service_Start \"x -> void",
            "a | connected | source | rule\n    call Service_Start @C -> void",
            "a | connected | source | rule\n    edit serial=65536 -> served",
            "a | connected | source | rule\n    edit serail=1 -> served",
            "a | connected | source | rule\n    edit last=5g -> served",
            "a | connected | source | rule\n    edit last=05 -> serve",
        ] {
            assert!(!is_read(wrong), "{wrong}");
        }
    }
}
