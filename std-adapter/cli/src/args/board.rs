//! The arguments of `bcap board`.

use clap::{Args, Subcommand};

/// Changes the settings of a gateway board over a serial line
#[derive(Debug, Args)]
pub(crate) struct Board {
    #[command(subcommand)]
    pub(crate) command: BoardCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum BoardCommand {
    Configure(Configure),
}

/// Replaces all settings of a board, or prints them
///
/// Without settings as arguments the command prints those of the board. Otherwise it replaces all of them in the flash of the
/// board, and prints the answer to each. The board uses them after a restart. Settings are checked before anything is sent,
/// and again by the board. A power cut leaves the earlier settings or the new ones.
///
/// --timeout limits each answer.
#[derive(Debug, Args)]
#[command(after_help = "\
Settings, among others:
  robot=192.168.0.1:5007               the robot controller; udp:ADDRESS:PORT over UDP
  address=192.168.0.9/24               the board's own address, if no DHCP server answers
  hostname=cell-7                      its name for DHCP
  put=I/0-99=-10..10                   what PLCs may write, and the accepted values; can be repeated
  allow=192.168.0.0/24                 the clients that may connect; can be repeated
Examples:
  bcap board configure /dev/ttyACM0 >board.conf
  bcap board configure /dev/ttyACM0 robot=192.168.0.1:5007 put=I/0-99 --restart
  bcap board configure /dev/ttyACM0 @board.conf hostname=cell-7
  bcap board configure /dev/ttyACM0 --factory")]
pub(crate) struct Configure {
    /// The serial port, such as /dev/ttyACM0 or COM3
    pub(crate) port: String,

    /// The settings: KEY=VALUE, or @FILE with one on each line and comments after #
    #[arg(value_name = "SETTING")]
    pub(crate) settings: Vec<String>,

    /// The rate of the serial line, in bits a second; a USB port ignores it
    #[arg(long, value_name = "RATE", default_value_t = 115_200)]
    pub(crate) baud: u32,

    /// Removes the settings from the flash, so those of the image count
    #[arg(long, conflicts_with = "settings")]
    pub(crate) factory: bool,

    /// Restarts the board at the end, so it uses its settings
    #[arg(long)]
    pub(crate) restart: bool,
}
