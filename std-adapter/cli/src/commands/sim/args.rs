//! The arguments of `bcap sim`.

use std::net::SocketAddr;
use std::path::PathBuf;

use bcap_sim::{ArmProfile, Mode, Profile, Token};
use bcap_std::{Address, SerialLine};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};

/// Runs a virtual controller on real sockets
///
/// Prints one line, `ready bcap=IP:PORT udp=IP:PORT rac=IP:PORT`, when it listens, with `serial=PATH?OPTIONS` for each serial line.
/// A model without RAC leaves `rac=IP:PORT` out.
/// Port 0 selects a free port. On SIGINT, SIGTERM and SIGHUP it exits with 0.
///
/// Not simulated, and answered with E_NOTIMPL, because only hardware could answer: force control (ForceSensor, ForceValue,
/// ForceCtrl, ForceParam, ForceWaitCondition, ForceChangeTable); the provider of electric hands; SyncTimeStart, SyncTimeEnd,
/// SyncMoveStart and SyncMoveEnd, which need a second robot; GenerateNonStopPath, which needs a licence. No public source
/// describes scenes (CurScene, CurSubScene, SceneInfo), SetAutoMode and CalcPos of a pallet. HandCurPressure and the
/// commands of other hands (HandGrip, HandRelease) are refused with E_INVALID_CMD_NAME.
/// docs/virtual-controller.md describes every function and command.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap sim
  bcap sim --bcap 127.0.0.1:0 --udp 127.0.0.1:0 --rac 127.0.0.1:0
  bcap sim --scenario faults.toml
  bcap sim --token 192.168.0.5
  bcap sim --replay session.pcapng
  bcap sim --replay session.pcapng --web
  bcap sim --record motion.csv
  bcap sim --record motion.mcap
  bcap sim --screen
  bcap sim --web
  bcap sim --model rc9 --print-model
  bcap sim --model cell7.toml
  bcap sim --model rc9 --arm vs060
  bcap sim --model cobotta --robot-type CVR038A1-NV6
  bcap sim --serial '/dev/ttyUSB0?baud=115200' --no-network
  bcap sim --bcap [::]:5007 --udp [::]:5007 --rac [::]:5006")]
pub(crate) struct Sim {
    /// The address for b-CAP over TCP
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5007")]
    pub(crate) bcap: SocketAddr,

    /// The address for b-CAP over UDP
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5007")]
    pub(crate) udp: SocketAddr,

    /// The address for RAC [default: 127.0.0.1:5006 on a model that has RAC: rc8, rc8a, cobotta]
    ///
    /// With an address, any model serves RAC.
    #[arg(long, value_name = "ADDR")]
    pub(crate) rac: Option<SocketAddr>,

    /// A serial line for b-CAP, written as for --robot, with or without `serial:`; may be given several times
    ///
    /// Its client is at the other end. When the device is unplugged, the controller releases the client's objects, opens the
    /// device again as soon as it is plugged in, and says both on stderr.
    #[arg(long, value_name = "PATH?OPTIONS", value_parser = serial_line)]
    pub(crate) serial: Vec<SerialLine>,

    /// Serves only the serial lines
    #[arg(long, requires = "serial", conflicts_with_all = ["bcap", "udp", "rac"])]
    pub(crate) no_network: bool,

    /// The controller to simulate: rc8, rc8a, rc9, cobotta, cobotta-pro, or a file like those that --print-model prints
    #[arg(long, value_name = "MODEL|FILE.toml", default_value = "rc8", value_parser = model)]
    pub(crate) model: Source<Profile>,

    /// Prints the file of the model, to copy and change, and exits
    #[arg(long)]
    pub(crate) print_model: bool,

    /// The arm, instead of the model's arm: vs060, vs087, hsr065 (four axes), or a file like those that --print-arm
    /// prints
    #[arg(long, value_name = "ARM|FILE.toml", value_parser = arm)]
    pub(crate) arm: Option<Source<ArmProfile>>,

    /// Prints the file of the arm, to copy and change, and exits
    #[arg(long, requires = "arm")]
    pub(crate) print_arm: bool,

    /// The type of the robot, which drivers read as @TYPE_NAME [default: VS060A3; CVR038A1 for a COBOTTA]
    ///
    /// The type does not change the lengths, ranges and speeds of the arm. A scenario sets name, axes and version.
    #[arg(long, value_name = "TYPE")]
    pub(crate) robot_type: Option<String>,

    /// The operation mode at the start
    #[arg(long, value_name = "MODE", default_value = "auto", value_parser = mode())]
    pub(crate) mode: Mode,

    /// The holder of the executable token: any client, the teach pendant, or the clients of one IP address
    ///
    /// Other clients are refused with E_TOKEN_NOT_ETHERNET or E_TOKEN_ADDRESS when they start something.
    #[arg(long, value_name = "any|pendant|IP", default_value = "any", value_parser = token)]
    pub(crate) token: Token,

    /// Starts without a Slave Mode licence
    #[arg(long)]
    pub(crate) no_slave_licence: bool,

    /// A file with the initial state of the controller (errors, type, axes, version, limits) and with faults to inject:
    /// refused calls, errors, the emergency stop, a bad link
    #[arg(long, value_name = "FILE")]
    pub(crate) scenario: Option<PathBuf>,

    /// Answers as the server of a capture did, instead of as a virtual controller
    ///
    /// Each connection of a client replays the next connection of the capture. A request gets the reply of the next
    /// call with the same function and arguments, at once. A request that the capture does not have is refused with
    /// E_FAIL and printed on stderr.
    #[arg(long, value_name = "FILE.pcapng", conflicts_with_all = [
        "model", "print_model", "arm", "robot_type", "mode", "token", "no_slave_licence", "scenario", "record", "files", "explain", "lenient",
    ])]
    pub(crate) replay: Option<PathBuf>,

    /// Writes the trajectory of the arm to a file: the axes and the tool centre point every 8 ms while the arm moves
    ///
    /// A name that ends with .mcap makes an MCAP file for Foxglove and PlotJuggler, with the topic /arm; its times are those of
    /// the controller's clock. Any other name makes a CSV file with the columns time_s, J1 to J8 (degrees, mm), X, Y, Z (mm), RX,
    /// RY, RZ (degrees), tool, work. Time passes when clients call, and with --screen always, so the file ends with the last
    /// call.
    #[arg(long, value_name = "FILE")]
    pub(crate) record: Option<PathBuf>,

    /// Shows the state, the pose, the tasks, the connections and the last calls live in the terminal; `q` quits
    ///
    /// The refused arguments of --explain are part of the screen. `bcap monitor --help` says what the terminal needs.
    #[cfg(feature = "screens")]
    #[arg(long, conflicts_with = "replay")]
    pub(crate) screen: bool,

    /// Serves the page of `bcap web` for this controller, with a panel: scenarios, faults of the link, the time factor
    ///
    /// The line `ready` ends with its address, `web=http://IP:PORT/#token=TOKEN`. The page may write and move, because nothing real
    /// moves; each action is a line of the output. With --replay the page shows the recorded session, without a panel, and only
    /// reads. [default address: 127.0.0.1:8011]
    #[cfg(feature = "web")]
    #[arg(long, value_name = "IP:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8011")]
    #[arg(conflicts_with = "no_network")]
    #[cfg_attr(feature = "screens", arg(conflicts_with = "screen"))]
    pub(crate) web: Option<SocketAddr>,

    /// The folder of the controller's files; clients see its regular files and folders [default: a temporary
    /// folder with a source file for each task]
    #[arg(long, value_name = "DIR")]
    pub(crate) files: Option<PathBuf>,

    /// Prints on stderr why an argument was refused: the call, the refused value, the accepted values
    ///
    /// GetErrorDescription of the code returns the same text.
    #[arg(long)]
    pub(crate) explain: bool,

    /// Accepts the provider of another model and unknown options, and prints each of them on stderr
    ///
    /// Without it, Controller_Connect answers E_CAO_PROV_INVALID, and other functions E_INVALIDARG.
    #[arg(long)]
    pub(crate) lenient: bool,
}

/// Parses a serial line, with or without `serial:`.
fn serial_line(text: &str) -> Result<SerialLine, String> {
    let has_scheme = text.get(..7).is_some_and(|scheme| scheme.eq_ignore_ascii_case("serial:"));
    let address = if has_scheme { text.to_owned() } else { format!("serial:{text}") };
    match address.parse::<Address>() {
        Ok(Address::Serial(line)) => Ok(line),
        Ok(_) => Err("write the path of a serial device, such as /dev/ttyUSB0".into()),
        Err(error) => Err(error.to_string()),
    }
}

/// The source of a model or an arm.
#[derive(Clone, Debug)]
pub(crate) enum Source<T> {
    BuiltIn(T),
    File(PathBuf),
}

impl<T: Copy> Source<T> {
    /// Finds a built-in source by its name, or takes the text as the name of a file.
    fn find(text: &str, all: &[(&str, T)]) -> Result<Self, String> {
        let name = text.to_ascii_lowercase();
        match all.iter().find(|(known, _)| *known == name) {
            Some((_, found)) => Ok(Self::BuiltIn(*found)),
            None if name.ends_with(".toml") => Ok(Self::File(text.into())),
            None => {
                let names: Vec<&str> = all.iter().map(|(known, _)| *known).collect();
                Err(format!("it is {}, or a file whose name ends with .toml", names.join(", ")))
            }
        }
    }
}

/// Parses a model.
pub(crate) fn model(text: &str) -> Result<Source<Profile>, String> {
    const NAMES: [&str; 5] = ["rc8", "rc8a", "rc9", "cobotta", "cobotta-pro"];
    let all: Vec<_> = NAMES.into_iter().zip(Profile::ALL).collect();
    Source::find(text, &all)
}

fn arm(text: &str) -> Result<Source<ArmProfile>, String> {
    Source::find(text, &ArmProfile::ALL.map(|arm| (arm.name(), arm)))
}

/// Parses an operation mode.
fn mode() -> impl TypedValueParser<Value = Mode> {
    PossibleValuesParser::new(["manual", "teach-check", "auto"]).map(|mode| match mode.as_str() {
        "manual" => Mode::Manual,
        "teach-check" => Mode::TeachCheck,
        _ => Mode::Auto,
    })
}

/// Parses the holder of the executable token.
fn token(text: &str) -> Result<Token, String> {
    match text {
        "any" => Ok(Token::Any),
        "pendant" => Ok(Token::TeachPendant),
        address => match address.parse() {
            Ok(address) => Ok(Token::Address(address)),
            Err(_) => Err("it is any, pendant, or an IP address".into()),
        },
    }
}
