//! `bcap board update` and `bcap board status`.

use bcap_board::crc::Crc32;
use bcap_board::identity::BLOCK;
use bcap_terminal::progress::{Progress, bar};
use clap::Args;
use serde_json::json;

use super::image::read;
use super::key::{Signature, manifest};
use super::port::{Answer, Port};
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
    pub(crate) image: String,

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
    pub(crate) key: Option<String>,

    /// Sends the signature in this file, which `bcap board sign` wrote
    #[arg(long, value_name = "FILE")]
    pub(crate) signature: Option<String>,

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
pub(crate) struct Status {
    /// The serial port, such as /dev/ttyACM0 or COM3, or tcp:HOST[:PORT]
    pub(crate) port: String,

    /// The rate of the serial line, in bits a second; a USB port ignores it
    #[arg(long, value_name = "RATE", default_value_t = 115_200)]
    pub(crate) baud: u32,
}

/// How often a block is sent before the command gives up.
const ATTEMPTS: u32 = 5;
/// The hint after a refused update.
const IMAGE_REMAINS: &str = "the board runs its earlier image";

/// Prints the version of a board, and what became of its last update.
pub(super) fn status(args: &Status, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let mut port = Port::open(&args.port, args.baud, link.timeout())?;
    let answer = ask(&mut port, "status")?;
    let status = answer.0.strip_prefix("ok ").unwrap_or(&answer.0);
    Ok(output::print_result(json, &json!({ "status": status }), status)?)
}

/// Sends an image to a board, and restarts it.
pub(super) fn update(args: &Update, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    // the image is checked before the port is opened
    let (image, identity) = read(&args.image)?;
    let crc = Crc32::new().and(&image).value();
    let manifest = manifest(&args.image, &image, &identity)?;
    let signature = match (&args.key, &args.signature) {
        (Some(key), _) => Some(Signature::by_key(&manifest, key)?),
        (None, Some(file)) => Some(Signature::of_file(&manifest, file)?),
        (None, None) => None,
    };
    let mut port = Port::open(&args.port, args.baud, link.timeout())?;
    // over the network the board itself checks that
    if !args.force && !port.is_network() {
        check_settings(&mut port)?;
    }
    let (board, version) = (identity.board(), identity.version());
    let older = if args.older { " older" } else { "" };
    ask(&mut port, &format!("update {board} {version} {} {crc:08x}{older}", image.len()))?;
    if let Some(signature) = signature {
        ask(&mut port, &format!("sign {}", signature.text()))?;
    }
    let repeated = send(&mut port, &image)?;
    // answers to blocks that were sent twice
    port.skip_answers()?;
    ask(&mut port, "install")?;
    if !args.no_restart {
        ask(&mut port, "restart")?;
    }
    let (bytes, restarted) = (image.len(), !args.no_restart);
    if json {
        let line =
            json!({ "board": board, "version": version, "bytes": bytes, "repeated": repeated, "restarted": restarted });
        output::print_json(&line.to_string())?;
    } else {
        let repeated = if repeated == 0 { String::new() } else { format!(", {repeated} blocks were sent again") };
        output::print_line(&format!("{board} {version}: {bytes} bytes received and checked{repeated}"))?;
        output::note(match restarted {
            true => {
                "the board swaps the images and is on trial until it has served a request; ask it with bcap board status"
            }
            false => "the board swaps the images at its next start",
        });
    }
    Ok(())
}

/// Fails if the settings of the board are a part of its image, which the update replaces.
fn check_settings(port: &mut Port) -> Result<(), Failure> {
    let mut count = 0_u32;
    let answer = port.ask("show", |_| {
        count += 1;
        Ok(())
    })?;
    if count == 0 || answer.0 != "ok image" {
        return Ok(());
    }
    Err(Failure::unfit(
        "the settings of the board are those of its image, which the new one replaces",
        "store them in the flash first: `bcap board configure PORT` prints them, and with @FILE it stores them; or use --force",
    ))
}

/// Sends the image in blocks; returns how many were sent again.
fn send(port: &mut Port, image: &[u8]) -> Result<u32, Failure> {
    let (mut progress, mut repeated) = (Progress::default(), 0);
    for (number, data) in (0..).zip(image.chunks(BLOCK)) {
        let crc = Crc32::new().and(&u32::to_le_bytes(number)).and(data).value();
        let digits: String = data.iter().map(|byte| format!("{byte:02x}")).collect();
        let request = format!("block {number} {crc:08x} {digits}");
        let mut attempts = 0;
        while let Some(reason) = port.send_block(&request, number)? {
            attempts += 1;
            if attempts == ATTEMPTS {
                let message = format!("block {number} failed {ATTEMPTS} times: {reason}");
                return Err(Failure::unfit(message, IMAGE_REMAINS));
            }
            repeated += 1;
        }
        let (sent, total) = (u64::from(number) * BLOCK as u64, image.len() as u64);
        progress.show(|elapsed| format!("{} {}/{} KiB {elapsed}", bar(sent, total), sent >> 10, total >> 10));
    }
    Ok(repeated)
}

/// Sends a request; fails if the board refuses it.
fn ask(port: &mut Port, request: &str) -> Result<Answer, Failure> {
    let answer = port.ask(request, |_| Ok(()))?;
    // an image older than updates, or one without them
    if answer.0.starts_with("error unknown request") {
        return Err(Failure::unfit(
            "the board cannot be updated: its image was built without updates",
            "flash the boot loader and an image with updates once, as the README of the board says",
        ));
    }
    answer.accepted(request, IMAGE_REMAINS)?;
    Ok(answer)
}
