//! The gateway: lines from the input on one side, a robot that answers by the input on the other.

use bcap_core::endpoint::{Endpoint, Serve};
use core::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{self, Handler, Request, Session};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_core::time::Instant;
use bcap_gateway::{Allow, Bounds, Config, Event, Gateway, Memory, Rate, Rules};

/// Serves two PLCs that send the input, and returns how many requests the robot has executed.
pub fn serve(input: &[u8]) -> u32 {
    let bound = input.first().copied().map_or(0.0, f64::from);
    let values = [Bounds { min: -bound, max: bound }];
    let put = [Allow::all(VariableKind::P), Allow { values: &values, ..Allow::range(VariableKind::I, 1, 1000) }];
    let rate = Rate { per_second: 100, burst: 1000 };
    let rules = Rules { put: &put, convert: bound > 0.0, rate, ..Rules::READ_ONLY };
    let mut memory = Memory::<2, 2>::new();
    let mut gateway = Gateway::new(Config { rules, ..Config::RC9 }, &mut memory);
    let mut robot = Robot { input, at: 0 };
    let mut session = Session::<[u8; 512], [u8; 512], 8>::new(server::Config::TCP, [0; 512], [0; 512]);
    let mut now = Instant::ZERO;
    let (mut open, mut sum) = (false, 0_u32);
    for chunk in input.chunks(40) {
        now = now + Duration::from_millis(200);
        for _ in 0..2 {
            let Some(plc) = gateway.open() else { break };
            let count = super::carry(chunk, gateway.receive_buffer(plc));
            gateway.received(plc, count);
        }
        if gateway.robot_wanted() != open {
            open = gateway.robot_wanted();
            match open {
                true => gateway.robot_opened(now),
                false => gateway.robot_closed(now),
            }
        }
        loop {
            while let Some(event) = gateway.poll_event(now) {
                sum = sum.wrapping_add(count(&mut gateway, event));
            }
            let sent = super::carry(gateway.robot_transmit(), session.receive_buffer());
            if sent == 0 {
                break;
            }
            gateway.robot_transmitted(sent);
            session.received(sent);
            while session.run(&mut robot, PeerId(1), now).is_some() {}
            let received = super::carry(session.transmit(), gateway.robot_receive_buffer());
            session.transmitted(received);
            gateway.robot_received(received);
        }
        // some of its bytes are not valid replies
        if robot.next() == b'!' {
            let received = super::carry(chunk, gateway.robot_receive_buffer());
            gateway.robot_received(received);
        }
        now = now.max(gateway.poll_timeout().filter(|_| robot.next() == b'?').unwrap_or(now));
    }
    sum.wrapping_add(u32::from(gateway.counters().served.percentile(50) > Duration::from_secs(1)))
}

/// Looks at an event, and lets the client go that it is about.
fn count(gateway: &mut Gateway<'_>, event: Event) -> u32 {
    let Some(peer) = event.peer() else { return 0 };
    let length = gateway.transmit(peer).len();
    gateway.transmitted(peer, length);
    let seen = u32::from(!gateway.line(peer).is_empty());
    gateway.close(peer);
    match event {
        Event::Served { .. } => seen,
        _ => 0,
    }
}

/// A robot with values from the input.
struct Robot<'a> {
    input: &'a [u8],
    at: usize,
}

impl Robot<'_> {
    fn next(&mut self) -> u8 {
        self.at = self.at.wrapping_add(1);
        self.input.get(self.at.checked_rem(self.input.len()).unwrap_or(0)).copied().unwrap_or(0)
    }
}

impl Handler for Robot<'_> {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let byte = self.next();
        let set = match request.function {
            FunctionId::VARIABLE_GET_VALUE if byte & 3 == 0 => reply.set(&[f64::from(byte); 7]),
            FunctionId::VARIABLE_GET_VALUE if byte & 3 == 1 => reply.set(&"text"),
            FunctionId::VARIABLE_GET_VALUE if byte & 3 == 2 => reply.set(&u64::from(byte)),
            FunctionId::VARIABLE_GET_VALUE | FunctionId::VARIABLE_PUT_VALUE if byte & 4 == 0 => {
                return HResult::E_HANDLE.into();
            }
            _ => reply.set(&i32::from(byte)),
        };
        set.map_or(HResult::E_FAIL, |()| HResult::S_OK).into()
    }
}
