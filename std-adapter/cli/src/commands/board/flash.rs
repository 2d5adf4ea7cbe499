//! `bcap board flash` and `bcap board convert`: files for boards without a compiler.

use std::fs;
use std::path::PathBuf;

use bcap_provision::uf2::Image;
use bcap_provision::{drive, elf};
use clap::Args;
use serde_json::json;

use crate::failure::{Failure, of_file};
use crate::link::LinkArgs;
use crate::output;

/// Writes an image to a board that is a drive in boot mode
///
/// For boards with an RP2040 or RP2350: hold BOOTSEL while you plug in the USB cable. The board is then a drive, which must be
/// mounted. The command checks the image, finds the drive by its file INFO_UF2.TXT, and writes nothing to a drive of another chip.
/// --timeout limits the wait for the restart of the board.
///
/// Other boards have tools of their makers, which also set up what is not in the image: for an ESP32-C3 `espflash flash IMAGE.elf`
/// adds the boot loader and the table of partitions; for a Nucleo copy IMAGE.bin to its drive NOD_..., or use STM32CubeProgrammer
/// or probe-rs. A board that runs an image with updates takes the next one with `bcap board update`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap board flash w5500-evb-pico.uf2
  bcap board flash w5500-evb-pico.uf2 --drive /media/me/RPI-RP2")]
pub(crate) struct Flash {
    /// The image: a UF2 file, or an ELF file that is converted
    #[arg(value_name = "IMAGE")]
    pub(crate) image: PathBuf,

    /// The folder of the drive [default: the only mounted one]
    #[arg(long, value_name = "FOLDER")]
    pub(crate) drive: Option<PathBuf>,
}

/// Converts ELF files of images into one UF2 file or binary
///
/// The name of the output ends in .uf2 or .bin. A boot loader and an image are joined; gaps are ff, as in erased flash. A UF2 file is
/// made for an RP2040 or RP2350 only, and only from an image that its boot ROM starts.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap board convert w5500-evb-pico --out w5500-evb-pico.uf2
  bcap board convert w5500-evb-pico-boot w5500-evb-pico+updates --out factory.uf2")]
pub(crate) struct Convert {
    /// The ELF files
    #[arg(value_name = "ELF", required = true)]
    pub(crate) images: Vec<PathBuf>,

    /// The file to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
}

pub(super) fn convert(args: &Convert, json: bool) -> Result<(), Failure> {
    let (start, bytes) = elf::join(args.images.iter().map(|path| drive::flatten(path)).collect::<Result<_, _>>()?)
        .ok_or_else(|| Failure::Input("the images overlap, or are too far apart".into()))?;
    let path = args.out.display();
    let contents = match args.out.extension().and_then(|extension| extension.to_str()) {
        Some("bin") => bytes,
        Some("uf2") => Image::new(start, bytes).map_err(Failure::Input)?.to_file(),
        _ => return Err(Failure::Input(format!("{path}: the name must end in .uf2 or .bin"))),
    };
    fs::write(&args.out, &contents).map_err(of_file(&args.out))?;
    let text = format!("{path}: {} bytes, for the addresses from {start:#010x} on", contents.len());
    Ok(output::print_result(
        json,
        &json!({ "file": path.to_string(), "bytes": contents.len(), "start": start }),
        &text,
    )?)
}

pub(super) fn flash(args: &Flash, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    // the image is checked before a drive is searched
    let image = drive::read(&args.image)?;
    let folder = match &args.drive {
        Some(folder) => folder.clone(),
        None => drive::find().map_err(|error| Failure::from(error).hinting(" with --drive"))?,
    };
    drive::check(&folder, &image)?;
    let file = image.to_file();
    let restarted = drive::write(&folder, &file, link.timeout())?;
    let (path, chip) = (folder.display(), image.chip.name());
    let text = format!("{}: {} bytes for an {chip} written to {path}", args.image.display(), image.bytes.len());
    let object = json!({ "drive": path.to_string(), "chip": chip, "bytes": image.bytes.len(), "restarted": restarted });
    output::print_result(json, &object, &text)?;
    output::note(match restarted {
        true => "the drive is gone, so the board has restarted; find it with bcap board find",
        false => "the drive is still there: a board restarts once it has all blocks, so try again if it does not",
    });
    Ok(())
}
