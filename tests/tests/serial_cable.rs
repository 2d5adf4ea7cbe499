//! Values and files over a serial cable of 115200 baud with corrupted and lost bytes: all arrive as they were sent.
//!
//! A frame of a serial line has at most 503 bytes, and b-CAP has no function for a part of a value. So a large file travels as
//! many small ones.

use std::io;
use std::time::{Duration, Instant as Clock};

use bcap_core::bcap::Header;
use bcap_core::bcap::call::{self, ControllerHandle};
use bcap_core::time::Instant;
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_sim::{Config, Controller, Profile};
use bcap_std::blocking::{self, Connection, SerialTransport, Transport};
use bcap_std::{Address, Options};
use bcap_testkit::network::Random;
use bcap_tests::cable::{Cable, End, Quality};
use bcap_tests::line_server::LineServer;

use crate::serial_lines::values;

const BAUD: u32 = 115_200;

/// The bytes of a part of a file, which fit a frame with its arguments.
const PART: usize = 432;

/// A transport that counts the frames that it sends.
struct Counted {
    inner: SerialTransport,
    frames: u64,
    /// The unsent bytes of the current frame.
    left: usize,
}

impl Transport for Counted {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        if self.left == 0 {
            // the client passes a frame from its first byte, and then the rest of it
            self.frames += 1;
            self.left = Header::read_length(bytes).unwrap().try_into().unwrap();
        }
        let sent = self.inner.send(bytes, until)?;
        self.left -= sent.unwrap_or(0);
        Ok(sent)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        self.inner.receive(buffer, until)
    }

    fn sleep_until(&mut self, at: Instant) {
        self.inner.sleep_until(at);
    }
}

/// A client at the end of a cable, and the virtual controller at the other end.
struct Cell {
    robot: Connection<Counted, Vec<u8>>,
    controller: ControllerHandle,
    calls: u64,
    cable: Cable,
    _server: LineServer<Controller>,
    _files: tempfile::TempDir,
}

impl Cell {
    /// Connects over a cable.
    fn connect(quality: Quality) -> Self {
        let cable = Cable::new(quality);
        let files = tempfile::tempdir().unwrap();
        let config = Config { files: Some(files.path().to_owned()), ..Config::new(Profile::Rc8) };
        let server = LineServer::start(Controller::new(config), &cable.path(End::Controller));
        let mut options = Options::default();
        // each corrupted frame costs an attempt
        options.serial.timing.attempt_timeout = Duration::from_millis(100);
        options.serial.timing.attempts = 20;
        let Ok(Address::Serial(line)) = cable.address(BAUD).parse() else { panic!("not a serial line") };
        let (transport, client) = blocking::connect_serial(&line, &options).unwrap().into_parts();
        let mut robot = Connection::new(Counted { inner: transport, frames: 0, left: 0 }, client);
        robot.call(call::service_start("")).unwrap();
        let controller = robot.call(call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")).unwrap();
        Self { robot, controller, calls: 2, cable, _server: server, _files: files }
    }

    fn write(&mut self, name: &str, value: &OwnedVariant) {
        let variable = self.robot.call(call::controller_get_variable(self.controller, name, "")).unwrap();
        self.robot.call(call::variable_put_value(variable, value)).unwrap();
        self.robot.call(call::variable_release(variable)).unwrap();
        self.calls += 3;
    }

    fn read(&mut self, name: &str) -> OwnedVariant {
        let variable = self.robot.call(call::controller_get_variable(self.controller, name, "")).unwrap();
        let value = OwnedVariant::new(&self.robot.call(call::variable_get_value(variable)).unwrap()).unwrap();
        self.robot.call(call::variable_release(variable)).unwrap();
        self.calls += 3;
        value
    }

    fn write_file(&mut self, name: &str, bytes: &[u8]) {
        let file = self.robot.call(call::controller_get_file(self.controller, name, "@Create=1")).unwrap();
        self.robot.call(call::file_put_value(file, bytes)).unwrap();
        self.robot.call(call::file_release(file)).unwrap();
        self.calls += 3;
    }

    fn read_file(&mut self, name: &str) -> Vec<u8> {
        let file = self.robot.call(call::controller_get_file(self.controller, name, "")).unwrap();
        let value = self.robot.call(call::file_get_value(file)).unwrap();
        let Variant::Array(array) = value else { panic!("{value:?}") };
        let bytes = array.items::<u8>().unwrap().iter().collect();
        self.robot.call(call::file_release(file)).unwrap();
        self.calls += 3;
        bytes
    }

    /// Writes all kinds of variables and a file of this size in parts, and reads them back.
    fn exchange(&mut self, rounds: i16, size: usize) {
        let begin = Clock::now();
        for round in 1..=rounds {
            for (name, value) in values(round) {
                self.write(name, &value);
            }
            for (name, value) in values(round) {
                assert_eq!(self.read(name), value, "{name} in round {round}");
            }
        }
        self.report("variables", begin);
        let mut random = Random(7);
        // 0xff is not UTF-8, so each part is an array of bytes
        let content: Vec<u8> = (0..size).map(|at| if at % PART == 0 { 0xff } else { random.number() as u8 }).collect();
        let parts = || content.chunks(PART).enumerate().map(|(number, part)| (format!("part{number:04}"), part));
        let begin = Clock::now();
        parts().for_each(|(name, part)| self.write_file(&name, part));
        self.report("file written", begin);
        let begin = Clock::now();
        let mut arrived = Vec::with_capacity(size);
        parts().for_each(|(name, _)| arrived.extend(self.read_file(&name)));
        assert_eq!(arrived.len(), content.len());
        assert!(arrived == content, "the file differs");
        self.report("file read", begin);
    }

    /// Prints the figures so far.
    fn report(&mut self, part: &str, begin: Clock) {
        let (passed, seconds) = (self.cable.passed(), begin.elapsed().as_secs_f64());
        println!(
            "{part}: {seconds:.1} s; so far {} calls, {} retransmissions, {passed:?}",
            self.calls,
            self.robot.transport().frames - self.calls
        );
    }
}

#[test]
fn values_and_a_small_file_survive_corrupted_bytes_at_115200_baud() {
    let quality = Quality { baud: Some(BAUD), corrupt_one_in: 1000, seed: 1, ..Quality::default() };
    let mut cell = Cell::connect(quality);
    cell.exchange(1, 2 << 10);
    assert!(cell.cable.passed().corrupted > 0);
}

#[test]
fn values_and_a_small_file_survive_lost_bytes_at_115200_baud() {
    let quality = Quality { baud: Some(BAUD), lose_one_in: 1000, seed: 2, ..Quality::default() };
    let mut cell = Cell::connect(quality);
    cell.exchange(1, 2 << 10);
    assert!(cell.cable.passed().lost > 0);
}

#[test]
#[ignore = "takes a minute and a half: `just serial`"]
fn values_and_a_file_of_256_kib_survive_corrupted_bytes_at_115200_baud() {
    let quality = Quality { baud: Some(BAUD), corrupt_one_in: 10_000, seed: 3, ..Quality::default() };
    let mut cell = Cell::connect(quality);
    cell.exchange(5, 256 << 10);
    assert!(cell.cable.passed().corrupted > 0);
}
