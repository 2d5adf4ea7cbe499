//! Tests of the constants in the header.

use std::fmt::Write as _;

use bcap_core::bcap::FunctionId;
use bcap_core::variant::VarType;

use crate::status::CODES;

/// Returns the constants of the header that the core defines.
fn constants() -> String {
    let mut text = String::from("/* The status of a function. */\nenum {\n");
    for (code, name, meaning) in CODES {
        writeln!(text, "    /* {meaning} */\n    {name} = {code},").unwrap();
    }
    text.push_str("};\n\n/* VARTYPEs; BCAP_ARRAY is added for arrays. */\nenum {\n");
    for vartype in VarType::scalars() {
        let name = format!("{vartype:?}");
        writeln!(text, "    BCAP_{} = {},", name.trim_start_matches("VT_"), vartype.0).unwrap();
    }
    text.push_str("    BCAP_ARRAY = 0x2000,\n};\n\n/* The functions of b-CAP. */\nenum {\n");
    for function in FunctionId::all() {
        let mut name = String::new();
        let mut after_lower = false;
        for letter in function.name().unwrap().chars() {
            if after_lower && letter.is_uppercase() {
                name.push('_');
            }
            after_lower = letter.is_lowercase();
            name.push(letter.to_ascii_uppercase());
        }
        writeln!(text, "    BCAP_FN_{name} = {},", function.0).unwrap();
    }
    text.push_str("};\n");
    text
}

#[test]
fn the_header_has_the_constants_of_the_core() {
    // for the script that writes the header
    if let Some(file) = std::env::var_os("BCAP_CONSTANTS") {
        std::fs::write(file, constants()).unwrap();
        return;
    }
    assert!(include_str!("../include/bcap.h").contains(&constants()), "write it again: std-adapter/c/test --header");
}

#[test]
fn every_status_has_one_name_and_a_text() {
    for (index, (code, name, meaning)) in CODES.iter().enumerate() {
        assert!(name.starts_with("BCAP_") && !meaning.is_empty(), "{name}");
        assert!(!CODES.iter().skip(index + 1).any(|other| other.0 == *code || other.1 == *name), "{name} is twice");
    }
}
