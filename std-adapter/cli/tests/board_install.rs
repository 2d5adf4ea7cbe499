//! `bcap board flash`, `convert` and `find`: the drive is a folder, and the boards are sockets of this machine.

use std::fs;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::thread;

use bcap_board::find::{Found, REQUEST, number};

use crate::common::{Run, bcap};

const FLASH: u32 = 0x1000_0000;

/// Creates an ELF file for a machine (40 is ARM, 243 RISC-V), with one segment.
fn elf(machine: u8, address: u32, bytes: &[u8]) -> Vec<u8> {
    let mut file = b"\x7fELF\x01\x01".to_vec();
    file.resize(52, 0);
    (file[18], file[28], file[42], file[44]) = (machine, 52, 32, 1);
    for field in [1, 52 + 32, 0, address, u32::try_from(bytes.len()).unwrap(), 0, 5, 1] {
        file.extend(field.to_le_bytes());
    }
    [file, bytes.to_vec()].concat()
}

/// Returns an image with the image definition of an RP2350.
fn rp2350() -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..1000_u32).map(|at| u8::try_from(at % 7).unwrap()).collect();
    bytes[300..304].copy_from_slice(&0xffff_ded3_u32.to_le_bytes());
    bytes
}

/// A folder with a drive in boot mode.
struct Drive {
    folder: tempfile::TempDir,
    drive: PathBuf,
}

impl Drive {
    fn new(board: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let drive = folder.path().join("drive");
        fs::create_dir(&drive).unwrap();
        let info = format!("UF2 Bootloader v1.0\r\nModel: Raspberry Pi\r\nBoard-ID: {board}\r\n");
        fs::write(drive.join("INFO_UF2.TXT"), info).unwrap();
        Self { folder, drive }
    }

    fn file(&self, name: &str, bytes: &[u8]) -> String {
        let path = self.folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    }

    fn flash(&self, image: &str) -> Run {
        bcap(&["board", "flash", image, "--drive", self.drive.to_str().unwrap(), "--timeout", "100"])
    }

    fn written(&self) -> Option<Vec<u8>> {
        fs::read(self.drive.join("BCAP.UF2")).ok()
    }
}

#[test]
fn an_image_is_written_to_a_drive_of_its_chip_only() {
    let right = Drive::new("RP2350");
    let (image, uf2) = (right.file("image", &elf(40, FLASH, &rp2350())), right.folder.path().join("image.uf2"));
    let run = bcap(&["board", "convert", &image, "--out", uf2.to_str().unwrap()]);
    assert_eq!(
        (run.out, run.code),
        (format!("{}: 2048 bytes, for the addresses from 0x10000000 on\n", uf2.display()), 0)
    );
    let expected = fs::read(&uf2).unwrap();
    // an ELF file is converted
    for file in [&image, uf2.to_str().unwrap()] {
        let _ = fs::remove_file(right.drive.join("BCAP.UF2"));
        let run = right.flash(file);
        assert!(
            run.code == 0 && run.out.contains(" bytes for an RP2350 written to ") && run.err.contains("still there"),
            "{run:?}"
        );
        assert_eq!(right.written().as_ref(), Some(&expected));
    }
    for (board, reason) in [
        ("RPI-RP2", "is a board \"RPI-RP2\", but the image is for an RP2350"),
        ("SAMD51-v0", "is a board \"SAMD51-v0\", but the image is for an RP2350"),
    ] {
        let wrong = Drive::new(board);
        let run = wrong.flash(&image);
        assert!(run.code == 1 && run.err.contains(reason) && run.err.contains("nothing was written"), "{run:?}");
        assert_eq!(wrong.written(), None);
    }
    let other = Drive::new("RP2350");
    for text in ["", "Model: x\n"] {
        fs::write(other.drive.join("INFO_UF2.TXT"), text).unwrap();
        let run = other.flash(&image);
        assert!(
            run.code == 1 && run.err.contains("is no drive of a boot ROM: INFO_UF2.TXT: it has no line Board-ID"),
            "{run:?}"
        );
    }
    fs::remove_file(other.drive.join("INFO_UF2.TXT")).unwrap();
    let run = other.flash(&image);
    assert!(run.code == 1 && run.err.contains("INFO_UF2.TXT: No such file"), "{run:?}");
}

#[test]
fn a_file_that_is_no_image_for_a_drive_is_refused_and_its_tool_named() {
    let drive = Drive::new("RP2350");
    let mut damaged = rp2350();
    damaged[300] = 0;
    let uf2 = [&b"UF2\n"[..], &[0; 508]].concat();
    for (bytes, reason) in [
        (uf2, "block 0 of the UF2 file: its marks are not those of UF2"),
        (
            b"\x00\x00\x08\x20 a binary".to_vec(),
            "neither a UF2 nor an ELF file. Copy the .bin of a Nucleo to the drive NOD_...",
        ),
        (elf(243, FLASH, b"riscv"), "this is for an ESP32-C3, which has no drive: `espflash flash` writes it"),
        (elf(40, 0x0800_0000, b"stm32"), "For a Nucleo use its .bin, STM32CubeProgrammer or probe-rs"),
        (elf(40, FLASH, &damaged), "no boot ROM starts the image"),
        (elf(40, FLASH + 0x1_0000, &rp2350()), "an image with updates needs its boot loader as well"),
    ] {
        let run = drive.flash(&drive.file("image", &bytes));
        assert!(run.code == 2 && run.err.contains(reason), "{reason}: {run:?}");
    }
    assert_eq!(drive.written(), None);
}

#[test]
fn a_boot_loader_and_an_image_become_one_binary() {
    let drive = Drive::new("RP2350");
    let loader = drive.file("loader", &elf(40, FLASH, &rp2350()));
    let image = drive.file("image", &elf(40, FLASH + 2000, b"image"));
    let out = drive.folder.path().join("both.bin");
    let convert = |images: &[&str], out: &Path| {
        bcap(&[&["board", "convert"], images, &["--out", out.to_str().unwrap()]].concat())
    };
    assert_eq!(convert(&[&image, &loader], &out).code, 0);
    assert_eq!(fs::read(&out).unwrap(), [&rp2350()[..], &[0xff; 1000], b"image"].concat());
    let run = convert(&[&loader, &loader], &out);
    assert!(run.code == 2 && run.err.contains("the images overlap, or are too far apart"), "{run:?}");
    let run = convert(&[&loader], &drive.folder.path().join("image.hex"));
    assert!(run.code == 2 && run.err.contains("the name must end in .uf2 or .bin"), "{run:?}");
    let run = convert(&[&image], &drive.folder.path().join("image.uf2"));
    assert!(run.code == 2 && run.err.contains("needs its boot loader as well"), "{run:?}");
}

/// A board that answers one request, after datagrams that are not answers.
fn board(found: Found<'static>) -> String {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    thread::spawn(move || {
        let mut datagram = [0; 2 * REQUEST];
        let (count, host) = socket.recv_from(&mut datagram).unwrap();
        let number = number(&datagram[..count]).unwrap();
        let mut answer = [0; REQUEST];
        let len = found.write([0x55; 8], &mut answer).unwrap();
        // another request's answer, the request itself, and a cut one
        for noise in [&answer[..len], &datagram[..count], &answer[..20], &[0xff; 1400]] {
            socket.send_to(noise, host).unwrap();
        }
        let len = found.write(number, &mut answer).unwrap();
        assert!(len <= count, "an answer is not longer than its request");
        socket.send_to(&answer[..len], host).unwrap();
        socket.send_to(&answer[..len], host).unwrap();
    });
    address
}

#[test]
fn boards_are_found_once_and_other_datagrams_ignored() {
    let address = ([192, 168, 0, 9].into(), 24);
    let mac = [2, 0, 0, 0xbc, 0xa9, 3];
    let found = Found { name: "cell-7", board: "w5500-evb-pico", version: "0.1.0", address, port: 5006, mac };
    let run = bcap(&["board", "find", &board(found), "--timeout", "1000"]);
    let line = "192.168.0.9:5006  02:00:00:bc:a9:03  w5500-evb-pico 0.1.0  cell-7\n";
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), (line, "", 0));
    let nameless = Found { name: "", version: "\u{1b}[31m", ..found };
    let run = bcap(&["board", "find", &board(nameless), "--timeout", "1000", "--json"]);
    assert!(
        run.code == 0 && run.out.starts_with(r#"{"address":"192.168.0.9","board":"w5500-evb-pico","mac":"#),
        "{run:?}"
    );
    let run = bcap(&["board", "find", &board(nameless), "--timeout", "1000"]);
    assert!(run.code == 0 && !run.out.contains('\u{1b}'), "a board cannot control the terminal: {run:?}");

    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let silent_address = silent.local_addr().unwrap().to_string();
    let run = bcap(&["board", "find", &silent_address, "--timeout", "90"]);
    assert!(
        run.code == 3 && run.err.contains(&format!("no board answers at {silent_address} within 90 ms")),
        "{run:?}"
    );
    silent.set_nonblocking(true).unwrap();
    let mut datagram = [0; 2 * REQUEST];
    let requests = std::iter::from_fn(|| silent.recv(&mut datagram).ok()).collect::<Vec<_>>();
    assert_eq!(requests, [REQUEST; 3], "each request has the size of the longest answer");
}
