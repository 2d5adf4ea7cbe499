//! `bcap profile`: lists and shows profiles.

use clap::{Args, Subcommand};
use serde_json::{Value, json};

use crate::failure::Failure;
use crate::link::profiles::{Profile, Profiles};
use crate::output::{print_json, print_line, print_result};

/// Lists and shows profiles: connections to controllers under a name
///
/// The profiles are in ~/.config/bcap/config.toml, or in bcap/config.toml below XDG_CONFIG_HOME. --profile NAME or
/// BCAP_PROFILE chooses one. An option of the command line overrides its environment variable, which overrides the profile.
/// `halt` ignores the timeout of a profile, and with --robot also a profile that cannot be read.
#[derive(Debug, Args)]
#[command(after_help = "\
The file:
  [profile.cell1]
  address = \"tcp:192.168.0.1\"
  model = \"rc9\"                # as for --provider, which is the other name of this key
  option = \"\"
  rac_port = 5006
  timeout = \"3s\"
Examples:
  bcap profile list
  bcap profile show cell1
  bcap --profile cell1 get I1")]
pub(crate) struct ProfileArgs {
    #[command(subcommand)]
    pub(crate) command: ProfileCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum ProfileCommand {
    /// Prints the names and addresses of all profiles
    List,
    /// Prints the values of a profile
    Show {
        /// The name of the profile
        name: String,
    },
}

/// Runs `bcap profile`.
pub(crate) fn profile(args: &ProfileArgs, json: bool) -> Result<(), Failure> {
    let profiles = Profiles::read()?;
    match &args.command {
        ProfileCommand::List if profiles.by_name.is_empty() && !json => {
            Ok(print_line(&format!("{} has no profiles", profiles.path.display()))?)
        }
        ProfileCommand::List => profiles.by_name.iter().try_for_each(|(name, profile)| list(name, profile, json)),
        ProfileCommand::Show { name } => show(name, profiles.find(name)?, json),
    }
}

fn list(name: &str, profile: &Profile, json: bool) -> Result<(), Failure> {
    let shown = format!("{name}: {}", profile.address.as_deref().unwrap_or("no address"));
    Ok(print_result(json, &object(name, profile), &shown)?)
}

fn show(name: &str, profile: &Profile, json: bool) -> Result<(), Failure> {
    let object = object(name, profile);
    if json {
        return Ok(print_json(&object.to_string())?);
    }
    print_line(&format!("[profile.{name}]"))?;
    for key in ["address", "provider", "machine", "option", "rac_port"] {
        // text and numbers have the same form in JSON and TOML
        if let Some(value) = object.get(key).filter(|value| !value.is_null()) {
            print_line(&format!("{key} = {value}"))?;
        }
    }
    let timeout = object["timeout_ms"].as_u64();
    Ok(timeout.map_or(Ok(()), |ms| print_line(&format!("timeout = \"{ms}ms\"")))?)
}

fn object(name: &str, profile: &Profile) -> Value {
    json!({
        "name": name, "address": profile.address, "provider": profile.provider, "machine": profile.machine,
        "option": profile.option, "rac_port": profile.rac_port,
        "timeout_ms": profile.timeout.and_then(|timeout| u64::try_from(timeout.as_millis()).ok()),
    })
}
