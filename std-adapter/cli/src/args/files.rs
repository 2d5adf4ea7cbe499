//! The arguments of `bcap ls` and `bcap cp`.

use clap::Args;

/// Lists files and folders of the controller
///
/// A folder ends with /. PATH may have the wildcards * and ?; quote them. Case does not matter there.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap ls
  bcap ls --long '/*.pcs'
  bcap ls --recursive --json")]
pub(crate) struct Ls {
    /// A folder or file of the controller; robot: before it is optional
    #[arg(default_value = "/")]
    pub(crate) path: String,

    /// Lists all files below each folder
    #[arg(short, long)]
    pub(crate) recursive: bool,

    /// Prints the size of each file in bytes before its name
    #[arg(short, long)]
    pub(crate) long: bool,
}

/// Copies files to or from the controller
///
/// robot: marks the side of the controller: robot:/Pro1.pcs. A path of the controller may have the wildcards * and ?; quote
/// them. DEST is a folder if it ends with /, exists as a folder, or there are several sources. All destinations are checked
/// before the first file is copied; an existing file is replaced only with --force. A file that was written to the
/// controller is read back and compared. A file of this machine is never half written.
///
/// A controller stores text: UTF-8 is sent as a string, other bytes as an array of bytes. Over UDP a file must fit one
/// datagram of at most 504 bytes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap cp Pro1.pcs robot:/
  bcap cp robot:/Pro1.pcs Pro1-copy.pcs
  bcap cp --force 'robot:/*.pcs' programs/
  bcap cp --recursive robot:/ all/")]
pub(crate) struct Cp {
    /// The files, and where to copy them
    #[arg(value_names = ["SOURCE", "DEST"], required = true, num_args = 2..)]
    pub(crate) paths: Vec<String>,

    /// Replaces files that exist
    #[arg(short, long)]
    pub(crate) force: bool,

    /// Copies folders with all files below them
    #[arg(short, long)]
    pub(crate) recursive: bool,
}
