//! `Controller` over serial lines: pairs of pseudo-terminals, with the virtual controller at the other end and noise between.
#![cfg(unix)]

use std::io::{self, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::variant::OwnedVariant;
use bcap_sim::{Config, Controller as Simulated, Profile};
use bcap_std::{Backoff, Error, Joints, Position, ServiceOptions, Settings, Transform, asynch, blocking};
use bcap_testkit::network::Random;
use bcap_tests::serial::{Wire, serve};
use serialport::{SerialPort, TTYPort};

/// How often the controller's end looks whether it was unplugged.
const LOOK: Duration = Duration::from_millis(5);

/// A line to a virtual controller. Dropping it unplugs the line.
struct Line {
    /// The client's end, kept open so that the line exists before and after the client.
    client: TTYPort,
    unplugged: Arc<AtomicBool>,
    corrupted: Arc<AtomicU32>,
    server: Option<JoinHandle<()>>,
}

/// The controller's end, which corrupts some of the bytes in both directions.
struct Noisy {
    port: TTYPort,
    random: Random,
    per_mille: u64,
    unplugged: Arc<AtomicBool>,
    corrupted: Arc<AtomicU32>,
}

/// Makes the two ends of a line, the controller's first; says so if this machine has no pseudo-terminals.
fn pair() -> Option<(TTYPort, TTYPort)> {
    TTYPort::pair().map_err(|error| eprintln!("skipped: this machine has no pseudo-terminals ({error})")).ok()
}

fn address(client: &TTYPort) -> String {
    format!("serial:{}?baud=115200", client.name().unwrap())
}

impl Line {
    /// Connects a line to a controller; `None` if this machine has no pseudo-terminals.
    fn to(controller: Simulated, seed: u64, per_mille: u64) -> Option<Self> {
        let (port, client) = pair()?;
        let (unplugged, corrupted) = <(Arc<AtomicBool>, Arc<AtomicU32>)>::default();
        let random = Random(seed);
        let wire =
            Noisy { port, random, per_mille, unplugged: Arc::clone(&unplugged), corrupted: Arc::clone(&corrupted) };
        let controller = Mutex::new(controller);
        // an error is the end of the line
        let server = thread::spawn(move || drop(serve(wire, &controller, PeerId(1))));
        Some(Self { client, unplugged, corrupted, server: Some(server) })
    }

    fn unplug(&mut self) {
        self.unplugged.store(true, Ordering::Release);
        if let Some(server) = self.server.take() {
            server.join().unwrap();
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.unplug();
    }
}

impl Noisy {
    fn corrupt(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            if self.random.happens(self.per_mille) {
                *byte ^= 1 << self.random.below(8);
                self.corrupted.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

impl Read for Noisy {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.port.read(buffer)?;
        self.corrupt(&mut buffer[..count]);
        Ok(count)
    }
}

impl Write for Noisy {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut bytes = bytes.to_vec();
        self.corrupt(&mut bytes);
        self.port.write_all(&bytes)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

impl Wire for Noisy {
    fn set_wait(&mut self, wait: Option<Duration>) -> io::Result<()> {
        if self.unplugged.load(Ordering::Acquire) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        Ok(self.port.set_timeout(wait.unwrap_or(LOOK).min(LOOK))?)
    }
}

fn simulated() -> Simulated {
    Simulated::new(Config::new(Profile::Rc8))
}

/// Short time limits, because each corrupted frame costs one of them.
fn settings() -> Settings {
    let mut settings = Settings::rc8().service(ServiceOptions::default().watchdog(Duration::from_millis(80)));
    settings.options.serial.timing.attempts = 10;
    settings.options.serial.timing.attempt_timeout = Duration::from_millis(100);
    settings.reconnect(Backoff { min: Duration::from_millis(1), max: Duration::from_millis(20) })
}

/// A value of each of the nine kinds; `round` makes those of the rounds differ.
fn values(round: i16) -> [(&'static str, OwnedVariant); 9] {
    let number = f32::from(round);
    let far = f64::from(number);
    let joints = Joints::new([far, 45.5, 90.0, 0.0, 45.0, -10.0]);
    let position = Position::new([400.0 + far, 0.5, 300.0], [180.0, 0.0, 180.0]).figure(5);
    let transform = Transform::new([400.0, far, 300.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    [
        ("I1", OwnedVariant::new(&(i32::from(round) * -70_000)).unwrap()),
        ("F2", OwnedVariant::new(&(number * 0.5)).unwrap()),
        ("D3", OwnedVariant::new(&(far / 3.0)).unwrap()),
        ("V4", OwnedVariant::new(&[number, -1.5, 2.25].as_slice()).unwrap()),
        ("P5", OwnedVariant::new(&position).unwrap()),
        ("J6", OwnedVariant::new(&joints).unwrap()),
        ("T7", OwnedVariant::new(&transform).unwrap()),
        ("S8", OwnedVariant::new(&format!("round {round}, {}", "é".repeat(60))[..]).unwrap()),
        ("IO128", OwnedVariant::new(&(round % 2 == 0)).unwrap()),
    ]
}

const ROUNDS: i16 = 12;

#[test]
fn every_kind_of_variable_survives_noise_on_the_line() {
    let Some(line) = Line::to(simulated(), 1, 1) else { return };
    let mut cell = blocking::Controller::connect(&address(&line.client), &settings()).unwrap();
    for round in 1..=ROUNDS {
        for (name, value) in values(round) {
            cell.write(name, &value).unwrap();
        }
        for (name, value) in values(round) {
            assert_eq!(cell.read::<OwnedVariant>(name).unwrap(), value, "{name} in round {round}");
        }
    }
    cell.close().unwrap();
    let corrupted = line.corrupted.load(Ordering::Relaxed);
    println!("{corrupted} bytes corrupted");
    assert!(corrupted > 5, "{corrupted}");
}

#[tokio::test]
async fn every_kind_of_variable_survives_noise_on_the_line_under_tokio() {
    let Some(line) = Line::to(simulated(), 2, 1) else { return };
    let cell = asynch::Controller::connect(&address(&line.client), &settings()).await.unwrap();
    for round in 1..=ROUNDS {
        for (name, value) in values(round) {
            cell.write(name, &value).await.unwrap();
        }
        for (name, value) in values(round) {
            assert_eq!(cell.read::<OwnedVariant>(name).await.unwrap(), value, "{name} in round {round}");
        }
    }
    cell.close().await.unwrap();
    let corrupted = line.corrupted.load(Ordering::Relaxed);
    println!("{corrupted} bytes corrupted");
    assert!(corrupted > 5, "{corrupted}");
}

#[test]
fn an_unplugged_line_is_a_lost_connection() {
    let Some(mut line) = Line::to(simulated(), 3, 0) else { return };
    let mut cell = blocking::Controller::connect(&address(&line.client), &settings()).unwrap();
    cell.write("I1", 1).unwrap();
    line.unplug();
    let error = cell.read::<i32>("I1").unwrap_err();
    assert!(error.is_lost(), "{error}");
}

#[tokio::test]
async fn an_unplugged_line_is_a_lost_connection_under_tokio() {
    let Some(mut line) = Line::to(simulated(), 4, 0) else { return };
    let cell = asynch::Controller::connect(&address(&line.client), &settings()).await.unwrap();
    cell.write("I1", 1).await.unwrap();
    let mut states = cell.states();
    assert_eq!(states.next().await, Some(asynch::State::Connected));
    line.unplug();
    // the loss is seen without a call
    let state = states.next().await.unwrap();
    assert!(!matches!(state, asynch::State::Connected), "{state:?}");
    let error = cell.read::<i32>("I1").await.unwrap_err();
    assert!(matches!(error, Error::NotConnected { .. }), "{error}");
}

/// A line whose other end takes the first byte of a request and is then unplugged.
fn unplugged_during_a_call() -> Option<(TTYPort, JoinHandle<()>)> {
    let (mut port, client) = pair()?;
    let unplugging = thread::spawn(move || {
        port.set_timeout(Duration::from_secs(60)).unwrap();
        port.read_exact(&mut [0]).unwrap();
    });
    Some((client, unplugging))
}

#[tokio::test]
async fn a_call_ends_when_the_line_is_unplugged() {
    let Some((line, unplugging)) = unplugged_during_a_call() else { return };
    let error = blocking::Controller::connect(&address(&line), &settings()).unwrap_err();
    assert!(error.is_lost(), "{error}");
    unplugging.join().unwrap();

    let Some((line, unplugging)) = unplugged_during_a_call() else { return };
    let error = asynch::Controller::connect(&address(&line), &settings()).await.unwrap_err();
    assert!(error.is_lost(), "{error}");
    unplugging.join().unwrap();
}

#[tokio::test]
async fn a_line_carries_one_session() {
    let Some(line) = Line::to(simulated(), 5, 0) else { return };
    let mut cell = blocking::Controller::connect(&address(&line.client), &settings()).unwrap();
    assert!(matches!(cell.stopper(), Err(Error::NoSecondSession)));
    for error in [
        blocking::Controller::connect(&address(&line.client), &settings()).unwrap_err(),
        asynch::Controller::connect(&address(&line.client), &settings()).await.unwrap_err(),
    ] {
        assert!(error.to_string().starts_with("cannot open the serial line /dev/pts/"), "{error}");
    }
    cell.write("I1", 7).unwrap();
    cell.close().unwrap();
    // the next client gets its own session
    let cell = asynch::Controller::connect(&address(&line.client), &settings()).await.unwrap();
    assert!(matches!(cell.stopper().await, Err(Error::NoSecondSession)));
    assert_eq!(cell.read::<i32>("I1").await.unwrap(), 7);
    cell.close().await.unwrap();
}

#[test]
fn a_device_that_does_not_exist_is_named() {
    let error = blocking::Controller::connect("serial:/dev/no-such-line", &settings()).unwrap_err();
    assert_eq!(error.to_string(), "cannot open the serial line /dev/no-such-line");
}
