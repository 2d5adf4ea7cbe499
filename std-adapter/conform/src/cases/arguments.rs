//! The number and the types of arguments.

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;

use crate::case::Arg::{H, I, S, Scratch, Unsigned, V};
use crate::case::Setup::{Connected, Controller, Started};
use crate::case::{Case, Group, Level, Setup, Slot, Step, Want, case, steps};

const COUNT: Want = Want::Code(&[HResult::E_INVALIDARG]);
const TYPE: Want = Want::Code(&[HResult::E_INVALIDARGTYPE, HResult::E_INVALIDARG]);
const C: Slot = Slot::Controller;

const fn arguments(
    name: &'static str,
    source: &'static str,
    rule: &'static str,
    setup: Setup,
    table: &'static [Step],
) -> Case {
    case(Group::Arguments, name, source, rule, setup, steps(table))
}

pub(super) const CASES: &[Case] = &[
    arguments(
        "start-number",
        "b-CAP specification, section 4.1.1",
        "the option of Service_Start is a BSTR",
        Connected,
        &[Step::Must(F::SERVICE_START, &[V("8195,1,2")], TYPE)],
    ),
    arguments(
        "start-two",
        "b-CAP specification, section 4.1.1",
        "Service_Start has one argument",
        Connected,
        &[Step::Must(F::SERVICE_START, &[S(""), S("")], COUNT)],
    ),
    arguments(
        "stop-one",
        "b-CAP specification, section 4.1.5",
        "Service_Stop has no argument",
        Started,
        &[Step::Must(F::SERVICE_STOP, &[I(1)], COUNT)],
    ),
    arguments(
        "connect-three",
        "b-CAP specification, section 4.1.2",
        "Controller_Connect has four arguments",
        Started,
        &[Step::Must(F::CONTROLLER_CONNECT, &[S(""), S("CaoProv.DENSO.VRC"), S("localhost")], COUNT)],
    ),
    arguments(
        "connect-five",
        "b-CAP specification, section 4.1.2",
        "Controller_Connect has four arguments",
        Started,
        &[Step::Must(F::CONTROLLER_CONNECT, &[S(""), S("CaoProv.DENSO.VRC"), S("localhost"), S(""), S("")], COUNT)],
    ),
    arguments(
        "connect-number",
        "b-CAP specification, section 4.1.2",
        "the provider is a BSTR",
        Started,
        &[Step::Must(F::CONTROLLER_CONNECT, &[S(""), I(1), S("localhost"), S("")], TYPE)],
    ),
    arguments(
        "variable-without-option",
        "b-CAP specification, section 4.1.2",
        "Controller_GetVariable has three arguments",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1")], COUNT)],
    ),
    arguments(
        "variable-four",
        "b-CAP specification, section 4.1.2",
        "Controller_GetVariable has three arguments",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S(""), S("")], COUNT)],
    ),
    arguments(
        "variable-name-is-number",
        "b-CAP specification, section 4.1.2",
        "the name is a BSTR",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), I(1), S("")], TYPE)],
    ),
    arguments(
        "variable-name-is-array",
        "b-CAP specification, section 4.1.2",
        "the name is a BSTR",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), V("8200,I1,I2"), S("")], TYPE)],
    ),
    arguments(
        "variable-option-is-array",
        "b-CAP specification, section 4.1.2",
        "the option is a BSTR",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), V("8195,1,2")], TYPE)],
    ),
    arguments(
        "variable-arguments-swapped",
        "b-CAP specification, section 4.1.2",
        "the handle is the first argument",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[S("I1"), H(C), S("")], TYPE)],
    ),
    arguments(
        "value-two",
        "b-CAP specification, section 4.1.3",
        "Variable_GetValue has one argument",
        Controller,
        &[
            Step::Open(Slot::A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(Slot::A), I(0)], COUNT),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(Slot::A)], Want::Type(3)),
        ],
    ),
    arguments(
        "release-two",
        "b-CAP specification, section 4.1.4",
        "Variable_Release has one argument, and a refused one releases nothing",
        Controller,
        &[
            Step::Open(Slot::A, F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_RELEASE, &[H(Slot::A), I(0)], COUNT),
            Step::Must(F::VARIABLE_GET_VALUE, &[H(Slot::A)], Want::Ok),
        ],
    ),
    arguments(
        "put-without-value",
        "b-CAP specification, section 4.1.3",
        "Variable_PutValue has two arguments",
        Controller,
        &[
            Step::Save("I"),
            Step::Open(Slot::A, F::CONTROLLER_GET_VARIABLE, &[H(C), Scratch("I"), S("")]),
            Step::Must(F::VARIABLE_PUT_VALUE, &[H(Slot::A)], COUNT),
        ],
    )
    .at(Level::Write),
    arguments(
        "handle-as-ui4",
        "b-CAP specification, section 4.1.3",
        "a handle may be sent as UI4, as open drivers do",
        Controller,
        &[
            Step::Open(Slot::A, F::CONTROLLER_GET_VARIABLE, &[Unsigned(C), S("I1"), S("")]),
            Step::Must(F::VARIABLE_GET_VALUE, &[Unsigned(Slot::A)], Want::Type(3)),
        ],
    ),
    arguments(
        "handle-as-double",
        "b-CAP specification, section 4.1.3",
        "a handle is an integer",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[V("5,1"), S("I1"), S("")], TYPE)],
    ),
    arguments(
        "handle-as-bool",
        "b-CAP specification, section 4.1.3",
        "a handle is an I4",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[V("11,1"), S("I1"), S("")], TYPE)],
    ),
    arguments(
        "handle-as-array",
        "b-CAP specification, section 4.1.3",
        "a handle is a scalar",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[V("8195,1"), S("I1"), S("")], TYPE)],
    ),
    arguments(
        "handle-as-empty",
        "b-CAP specification, section 4.1.3",
        "a handle is an I4",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[V("0,"), S("I1"), S("")], TYPE)],
    ),
    arguments(
        "many",
        "RAC specification, Table 2-3",
        "a call with 30 arguments is refused",
        Started,
        &[Step::Must(F::CONTROLLER_CONNECT, &[I(0); 30], Want::Refused)],
    ),
    arguments(
        "long-name",
        "b-CAP specification, section 4.1.2",
        "a long name is refused, not cut",
        Controller,
        &[Step::Call(F::CONTROLLER_GET_VARIABLE, &[H(C), S(LONG), S("")], Want::Refused)],
    ),
    arguments(
        "empty-name",
        "b-CAP specification, section 4.1.2",
        "a variable has a name",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S(""), S("")], Want::Refused)],
    ),
    arguments(
        "name-with-nul",
        "b-CAP specification, section 4.1.2",
        "a NUL does not end a name",
        Controller,
        &[Step::Must(F::CONTROLLER_GET_VARIABLE, &[H(C), S("I1\0"), S("")], Want::Refused)],
    ),
];

/// A name of 100 letters, which fits a datagram.
const LONG: &str =
    "IIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIIII";
