//! The reference of the functions: `bcap call FUNCTION --help` and `bcap call --list`.

use std::io;

use bcap_core::bcap::{Command, FunctionId, Properties};
use serde_json::json;

use crate::output::{print_block, print_result};

/// Prints the help of a function.
pub(crate) fn function(function: FunctionId) -> io::Result<()> {
    let help = function.help().collect::<Vec<_>>().join("\n");
    let end = "`bcap call --help` describes how the arguments are written.";
    print_block(&format!("{}: function {}\n\n{help}\n\n{end}", usage(function), function.0))
}

/// Lists all functions, one a line: number, usage and first sentence of the help.
pub(crate) fn list(json: bool) -> io::Result<()> {
    FunctionId::all().try_for_each(|function| {
        let summary = function.help().next().unwrap_or_default();
        let (name, arguments) = (function.to_string(), function.argument_names());
        let object = json!({ "number": function.0, "name": name, "arguments": arguments, "summary": summary });
        print_result(json, &object, &format!("{:>3} {}: {summary}", function.0, usage(function)))
    })
}

/// Lists all functions and the known commands of the Execute functions, with the effect of a call and whether Slave Mode allows
/// it.
pub(crate) fn effects(json: bool) -> io::Result<()> {
    FunctionId::all().try_for_each(|function| {
        let properties = function.properties(None, None);
        print_effects(&function.to_string(), properties, None, json)?;
        function.commands().try_for_each(|Command { name, properties, source, .. }| {
            print_effects(&format!("{function}/{name}"), *properties, Some(source), json)
        })
    })
}

fn print_effects(name: &str, properties: Properties, source: Option<&str>, json: bool) -> io::Result<()> {
    let (effect, in_slave_mode) = (properties.effect.name(), properties.in_slave_mode.name());
    let object = json!({ "name": name, "effect": effect, "in_slave_mode": in_slave_mode, "source": source });
    let source = source.map(|source| format!("  {source}")).unwrap_or_default();
    print_result(json, &object, format!("{name:<44} {effect:<8} {in_slave_mode:<8}{source}").trim_end())
}

/// Returns the signature of a function: `Robot_Speed(robot, axis, speed)`.
pub(crate) fn usage(function: FunctionId) -> String {
    format!("{function}({})", function.argument_names().join(", "))
}
