//! Cases of each function, made of the function table (b-CAP specification, Appendix A).

use std::borrow::Cow;

use bcap_core::bcap::{Effect, FunctionId, Kind};
use bcap_core::hresult::HResult;

use crate::case::{Arg, Body, Case, Group, Level, Setup, Step, Want};

const TABLE: &str = "b-CAP specification, Appendix A";

/// A handle that no device gives out in the first hours.
const UNKNOWN: i32 = 0x5a17_e001;

/// Returns the cases of all functions that are called on a handle.
pub(super) fn cases() -> impl Iterator<Item = Case> {
    FunctionId::all().flat_map(|function| {
        let arguments = function.signature().map_or(&[][..], |signature| signature.arguments);
        let on_handle = matches!(arguments.first(), Some(Kind::Handle(_)));
        let connects = function == FunctionId::CONTROLLER_CONNECT;
        [
            on_handle.then(|| unknown_handle(function, arguments)),
            (on_handle || connects).then(|| missing(function)),
            on_handle.then(|| text_as_handle(function, arguments)),
        ]
        .into_iter()
        .flatten()
    })
}

/// Returns the level of the arguments below: a call that wrongly succeeds would have this effect.
fn level(function: FunctionId) -> Level {
    level_of(function.properties(Some(""), Some("")).effect)
}

/// Returns the level that allows an effect.
pub(super) const fn level_of(effect: Effect) -> Level {
    match effect {
        Effect::Session | Effect::Reads => Level::Read,
        Effect::Writes => Level::Write,
        _ => Level::Motion,
    }
}

fn made(function: FunctionId, group: Group, prefix: &str, rule: &'static str, args: Vec<Arg>, want: Want) -> Case {
    let step = Step::Call(function, args.leak(), want);
    Case {
        name: Cow::Owned(format!("{prefix}/{function}")),
        group,
        level: level(function),
        source: TABLE,
        rule,
        only: None,
        models: Vec::new(),
        setup: Setup::Started,
        body: Body::Steps(Cow::Owned(vec![step])),
    }
}

fn of_kind(kind: &Kind) -> Arg {
    match kind {
        Kind::Handle(_) => Arg::I(UNKNOWN),
        Kind::Int => Arg::I(0),
        Kind::Float => Arg::V("4,0"),
        Kind::Text => Arg::S(""),
        Kind::Any | Kind::Nothing | Kind::Maybe => Arg::V("0,"),
    }
}

fn unknown_handle(function: FunctionId, kinds: &[Kind]) -> Case {
    let args = kinds.iter().map(of_kind).collect();
    let rule = "a handle that was not given out is E_HANDLE (RAC specification, Table 2-3)";
    made(function, Group::Handles, "unknown", rule, args, Want::Code(&[HResult::E_HANDLE]))
}

fn missing(function: FunctionId) -> Case {
    let codes = &[HResult::E_INVALIDARG, HResult::E_INVALIDARGTYPE, HResult::E_HANDLE];
    let rule = "a call without its arguments is refused (RAC specification, Table 2-3)";
    made(function, Group::Arguments, "missing", rule, Vec::new(), Want::Code(codes))
}

fn text_as_handle(function: FunctionId, kinds: &[Kind]) -> Case {
    let args = std::iter::once(Arg::S("1")).chain(kinds.iter().skip(1).map(of_kind)).collect();
    let codes = &[HResult::E_INVALIDARGTYPE, HResult::E_INVALIDARG, HResult::E_HANDLE];
    let rule = "a BSTR is not a handle (RAC specification, Table 2-3)";
    made(function, Group::Arguments, "text-as-handle", rule, args, Want::Code(codes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_is_the_effect_of_the_table() {
        assert_eq!(level(FunctionId::VARIABLE_GET_VALUE), Level::Read);
        assert_eq!(level(FunctionId::CONTROLLER_GET_FILE), Level::Read, "without an option");
        assert_eq!(level(FunctionId::VARIABLE_PUT_VALUE), Level::Write);
        assert_eq!(level(FunctionId::ROBOT_HALT), Level::Motion);
        assert_eq!(level(FunctionId::CONTROLLER_EXECUTE), Level::Motion, "a command without a name may do anything");
    }
}
