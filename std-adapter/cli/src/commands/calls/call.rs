//! `bcap call` and `bcap exec`: call any function with arguments from the command line.

use bcap_capture::value::to_json;
use bcap_core::bcap::{FunctionId, Kind};
use bcap_core::hresult::HResult;
use bcap_core::variant::{OwnedVariant as Value, VarType, Variant};
use bcap_std::ObjectPath;
use clap::Args;

use crate::commands::calls::reference::{self, usage};
use crate::failure::Failure;
use crate::output::{print_json, print_line};
use crate::session::Session;
use bcap_capture::value::data;

/// Calls any of the 137 functions
///
/// FUNCTION is a name (VariableGetValue, Variable_GetValue, variable_get_value) or a number. ARG is TYPE,DATA. For a handle
/// it may be the name of an object, which is opened first and released at the end: controller, robot, robot:Arm0,
/// task:Pro1, file:NAME, extension:NAME, variable:I1, robot/variable:@SERVO_ON. For an integer, a float or a string it may
/// be plain data. A missing last `option` is an empty string, a missing last `param` is EMPTY. The command starts the
/// service and connects to the controller as needed.
///
/// Effects that belong to the session, such as the arm authority, end with the command; `bcap move` does a whole
/// motion, `bcap shell` and `bcap run` keep a session.
///
/// `bcap call FUNCTION --help` prints what FUNCTION does, its arguments with units, what it returns, and which controllers
/// have it.
#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
#[command(after_help = "\
Examples:
  bcap call ControllerGetName controller
  bcap call VariablePutValue variable:I1 3,42
  bcap call Robot_GetVariableNames robot
  bcap call 17 controller SysState
  bcap call TaskStart task:Pro1 1
  bcap call ServiceStart 8,WDT=400
  bcap call Robot_Move --help
  bcap call --list
  bcap call --list --effects")]
pub(crate) struct Call {
    /// The function
    #[arg(required_unless_present_any = ["help", "list"])]
    pub(crate) function: Option<String>,

    /// Its arguments
    #[arg(value_name = "ARG", allow_negative_numbers = true)]
    pub(crate) arguments: Vec<String>,

    /// Lists all functions
    #[arg(long, conflicts_with = "function")]
    pub(crate) list: bool,

    /// Lists functions and commands with their effect (session, reads, writes, moves), and whether Slave Mode allows them
    ///
    /// A call that Slave Mode refuses ends a stream, even when another client sends it. "unknown" counts as refused,
    /// and a command that is not listed may move.
    #[arg(long, requires = "list")]
    pub(crate) effects: bool,

    /// Prints help; after FUNCTION, the help of that function
    #[arg(short, long)]
    pub(crate) help: bool,
}

impl Call {
    /// Returns whether the help of `bcap call` itself is wanted.
    pub(crate) const fn is_help(&self) -> bool {
        self.help && self.function.is_none()
    }
}

/// Runs `bcap call`.
pub(crate) fn call(args: &Call, session: &mut Session, json: bool) -> Result<(), Failure> {
    let Some(name) = &args.function else {
        let printed = if args.effects { reference::effects(json) } else { reference::list(json) };
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
            Argument::Object(path) => session.object(path).and_then(|handle| Ok(Value::new(&handle)?)),
        })
        .collect::<Result<Vec<_>, _>>()?;
    let (code, value) = session.call_for_code(function, &values)?;
    if code.is_err() {
        return Err(refused(session, function, arguments.len(), code));
    }
    print_reply(code, value.as_ref(), json)
}

/// Prints the result of a successful call: its value, or `{"code":0,"name":"S_OK","value":{"vt":3,"v":5}}`.
pub(super) fn print_reply(code: HResult, value: Option<&Value>, json: bool) -> Result<(), Failure> {
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
        Some(value) => Ok(print_line(&data::format(value))?),
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
        let typed = data::from_typed(argument);
        let vartype = match kind {
            Some(Kind::Handle(_) | Kind::Int) => VarType::I4,
            Some(Kind::Float) => VarType::R4,
            Some(Kind::Text) => VarType::BSTR,
            _ => VarType::EMPTY,
        };
        let value = match typed {
            Ok(value) => Ok(value),
            Err(error) if vartype == VarType::EMPTY => Err(error),
            Err(_) => data::from_data(vartype, argument),
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

/// Returns the failure of a refused call: missing arguments and a motion without the arm have special hints.
fn refused(session: &Session, function: FunctionId, given: usize, code: HResult) -> Failure {
    let refused = Failure::Refused { doing: usage(function), code };
    let missing = function.argument_names().get(given..).unwrap_or_default().join(", ");
    let moves = [FunctionId::ROBOT_MOVE, FunctionId::ROBOT_DRIVE, FunctionId::ROBOT_ROTATE, FunctionId::ROBOT_GO_HOME];
    let hint = if !missing.is_empty() {
        format!("arguments are missing: {missing}; `bcap call {function} --help` describes them")
    } else if moves.contains(&function) && !session.has_arm() {
        "this session has not taken the arm, which a motion needs: `bcap move P1` takes it, moves and gives it back; in \
         `bcap shell` and `bcap run` it stays taken after `exec robot TakeArm 0 1`"
            .into()
    } else {
        return refused;
    };
    Failure::Unfit { message: refused.to_string(), code: Some(code), hint: Some(hint) }
}
