//! A board with an RP2040 or RP2350 in boot mode, which is a drive: a UF2 file that is copied to it becomes the contents of the flash.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::elf;
use crate::error::Error;
use crate::uf2::{self, Image};

/// The file on a boot ROM's drive that identifies the chip.
const INFO: &str = "INFO_UF2.TXT";
/// The maximum size of this file.
const MOST_INFO: usize = 4096;
/// The interval at which the drive is polled.
const LOOK: Duration = Duration::from_millis(50);

/// Reads an image for a drive: a UF2 file, or an ELF file.
///
/// # Errors
///
/// [`Error::Invalid`] if the file cannot be read, or if no boot ROM starts it.
pub fn read(path: &Path) -> Result<Image, Error> {
    let invalid = |reason: String| Error::at(path, reason);
    let file = fs::read(path).map_err(|error| Error::at(path, error))?;
    if uf2::is_uf2(&file) {
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
///
/// # Errors
///
/// [`Error::Invalid`] if the file cannot be read, is damaged, or is another kind of ELF.
pub fn flatten(path: &Path) -> Result<(u32, Vec<u8>), Error> {
    let file = fs::read(path).map_err(|error| Error::at(path, error))?;
    elf::flatten(&file).ok_or_else(|| {
        Error::at(path, "not an ELF file of an image with 32 bits, or damaged, or its parts are far apart")
    })
}

/// Checks that a drive has the chip of the image.
///
/// # Errors
///
/// [`Error::Refused`] if the folder is not a boot ROM's drive, or the drive of another chip.
pub fn check(drive: &Path, image: &Image) -> Result<(), Error> {
    let hint = "hold BOOTSEL while you plug in the USB cable, and give the folder where the drive is mounted";
    let board_id = board_id(drive).map_err(|error| {
        Error::refused(format!("{} is no drive of a boot ROM: {INFO}: {error}", drive.display()), hint)
    })?;
    if board_id != image.chip.board_id() {
        return Err(Error::refused(
            format!(
                "the drive {} is a board \"{board_id}\", but the image is for an {}",
                drive.display(),
                image.chip.name()
            ),
            "nothing was written; take the image for this board",
        ));
    }
    Ok(())
}

/// Finds the only mounted drive of a boot ROM. It may be of any chip: [`check`] compares it with an image.
///
/// # Errors
///
/// [`Error::Refused`] if no drive is mounted, or if several are.
pub fn find() -> Result<PathBuf, Error> {
    let found: Vec<PathBuf> = mounted().into_iter().filter(|folder| board_id(folder).is_ok()).collect();
    only(&found)
}

fn only(drives: &[PathBuf]) -> Result<PathBuf, Error> {
    match drives {
        [drive] => Ok(drive.clone()),
        [] => Err(Error::refused(
            "no drive of a boot ROM is mounted",
            "hold BOOTSEL while you plug in the USB cable; without a desktop mount the drive, and name its folder",
        )),
        [_, _, ..] => {
            let names: Vec<String> = drives.iter().map(|drive| drive.display().to_string()).collect();
            Err(Error::refused(
                format!("several boards are in boot mode: {}", names.join(", ")),
                "choose one, and name its folder",
            ))
        }
    }
}

/// Returns the board ID that the boot ROM reports.
fn board_id(drive: &Path) -> io::Result<String> {
    let mut text = Vec::new();
    io::Read::read_to_end(&mut io::Read::take(File::open(drive.join(INFO))?, MOST_INFO as u64), &mut text)?;
    let text = String::from_utf8_lossy(&text);
    let id = text.lines().find_map(|line| line.strip_prefix("Board-ID:"));
    id.map(|id| id.trim().to_owned()).ok_or_else(|| io::Error::other("it has no line Board-ID"))
}

/// Writes a UF2 file, and waits until the drive disappears, because the board has restarted; returns whether it disappeared.
///
/// # Errors
///
/// [`Error::Refused`] if the file could not be written in time.
pub fn write(drive: &Path, contents: &[u8], timeout: Duration) -> Result<bool, Error> {
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
                return Err(Error::refused(
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

/// Returns the folders of FAT file systems in a mount table, which has `\040` for blanks in a name.
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

    #[test]
    fn no_drive_and_several_are_refused() {
        let found = |names: &[&str]| match only(&names.iter().map(PathBuf::from).collect::<Vec<_>>()) {
            Ok(drive) => drive.display().to_string(),
            Err(Error::Refused { message, hint }) => format!("{message}; {hint}"),
            Err(error) => error.to_string(),
        };
        assert_eq!(found(&["/a"]), "/a");
        assert_eq!(found(&["/a", "/b"]), "several boards are in boot mode: /a, /b; choose one, and name its folder");
        let none = found(&[]);
        assert!(none.starts_with("no drive of a boot ROM is mounted; hold BOOTSEL"), "{none}");
        assert!(none.ends_with("mount the drive, and name its folder"), "{none}");
    }
}
