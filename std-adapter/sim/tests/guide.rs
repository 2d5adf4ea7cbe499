//! The frames of the RC8 guide, sent through the server of b-CAP: the virtual controller's answers are the guide's.

use bcap_core::bcap::header::field;
use bcap_core::bcap::server::{Config as Server, Session};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::PeerId;
use bcap_core::time::Instant;
use bcap_core::variant::VariantBuf;
use bcap_sim::{Config, Controller, Profile, VariableKind};

/// The guide's frames by name: `rc8_01` is a request, `rc8_02` its response, and so on.
const FRAMES: &str = include_str!("../../../tests/vectors/bcap-rc8-guide.jsonl");

fn frame(number: u32) -> Vec<u8> {
    let field = |line: &'static str, name: &str| {
        let (_, rest) = line.split_once(&format!("\"{name}\": \"")).unwrap();
        rest.split('"').next().unwrap()
    };
    let line = FRAMES.lines().find(|line| field(line, "name") == format!("rc8_{number:02}")).unwrap();
    let hex = field(line, "hex").as_bytes();
    hex.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

struct Link {
    sim: Controller,
    session: Session<[u8; 1024]>,
    now: Instant,
}

impl Link {
    fn new() -> Self {
        let session = Session::new(Server::TCP, [0; 1024], [0; 1024]);
        Self { sim: Controller::new(Config::new(Profile::Rc8)), session, now: Instant::ZERO }
    }

    /// Sends a request and lets time pass until the response is there.
    fn exchange(&mut self, request: &[u8]) -> Vec<u8> {
        self.session.receive_buffer()[..request.len()].copy_from_slice(request);
        self.session.received(request.len());
        for _ in 0..10_000 {
            while self.session.run(&mut self.sim, PeerId(1), self.now).is_some() {}
            let sent = self.session.transmit().to_vec();
            if !sent.is_empty() {
                self.session.transmitted(sent.len());
                return sent;
            }
            self.now = self.session.poll_timeout().expect("no answer, and nothing to wait for");
        }
        panic!("no answer")
    }

    /// Plays the guide's requests of these numbers, and expects the response after each.
    fn play(&mut self, numbers: &[u32]) {
        for number in numbers {
            let (request, mut response) = (frame(*number), frame(number + 1));
            // some of the guide's responses show another serial than their requests
            response[field::SERIAL].copy_from_slice(&request[field::SERIAL]);
            assert_eq!(self.exchange(&request), response, "rc8_{number:02} at {}", self.now);
        }
    }

    fn pass(&mut self, millis: u64) {
        self.now = Instant::from_micros(self.now.as_micros() + millis * 1000);
        self.sim.advance(self.now);
    }
}

#[test]
fn the_guides_session_with_a_variable() {
    let mut link = Link::new();
    link.play(&[1, 3, 5, 7, 9, 11, 13, 15]);
    assert_eq!((link.sim.open_objects(), link.session.open_objects()), (0, 0));
    let io = link.sim.variable::<8>(VariableKind::Io, 150).unwrap();
    assert_eq!(io, VariantBuf::<8>::new(&true).unwrap());
}

#[test]
fn the_guides_session_with_a_task() {
    let mut link = Link::new();
    link.play(&[1, 3, 19, 21]);
    link.pass(1500);
    link.play(&[23]);
    link.pass(1000);
    link.play(&[25, 13, 15]);
    assert_eq!(link.sim.task("Pro1").map(|(_, cycles)| cycles), Some(2));
}

#[test]
fn the_guides_session_with_the_robot() {
    let mut link = Link::new();
    let p1 = VariantBuf::<64>::new(&[300.0_f32, 100.0, 300.0, 180.0, 0.0, 180.0, 5.0]).unwrap();
    link.sim.set_variable(VariableKind::P, 1, &p1.as_variant()).unwrap();
    // TakeArm, Motor on, Move "NEXT", and Halt in its middle
    link.play(&[1, 3, 27, 29, 33, 37]);
    link.pass(100);
    assert!(link.sim.is_moving());
    link.play(&[39]);
    link.pass(500);
    assert!(!link.sim.is_moving());
    // ClearError, Move "@E P1" to its end, Motor off, GiveArm
    link.play(&[43, 45, 35, 31, 41, 13, 15]);
    assert!((link.sim.joints()[0] - 100.0_f64.atan2(300.0).to_degrees()).abs() < 1e-3);
    assert_eq!(link.sim.open_objects(), 0);
}

#[test]
fn the_guides_session_in_slave_mode() {
    let mut link = Link::new();
    // GetRobot, TakeArm, Motor on, slvChangeMode 0x001
    link.play(&[1, 3, 27, 29, 33, 47]);
    assert_eq!(link.sim.slave_mode(), 0x001);
    let reply = link.exchange(&frame(51));
    let response = frame(52);
    // everything up to the eight numbers
    assert_eq!(reply[..25], response[..25]);
    assert_eq!(reply.len(), response.len());
    // of the guide's numbers the last two are of axes that its robot has not
    let numbers = |bytes: &[u8]| -> Vec<f64> {
        bytes[25..73].chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
    };
    for (axis, (ours, guides)) in numbers(&reply).iter().zip(numbers(&response)).enumerate() {
        assert!((ours - guides).abs() < 1e-5, "J{}: {ours} is not {guides}", axis + 1);
    }
    // slvChangeMode 0x000, ClearError, Motor off, GiveArm
    link.play(&[49]);
    assert_eq!(link.sim.slave_mode(), 0);
    link.play(&[43, 35, 31, 41, 13, 15]);
    assert_eq!(link.sim.open_objects(), 0);
}

#[test]
fn a_lost_connection_leaves_nothing_behind() {
    let mut link = Link::new();
    link.play(&[1, 3, 27, 29, 33]);
    assert_eq!(link.sim.arm_owner(), Some(PeerId(1)));
    link.session.close(&mut link.sim, PeerId(1), link.now);
    assert_eq!((link.sim.arm_owner(), link.sim.open_objects()), (None, 0));
}
