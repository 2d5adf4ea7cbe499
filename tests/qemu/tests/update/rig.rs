//! A board with updates in QEMU, whose flash is a file.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpListener;
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use bcap_board::crc::Crc32;
use bcap_board::identity::{self, BLOCK, Identity};
use bcap_board::image;
use bcap_board::signature::{Manifest, public_of};
use bcap_qemu::{Plc, Sim, TIMEOUT, free_port, signal};

use crate::update::layout::{ACTIVE, CONTROL, OTHER, SECTOR, SIGNATURE, control};

/// The wait between two looks at the flash or the board.
const LOOK: Duration = Duration::from_millis(2);
/// The words of the model that count operations of the flash.
const OPERATIONS: [usize; 2] = [control::ERASED, control::WRITTEN];

/// The secret key of the images.
pub(crate) const SECRET: [u8; 32] = [7; 32];

/// The contents of the flash, as far as it is used.
pub(crate) type Contents = Vec<u8>;

/// The power was cut.
#[derive(Debug)]
pub(crate) struct Cut;

/// Everything but the running board.
pub(crate) struct Rig {
    /// Where the command of QEMU is valid. `timeout` is a part of it, so QEMU ends even if the test is killed.
    firmware: PathBuf,
    command: Vec<String>,
    folder: PathBuf,
    flash: File,
    pub(crate) rac: String,
    /// The address of its port for updates, for `bcap board`.
    pub(crate) network: String,
    pub(crate) sim: Sim,
    /// The ELF file of the image in the flash.
    pub(crate) elf: Vec<u8>,
}

impl Rig {
    /// Builds the image and the boot loader, and writes the flash.
    pub(crate) fn new(bcap: &PathBuf) -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("bcap-update-{}-{number}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let sim = Sim::start(bcap, "127.0.0.1:0");
        let firmware = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../embassy-adapter/firmware"));
        let update = free_port().to_string();
        let (rac, flash, socket) = (free_port().to_string(), folder.join("flash"), folder.join("console"));
        let board = std::env::var("BOARD").unwrap_or_else(|_| "mps2-an386".into());
        let run = |last: &str| {
            let (flash, socket) = (flash.to_str().unwrap(), socket.to_str().unwrap());
            let mut command = Command::new(firmware.join("run"));
            command.args([
                "--board",
                &board,
                "--robot",
                &sim.bcap,
                "--rac",
                &rac,
                "--update",
                &update,
                "--flash",
                flash,
                "--console",
                socket,
            ]);
            command.env("BCAP_BOARD_KEY", public_of(&SECRET).to_string());
            // without DHCP, so that it is up immediately
            command.args(["--set", "dhcp=no", "--set", "provider=CaoProv.DENSO.VRC", last, "gateway"]);
            let output = command.stderr(Stdio::inherit()).output().unwrap();
            assert!(output.status.success(), "the image was not built");
            String::from_utf8(output.stdout).unwrap()
        };
        let mut elf = fs::read(firmware.join(run("--build").trim_end())).unwrap();
        let command = run("--command");
        let command = command.lines().map(str::to_owned).collect();
        let mut settings = fs::read(&flash).unwrap();
        settings.truncate(ACTIVE.end as usize);
        image::write(&mut elf, image::text(&settings).unwrap()).unwrap();
        let flash = OpenOptions::new().read(true).write(true).open(flash).unwrap();
        Self {
            firmware: firmware.clone(),
            command,
            folder,
            flash,
            rac: format!("127.0.0.1:{rac}"),
            network: format!("tcp:127.0.0.1:{update}"),
            sim,
            elf,
        }
    }

    /// Returns the image as an ELF file with another version.
    pub(crate) fn version(&self, version: &str) -> Vec<u8> {
        let old = identity::find(&self.elf).unwrap();
        let new = Identity::new(old.board(), version);
        let mut elf = self.elf.clone();
        let places: Vec<usize> = find(&elf, old.as_bytes()).collect();
        assert!(!places.is_empty());
        for place in places {
            elf[place..place + new.as_bytes().len()].copy_from_slice(new.as_bytes());
        }
        elf
    }

    /// Writes a file for a command.
    pub(crate) fn file(&self, name: &str, contents: &[u8]) -> PathBuf {
        let path = self.folder.join(name);
        fs::write(&path, contents).unwrap();
        path
    }

    /// Writes the file of the secret key, and returns its path.
    pub(crate) fn key(&self) -> String {
        self.file("plant.key", digits(&SECRET).as_bytes()).to_str().unwrap().to_owned()
    }

    /// Returns the contents of the flash.
    pub(crate) fn contents(&self) -> Contents {
        let mut contents = vec![0; OTHER.end as usize];
        self.flash.read_exact_at(&mut contents, 0).unwrap();
        contents
    }

    /// Replaces the contents of the flash while no board runs, and clears the words of the model.
    pub(crate) fn restore(&self, contents: &Contents) {
        self.flash.write_all_at(contents, 0).unwrap();
        self.flash.write_all_at(&[0; SECTOR], CONTROL as u64).unwrap();
    }

    /// Returns a word of the model.
    pub(crate) fn word(&self, number: usize) -> u32 {
        let mut word = [0; 4];
        self.flash.read_exact_at(&mut word, (CONTROL + 4 * number) as u64).unwrap();
        u32::from_le_bytes(word)
    }

    /// Returns the operations of the flash so far.
    pub(crate) fn operations(&self) -> u32 {
        OPERATIONS.into_iter().map(|number| self.word(number)).sum()
    }

    /// Cuts the power in the middle of an operation of the flash, counted from now on; 0 means never.
    pub(crate) fn cut_at(&self, operation: u32) {
        self.flash.write_all_at(&operation.to_le_bytes(), (CONTROL + 4 * control::CUT) as u64).unwrap();
    }

    /// Waits until the power was cut.
    pub(crate) fn until_cut(&self) {
        wait("the power was not cut", || (self.word(control::CUTS) > 0).then_some(()));
    }

    /// Switches the board on.
    pub(crate) fn start(&self) -> Board<'_> {
        // QEMU was killed, and on a busy machine it may still have its ports
        for address in [&*self.rac, self.network.trim_start_matches("tcp:")] {
            wait("the ports are not free", || TcpListener::bind(address).ok());
        }
        let _ = fs::remove_file(self.folder.join("console"));
        let log = File::create(self.folder.join("log")).unwrap();
        let mut command = Command::new(&self.command[0]);
        command.args(&self.command[1..]).current_dir(&self.firmware).stdin(Stdio::piped()).stdout(log);
        // a process group, so that one signal also ends QEMU
        let mut child = command.process_group(0).spawn().unwrap();
        let keys = child.stdin.take().unwrap();
        Board { rig: self, child, keys, console: None, received: Vec::new(), skips: 0, cuts: 0 }
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// A board that is on. The power goes off when this value is dropped, by SIGKILL.
pub(crate) struct Board<'a> {
    rig: &'a Rig,
    child: Child,
    keys: ChildStdin,
    console: Option<UnixStream>,
    received: Vec<u8>,
    /// The number of the last unknown request to the board.
    skips: u32,
    /// The cuts of the power until the last status.
    cuts: u32,
}

impl Board<'_> {
    /// Connects to the console.
    pub(crate) fn connect(&mut self) -> UnixStream {
        let path = self.rig.folder.join("console");
        wait("QEMU does not listen", || {
            assert!(self.child.try_wait().unwrap().is_none(), "QEMU has ended");
            UnixStream::connect(&path).ok()
        })
    }

    /// Sends a byte to the first serial port, which provokes a fault.
    pub(crate) fn key(&mut self, letter: u8) {
        self.keys.write_all(&[letter]).unwrap();
    }

    /// Waits until the board answers, and returns its version and the outcome of the last update.
    pub(crate) fn status(&mut self) -> String {
        let since = Instant::now();
        loop {
            // the line feed ends an interrupted request
            self.send("\nstatus\n");
            let asked = Instant::now();
            while asked.elapsed() < Duration::from_millis(100) {
                if let Some(status) = self.line().and_then(|line| Some(line.strip_prefix("ok mps2-")?.to_owned())) {
                    self.skip_answers();
                    self.cuts = self.rig.word(control::CUTS);
                    return status.split_once(' ').unwrap().1.to_owned();
                }
            }
            assert!(
                since.elapsed() < TIMEOUT,
                "no status; {} starts of the boot loader",
                self.rig.word(control::STARTS)
            );
        }
    }

    /// Waits for a status.
    pub(crate) fn until(&mut self, expected: &str) {
        let since = Instant::now();
        loop {
            let status = self.status();
            if status == expected {
                return;
            }
            assert!(since.elapsed() < TIMEOUT, "the board is {status:?} instead of {expected:?}");
            sleep(20 * LOOK);
        }
    }

    /// Waits until a request over the network is answered with a value of the robot.
    pub(crate) fn serve(&self) {
        wait("no request is served", || self.answer().filter(|answer| answer.starts_with("0,")));
    }

    /// Returns the answer to a request over the network.
    pub(crate) fn answer(&self) -> Option<String> {
        let mut plc = Plc::try_connect(&self.rig.rac, Duration::from_millis(300)).ok()?;
        plc.try_ask("GET:RC8:1:I:\r").ok()
    }

    /// Sends an image in blocks, and installs it.
    pub(crate) fn install(&mut self, image: &[u8]) -> Result<(), Cut> {
        let identity = identity::find(image).unwrap();
        let (len, crc) = (image.len(), Crc32::new().and(image).value());
        self.ask(&format!("update {} {} {len} {crc:08x}", identity.board(), identity.version()))?;
        let manifest = Manifest::of(image, &identity).unwrap();
        self.ask(&format!("sign {} {}", digits(&manifest.digest), digits(&manifest.sign(&SECRET))))?;
        for (number, data) in (0_u32..).zip(image.chunks(BLOCK)) {
            let crc = Crc32::new().and(&number.to_le_bytes()).and(data).value();
            self.ask(&format!("block {number} {crc:08x} {}", digits(data)))?;
        }
        self.ask("install")
    }

    /// Restarts the board as `bcap board update` does.
    pub(crate) fn restart(&mut self) -> Result<(), Cut> {
        let starts = self.rig.word(control::STARTS);
        self.ask("restart")?;
        wait("the board does not restart", || (self.rig.word(control::STARTS) != starts).then_some(()));
        Ok(())
    }

    /// Sends a request that the board must accept.
    fn ask(&mut self, request: &str) -> Result<(), Cut> {
        let since = Instant::now();
        self.send(&format!("{request}\n"));
        loop {
            match self.line() {
                // the board reports its address when it gets one
                Some(line) if line.starts_with("address ") => {}
                Some(answer) if answer.starts_with("ok") => return Ok(()),
                // a cut that follows an answer leaves the end of the next request to the board that starts again
                _ if self.rig.word(control::CUTS) > self.cuts => return Err(Cut),
                Some(answer) => panic!("{request:.40}: {answer}"),
                None => assert!(since.elapsed() < TIMEOUT, "no answer to {request:.40}"),
            }
        }
    }

    fn send(&mut self, request: &str) {
        if self.console.is_none() {
            let console = self.connect();
            console.set_read_timeout(Some(5 * LOOK)).unwrap();
            self.console = Some(console);
        }
        self.console.as_mut().unwrap().write_all(request.as_bytes()).unwrap();
    }

    /// Skips the answers to repeated requests, which may arrive late or be damaged: requests while the board is down can fill
    /// its buffer.
    ///
    /// The answer to a request that was never sent before follows all of them.
    fn skip_answers(&mut self) {
        let since = Instant::now();
        loop {
            self.skips += 1;
            let expected = format!("error unknown request \"skip{}\"", self.skips);
            self.send(&format!("\nskip{}\n", self.skips));
            let asked = Instant::now();
            while asked.elapsed() < Duration::from_millis(100) {
                if self.line().is_some_and(|line| line == expected) {
                    return;
                }
            }
            assert!(since.elapsed() < TIMEOUT, "no answer to skip{}", self.skips);
        }
    }

    /// Returns the next line of an answer, if it arrives soon.
    fn line(&mut self) -> Option<String> {
        let mut bytes = [0; 512];
        loop {
            if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
                let line = self.received.drain(..=end).collect::<Vec<u8>>();
                return Some(String::from_utf8_lossy(&line[..end]).into_owned());
            }
            match self.console.as_mut()?.read(&mut bytes) {
                Ok(0) => panic!("QEMU has ended"),
                Ok(count) => self.received.extend_from_slice(&bytes[..count]),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return None,
                Err(error) => panic!("the console: {error}"),
            }
        }
    }
}

impl Drop for Board<'_> {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            signal("-KILL", &format!("-{}", self.child.id()));
            let _ = self.child.wait();
        }
    }
}

/// Puts an image where a received one is, with its signature.
pub(crate) fn replace_received(flash: &mut Contents, image: &[u8]) {
    let identity = identity::find(image).unwrap();
    let mut version = [0; 20];
    version[..identity.version().len()].copy_from_slice(identity.version().as_bytes());
    let len = u32::try_from(image.len()).unwrap().to_le_bytes();
    let signature = Manifest::of(image, &identity).unwrap().sign(&SECRET);
    let record = [&b"BCAPSIGN"[..], &len, &version, &signature].concat();
    let crc = Crc32::new().and(&record).value().to_le_bytes();
    for (at, bytes) in [(OTHER.start, image), (SIGNATURE.start, &[&record[..], &crc].concat())] {
        flash[at as usize..at as usize + bytes.len()].copy_from_slice(bytes);
    }
}

fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Waits for a value.
pub(crate) fn wait<T>(what: &str, mut value: impl FnMut() -> Option<T>) -> T {
    let since = Instant::now();
    loop {
        if let Some(value) = value() {
            return value;
        }
        assert!(since.elapsed() < TIMEOUT, "{what}");
        sleep(LOOK);
    }
}

/// Returns the bytes of an image in the flash, from its ELF file: the segments that are loaded, at their addresses.
pub(crate) fn flatten(elf: &[u8]) -> Vec<u8> {
    let mut image = Vec::new();
    let segments = segments(elf);
    let first = segments.iter().map(|segment| segment.address).min().unwrap();
    for Segment { address, offset, len } in segments {
        let at = address - first;
        image.resize(image.len().max(at + len), 0xff);
        image[at..at + len].copy_from_slice(&elf[offset..offset + len]);
    }
    image
}

/// A part of an image, and its place in the ELF file.
struct Segment {
    address: usize,
    offset: usize,
    len: usize,
}

fn segments(elf: &[u8]) -> Vec<Segment> {
    let word = |at: usize| u32::from_le_bytes(*elf[at..].first_chunk().unwrap()) as usize;
    let half = |at: usize| usize::from(u16::from_le_bytes(*elf[at..].first_chunk().unwrap()));
    let headers = (0..half(44)).map(|number| word(28) + number * half(42));
    let loaded = headers.filter(|at| word(*at) == 1 && word(at + 16) > 0);
    loaded.map(|at| Segment { address: word(at + 12), offset: word(at + 4), len: word(at + 16) }).collect()
}

/// Returns where some bytes are.
fn find<'a>(bytes: &'a [u8], wanted: &'a [u8]) -> impl Iterator<Item = usize> + 'a {
    bytes.windows(wanted.len()).enumerate().filter(move |(_, window)| *window == wanted).map(|(at, _)| at)
}

/// Returns an image, as an ELF file, that hangs in its first instruction.
pub(crate) fn hanging(elf: &[u8]) -> Vec<u8> {
    let image = flatten(elf);
    let reset = u32::from_le_bytes(*image[4..].first_chunk().unwrap()) as usize & !1;
    let mut elf = elf.to_vec();
    let inside = |segment: &&Segment| (segment.address..segment.address + segment.len).contains(&reset);
    let place = segments(&elf).iter().find(inside).map(|segment| segment.offset + reset - segment.address).unwrap();
    // b .
    elf[place..place + 2].copy_from_slice(&[0xfe, 0xe7]);
    elf
}
