//! User variables and system variables.

use std::borrow::Cow;

use bcap_core::bcap::FunctionId as F;

use crate::case::Arg::{H, I, S, Scratch, V};
use crate::case::Setup::{Controller, Robot, Task};
use crate::case::{Arg, Body, Case, Group, Level, Setup, Slot, Step, Want, case, steps};

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;
const R: Slot = Slot::Robot;

const fn variable(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    setup: Setup,
    table: &'static [Step],
) -> Case {
    case(Group::Variables, name, source, rule, setup, steps(table))
}

/// A user variable has the type of its kind.
macro_rules! kind {
    ($name:literal, $variable:literal, $source:literal, $rule:literal, $want:expr) => {
        variable(
            $name,
            $source,
            $rule,
            Controller,
            &[
                Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S($variable), S("")]),
                Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], $want),
            ],
        )
    };
}

/// A value that a scratch variable gets is read back through another handle.
macro_rules! written {
    ($name:literal, $kind:literal, $value:literal) => {
        variable(
            $name,
            "b-CAP specification, section 4.1.3",
            "a written value is seen through another handle",
            Controller,
            &[
                Step::Save($kind),
                Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), Scratch($kind), S("")]),
                Step::Open(Slot::B, F::CONTROLLER_GET_VARIABLE, &[H(C), Scratch($kind), S("")]),
                Step::Call(F::VARIABLE_PUT_VALUE, &[H(A), V($value)], Want::NoValue),
                Step::Must(F::VARIABLE_GET_VALUE, &[H(Slot::B)], Want::Value($value)),
            ],
        )
        .at(Level::Write)
    };
}

pub(super) const CASES: &[Case] = &[
    kind!("type-of-i", "I1", "RAC specification, section 4.1", "I is an I4", Want::Type(3)),
    kind!("type-of-f", "F1", "RAC specification, section 4.1", "F is an R4", Want::Type(4)),
    kind!("type-of-d", "D1", "RAC specification, section 4.1", "D is an R8", Want::Type(5)),
    kind!("type-of-s", "S1", "RAC specification, section 4.1", "S is a BSTR", Want::Type(8)),
    kind!("type-of-v", "V1", "RAC specification, section 4.1", "V is an array of 3 R4", Want::Array(4, 3)),
    kind!("type-of-p", "P1", "RAC specification, section 4.1", "P is an array of 7 R4", Want::Array(4, 7)),
    kind!("type-of-j", "J1", "RAC specification, section 4.1", "J is an array of 8 R4", Want::Array(4, 8)),
    kind!("type-of-t", "T1", "RAC specification, section 4.1", "T is an array of 10 R4", Want::Array(4, 10)),
    kind!("type-of-io", "IO150", "b-CAP specification, section 4.1.3", "IO is a BOOL", Want::Type(11)),
    variable(
        "name-in-lower-case",
        "b-CAP specification, section 4.3.2",
        "the case of a name does not matter",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("i1"), S("")], Want::Ok),
        ],
    ),
    kind!("name-with-brackets", "I[1]", "public samples", "I[1] is I1", Want::Type(3)),
    kind!("index-0", "I0", "RAC specification, section 2.1.2", "indices begin with 0", Want::Type(3)),
    variable(
        "index-too-large",
        "RAC specification, section 2.1.2",
        "an index above the last one is refused",
        Controller,
        &[Step::Call(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I99999999"), S("")], Want::Refused)],
    ),
    variable(
        "index-negative",
        "RAC specification, section 2.1.2",
        "a negative index is refused",
        Controller,
        &[Step::Call(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I-1"), S("")], Want::Refused)],
    ),
    variable(
        "unknown-name",
        "b-CAP specification, section 4.1.2",
        "a name that does not exist is refused",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("NoSuchVariable"), S("")], Want::Refused)],
    ),
    variable(
        "unknown-system-name",
        "b-CAP specification, section 4.1.6",
        "a system variable that does not exist is refused",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("@NO_SUCH_VARIABLE"), S("")], Want::Refused)],
    ),
    variable(
        "unknown-name-of-robot",
        "b-CAP specification, section 4.1.6",
        "a system variable that does not exist is refused",
        Robot,
        &[Step::Call(F::ROBOT_GET_VARIABLE, &[H(R), S("@NO_SUCH_VARIABLE"), S("")], Want::Refused)],
    ),
    variable(
        "read-twice",
        "b-CAP specification, section 4.1.3",
        "a variable may be read many times",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3)),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3)),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3)),
        ],
    ),
    variable(
        "names",
        "b-CAP specification, Appendix A",
        "the names of the variables are an array of BSTR",
        Controller,
        &[Step::Call(F::CONTROLLER_GET_VARIABLE_NAMES, &[H(C), S("")], Want::Array(8, 0))],
    )
    .over(bcap_testkit::wire::Link::Tcp),
    variable(
        "names-of-robots",
        "b-CAP specification, Appendix A",
        "the names of the robots are an array of BSTR",
        Controller,
        &[Step::Call(F::CONTROLLER_GET_ROBOT_NAMES, &[H(C), S("")], Want::Array(8, 0))],
    ),
    variable(
        "attribute",
        "b-CAP specification, Appendix A",
        "the attribute of a variable is an I4",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Call(F::VARIABLE_GET_ATTRIBUTE, &[H(A)], Want::Type(3)),
        ],
    ),
    variable(
        "microsecond",
        "b-CAP specification, Appendix A",
        "the time stamp of a variable is an I4",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Call(F::VARIABLE_GET_MICROSECOND, &[H(A)], Want::Type(3)),
        ],
    ),
    variable(
        "error-description",
        "b-CAP specification, section 4.3.6",
        "GetErrorDescription returns a BSTR",
        Controller,
        &[Step::Call(F::CONTROLLER_EXECUTE, &[H(C), S("GetErrorDescription"), V("3,-2147024809")], Want::Type(8))],
    ),
    variable(
        "command-in-lower-case",
        "b-CAP specification, section 4.3.2",
        "the case of a command does not matter",
        Controller,
        &[Step::Call(F::CONTROLLER_EXECUTE, &[H(C), S("geterrordescription"), V("3,-2147024809")], Want::Type(8))],
    ),
    variable(
        "error-count",
        "b-CAP specification, section 4.3.6",
        "GetCurErrorCount returns an I4",
        Controller,
        &[Step::Call(F::CONTROLLER_EXECUTE, &[H(C), S("GetCurErrorCount"), V("0,")], Want::Type(3))],
    ),
    variable(
        "unknown-command",
        "b-CAP specification, section 4.3.6",
        "a command that does not exist is refused",
        Controller,
        &[Step::Must(F::CONTROLLER_EXECUTE, &[H(C), S("NoSuchCommand"), V("0,")], Want::Refused)],
    ),
    variable(
        "joints",
        "b-CAP specification, Appendix A",
        "CurJnt returns 8 doubles",
        Robot,
        &[Step::Call(F::ROBOT_EXECUTE, &[H(R), S("CurJnt"), V("0,")], Want::Array(5, 8))],
    ),
    variable(
        "position",
        "b-CAP specification, Appendix A",
        "CurPos returns 7 doubles",
        Robot,
        &[Step::Call(F::ROBOT_EXECUTE, &[H(R), S("CurPos"), V("0,")], Want::Array(5, 7))],
    ),
    variable(
        "transform",
        "b-CAP specification, Appendix A",
        "CurTrn returns 10 doubles",
        Robot,
        &[Step::Call(F::ROBOT_EXECUTE, &[H(R), S("CurTrn"), V("0,")], Want::Array(5, 10))],
    ),
    variable(
        "unknown-command-of-robot",
        "b-CAP specification, Appendix A",
        "a command that does not exist is refused",
        Robot,
        &[Step::Must(F::ROBOT_EXECUTE, &[H(R), S("NoSuchCommand"), V("0,")], Want::Refused)],
    ),
    variable(
        "wildcard",
        "public samples",
        "I* with Variable_PutID reads any index",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I*"), S("")]),
            Step::Call(F::VARIABLE_PUT_ID, &[H(A), I(2)], Want::NoValue),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Type(3)),
        ],
    )
    .at(Level::Write),
    written!("write-i", "I", "3,-12345"),
    written!("write-f", "F", "4,-0.25"),
    written!("write-d", "D", "5,-0.1"),
    written!("write-s", "S", "8,conform"),
    written!("write-v", "V", "8196,1,2,3"),
    written!("write-p", "P", "8196,1,2,3,4,5,6,-1"),
    written!("write-j", "J", "8196,8,7,6,5,4,3,2,1"),
    written!("write-t", "T", "8196,1,2,3,1,0,0,0,1,0,-1"),
    variable(
        "write-a-read-only-variable",
        "b-CAP specification, section 4.1.6",
        "@MODE cannot be written",
        Controller,
        &[
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("@MODE"), S("")]),
            Step::Call(F::VARIABLE_PUT_VALUE, &[H(A), V("8,conform")], Want::Refused),
        ],
    )
    .at(Level::Write),
    variable(
        "seen-by-another-client",
        "b-CAP specification, section 4.1.3",
        "a written value is that of the controller, not of the session",
        Controller,
        &[
            Step::Save("I"),
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), Scratch("I"), S("")]),
            Step::Call(F::VARIABLE_PUT_VALUE, &[H(A), V("3,4711")], Want::NoValue),
            Step::ReconnectController,
            Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), Scratch("I"), S("")]),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Value("3,4711")),
        ],
    )
    .at(Level::Write),
];

/// The system variables, on which object they are, and the VARTYPE of their values; 0x2000 marks an array.
const SYSTEM: &[(Setup, &str, u16)] = &[
    (Controller, "@MODE", 3),
    (Controller, "@LOCK", 11),
    (Controller, "@TIME", 3),
    (Controller, "@CURRENT_TIME", 7),
    (Controller, "@BUSY_STATUS", 11),
    (Controller, "@NORMAL_STATUS", 11),
    (Controller, "@ERROR_CODE", 3),
    (Controller, "@ERROR_DESCRIPTION", 8),
    (Controller, "@EMERGENCY_STOP", 11),
    (Controller, "@DEADMAN_SW", 11),
    (Controller, "@AUTO_ENABLE", 11),
    (Controller, "@PROTECTIVE_STOP", 11),
    (Controller, "@MAKER_NAME", 8),
    (Controller, "@TYPE", 8),
    (Controller, "@VERSION", 8),
    (Controller, "@SERIAL_NO", 8),
    (Robot, "@CURRENT_POSITION", 0x2005),
    (Robot, "@CURRENT_ANGLE", 0x2005),
    (Robot, "@CURRENT_TRANS", 0x2005),
    (Robot, "@SERVO_ON", 11),
    (Robot, "@BUSY_STATUS", 11),
    (Robot, "@TYPE_NAME", 8),
    (Robot, "@CURRENT_TOOL", 3),
    (Robot, "@CURRENT_WORK", 3),
    (Robot, "@SPEED", 4),
    (Robot, "@EXTSPEED", 4),
    (Task, "@STATUS", 3),
    (Task, "@PRIORITY", 3),
];

/// Returns the cases of the types of system variables (b-CAP specification, section 4.1.6; names and types from the vendor's open drivers).
pub(super) fn system() -> impl Iterator<Item = Case> {
    SYSTEM.iter().map(|(setup, name, vartype)| {
        let (object, opens, slot) = match setup {
            Robot => ("robot", F::ROBOT_GET_VARIABLE, R),
            Task => ("task", F::TASK_GET_VARIABLE, Slot::Task),
            _ => ("controller", F::CONTROLLER_GET_VARIABLE, C),
        };
        let want = match vartype & 0x2000 {
            0 => Want::Type(*vartype),
            _ => Want::Array(vartype & 0xfff, 0),
        };
        let arguments: &'static [Arg] = vec![H(slot), S(name), S("")].leak();
        let table = vec![Step::Open(A, opens, arguments), Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], want)];
        Case {
            name: Cow::Owned(format!("system/{object}/{name}")),
            group: if *setup == Task { Group::Tasks } else { Group::Variables },
            level: Level::Read,
            source: "b-CAP specification, section 4.1.6",
            rule: "a system variable has the type of the provider guide",
            only: None,
            setup: *setup,
            body: Body::Steps(Cow::Owned(table)),
        }
    })
}
