//! The arguments of `bcap profile`.

use clap::{Args, Subcommand};

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
  model = \"rc9\"                # rc8, rc9 or cobotta; or provider = \"CaoProv.DENSO.VRC9\"
  option = \"\"
  rac_port = 5006
  timeout = \"3s\"
Examples:
  bcap profile list
  bcap profile show cell1
  bcap --profile cell1 get I1")]
pub(crate) struct Profile {
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
