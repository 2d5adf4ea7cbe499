//! The encoding of values: invalid ones are refused, valid ones come back as they were sent.

use bcap_core::bcap::FunctionId as F;

use crate::case::Arg::{H, S, Scratch, V};
use crate::case::Edit::{Body as Args, Nested};
use crate::case::Reaction::{Ends, Refused};
use crate::case::Setup::{Connected, Controller};
use crate::case::{Case, Group, Level, Slot, Step, Want, case, steps};

const fn raw(name: &'static str, source: &'static str, rule: &'static str, table: &'static [Step]) -> Case {
    case(Group::Types, name, source, rule, Connected, steps(table))
}

/// A value that is written to a scratch variable and read back.
const fn echo(name: &'static str, source: &'static str, table: &'static [Step]) -> Case {
    case(Group::Types, name, source, "a written value is read back bit by bit", Controller, steps(table))
        .at(Level::Write)
}

const C: Slot = Slot::Controller;
const A: Slot = Slot::A;
const TYPES: &str = "b-CAP specification, Table 6-3";

macro_rules! echo {
    ($name:literal, $kind:literal, $value:literal) => {
        echo(
            $name,
            TYPES,
            &[
                Step::Save($kind),
                Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), Scratch($kind), S("")]),
                Step::Call(F::VARIABLE_PUT_VALUE, &[H(A), V($value)], Want::NoValue),
                Step::Must(F::VARIABLE_GET_VALUE, &[H(A)], Want::Value($value)),
            ],
        )
    };
}

/// A value of this type that the variable cannot hold is refused, and the variable keeps its value.
macro_rules! refused {
    ($name:literal, $kind:literal, $value:literal) => {
        case(
            Group::Types,
            $name,
            "RAC specification, Table 2-3",
            "a value of another type is refused",
            Controller,
            steps(&[
                Step::Save($kind),
                Step::Open(A, F::CONTROLLER_GET_VARIABLE, &[H(C), Scratch($kind), S("")]),
                Step::Call(F::VARIABLE_PUT_VALUE, &[H(A), V($value)], Want::Refused),
            ]),
        )
        .at(Level::Write)
    };
}

pub(super) const CASES: &[Case] = &[
    raw(
        "unknown-9",
        TYPES,
        "type 9 (DISPATCH) is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 9, 0, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "unknown-13",
        TYPES,
        "type 13 (UNKNOWN) is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 13, 0, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "unknown-14",
        TYPES,
        "type 14 (DECIMAL) is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 14, 0, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "unknown-16",
        TYPES,
        "type 16 (I1) is not in the table",
        &[Step::Edited(&[Args(1, &[7, 0, 0, 0, 16, 0, 1, 0, 0, 0, 1])], Refused)],
    ),
    raw(
        "unknown-22",
        TYPES,
        "type 22 (INT) is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 22, 0, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "unknown-23",
        TYPES,
        "type 23 (UINT) is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 23, 0, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "unknown-255",
        TYPES,
        "type 255 is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 255, 0, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "by-reference",
        TYPES,
        "a value by reference (0x4000) is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 3, 0x40, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "array-of-unknown",
        TYPES,
        "an array of type 13 is not in the table",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 13, 0x20, 1, 0, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "bstr-longer-than-the-argument",
        TYPES,
        "a string ends within its argument",
        &[Step::Edited(&[Args(1, &[12, 0, 0, 0, 8, 0, 1, 0, 0, 0, 200, 0, 0, 0, 65, 0])], Refused)],
    ),
    raw(
        "bstr-4-gib",
        TYPES,
        "a string ends within its argument",
        &[Step::Edited(&[Args(1, &[12, 0, 0, 0, 8, 0, 1, 0, 0, 0, 0xfe, 0xff, 0xff, 0xff, 65, 0])], Refused)],
    ),
    raw(
        "bstr-odd",
        TYPES,
        "a string has an even number of bytes",
        &[Step::Edited(&[Args(1, &[13, 0, 0, 0, 8, 0, 1, 0, 0, 0, 3, 0, 0, 0, 65, 0, 66])], Ends)],
    ),
    raw(
        "bstr-without-length",
        TYPES,
        "a string has a length",
        &[Step::Edited(&[Args(1, &[6, 0, 0, 0, 8, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "i4-cut-off",
        TYPES,
        "a scalar has all its bytes",
        &[Step::Edited(&[Args(1, &[8, 0, 0, 0, 3, 0, 1, 0, 0, 0, 1, 0])], Refused)],
    ),
    raw(
        "array-longer-than-the-argument",
        TYPES,
        "an array ends within its argument",
        &[Step::Edited(&[Args(1, &[14, 0, 0, 0, 5, 0x20, 9, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])], Refused)],
    ),
    raw(
        "array-count-wraps-r8",
        TYPES,
        "count times size does not wrap at 32 bits",
        &[Step::Edited(&[Args(1, &[14, 0, 0, 0, 5, 0x20, 1, 0, 0, 0x20, 0, 0, 0, 0, 0, 0, 0, 0])], Refused)],
    ),
    raw(
        "array-count-wraps-i4",
        TYPES,
        "count times size does not wrap at 32 bits",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 3, 0x20, 1, 0, 0, 0x40, 0, 0, 0, 0])], Refused)],
    ),
    raw(
        "array-count-wraps-ui1",
        TYPES,
        "offset plus count does not wrap at 32 bits",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 17, 0x20, 0xf0, 0xff, 0xff, 0xff, 0, 0, 0, 0])], Refused)],
    ),
    raw(
        "array-count-wraps-bstr",
        TYPES,
        "an array ends within its argument",
        &[Step::Edited(&[Args(1, &[10, 0, 0, 0, 8, 0x20, 1, 0, 0, 0x20, 0, 0, 0, 0])], Refused)],
    ),
    raw(
        "array-count-wraps-variant",
        TYPES,
        "an array ends within its argument",
        &[Step::Edited(&[Args(1, &[12, 0, 0, 0, 12, 0x20, 0xab, 0xaa, 0xaa, 0x0a, 0, 0, 1, 0, 0, 0])], Refused)],
    ),
    raw(
        "array-of-empty-4-gib",
        TYPES,
        "elements without bytes do not make an endless array",
        &[Step::Edited(&[Args(1, &[6, 0, 0, 0, 0, 0x20, 0xff, 0xff, 0xff, 0xff])], Refused)],
    ),
    raw(
        "nested-70-deep",
        TYPES,
        "nesting is limited, and a device does not crash",
        &[Step::Edited(&[Nested(70)], Refused)],
    ),
    raw(
        "nested-10000-deep",
        TYPES,
        "nesting is limited, and a device does not crash",
        &[Step::Edited(&[Nested(10_000)], Refused)],
    )
    .over(bcap_testkit::wire::Link::Tcp),
    raw(
        "nested-150000-deep",
        TYPES,
        "nesting is limited, and a device does not crash",
        &[Step::Edited(&[Nested(150_000)], Refused)],
    )
    .over(bcap_testkit::wire::Link::Tcp),
    raw(
        "scalar-count-0",
        TYPES,
        "the count of a scalar is 1",
        &[Step::Edited(&[Args(1, &[14, 0, 0, 0, 8, 0, 0, 0, 0, 0, 4, 0, 0, 0, 65, 0, 65, 0])], Ends)],
    ),
    raw(
        "scalar-count-4-gib",
        TYPES,
        "the count of a scalar is 1",
        &[Step::Edited(&[Args(1, &[14, 0, 0, 0, 8, 0, 0xff, 0xff, 0xff, 0xff, 4, 0, 0, 0, 65, 0, 65, 0])], Ends)],
    ),
    echo!("i4-0", "I", "3,0"),
    echo!("i4-minus-1", "I", "3,-1"),
    echo!("i4-min", "I", "3,-2147483648"),
    echo!("i4-max", "I", "3,2147483647"),
    echo!("i4-bytes", "I", "3,0x12345678"),
    echo!("r4-tenth", "F", "4,0.1"),
    echo!("r4-largest", "F", "4,3.4028235e38"),
    echo!("r4-smallest", "F", "4,1e-45"),
    echo!("r8-tenth", "D", "5,0.1"),
    echo!("r8-digits", "D", "5,0.30000000000000004"),
    echo!("r8-largest", "D", "5,1.7976931348623157e308"),
    echo!("bstr-ascii", "S", "8,Sample"),
    echo!("bstr-empty", "S", "8,"),
    echo!("bstr-comma", "S", "8,Sample,Test"),
    echo!("bstr-umlaut", "S", "8,\u{e4}\u{f6}\u{fc}"),
    echo!("bstr-kanji", "S", "8,\u{6f22}\u{5b57}"),
    echo!("r4-array-v", "V", "8196,1.5,-2.25,3"),
    echo!("r4-array-p", "P", "8196,400.5,0,300.25,180,0,180,5"),
    echo!("r4-array-j", "J", "8196,1,2,3,4,5,6,7,8"),
    echo!("r4-array-t", "T", "8196,1,2,3,1,0,0,0,1,0,5"),
    refused!("text-to-i", "I", "8,abc"),
    refused!("array-to-i", "I", "8195,1,2"),
    refused!("too-large-for-i", "I", "20,2147483648"),
    refused!("text-to-f", "F", "8,abc"),
    refused!("array-to-s", "S", "8200,a,b"),
    refused!("scalar-to-p", "P", "4,1"),
    refused!("short-array-to-p", "P", "8196,1,2,3"),
    refused!("text-array-to-j", "J", "8200,a,b,c,d,e,f,g,h"),
];
