//! `bcap board`: the settings, the images and the addresses of gateway boards, by [`bcap_provision`].

mod find;
mod flash;
mod key;
pub(crate) mod update;

use bcap_provision::{Answer, Console, settings};
use clap::{Args, Subcommand};

use self::find::Find;
use self::flash::{Convert, Flash};
use self::key::{Key, Sign};
use self::update::{BoardStatus, Update};
use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::output;

/// Finds gateway boards, and changes their settings and images
#[derive(Debug, Args)]
pub(crate) struct Board {
    #[command(subcommand)]
    pub(crate) command: BoardCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum BoardCommand {
    Find(Find),
    Configure(Configure),
    Flash(Flash),
    Convert(Convert),
    Update(Update),
    Status(BoardStatus),
    Key(Key),
    Sign(Sign),
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

pub(crate) fn board(args: &Board, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    match &args.command {
        BoardCommand::Find(args) => find::find(args, link, json),
        BoardCommand::Configure(args) => configure(args, link, json),
        BoardCommand::Flash(args) => flash::flash(args, link, json),
        BoardCommand::Convert(args) => flash::convert(args, json),
        BoardCommand::Update(args) => update::send(args, link, json),
        BoardCommand::Status(args) => update::status(args, link, json),
        BoardCommand::Key(args) => key::key(args, json),
        BoardCommand::Sign(args) => key::sign(args, json),
    }
}

fn configure(args: &Configure, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    // the settings are checked before the port is opened
    let settings = settings::read(&args.settings)?;
    let mut console = Console::open(&args.port, args.baud, link.timeout())?;
    let accepted = |request: &str, answer: &Answer| {
        let object = serde_json::json!({ "request": request, "answer": answer.text });
        output::print_result(json, &object, &format!("{request}: {}", answer.text)).map_err(Failure::from)
    };
    if args.factory {
        accepted("factory", &settings::request(&mut console, "factory")?)?;
    } else if !args.settings.is_empty() {
        settings::replace(&mut console, &settings, accepted)?;
    } else if !args.restart {
        show(&mut console, json)?;
    }
    if args.restart {
        accepted("restart", &settings::request(&mut console, "restart")?)?;
    }
    Ok(())
}

/// Prints the settings of the board in the format of `@FILE`, and where they are stored.
fn show(console: &mut Console, json: bool) -> Result<(), Failure> {
    let answer = settings::request(console, "show")?;
    for setting in &answer.settings {
        output::print_result(json, &serde_json::json!({ "setting": setting }), setting)?;
    }
    match answer.text.as_str() {
        "ok flash" => output::note("these settings are in the flash of the board"),
        "ok image" => output::note("these settings are those of the image; the flash has none"),
        _ => {}
    }
    Ok(())
}
