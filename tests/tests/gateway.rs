//! Tests the core's gateway with the virtual controller, in one process and with one fake clock.

use bcap_core::endpoint::{Endpoint, Serve};
use std::time::Duration;

use bcap_core::bcap::server::{self, Session};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::Variant;
use bcap_gateway::{Allow, Config, Event, Gateway, Memory, RobotError, Rules};
use bcap_sim::{Controller, Profile, VariableKind};

const WRITABLE: Rules<'static> = Rules { put: &Allow::EVERYTHING, ..Rules::READ_ONLY };

/// A gateway, a controller and the connection between them.
struct Plant<'m> {
    gateway: Gateway<'m>,
    controller: Controller,
    session: Session<Vec<u8>, Vec<u8>, 64>,
    connections: u32,
    now: Instant,
    events: Vec<Event>,
}

impl<'m> Plant<'m> {
    fn new<const S: usize, const H: usize>(config: Config<'m>, memory: &'m mut Memory<S, H>) -> Self {
        Self {
            gateway: Gateway::new(config, memory),
            controller: Controller::new(bcap_sim::Config::new(Profile::Rc8)),
            session: new_session(),
            connections: 0,
            now: Instant::from_millis(1),
            events: Vec::new(),
        }
    }

    /// Opens a connection; the controller takes it for a new client.
    fn connect(&mut self) {
        self.disconnect();
        self.connections += 1;
        self.session = new_session();
        self.gateway.robot_opened(self.now);
        self.settle();
    }

    fn disconnect(&mut self) {
        self.session.close(&mut self.controller, PeerId(self.connections), self.now);
    }

    fn poll(&mut self) {
        while let Some(event) = self.gateway.poll_event(self.now) {
            self.events.push(event);
        }
    }

    fn settle(&mut self) {
        loop {
            self.poll();
            let request = self.gateway.robot_transmit().to_vec();
            if request.is_empty() {
                return;
            }
            self.session.receive_buffer()[..request.len()].copy_from_slice(&request);
            self.session.received(request.len());
            self.gateway.robot_transmitted(request.len());
            while self.session.run(&mut self.controller, PeerId(self.connections), self.now).is_some() {}
            // in small pieces, as a slow network brings them
            while !self.session.transmit().is_empty() {
                let piece: Vec<u8> = self.session.transmit().iter().copied().take(7).collect();
                self.gateway.robot_receive_buffer()[..piece.len()].copy_from_slice(&piece);
                self.gateway.robot_received(piece.len());
                self.session.transmitted(piece.len());
                self.poll();
            }
        }
    }

    fn ask(&mut self, plc: PeerId, line: &str) -> String {
        self.gateway.receive_buffer(plc)[..line.len()].copy_from_slice(line.as_bytes());
        self.gateway.received(plc, line.len());
        self.settle();
        let answer = String::from_utf8(self.gateway.transmit(plc).to_vec()).unwrap();
        self.gateway.transmitted(plc, answer.len());
        answer
    }
}

fn new_session() -> Session<Vec<u8>, Vec<u8>, 64> {
    Session::new(server::Config::TCP, vec![0; 1024], vec![0; 1024])
}

fn line(result: HResult) -> String {
    format!("{}\r", result.0)
}

#[test]
fn all_kinds_are_written_to_the_controller() {
    let mut memory = Memory::<2, 4>::new();
    let mut plant = Plant::new(Config { rules: WRITABLE, ..Config::RC8 }, &mut memory);
    plant.connect();
    assert_eq!(plant.events, [Event::RobotUp]);
    let plc = plant.gateway.open().unwrap();
    // more variables than handles, twice
    for round in 0..2 {
        for (kind, text) in [
            ("I", "3,-5"),
            ("F", "4,0.1"),
            ("D", "5,0.1"),
            ("S", "8,Grüße, 世界"),
            ("V", "8196,1,2,3"),
            ("P", "8196,400,0,300.5,180,0,180,5"),
            ("J", "8196,1,2,3,4,5,6,7,8"),
            ("T", "8196,1,2,3,4,5,6,7,8,9,-1"),
            ("IO", "11,-1"),
        ] {
            assert_eq!(plant.ask(plc, &format!("PUT:RC8:{round}:{kind}:{text}\r")), "0\r", "{kind}");
            assert_eq!(plant.ask(plc, &format!("GET:RC8:{round}:{kind}:\r")), format!("0,{text}\r"));
        }
    }
    let stored = plant.controller.variable::<64>(VariableKind::I, 1).unwrap();
    assert_eq!(stored.as_variant(), Variant::I4(-5));
    // the controller's own refusals come through
    assert_eq!(plant.ask(plc, "GET:RC8:100:I:\r"), line(HResult::DISP_E_BADINDEX));
    assert_eq!(plant.gateway.counters().served.count(), 36);
}

#[test]
fn many_clients_use_their_own_variables() {
    let mut memory = Memory::<8, 5>::new();
    let mut plant = Plant::new(Config { rules: WRITABLE, ..Config::RC8 }, &mut memory);
    plant.connect();
    let plcs: Vec<PeerId> = std::iter::from_fn(|| plant.gateway.open()).collect();
    assert_eq!(plcs.len(), 8);
    for round in 0..50 {
        // all lines are there before the first is answered
        for (n, plc) in plcs.iter().enumerate() {
            let line = format!("PUT:RC8:{n}:I:3,{}\rGET:RC8:{n}:I:\r", round * 100 + n);
            plant.gateway.receive_buffer(*plc)[..line.len()].copy_from_slice(line.as_bytes());
            plant.gateway.received(*plc, line.len());
        }
        for expected in ["put", "get"] {
            plant.settle();
            for (n, plc) in plcs.iter().enumerate() {
                let answer = String::from_utf8(plant.gateway.transmit(*plc).to_vec()).unwrap();
                plant.gateway.transmitted(*plc, answer.len());
                let value = format!("0,3,{}\r", round * 100 + n);
                assert_eq!(answer, if expected == "put" { "0\r" } else { &value });
            }
        }
    }
}

#[test]
fn the_gateway_reconnects_to_a_controller() {
    let mut memory = Memory::<1, 4>::new();
    let mut plant = Plant::new(Config { rules: WRITABLE, ..Config::RC8 }, &mut memory);
    let plc = plant.gateway.open().unwrap();
    assert_eq!(plant.ask(plc, "GET:RC8:1:I:\r"), line(HResult::E_NOT_CONNECTED));
    for round in 0..3 {
        plant.connect();
        assert_eq!(plant.ask(plc, &format!("PUT:RC8:1:I:3,{round}\r")), "0\r");
        assert_eq!(plant.ask(plc, "GET:RC8:1:I:\r"), format!("0,3,{round}\r"), "with a handle of this connection");
        plant.gateway.robot_closed(plant.now);
        assert_eq!(plant.ask(plc, "GET:RC8:1:I:\r"), line(HResult::E_NOT_CONNECTED));
        plant.now = plant.gateway.poll_timeout().unwrap();
        plant.settle();
        assert!(plant.gateway.robot_wanted());
    }
    assert_eq!(plant.gateway.counters().connected, 3);
}

#[test]
fn a_provider_that_the_controller_does_not_have_is_reported() {
    let mut memory = Memory::<1, 4>::new();
    let mut plant = Plant::new(Config { provider: "CaoProv.Unknown", ..Config::RC8 }, &mut memory);
    plant.connect();
    let [Event::RobotDown { error: RobotError::Refused { function, result }, pause }] = plant.events[..] else {
        panic!("{:?}", plant.events)
    };
    assert_eq!((function.to_string().as_str(), pause), ("Controller_Connect", Duration::from_millis(500)));
    assert!(result.is_err());
}

#[test]
fn an_idle_connection_is_kept_alive_by_a_request() {
    let mut memory = Memory::<1, 4>::new();
    let mut plant = Plant::new(Config::RC8, &mut memory);
    plant.connect();
    plant.events.clear();
    for _ in 0..20 {
        plant.now = plant.gateway.poll_timeout().unwrap();
        plant.settle();
    }
    assert_eq!(plant.events, []);
    assert!(plant.gateway.is_up() && plant.now >= Instant::from_millis(40_000));
}
