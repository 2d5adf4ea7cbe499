//! `bcap call` and `bcap exec`: call any function with arguments from the command line.

use bcap_core::bcap::{FunctionId, Kind, Object};
use bcap_core::error::EncodeError;
use bcap_core::hresult::HResult;
use bcap_core::variant::{VarType, Variant};
use bcap_std::ObjectPath;

use crate::args::{Call, Exec};
use crate::error::Failure;
use crate::output::{print_json, print_line};
use crate::plain;
use crate::reference::{self, usage};
use crate::session::Session;
use crate::value::{Value, integer, text};
use bcap_capture::value::to_json;

/// Runs `bcap call`.
pub(crate) fn call(args: &Call, session: &mut Session, json: bool) -> Result<(), Failure> {
    let Some(name) = &args.function else {
        let printed = if args.help {
            reference::command()
        } else if args.effects {
            reference::effects(json)
        } else {
            reference::list(json)
        };
        return Ok(printed?);
    };
    let function = FunctionId::parse(name).ok_or_else(|| unknown(name))?;
    if args.help {
        return Ok(reference::function(function)?);
    }
    let mut arguments = parsed(function, args)?;
    arguments.extend(defaults(function, arguments.len()).unwrap_or_default().into_iter().map(Argument::Value));
    if function == FunctionId::SERVICE_START && !session.is_open() {
        // this call starts the session itself
        session.open_connection()?;
    }
    call_in(session, function, &arguments, json)
}

/// Checks the arguments before the first call.
pub(crate) fn check(args: &Call) -> Result<(), Failure> {
    let Some(name) = &args.function else { return Ok(()) };
    let function = FunctionId::parse(name).ok_or_else(|| unknown(name))?;
    parsed(function, args).map(drop)
}

fn parsed(function: FunctionId, args: &Call) -> Result<Vec<Argument>, Failure> {
    let kinds = function.signature().map(|signature| signature.arguments).unwrap_or_default();
    let parse = |(i, argument): (usize, &String)| Argument::parse(argument, kinds.get(i).copied(), function);
    args.arguments.iter().enumerate().map(parse).collect()
}

fn call_in(session: &mut Session, function: FunctionId, arguments: &[Argument], json: bool) -> Result<(), Failure> {
    let values = arguments
        .iter()
        .map(|argument| match argument {
            Argument::Value(value) => Ok(value.clone()),
            Argument::Object(path) => session.object(path).and_then(integer),
        })
        .collect::<Result<Vec<_>, _>>()?;
    let (code, value) = session.call_for_code(function, &values)?;
    if code.is_err() {
        return Err(refused(session, function, code));
    }
    print_reply(code, value.as_ref(), json)
}

/// Prints the result of a successful call: its value, or `{"code":0,"name":"S_OK","value":{"vt":3,"v":5}}`.
fn print_reply(code: HResult, value: Option<&Value>, json: bool) -> Result<(), Failure> {
    if json {
        let name = serde_json::Value::from(code.name());
        let value = value.map_or("null".into(), |value| to_json(value.as_variant()));
        return Ok(print_json(&format!("{{\"code\":{},\"name\":{name},\"value\":{value}}}", code.0))?);
    }
    if code != HResult::S_OK {
        print_line(&code.to_string())?;
    }
    match value.map(Value::as_variant) {
        // most commands return no value
        None | Some(Variant::Empty) => Ok(()),
        Some(value) => Ok(print_line(&plain::to_plain(value))?),
    }
}

/// An argument of a call.
enum Argument {
    Value(Value),
    /// The handle of this object, which is opened first.
    Object(ObjectPath),
}

impl Argument {
    /// Parses an argument: the path of an object if the function takes a handle, `TYPE,DATA`, or plain data of the kind that
    /// the function takes.
    fn parse(argument: &str, kind: Option<Kind>, function: FunctionId) -> Result<Self, Failure> {
        if let Some(Kind::Handle(object)) = kind
            && ObjectPath::is_path(argument)
        {
            let path: ObjectPath = argument.parse()?;
            if path.object() != object {
                let kind = object.name().to_ascii_lowercase();
                let message = format!("{argument} is not a {kind}, which {function} takes here");
                return Err(Failure::Input(message));
            }
            return Ok(Self::Object(path));
        }
        let typed = plain::from_typed(argument);
        let vartype = match kind {
            Some(Kind::Handle(_) | Kind::Int) => VarType::I4,
            Some(Kind::Float) => VarType::R4,
            Some(Kind::Text) => VarType::BSTR,
            _ => VarType::EMPTY,
        };
        let value = match typed {
            Ok(value) => Ok(value),
            Err(error) if vartype == VarType::EMPTY => Err(error),
            Err(_) => plain::from_data(vartype, argument),
        };
        value.map(Self::Value).map_err(|error| {
            let usage = usage(function);
            Failure::Input(format!(
                "{argument}: {error}; an argument is TYPE,DATA, such as 3,100, in {usage}; `bcap call {function} --help` \
                 describes each"
            ))
        })
    }
}

/// Returns values for the missing arguments after the first `given` ones; `None` if one of them has no default.
fn defaults(function: FunctionId, given: usize) -> Option<Vec<Value>> {
    let kinds = function.signature()?.arguments;
    let missing = function.argument_names().iter().zip(kinds).skip(given);
    missing
        .map(|argument| match argument {
            (&"option", Kind::Text) => Value::new("").ok(),
            (&"param", Kind::Any) => Some(Value::default()),
            _ => None,
        })
        .collect()
}

fn unknown(function: &str) -> Failure {
    Failure::Input(format!(
        "there is no function {function}; write a name such as VariableGetValue or Variable_GetValue, or a number from 1 to 137; \
         `bcap call --list` prints all"
    ))
}

/// Returns the failure of a refused call: a motion without the arm has a special hint.
fn refused(session: &Session, function: FunctionId, code: HResult) -> Failure {
    let moves = [FunctionId::ROBOT_MOVE, FunctionId::ROBOT_DRIVE, FunctionId::ROBOT_ROTATE, FunctionId::ROBOT_GO_HOME];
    if !moves.contains(&function) || session.has_arm() {
        return Failure::Refused { doing: usage(function), code };
    }
    Failure::Unfit {
        message: Failure::Refused { doing: usage(function), code }.to_string(),
        code: Some(code),
        hint: Some(
            "this session has not taken the arm, which a motion needs: `bcap move P1` takes it, moves and gives it back; in \
             `bcap shell` and `bcap run` it stays taken after `exec robot TakeArm 0 1`"
                .into(),
        ),
    }
}

/// Runs `bcap exec`.
pub(crate) fn exec(args: &Exec, session: &mut Session, json: bool) -> Result<(), Failure> {
    let (path, function) = executed(args)?;
    let parameter = parameter(&args.arguments)?;
    let handle = session.object(&path)?;
    let arguments = [integer(handle)?, text(&args.command)?, parameter];
    let (code, value) = session.call_for_code(function, &arguments)?;
    if code.is_err() {
        return Err(Failure::Refused { doing: format!("{path}: {}", args.command), code });
    }
    print_reply(code, value.as_ref(), json)
}

/// Checks the arguments of `bcap exec` before the first call.
pub(crate) fn check_exec(args: &Exec) -> Result<(), Failure> {
    parameter(&args.arguments)?;
    executed(args).map(drop)
}

/// Returns the object, and the function that executes its commands.
fn executed(args: &Exec) -> Result<(ObjectPath, FunctionId), Failure> {
    let path: ObjectPath = args.object.parse()?;
    let function = match path.object() {
        Object::Controller => FunctionId::CONTROLLER_EXECUTE,
        Object::Robot => FunctionId::ROBOT_EXECUTE,
        Object::Task => FunctionId::TASK_EXECUTE,
        Object::File => FunctionId::FILE_EXECUTE,
        Object::Extension => FunctionId::EXTENSION_EXECUTE,
        other => {
            let kind = other.name().to_ascii_lowercase();
            return Err(Failure::Input(format!("{}: a {kind} has no commands", args.object)));
        }
    };
    Ok((path, function))
}

/// Encodes the parameter of a command: EMPTY, one value, or an array of several.
fn parameter(arguments: &[String]) -> Result<Value, EncodeError> {
    let values = arguments.iter().map(|argument| guess(argument)).collect::<Result<Vec<_>, _>>()?;
    if let [] | [_] = values.as_slice() {
        return Ok(values.into_iter().next().unwrap_or_default());
    }
    let all = |vartype: &[VarType]| values.iter().all(|value| vartype.contains(&value.as_variant().vartype()));
    if all(&[VarType::I4]) {
        let numbers: Vec<i32> = values.iter().filter_map(|value| value.as_variant().as_i32()).collect();
        return Value::new(numbers.as_slice());
    }
    if all(&[VarType::I4, VarType::R8]) {
        let numbers: Vec<f64> = values.iter().filter_map(|value| value.as_variant().as_f64()).collect();
        return Value::new(numbers.as_slice());
    }
    let variants: Vec<Variant<'_>> = values.iter().map(Value::as_variant).collect();
    Value::new(variants.as_slice())
}

/// Parses one argument of a command: `TYPE,DATA`, an integer as I4, another number as R8, any other text as a string.
fn guess(argument: &str) -> Result<Value, EncodeError> {
    if let Ok(value) = plain::from_typed(argument) {
        return Ok(value);
    }
    match (argument.parse::<i32>(), argument.parse::<f64>()) {
        (Ok(number), _) => Value::new(&number),
        (_, Ok(number)) if number.is_finite() => Value::new(&number),
        _ => Value::new(argument),
    }
}
