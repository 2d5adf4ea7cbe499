//! `bcap board flash` and `bcap board convert`: files for boards without a compiler.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use clap::Args;
use serde_json::json;

use super::elf;
use super::uf2::Image;
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
    pub(crate) image: String,

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
    pub(crate) images: Vec<String>,

    /// The file to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
}

/// The file of a boot ROM's drive that tells the chip.
const INFO: &str = "INFO_UF2.TXT";
/// The longest such file that is read.
const MOST_INFO: usize = 4096;
/// The first bytes of a UF2 file.
const UF2: &[u8] = b"UF2\n";
/// The pause between two looks at the drive.
const LOOK: Duration = Duration::from_millis(50);

pub(super) fn convert(args: &Convert, json: bool) -> Result<(), Failure> {
    let (start, bytes) = elf::join(args.images.iter().map(|path| flatten(path)).collect::<Result<_, _>>()?)
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
    let image = read(&args.image)?;
    let drive = match &args.drive {
        Some(drive) => check(drive, &image)?,
        None => find(&image)?,
    };
    let file = image.to_file();
    let restarted = write(&drive, &file, link.timeout())?;
    let (path, chip) = (drive.display(), image.chip.name());
    let text = format!("{}: {} bytes for an {chip} written to {path}", args.image, image.bytes.len());
    let object = json!({ "drive": path.to_string(), "chip": chip, "bytes": image.bytes.len(), "restarted": restarted });
    output::print_result(json, &object, &text)?;
    output::note(match restarted {
        true => "the drive is gone, so the board has restarted; find it with bcap board find",
        false => "the drive is still there: a board restarts once it has all blocks, so try again if it does not",
    });
    Ok(())
}

/// Reads an image for a drive.
fn read(path: &str) -> Result<Image, Failure> {
    let invalid = |reason: String| Failure::Input(format!("{path}: {reason}"));
    let file = fs::read(path).map_err(of_file(Path::new(path)))?;
    if file.starts_with(UF2) {
        return Image::of_file(&file).map_err(invalid);
    }
    if !elf::is_elf(&file) {
        return Err(invalid(
            "neither a UF2 nor an ELF file. Copy the .bin of a Nucleo to the drive NOD_... of its ST-Link, or use \
             STM32CubeProgrammer or probe-rs"
                .into(),
        ));
    }
    if elf::is_riscv(&file) {
        return Err(invalid(
            "this is for an ESP32-C3, which has no drive: `espflash flash` writes it, with Espressif's boot loader and table of \
             partitions"
                .into(),
        ));
    }
    let (start, bytes) = flatten(path)?;
    Image::new(start, bytes)
        .map_err(|reason| invalid(format!("{reason}. For a Nucleo use its .bin, STM32CubeProgrammer or probe-rs")))
}

/// Reads the start and the bytes of an ELF file.
fn flatten(path: &str) -> Result<(u32, Vec<u8>), Failure> {
    let file = fs::read(path).map_err(of_file(Path::new(path)))?;
    elf::flatten(&file).ok_or_else(|| {
        Failure::Input(format!(
            "{path}: not an ELF file of an image with 32 bits, or damaged, or its parts are far apart"
        ))
    })
}

/// Returns the drive if its chip is the one of the image.
fn check(drive: &Path, image: &Image) -> Result<PathBuf, Failure> {
    let hint = "hold BOOTSEL while you plug in the USB cable, and give the folder where the drive is mounted";
    let board_id = board_id(drive).map_err(|error| {
        Failure::unfit(format!("{} is no drive of a boot ROM: {INFO}: {error}", drive.display()), hint)
    })?;
    if board_id != image.chip.board_id() {
        return Err(Failure::unfit(
            format!(
                "the drive {} is a board \"{board_id}\", but the image is for an {}",
                drive.display(),
                image.chip.name()
            ),
            "nothing was written; take the image for this board",
        ));
    }
    Ok(drive.to_owned())
}

/// Finds the only mounted drive of a boot ROM for this image.
fn find(image: &Image) -> Result<PathBuf, Failure> {
    let found: Vec<PathBuf> = mounted().into_iter().filter(|folder| board_id(folder).is_ok()).collect();
    match found.as_slice() {
        [drive] => check(drive, image),
        [] => Err(Failure::unfit(
            "no drive of a boot ROM is mounted",
            "hold BOOTSEL while you plug in the USB cable; without a desktop mount the drive, and name its folder with --drive",
        )),
        [_, _, ..] => {
            let names: Vec<String> = found.iter().map(|drive| drive.display().to_string()).collect();
            Err(Failure::unfit(
                format!("several boards are in boot mode: {}", names.join(", ")),
                "choose one with --drive",
            ))
        }
    }
}

/// Returns the board id that the boot ROM tells.
fn board_id(drive: &Path) -> io::Result<String> {
    let mut text = Vec::new();
    io::Read::read_to_end(&mut io::Read::take(File::open(drive.join(INFO))?, MOST_INFO as u64), &mut text)?;
    let text = String::from_utf8_lossy(&text);
    let id = text.lines().find_map(|line| line.strip_prefix("Board-ID:"));
    id.map(|id| id.trim().to_owned()).ok_or_else(|| io::Error::other("it has no line Board-ID"))
}

/// Writes the file, and waits until the drive is gone; returns whether that was seen.
fn write(drive: &Path, contents: &[u8], timeout: Duration) -> Result<bool, Failure> {
    let path = drive.join("BCAP.UF2");
    let is_gone = || !drive.join(INFO).exists();
    let written = File::create(&path).and_then(|mut file| {
        file.write_all(contents)?;
        file.sync_all()
    });
    let deadline = Instant::now() + timeout;
    loop {
        match &written {
            // the board restarts after the last block, before the file system is complete
            _ if is_gone() => return Ok(true),
            Ok(()) if Instant::now() >= deadline => return Ok(false),
            Err(error) if Instant::now() >= deadline => {
                return Err(Failure::unfit(
                    format!("{}: {error}", path.display()),
                    "the board may have a part of the image; hold BOOTSEL while you plug it in, and try again",
                ));
            }
            _ => sleep(LOOK),
        }
    }
}

/// Returns the folders at which drives are mounted.
#[cfg(target_os = "linux")]
fn mounted() -> Vec<PathBuf> {
    of_table(&fs::read_to_string("/proc/self/mounts").unwrap_or_default())
}

#[cfg(target_os = "macos")]
fn mounted() -> Vec<PathBuf> {
    let entries = fs::read_dir("/Volumes").into_iter().flatten();
    entries.filter_map(|entry| Some(entry.ok()?.path())).collect()
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn mounted() -> Vec<PathBuf> {
    ('A'..='Z').map(|letter| PathBuf::from(format!("{letter}:\\"))).collect()
}

/// Returns the folders of file systems FAT in a table of mounts, in which blanks of a name are `\040`.
#[cfg(any(target_os = "linux", test))]
fn of_table(table: &str) -> Vec<PathBuf> {
    let folder = |line: &str| {
        let mut words = line.split(' ');
        let (folder, kind) = (words.nth(1)?, words.next()?);
        (kind == "vfat" || kind == "msdos").then(|| folder.replace("\\040", " ").into())
    };
    table.lines().filter_map(folder).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drives_are_the_fat_file_systems() {
        let table = "/dev/sda2 / ext4 rw 0 0\n/dev/sdb1 /media/me/RPI-RP2 vfat rw,nosuid 0 0\nproc /proc proc rw 0 0\n\
                     /dev/sdc1 /media/a\\040b vfat rw 0 0\ndamaged\n";
        assert_eq!(of_table(table), [Path::new("/media/me/RPI-RP2"), Path::new("/media/a b")]);
    }
}
