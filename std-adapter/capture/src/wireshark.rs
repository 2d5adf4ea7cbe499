//! A dissector for Wireshark, one Lua file.
//!
//! The code of the dissector is `wireshark/dissector.lua`. Its tables (fields of a header, functions, result codes, types, formats of
//! Slave Mode) are generated here from the tables of the core.

use std::fmt::Write as _;
use std::ops::Range;

use bcap_core::bcap::header::field;
use bcap_core::bcap::{self, EOT, FunctionId, HEADER_LEN, Kind, MIN_FRAME, SOH};
use bcap_core::hresult::{HResult, Pattern, Row};
use bcap_core::limits::Limits;
use bcap_core::rac::{self, VariableKind};
use bcap_core::slave::{Mode, PoseType, ReceiveFormat, ReceivePose, SlaveMode, TimeUnit, UserIo};
use bcap_core::variant::{MAX_EMPTY_ELEMENTS, VarType};

const HEAD: &str = "\
-- b-CAP and RAC of DENSO robot controllers: a dissector for Wireshark 4.0 or later.
--
-- `bcap generate wireshark` prints this file, with the tables of bcap-core. Do not edit it.
-- Licence: MIT OR Apache-2.0
";

/// Returns the dissector, for `bcap.lua` in the folder of Wireshark's plugins.
#[must_use]
pub fn script() -> String {
    let tables = [constants(), fields(), functions(), results(), types(), poses(), slave()];
    format!("{HEAD}\n{}{}", tables.join("\n"), include_str!("wireshark/dissector.lua"))
}

/// A string of Lua.
fn quoted(text: &str) -> String {
    // the tables are ASCII without control characters
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

fn constants() -> String {
    let limits = Limits::STREAM;
    format!(
        "local PORT, RAC_PORT = {}, {}\n\
         local SOH, EOT, HEADER, SHORTEST, LONGEST = {SOH}, {EOT}, {HEADER_LEN}, {MIN_FRAME}, {}\n\
         local MOST_ARGUMENTS, DEEPEST, MOST_EMPTY, LONGEST_LINE = {}, {}, {MAX_EMPTY_ELEMENTS}, {}\n\
         local START, MOVE, EXECUTING = {}, {}, {}\n",
        bcap::PORT,
        rac::PORT,
        limits.frame,
        limits.arguments,
        limits.depth,
        rac::MAX_LINE,
        FunctionId::SERVICE_START.0,
        FunctionId::ROBOT_MOVE.0,
        HResult::S_EXECUTING.0,
    )
}

/// A function for each field of a header, which takes its bytes from the frame.
fn fields() -> String {
    let fields = [
        ("LENGTH", field::LENGTH),
        ("SERIAL", field::SERIAL),
        ("RESERVED", field::RESERVED),
        ("CODE", field::CODE),
        ("COUNT", field::COUNT),
    ];
    let function = |(name, bytes): (&str, Range<usize>)| {
        format!("local function {name}(tvb) return tvb({}, {}) end\n", bytes.start, bytes.len())
    };
    fields.map(function).concat()
}

/// The 137 functions: names, arguments, what they open and release.
fn functions() -> String {
    let mut out = String::from("local FUNCTIONS = {\n");
    for function in FunctionId::all() {
        // writing to a string cannot fail, here and below
        let _ = writeln!(out, "    [{}] = {{ name = \"{function}\"{} }},", function.0, function_fields(function));
    }
    out.push_str("}\n");
    out
}

fn function_fields(function: FunctionId) -> String {
    let mut out = String::new();
    let Some(signature) = function.signature() else { return out };
    if let Some(object) = function.opens().filter(|_| function != FunctionId::SERVICE_START) {
        let _ = write!(out, ", opens = \"{}\"", object.name());
    }
    if function.releases().is_some() {
        out.push_str(", releases = true");
    }
    // of functions that read or write the value of the object they are called on
    if function == FunctionId::VARIABLE_GET_VALUE {
        out.push_str(", reads_value = true");
    } else if function == FunctionId::VARIABLE_PUT_VALUE {
        let _ = write!(out, ", value_at = {}", signature.arguments.len());
    }
    let arguments: Vec<String> = signature
        .arguments
        .iter()
        .zip(function.argument_names())
        .map(|(kind, name)| match kind {
            Kind::Handle(object) => format!("{{ name = \"{name}\", handle = \"{}\" }}", object.name()),
            other => format!("{{ name = \"{name}\", kind = \"{other:?}\" }}"),
        })
        .collect();
    let _ = write!(out, ", arguments = {{ {} }}", arguments.join(", "));
    out
}

/// The result codes with names, and the patterns of codes without names, the narrowest first.
fn results() -> String {
    let mut out = String::from("local RESULTS = {\n");
    for code in HResult::known() {
        let text = |text: Option<&str>| quoted(text.unwrap_or_default());
        let (name, meaning, hint) = (text(code.name()), text(code.meaning()), quoted(&hint(code)));
        let _ = writeln!(
            out,
            "    [0x{:08x}] = {{ name = {name}, meaning = {meaning},\n        hint = {hint} }},",
            code.to_u32()
        );
    }
    out.push_str("}\n\nlocal RANGES = {\n");
    let unnamed = Row::all().filter(|row| !row.meaning.is_empty());
    let mut patterns: Vec<_> =
        unnamed.flat_map(|row| row.patterns().map(move |pattern| (pattern, row.meaning))).collect();
    // the dissector uses the first match
    patterns.sort_by_key(|(Pattern { first, last, .. }, _)| last - first);
    for (Pattern { first, last, has_axis, .. }, meaning) in patterns {
        let axis = if has_axis { ", axis = true" } else { "" };
        let (meaning, hint) = (quoted(meaning), quoted(&hint(HResult::from_u32(first))));
        let _ = writeln!(
            out,
            "    {{ first = 0x{first:08x}, last = 0x{last:08x}{axis}, meaning = {meaning},\n        hint = {hint} }},"
        );
    }
    out.push_str("}\n");
    out
}

fn hint(code: HResult) -> String {
    code.hint().map(|hint| hint.to_string()).unwrap_or_default()
}

/// The VARTYPEs: their names without `VT_`, and the bytes of an element if they are fixed.
fn types() -> String {
    let mut out = format!("local ARRAY = {}\n\nlocal TYPES = {{\n", VarType::ARRAY.0);
    for vartype in VarType::scalars() {
        let name = vartype.name().unwrap_or_default().trim_start_matches("VT_");
        let bytes = vartype.element_bytes().map(|bytes| format!(", bytes = {bytes}")).unwrap_or_default();
        let _ = writeln!(out, "    [{}] = {{ name = \"{name}\"{bytes} }},", vartype.0);
    }
    out.push_str("}\n");
    out
}

/// The names and units of the numbers of poses, and where poses occur.
fn poses() -> String {
    let mut out = String::from("local POSES = {\n");
    for pose in [PoseType::P, PoseType::J, PoseType::T] {
        let _ = writeln!(out, "    {pose:?} = {{ {} }},", labels(pose.columns()));
    }
    let vector = PoseType::P.columns().get(..VariableKind::V.elements()).unwrap_or_default();
    let _ = writeln!(out, "    V = {{ {} }},\n}}\n", labels(vector));
    // the type of a destination in Robot_Move (b-CAP specification, section 6.3)
    out.push_str("local DESTINATIONS = { [0] = \"P\", [1] = \"T\", [2] = \"J\", [3] = \"V\" }\n");
    out.push_str("local COMMAND_POSES = { curpos = \"P\", curjnt = \"J\", curtrn = \"T\", destpos = \"P\", destjnt = \"J\", desttrn = \"T\" }\n");
    out.push_str("local SYSTEM_POSES = { [\"@CURRENT_POSITION\"] = \"P\", [\"@CURRENT_ANGLE\"] = \"J\", [\"@CURRENT_TRANS\"] = \"T\" }\n");
    let kinds: Vec<_> = VariableKind::ALL.iter().map(|kind| format!("{kind} = true")).collect();
    let _ = writeln!(out, "local RAC_KINDS = {{ {} }}", kinds.join(", "));
    out
}

fn labels(columns: &[&str]) -> String {
    let label = |name: &&str| match unit(name) {
        Some(unit) => format!("{{ name = \"{name}\", unit = \"{unit}\" }}"),
        None => format!("{{ name = \"{name}\" }}"),
    };
    columns.iter().map(label).collect::<Vec<_>>().join(", ")
}

/// Returns the unit of a number of a pose; the vectors and the figure have none.
fn unit(column: &str) -> Option<&'static str> {
    match column {
        "X" | "Y" | "Z" => Some("mm"),
        "RX" | "RY" | "RZ" => Some("deg"),
        joint if joint.starts_with('J') => Some("deg or mm"),
        _ => None,
    }
}

/// The modes and the formats of Slave Mode.
fn slave() -> String {
    let mut out = String::from("local SLAVE = {\n    modes = {\n");
    for mode in [Mode::Mode0, Mode::Mode1, Mode::Mode2] {
        for pose in [PoseType::P, PoseType::J, PoseType::T] {
            let code = SlaveMode { mode, pose }.code();
            let _ = writeln!(out, "        [0x{code:03x}] = {{ name = \"{mode:?}\", pose = \"{pose:?}\" }},");
        }
    }
    out.push_str("    },\n");
    let poses = [ReceivePose::P, ReceivePose::J, ReceivePose::T, ReceivePose::PJ, ReceivePose::TJ];
    let poses = poses.map(|pose| format!("[{}] = \"{pose:?}\"", ReceiveFormat::pose(pose).code()));
    let _ = writeln!(out, "    poses = {{ {} }},", poses.join(", "));
    for (name, bit) in receive_bits() {
        let _ = writeln!(out, "    {name} = 0x{bit:04x},");
    }
    out.push_str("}\n");
    out
}

/// The bit of each element of the reply to slvMove. slvSendFormat has the same bits for MiniIO, user IO and HandIO.
fn receive_bits() -> [(&'static str, i32); 5] {
    let plain = ReceiveFormat::pose(ReceivePose::P);
    let user_io = UserIo::new(128, 1).ok();
    [
        ("TIME", ReceiveFormat { time: Some(TimeUnit::Millis), ..plain }),
        ("HAND", ReceiveFormat { hand_io: true, ..plain }),
        ("CURRENT", ReceiveFormat { current: true, ..plain }),
        ("MINI", ReceiveFormat { mini_io: true, ..plain }),
        ("USER", ReceiveFormat { user_io, ..plain }),
    ]
    .map(|(name, format)| (name, format.code() ^ plain.code()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_are_ascii_and_have_no_control_characters() {
        for c in script().chars() {
            assert!(c == '\n' || c == ' ' || c.is_ascii_graphic(), "{c:?}");
        }
    }

    #[test]
    fn the_formats_of_slave_mode_are_those_of_the_specification() {
        let bits = [("TIME", 0x10), ("HAND", 0x20), ("CURRENT", 0x40), ("MINI", 0x100), ("USER", 0x200)];
        assert_eq!(receive_bits(), bits);
    }

    #[test]
    fn every_number_of_a_pose_has_a_label() {
        for (kind, pose) in
            [(VariableKind::P, PoseType::P), (VariableKind::J, PoseType::J), (VariableKind::T, PoseType::T)]
        {
            assert_eq!(pose.columns().len(), kind.elements());
        }
    }
}
