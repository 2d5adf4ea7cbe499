//! `bcap board key` and `bcap board sign`: the keys and signatures of images.

use std::fs;
use std::path::{Path, PathBuf};

use bcap_provision::image;
use bcap_provision::signature::{self, Signature};
use clap::Args;
use serde_json::json;

use crate::failure::{Failure, of_file};
use crate::output;

/// Makes a key pair for signed updates
///
/// The secret key is written into a new file, which only its owner can read. Keep it off the network: with it, anyone can install any
/// image. The public key is printed; build it into the image and its boot loader with the variable BCAP_BOARD_KEY. The board then
/// takes only images that are signed with the secret key.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  bcap board key plant.key
  BCAP_BOARD_KEY=$(bcap board key --show plant.key) embassy-adapter/boards/build w5500-evb-pico-boot w5500-evb-pico+updates")]
pub(crate) struct Key {
    /// The file of the secret key
    pub(crate) file: PathBuf,

    /// Prints the public key of an existing file
    #[arg(long)]
    pub(crate) show: bool,
}

/// Signs an image, for a computer that sends it without the key
///
/// Writes the signature into IMAGE.sig, for `bcap board update --signature`. The signature covers the board, the version and
/// all bytes of the image.
#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  bcap board sign w5500-evb-pico+updates --key plant.key")]
pub(crate) struct Sign {
    /// The image: an ELF file, or a binary that starts with its vector table
    pub(crate) image: PathBuf,

    /// The file of the secret key
    #[arg(long, value_name = "FILE")]
    pub(crate) key: PathBuf,
}

pub(super) fn key(args: &Key, json: bool) -> Result<(), Failure> {
    let key = match args.show {
        true => signature::Key::read(&args.file)?,
        false => signature::Key::make(&args.file)?,
    };
    let public = key.public().to_string();
    output::print_result(json, &json!({ "key": public }), &public)?;
    if !args.show {
        output::note(
            "the public key; build it into the image and the boot loader with BCAP_BOARD_KEY, and keep the file secret",
        );
    }
    Ok(())
}

pub(super) fn sign(args: &Sign, json: bool) -> Result<(), Failure> {
    let (image, identity) = image::read(&args.image)?;
    let signature = Signature::by_key(&image, &identity, &signature::Key::read(&args.key)?)?;
    let path = format!("{}.sig", args.image.display());
    fs::write(&path, signature.text() + "\n").map_err(of_file(Path::new(&path)))?;
    let text = format!("{path}: {} {} signed", identity.board(), identity.version());
    Ok(output::print_result(json, &json!({ "signature": path }), &text)?)
}
