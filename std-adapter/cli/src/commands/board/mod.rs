//! `bcap board`: the settings and the image of a board over a serial line, its image also over TCP, in the protocol of
//! [`bcap_board::console`]; its first image over a drive; its address.

mod elf;
mod find;
mod flash;
mod image;
mod key;
mod port;
mod uf2;
pub(crate) mod update;

use std::fs;

use bcap_board::Settings;
use bcap_board::console::LINE;
use bcap_board::crc::Crc32;
use bcap_board::slots::TEXT;
use clap::{Args, Subcommand};

use self::find::Find;
use self::flash::{Convert, Flash};
use self::key::{Key, Sign};
use self::port::{Answer, Port};
use self::update::{Status, Update};
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
    Status(Status),
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

/// The hint after a refused change of the settings.
const SETTINGS_REMAIN: &str = "the settings of the board are unchanged";

pub(crate) fn board(args: &Board, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    match &args.command {
        BoardCommand::Find(args) => find::find(args, link, json),
        BoardCommand::Configure(args) => configure(args, link, json),
        BoardCommand::Flash(args) => flash::flash(args, link, json),
        BoardCommand::Convert(args) => flash::convert(args, json),
        BoardCommand::Update(args) => update::update(args, link, json),
        BoardCommand::Status(args) => update::status(args, link, json),
        BoardCommand::Key(args) => key::key(args, json),
        BoardCommand::Sign(args) => key::sign(args, json),
    }
}

fn configure(args: &Configure, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    // the settings are checked before the port is opened
    let settings = read(&args.settings)?;
    let mut port = Port::open(&args.port, args.baud, link.timeout())?;
    if args.factory {
        request(&mut port, "factory", json)?;
    } else if !args.settings.is_empty() {
        replace(&mut port, &settings, json)?;
    } else if !args.restart {
        show(&mut port, json)?;
    }
    if args.restart {
        request(&mut port, "restart", json)?;
    }
    Ok(())
}

/// Reads and checks the settings of the command line; each ends with a line feed.
fn read(arguments: &[String]) -> Result<String, Failure> {
    let mut settings = String::new();
    let mut add = |line: &str| settings.extend([line, "\n"]);
    for argument in arguments {
        match argument.strip_prefix('@') {
            Some(path) => {
                let text = fs::read_to_string(path).map_err(|error| Failure::Input(format!("{path}: {error}")))?;
                Settings::lines_of_file(&text).for_each(&mut add);
            }
            None => add(argument),
        }
    }
    Settings::check(settings.as_bytes()).map_err(|error| Failure::Input(error.to_string()))?;
    let most = LINE - "add ".len();
    if let Some(line) = settings.lines().find(|line| line.len() > most || line.is_empty()) {
        return Err(Failure::Input(format!(
            "a setting has 1 to {most} bytes, but this has {}: \"{line}\"",
            line.len()
        )));
    }
    if settings.len() > TEXT {
        return Err(Failure::Input(format!("the settings take {} bytes of {TEXT}", settings.len())));
    }
    Ok(settings)
}

/// Replaces the settings of the board. They change with the last request, so an earlier failure changes nothing.
fn replace(port: &mut Port, settings: &str, json: bool) -> Result<(), Failure> {
    port.ask("new", |_| Ok(()))?.accepted("new", SETTINGS_REMAIN)?;
    for line in settings.lines() {
        request(port, &format!("add {line}"), json)?;
    }
    let crc = Crc32::new().and(settings.as_bytes()).value();
    request(port, &format!("save {crc:08x}"), json)
}

/// Sends a request and prints it with its answer.
fn request(port: &mut Port, request: &str, json: bool) -> Result<(), Failure> {
    let answer = port.ask(request, |_| Ok(()))?;
    let object = serde_json::json!({ "request": request, "answer": answer.0 });
    output::print_result(json, &object, &format!("{request}: {}", answer.0))?;
    answer.accepted(request, SETTINGS_REMAIN)
}

/// Prints the settings of the board in the format of `@FILE`, and where they are stored.
fn show(port: &mut Port, json: bool) -> Result<(), Failure> {
    let print = |setting: &str| output::print_result(json, &serde_json::json!({ "setting": setting }), setting);
    let answer = port.ask("show", print)?;
    let Answer(text) = &answer;
    match text.as_str() {
        "ok flash" => output::note("these settings are in the flash of the board"),
        "ok image" => output::note("these settings are those of the image; the flash has none"),
        _ => {}
    }
    answer.accepted("show", SETTINGS_REMAIN)
}
