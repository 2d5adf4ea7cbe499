//! The pages of the book for the commands: Markdown, made from the command line.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

use clap::{Arg, Command};

/// Writes a page for each command; returns a list with a link to each page.
pub(super) fn write(cli: &mut Command, directory: &Path) -> io::Result<String> {
    fs::create_dir_all(directory)?;
    let mut list = String::new();
    for command in
        cli.get_subcommands_mut().filter(|command| !command.is_hide_set() || command.get_name() == "connection")
    {
        let (name, about) = (command.get_name().to_owned(), command.get_about().map(ToString::to_string));
        if name == "help" {
            continue;
        }
        let _ = writeln!(list, "- [bcap {name}](commands/{name}.md): {}", prose(&about.unwrap_or_default()));
        let mut page = String::new();
        section(&mut page, command, &format!("bcap {name}"), "#");
        fs::write(directory.join(name).with_extension("md"), page)?;
    }
    Ok(list)
}

/// Appends a command and its subcommands.
fn section(page: &mut String, command: &mut Command, title: &str, level: &str) {
    let usage = command.render_usage().to_string();
    let _ = writeln!(page, "{level} {title}\n");
    let about = command.get_long_about().or(command.get_about()).map(ToString::to_string).unwrap_or_default();
    let _ = writeln!(page, "{}\n\n```text,help\n{}\n```\n", prose(&about), usage.trim_start_matches("Usage: "));
    if let Some(after) = command.get_after_long_help().or(command.get_after_help()) {
        let _ = writeln!(page, "```text,help\n{}\n```\n", after.to_string().trim_end());
    }
    for argument in command.get_arguments().filter(|argument| is_shown(argument)) {
        option(page, argument);
    }
    for inner in command.get_subcommands_mut().filter(|inner| inner.get_name() != "help" && !inner.is_hide_set()) {
        let title = format!("{title} {}", inner.get_name());
        section(page, inner, &title, &format!("{level}#"));
    }
}

fn is_shown(argument: &Arg) -> bool {
    !argument.is_hide_set() && !argument.is_hide_long_help_set() && argument.get_id() != "help"
}

/// Appends an argument and its help, as an entry of a definition list.
fn option(page: &mut String, argument: &Arg) {
    let short = argument.get_short().map(|short| format!("-{short}, ")).unwrap_or_default();
    let help = argument.get_long_help().or(argument.get_help()).map(ToString::to_string).unwrap_or_default();
    let mut lines: Vec<_> = help.lines().map(prose).collect();
    let values = |texts: Vec<String>| texts.iter().map(|text| format!("`{text}`")).collect::<Vec<_>>().join(", ");
    let defaults: Vec<_> =
        argument.get_default_values().iter().map(|text| text.to_string_lossy().into_owned()).collect();
    // a flag has the possible values true and false
    let possible = argument.get_possible_values().into_iter().filter(|_| argument.get_action().takes_values());
    let possible: Vec<_> =
        possible.filter(|value| !value.is_hide_set()).map(|value| value.get_name().to_owned()).collect();
    if !possible.is_empty() && !argument.is_hide_possible_values_set() {
        lines.push(format!("\nValues: {}.", values(possible)));
    }
    if !defaults.is_empty() && argument.get_action().takes_values() && !argument.is_hide_default_value_set() {
        lines.push(format!("\nDefault: {}.", values(defaults)));
    }
    if let Some(name) = argument.get_env() {
        lines.push(format!("\nThe environment variable `{}` sets it too.", name.display()));
    }
    let text = lines.join("\n").replace('\n', "\n  ").replace("\n  \n", "\n\n");
    let _ = writeln!(page, "`{short}{argument}`\n: {text}\n");
}

/// Escapes text outside of `code`, in which Markdown has other meanings for some characters.
fn prose(text: &str) -> String {
    let parts = text.split('`').enumerate().map(|(index, part)| match index % 2 {
        0 => {
            part.replace('\\', "\\\\").replace('<', "&lt;").replace('*', "\\*").replace('[', "\\[").replace('_', "\\_")
        }
        _ => part.to_owned(),
    });
    parts.collect::<Vec<_>>().join("`").replace("`bcap help connection`", "[`bcap help connection`](connection.md)")
}
