//! `bcap board key` and `bcap board sign`: the keys and signatures of images.

use std::fs::{self, OpenOptions};
use std::io::Write;

use bcap_board::signature::{KEY_SIZE, Manifest, SIGNATURE, public_of};
use clap::Args;
use serde_json::json;

use super::image::read;
use crate::failure::Failure;
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
    pub(crate) file: String,

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
    pub(crate) image: String,

    /// The file of the secret key
    #[arg(long, value_name = "FILE")]
    pub(crate) key: String,
}

/// The signature of an image: its SHA-512, and the signature of this and the image's name.
pub(super) struct Signature {
    digest: [u8; SIGNATURE],
    signature: [u8; SIGNATURE],
}

impl Signature {
    /// Signs with the key in a file.
    pub(super) fn by_key(manifest: &Manifest<'_>, path: &str) -> Result<Self, Failure> {
        Ok(Self { digest: manifest.digest, signature: manifest.sign(&secret(path)?) })
    }

    /// Reads the file that `sign` wrote.
    pub(super) fn of_file(manifest: &Manifest<'_>, path: &str) -> Result<Self, Failure> {
        let text = fs::read_to_string(path).map_err(|error| Failure::Input(format!("{path}: {error}")))?;
        let parts =
            text.trim().split_once(' ').and_then(|(digest, signature)| Some((bytes(digest)?, bytes(signature)?)));
        let Some((digest, signature)) = parts else {
            return Err(Failure::Input(format!("{path}: not a signature of `bcap board sign`")));
        };
        if digest != manifest.digest {
            return Err(Failure::Input(format!("{path}: the signature is for another image")));
        }
        Ok(Self { digest, signature })
    }

    /// Returns both parts in hexadecimal, as the board and the file have them.
    pub(super) fn text(&self) -> String {
        format!("{} {}", digits(&self.digest), digits(&self.signature))
    }
}

pub(super) fn key(args: &Key, json: bool) -> Result<(), Failure> {
    let path = args.file.as_str();
    let secret = match args.show {
        true => secret(path)?,
        false => make(path)?,
    };
    let public = public_of(&secret).to_string();
    output::print_result(json, &json!({ "key": public }), &public)?;
    if !args.show {
        output::note(
            "the public key; build it into the image and the boot loader with BCAP_BOARD_KEY, and keep the file secret",
        );
    }
    Ok(())
}

pub(super) fn sign(args: &Sign, json: bool) -> Result<(), Failure> {
    let (image, identity) = read(&args.image)?;
    let signature = Signature::by_key(&manifest(&args.image, &image, &identity)?, &args.key)?;
    let path = format!("{}.sig", args.image);
    fs::write(&path, signature.text() + "\n").map_err(|error| Failure::Input(format!("{path}: {error}")))?;
    let text = format!("{path}: {} {} signed", identity.board(), identity.version());
    Ok(output::print_result(json, &json!({ "signature": path }), &text)?)
}

/// Returns the signed facts about an image.
pub(super) fn manifest<'a>(
    path: &str,
    image: &[u8],
    identity: &'a bcap_board::identity::Identity,
) -> Result<Manifest<'a>, Failure> {
    Manifest::of(image, identity).ok_or_else(|| Failure::Input(format!("{path}: the image is too long")))
}

/// Writes a new secret key into a file that does not exist.
fn make(path: &str) -> Result<[u8; KEY_SIZE], Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Input(format!("{path}: {error}"));
    let mut secret = [0; KEY_SIZE];
    getrandom::fill(&mut secret).map_err(|error| failed(&error))?;
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path).map_err(|error| failed(&error))?;
    writeln!(file, "{}", digits(&secret)).and_then(|()| file.sync_all()).map_err(|error| failed(&error))?;
    Ok(secret)
}

/// Reads a secret key.
fn secret(path: &str) -> Result<[u8; KEY_SIZE], Failure> {
    let text = fs::read_to_string(path).map_err(|error| Failure::Input(format!("{path}: {error}")))?;
    bytes(text.trim()).ok_or_else(|| Failure::Input(format!("{path}: not a key of `bcap board key`")))
}

fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes<const N: usize>(digits: &str) -> Option<[u8; N]> {
    let (pairs, []) = digits.as_bytes().as_chunks::<2>() else { return None };
    let byte = |pair: &[u8; 2]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    pairs.iter().map(byte).collect::<Option<Vec<u8>>>()?.try_into().ok()
}
