//! `bcap board update` and `bcap board status`.

use std::path::PathBuf;

use bcap_provision::signature::{Key, Signature};
use bcap_provision::{Console, image, update};
use bcap_terminal::progress::{Progress, bar};
use clap::Args;
use serde_json::json;

use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::output;

/// Replaces the image of a board, which goes back to the earlier one if the new one does not work
///
/// The board must have a boot loader and an image that was built for updates. It receives the new image into a second partition
/// while its gateway runs; each erased sector pauses the gateway. After the restart the boot loader swaps the images, and the new one
/// is on trial: it is confirmed when it has served a request of a PLC, within 10 minutes and without another restart. Otherwise the
/// earlier image returns. A power cut at any moment leaves one of the two images.
///
/// An image for another board is refused before anything is erased. Lost and damaged blocks are sent again.
///
/// A board whose image has a key (`bcap board key`) takes signed images only: use --key or --signature. Over the network, tcp:HOST, it
/// takes them from the hosts of its setting update=ADDRESS.
///
/// --timeout limits each answer.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap board update /dev/ttyACM0 target/thumbv6m-none-eabi/release/w5500-evb-pico+updates
  bcap board update /dev/ttyACM0 gateway.bin --no-restart
  bcap board update tcp:192.168.0.9 w5500-evb-pico+updates --key plant.key")]
pub(crate) struct Update {
    /// The serial port, such as /dev/ttyACM0 or COM3, or tcp:HOST[:PORT]
    pub(crate) port: String,

    /// The image: an ELF file, or a binary that starts with its vector table
    #[arg(value_name = "IMAGE")]
    pub(crate) image: PathBuf,

    /// The rate of the serial line, in bits a second; a USB port ignores it
    #[arg(long, value_name = "RATE", default_value_t = 115_200)]
    pub(crate) baud: u32,

    /// Leaves the earlier image running until the next start of the board
    #[arg(long)]
    pub(crate) no_restart: bool,

    /// Sends the image although settings that only the earlier image has are lost
    #[arg(long)]
    pub(crate) force: bool,

    /// Signs the image with the secret key in this file
    #[arg(long, value_name = "FILE", conflicts_with = "signature")]
    pub(crate) key: Option<PathBuf>,

    /// Sends the signature in this file, which `bcap board sign` wrote
    #[arg(long, value_name = "FILE")]
    pub(crate) signature: Option<PathBuf>,

    /// Lets a board with a key take an image that is older than its own; over a serial port only
    #[arg(long)]
    pub(crate) older: bool,
}

/// Prints the version of a board, and whether its last update was confirmed or rolled back
///
/// --timeout limits the answer.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  bcap board status /dev/ttyACM0")]
pub(crate) struct BoardStatus {
    /// The serial port, such as /dev/ttyACM0 or COM3, or tcp:HOST[:PORT]
    pub(crate) port: String,

    /// The rate of the serial line, in bits a second; a USB port ignores it
    #[arg(long, value_name = "RATE", default_value_t = 115_200)]
    pub(crate) baud: u32,
}

/// Prints the version of a board, and what became of its last update.
pub(super) fn status(args: &BoardStatus, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let status = update::status(&mut Console::open(&args.port, args.baud, link.timeout())?)?;
    Ok(output::print_result(json, &json!({ "status": status }), &status)?)
}

/// Sends an image to a board, and restarts it.
pub(super) fn send(args: &Update, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    // the image is checked before the port is opened
    let (image, identity) = image::read(&args.image)?;
    let signature = match (&args.key, &args.signature) {
        (Some(key), _) => Some(Signature::by_key(&image, &identity, &Key::read(key)?)?),
        (None, Some(file)) => Some(Signature::of_file(&image, &identity, file)?),
        (None, None) => None,
    };
    let mut console = Console::open(&args.port, args.baud, link.timeout())?;
    // over the network the board itself checks that
    if !args.force && !console.is_network() {
        let how = ": `bcap board configure PORT` prints them, and with @FILE it stores them; or use --force";
        update::check_settings(&mut console).map_err(|error| Failure::from(error).hinting(how))?;
    }
    update::announce(&mut console, &image, &identity, signature.as_ref(), args.older)?;
    let mut progress = Progress::default();
    let total = image.len() as u64;
    let repeated = update::send(&mut console, &image, |sent| {
        let sent = sent as u64;
        progress.show(|elapsed| format!("{} {}/{} KiB {elapsed}", bar(sent, total), sent >> 10, total >> 10));
    })?;
    update::install(&mut console)?;
    if !args.no_restart {
        update::restart(&mut console)?;
    }
    let (board, version) = (identity.board(), identity.version());
    let (bytes, restarted) = (image.len(), !args.no_restart);
    let object =
        json!({ "board": board, "version": version, "bytes": bytes, "repeated": repeated, "restarted": restarted });
    let again = if repeated == 0 { String::new() } else { format!(", {repeated} blocks were sent again") };
    output::print_result(json, &object, &format!("{board} {version}: {bytes} bytes received and checked{again}"))?;
    if !json {
        output::note(match restarted {
            true => {
                "the board swaps the images and is on trial until it has served a request; ask it with bcap board status"
            }
            false => "the board swaps the images at its next start",
        });
    }
    Ok(())
}
