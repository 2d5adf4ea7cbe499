//! The arguments of `bcap board`.

use clap::{Args, Subcommand};

/// Changes the settings and the image of a gateway board over a serial line
#[derive(Debug, Args)]
pub(crate) struct Board {
    #[command(subcommand)]
    pub(crate) command: BoardCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum BoardCommand {
    Configure(Configure),
    Update(Update),
    Status(Status),
}

/// Replaces all settings of a board, or prints them
///
/// Without settings as arguments the command prints the board's settings. Otherwise it replaces all settings in the
/// flash of the board, and prints the answer to each. The board uses them after a restart. Settings are checked before
/// anything is sent, and again by the board. A power cut leaves the earlier settings or the new ones.
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

    /// Removes the settings from the flash, so that the image's defaults apply
    #[arg(long, conflicts_with = "settings")]
    pub(crate) factory: bool,

    /// Restarts the board at the end, so it uses its settings
    #[arg(long)]
    pub(crate) restart: bool,
}

/// Replaces the image of a board, which goes back to the earlier one if the new one does not work
///
/// The board must have a boot loader and an image that was built for updates. It receives the new image into a second partition
/// while its gateway runs; each erased sector pauses the gateway. After the restart the boot loader swaps the images, and the new one
/// is on trial: it is confirmed when it has served a request of a PLC, within 10 minutes and without another restart. Otherwise the
/// earlier image returns. A power cut at any moment leaves one of the two images.
///
/// An image for another board is refused before anything is erased. Lost and damaged blocks are sent again.
///
/// --timeout limits each answer.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap board update /dev/ttyACM0 target/thumbv6m-none-eabi/release/w5500-evb-pico+updates
  bcap board update /dev/ttyACM0 gateway.bin --no-restart")]
pub(crate) struct Update {
    /// The serial port, such as /dev/ttyACM0 or COM3
    pub(crate) port: String,

    /// The image: an ELF file, or a binary that starts with its vector table
    #[arg(value_name = "IMAGE")]
    pub(crate) image: String,

    /// The rate of the serial line, in bits a second; a USB port ignores it
    #[arg(long, value_name = "RATE", default_value_t = 115_200)]
    pub(crate) baud: u32,

    /// Leaves the earlier image running until the next start of the board
    #[arg(long)]
    pub(crate) no_restart: bool,
}

/// Prints the version of a board, and whether its last update was confirmed or rolled back
///
/// --timeout limits the answer.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  bcap board status /dev/ttyACM0")]
pub(crate) struct Status {
    /// The serial port, such as /dev/ttyACM0 or COM3
    pub(crate) port: String,

    /// The rate of the serial line, in bits a second; a USB port ignores it
    #[arg(long, value_name = "RATE", default_value_t = 115_200)]
    pub(crate) baud: u32,
}
