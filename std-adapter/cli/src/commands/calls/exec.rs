//! `bcap exec`: executes commands of the controller and its objects.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::variant::{OwnedVariant as Value, VarType, Variant};
use bcap_std::ObjectPath;
use clap::Args;

use super::call::print_reply;
use crate::failure::Failure;
use crate::session::Session;
use bcap_capture::value::data;

/// Executes a command of the controller or a robot
///
/// OBJECT is controller, robot, robot:NAME, task:NAME, file:NAME or extension:NAME. ARG is TYPE,DATA; otherwise an
/// integer is sent as I4, another number as R8, any other text as a string. Without ARG the parameter is EMPTY. Several
/// ARG are an array: of I4, else of R8, else of VARIANT. Resources that belong to the session, such as the arm, are
/// released when `bcap exec` ends; `bcap shell` and `bcap run` keep it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap exec controller SysState
  bcap exec controller GetErrorDescription -2147481344
  bcap exec robot TakeArm 0 1
  bcap exec robot CurPos --json")]
pub(crate) struct Exec {
    /// The object
    pub(crate) object: String,

    /// The command; case does not matter
    pub(crate) command: String,

    /// Its parameter, or the elements of its parameter
    #[arg(value_name = "ARG", allow_negative_numbers = true)]
    pub(crate) arguments: Vec<String>,
}

/// Runs `bcap exec`.
pub(crate) fn exec(args: &Exec, session: &mut Session, json: bool) -> Result<(), Failure> {
    let (path, function) = executed(args)?;
    let parameter = parameter(&args.arguments)?;
    let handle = session.object(&path)?;
    let (code, value) = session.execute(function, handle, &args.command, parameter)?;
    if code.is_err() {
        return Err(Failure::Refused { doing: format!("{path}: {}", args.command), code });
    }
    print_reply(code, value.as_ref(), json)
}

/// Checks the arguments of `bcap exec` before the first call.
pub(crate) fn check(args: &Exec) -> Result<(), Failure> {
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
    if let Ok(value) = data::from_typed(argument) {
        return Ok(value);
    }
    match (argument.parse::<i32>(), argument.parse::<f64>()) {
        (Ok(number), _) => Value::new(&number),
        (_, Ok(number)) if number.is_finite() => Value::new(&number),
        _ => Value::new(argument),
    }
}
