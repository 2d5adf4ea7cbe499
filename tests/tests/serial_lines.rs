//! `Controller` over serial lines: pairs of pseudo-terminals, with the virtual controller at the other end and noise between.

use std::io::Read;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bcap_core::variant::OwnedVariant;
use bcap_sim::{Config, Controller as Simulated, Profile};
use bcap_std::{Backoff, Error, Joints, Position, ServiceOptions, Settings, Transform, asynch, blocking};
use bcap_tests::pty::{Line, address, pair};
use serialport::{SerialPort, TTYPort};

fn simulated() -> Simulated {
    Simulated::new(Config::new(Profile::Rc8))
}

/// Short time limits, because each corrupted frame costs one of them.
fn settings() -> Settings {
    let mut settings = Settings::rc8().service(ServiceOptions::default().watchdog(Duration::from_millis(80)));
    settings.options.serial.timing.attempts = 10;
    settings.options.serial.timing.attempt_timeout = Duration::from_millis(100);
    settings.reconnect(Backoff::default().min(Duration::from_millis(1)).max(Duration::from_millis(20)))
}

/// A value of each of the nine kinds; `round` makes the values of the rounds differ.
pub(crate) fn values(round: i16) -> [(&'static str, OwnedVariant); 9] {
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

/// Writes and reads every kind of variable over a noisy line; `$wait` is `.await` or nothing.
macro_rules! through_noise {
    ($line:ident, $cell:ident $(, $wait:tt)?) => {{
        for round in 1..=ROUNDS {
            for (name, value) in values(round) {
                $cell.write(name, &value)$(.$wait)?.unwrap();
            }
            for (name, value) in values(round) {
                assert_eq!($cell.read::<OwnedVariant>(name)$(.$wait)?.unwrap(), value, "{name} in round {round}");
            }
        }
        $cell.close()$(.$wait)?.unwrap();
        let corrupted = $line.corrupted();
        println!("{corrupted} bytes corrupted");
        assert!(corrupted > 5, "{corrupted}");
    }};
}

#[test]
fn every_kind_of_variable_survives_noise_on_the_line() {
    let line = Line::to(simulated(), 1, 1);
    let mut cell = blocking::Controller::connect(&line.address(), &settings()).unwrap();
    through_noise!(line, cell);
}

#[tokio::test]
async fn every_kind_of_variable_survives_noise_on_the_line_under_tokio() {
    let line = Line::to(simulated(), 2, 1);
    let cell = asynch::Controller::connect(&line.address(), &settings()).await.unwrap();
    through_noise!(line, cell, await);
}

#[test]
fn an_unplugged_line_is_a_lost_connection() {
    let mut line = Line::to(simulated(), 3, 0);
    let mut cell = blocking::Controller::connect(&line.address(), &settings()).unwrap();
    cell.write("I1", 1).unwrap();
    line.unplug();
    let error = cell.read::<i32>("I1").unwrap_err();
    assert!(error.is_lost(), "{error}");
}

#[tokio::test]
async fn an_unplugged_line_is_a_lost_connection_under_tokio() {
    let mut line = Line::to(simulated(), 4, 0);
    let cell = asynch::Controller::connect(&line.address(), &settings()).await.unwrap();
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
fn unplugged_during_a_call() -> (TTYPort, JoinHandle<()>) {
    let (mut port, client) = pair();
    let unplugging = thread::spawn(move || {
        port.set_timeout(Duration::from_secs(60)).unwrap();
        port.read_exact(&mut [0]).unwrap();
    });
    (client, unplugging)
}

#[tokio::test]
async fn a_call_ends_when_the_line_is_unplugged() {
    let (line, unplugging) = unplugged_during_a_call();
    let error = blocking::Controller::connect(&address(&line), &settings()).unwrap_err();
    assert!(error.is_lost(), "{error}");
    unplugging.join().unwrap();

    let (line, unplugging) = unplugged_during_a_call();
    let error = asynch::Controller::connect(&address(&line), &settings()).await.unwrap_err();
    assert!(error.is_lost(), "{error}");
    unplugging.join().unwrap();
}

#[tokio::test]
async fn a_line_carries_one_session() {
    let line = Line::to(simulated(), 5, 0);
    let mut cell = blocking::Controller::connect(&line.address(), &settings()).unwrap();
    assert!(matches!(cell.stopper(), Err(Error::NoSecondSession)));
    for error in [
        blocking::Controller::connect(&line.address(), &settings()).unwrap_err(),
        asynch::Controller::connect(&line.address(), &settings()).await.unwrap_err(),
    ] {
        assert!(error.to_string().starts_with("cannot open the serial line /dev/pts/"), "{error}");
    }
    cell.write("I1", 7).unwrap();
    cell.close().unwrap();
    // the next client gets its own session
    let cell = asynch::Controller::connect(&line.address(), &settings()).await.unwrap();
    assert!(matches!(cell.stopper().await, Err(Error::NoSecondSession)));
    assert_eq!(cell.read::<i32>("I1").await.unwrap(), 7);
    cell.close().await.unwrap();
}

#[test]
fn a_device_that_does_not_exist_is_named() {
    let error = blocking::Controller::connect("serial:/dev/no-such-line", &settings()).unwrap_err();
    assert_eq!(error.to_string(), "cannot open the serial line /dev/no-such-line");
}
