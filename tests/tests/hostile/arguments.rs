//! Valid frames over TCP with invalid arguments: the server refuses the call and the connection continues.

use std::collections::HashMap;

use bcap_core::bcap::{FunctionId, Kind, Object};
use bcap_core::hresult::HResult;
use bcap_testkit::frame::field;
use bcap_testkit::value::Value;

use crate::Case;
use crate::target::Target;
use crate::wire::{Raw, SERIAL, frame, request};

pub(crate) const CASES: &[Case] = crate::cases! {
    arguments:
        every_function_without_arguments
        every_function_with_arguments_of_another_kind
        every_function_with_too_many_arguments
        unknown_functions
        releases_of_nothing
        handles_of_another_client
        handles_of_another_kind
        dates_beyond_the_calendar
        options_that_are_none
        a_time_limit_that_passes
        more_objects_than_the_limit
        serials_and_reserved_fields_of_any_value
};

/// Returns a value that a kind accepts, with handles that were not issued.
fn fitting(kind: Kind) -> Value {
    match kind {
        Kind::Handle(_) => Value::I4(-77),
        Kind::Int => Value::I4(1),
        Kind::Float => Value::R4(0),
        Kind::Text => Value::text("x"),
        _ => Value::Array(12, vec![Value::I4(1), Value::text("x")]),
    }
}

/// Begins a session and opens an object of every kind that can be opened.
fn one_of_each(raw: &mut Raw) -> HashMap<Object, i32> {
    let mut handles = HashMap::from([(Object::Controller, raw.begin())]);
    // some are opened by others that have to be opened first
    for _ in 0..4 {
        for function in FunctionId::all() {
            let Some(object) = function.opens().filter(|object| !handles.contains_key(object)) else { continue };
            let Some(Kind::Handle(parent)) = kinds(function).first() else { continue };
            if handles.contains_key(parent) {
                let args = kinds(function).iter().map(|kind| good(&handles, *kind)).collect();
                let reply = raw.call(&request(function, args));
                let [Value::I4(handle)] = reply.args[..] else { panic!("no handle: {reply:?}") };
                handles.insert(object, handle);
            }
        }
    }
    handles
}

/// Returns a value that a kind takes, with handles that are this client's.
fn good(handles: &HashMap<Object, i32>, kind: Kind) -> Value {
    match kind {
        Kind::Handle(object) => Value::I4(handles[&object]),
        kind => fitting(kind),
    }
}

fn kinds(function: FunctionId) -> &'static [Kind] {
    function.signature().unwrap().arguments
}

fn every_function_without_arguments(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    raw.begin();
    for function in FunctionId::all() {
        let code = HResult(raw.call(&request(function, vec![])).code);
        // two functions take no arguments, and Service_Start in the guides has none either
        let takes_none = kinds(function).is_empty() || function == FunctionId::SERVICE_START;
        assert_eq!(code == HResult::E_INVALIDARG, !takes_none, "{}: {code}", function.0);
        for given in 1..kinds(function).len() {
            let args = kinds(function)[..given].iter().map(|kind| fitting(*kind)).collect();
            assert_eq!(raw.call(&request(function, args)).code, HResult::E_INVALIDARG.0, "{}", function.0);
        }
    }
    raw.begin();
}

fn every_function_with_arguments_of_another_kind(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let handles = one_of_each(&mut raw);
    let others = [
        Value::Empty,
        Value::text("4294967296"),
        Value::R8(f64::NAN.to_bits()),
        Value::Date(1e300_f64.to_bits()),
        Value::Ui8(u64::MAX),
        Value::Error(-1),
        Value::Array(17, vec![Value::Ui1(1); 300]),
        Value::Array(8, vec![Value::text("x")]),
        Value::Array(12, vec![]),
    ];
    for function in FunctionId::all() {
        for (at, kind) in kinds(function).iter().enumerate() {
            for other in &others {
                let mut args: Vec<Value> = kinds(function).iter().map(|kind| good(&handles, *kind)).collect();
                args[at] = other.clone();
                let code = HResult(raw.call(&request(function, args)).code);
                let expected = match (kind, other) {
                    (Kind::Handle(_), _) => &[HResult::E_INVALIDARGTYPE, HResult::E_HANDLE][..],
                    // a text may be left empty
                    (Kind::Text, Value::Empty | Value::Bstr(_)) => continue,
                    (Kind::Text, _)
                    | (Kind::Int, Value::Bstr(_) | Value::Date(_) | Value::Ui8(_) | Value::Array(..))
                    | (Kind::Float, Value::Bstr(_) | Value::Array(..)) => &[HResult::E_INVALIDARGTYPE],
                    // numbers of other types may fit, and anything goes for a VARIANT
                    _ => continue,
                };
                assert!(expected.contains(&code), "{} argument {at} {other:?}: {code}", function.0);
            }
        }
    }
    raw.begin();
}

fn every_function_with_too_many_arguments(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    raw.begin();
    for function in FunctionId::all() {
        let mut args: Vec<Value> = kinds(function).iter().map(|kind| fitting(*kind)).collect();
        while args.len() < 64 {
            args.push(Value::I4(1));
            assert_eq!(raw.call(&request(function, args.clone())).code, HResult::E_INVALIDARG.0, "{}", function.0);
            args.extend(vec![Value::Empty; (64 - args.len()) / 2]);
        }
    }
}

fn unknown_functions(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    for number in [0, -1, 138, 0x900, 0x8000, i32::MAX, i32::MIN] {
        for args in [vec![], vec![Value::I4(1)]] {
            assert_eq!(raw.call(&request(FunctionId(number), args)).code, HResult::E_INVALIDARG.0, "{number}");
        }
    }
    raw.begin();
}

fn releases_of_nothing(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    for function in FunctionId::all().filter(|function| function.releases().is_some() && function.0 != 2) {
        for handle in [0, -1, i32::MAX, i32::MIN, controller + 1] {
            let reply = raw.call(&request(function, vec![Value::I4(handle)]));
            assert_eq!(reply.code, HResult::E_HANDLE.0, "{} {handle}", function.0);
        }
    }
    let disconnect = request(FunctionId::CONTROLLER_DISCONNECT, vec![Value::I4(controller)]);
    assert_eq!(raw.call(&disconnect).code, 0);
    assert_eq!(raw.call(&disconnect).code, HResult::E_HANDLE.0, "a second time");
}

/// Handles are small numbers that any client can guess; they are valid only on the connection that opened them.
fn handles_of_another_client(target: &mut Target) {
    let (mut owner, mut thief) = (Raw::connect(target.tcp), Raw::connect(target.tcp));
    let controller = owner.begin();
    thief.begin();
    for function in FunctionId::all().filter(|function| matches!(kinds(*function).first(), Some(Kind::Handle(_)))) {
        let mut args: Vec<Value> = kinds(function).iter().map(|kind| fitting(*kind)).collect();
        for handle in [controller, 1, 2, 3, 4] {
            args[0] = Value::I4(handle);
            let code = HResult(thief.call(&request(function, args.clone())).code);
            assert_eq!(code, HResult::E_HANDLE, "{} on {handle}", function.0);
        }
    }
    assert_eq!(owner.call(&request(FunctionId::CONTROLLER_GET_NAME, vec![Value::I4(controller)])).code, 0);
}

fn handles_of_another_kind(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    for function in FunctionId::all() {
        if let Some(Kind::Handle(object)) = kinds(function).first()
            && *object != Object::Controller
        {
            let mut args: Vec<Value> = kinds(function).iter().map(|kind| fitting(*kind)).collect();
            args[0] = Value::I4(controller);
            assert_eq!(raw.call(&request(function, args)).code, HResult::E_HANDLE.0, "{}", function.0);
        }
    }
}

fn dates_beyond_the_calendar(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    for date in [1e14, 1e300, -1e300, f64::MAX, f64::INFINITY, f64::NAN, -657_435.0, 2_958_466.0] {
        let date = Value::Date(date.to_bits());
        // it is refused in place of a text; as a value its bits pass through unchanged
        let reply = raw.call(&request(FunctionId::SERVICE_START, vec![date.clone()]));
        assert_eq!(reply.code, HResult::E_INVALIDARGTYPE.0);
        let args = vec![Value::I4(controller), Value::text("echo"), date.clone()];
        assert_eq!(raw.call(&request(FunctionId::CONTROLLER_EXECUTE, args)).args, [date]);
    }
}

fn options_that_are_none(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let start = |text: &str| request(FunctionId::SERVICE_START, vec![Value::text(text)]);
    let wrong = [
        "WDT=abc",
        "WDT=-1",
        "WDT=",
        "WDT=0",
        "WDT=79",
        "WDT=100=5",
        "WDT=(100",
        "WDT=0x",
        "WDT=99999999999999999999",
        "InvokeTimeout=abc",
        "InvokeTimeout=79",
        "InvokeTimeout=(((((",
        &"x".repeat(200),
        &"WDT=400,".repeat(100),
    ];
    for option in wrong {
        assert_eq!(raw.call(&start(option)).code, HResult::E_INVALIDARG.0, "{option}");
    }
    for option in ["", ",,,,", "=", "WDT", "Wdt = (400) , invoketimeout=<0x1000>", "Unknown=1=2", ",WDT=400"] {
        assert_eq!(raw.call(&start(option)).code, 0, "{option}");
    }
    raw.begin();
}

/// A call that exceeds its time limit is answered, and the connection is free for the next.
fn a_time_limit_that_passes(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    let start = request(FunctionId::SERVICE_START, vec![Value::text("InvokeTimeout=100")]);
    assert_eq!(raw.call(&start).code, 0);
    let sleep = |millis| vec![Value::I4(controller), Value::text("sleep"), Value::I4(millis)];
    for _ in 0..3 {
        let reply = raw.call(&request(FunctionId::CONTROLLER_EXECUTE, sleep(3_600_000)));
        assert_eq!((reply.code, &reply.args[..]), (HResult::E_TIMEOUT.0, &[Value::Empty][..]));
        let reply = raw.call(&request(FunctionId::CONTROLLER_GET_NAME, vec![Value::I4(controller)]));
        assert_eq!(reply.code, 0);
    }
    // one that goes away in the middle of a long call is let go
    raw.send(&request(FunctionId::CONTROLLER_EXECUTE, sleep(3_600_000)).to_wire(false));
    target.serves_others();
    raw.reset();
}

fn more_objects_than_the_limit(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    let controller = raw.begin();
    let variable =
        request(FunctionId::CONTROLLER_GET_VARIABLE, vec![Value::I4(controller), Value::text("V"), Value::text("")]);
    let before = target.open();
    // service and controller are two of the thousand
    for _ in 0..998 {
        assert_eq!(raw.call(&variable).code, 0);
    }
    for _ in 0..5 {
        assert_eq!(raw.call(&variable).code, HResult::E_MAX_OBJECT.0);
    }
    assert_eq!(target.open(), before + 998);
    target.serves_others();
}

/// On a stream the client chooses the serial freely: 0 and repetitions are executed like any other.
fn serials_and_reserved_fields_of_any_value(target: &mut Target) {
    let mut raw = Raw::connect(target.tcp);
    raw.begin();
    for serial in [0, 0, 1, 1, SERIAL, SERIAL, 65535, 0] {
        for reserved in [0_u16, 1, SERIAL, 65535] {
            let mut bytes = frame(serial, FunctionId::SERVICE_START.0, 0, &[]);
            bytes[field::RESERVED].copy_from_slice(&reserved.to_le_bytes());
            raw.send(&bytes);
            let reply = raw.reply();
            assert_eq!((reply.serial, reply.reserved, reply.code), (serial, 0, 0));
        }
    }
}
