//! A client and a server of the core with a wire between them that takes no time and follows a scenario.

use bcap_core::bcap::call::{self, Call, ControllerHandle, RobotHandle};
use bcap_core::bcap::client::{self, ClientError, Event, Timing};
use bcap_core::bcap::server::{self, Session};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::slave::Handles;
use bcap_core::time::Instant;
use bcap_sim::scenario::Delivery;

use crate::common::World;

/// The connection between a client and the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Link {
    Tcp,
    Udp,
}

pub(crate) const LINKS: [Link; 2] = [Link::Tcp, Link::Udp];

type Buffer = [u8; 1024];

/// A connection.
pub(crate) struct Wire {
    pub(crate) client: client::Client<Buffer>,
    session: Session<Buffer>,
    pub(crate) peer: PeerId,
    /// Requests that the client has put on the wire, repetitions too.
    pub(crate) requests: u32,
    cut: bool,
}

impl Wire {
    pub(crate) fn new(link: Link, peer: u32) -> Self {
        let (client, server) = match link {
            Link::Tcp => (client::Config::TCP, server::Config::TCP),
            Link::Udp => (client::Config::UDP, server::Config::UDP),
        };
        Self {
            client: client::Client::new(client, [0; 1024], [0; 1024]),
            session: Session::new(server, [0; 1024], [0; 1024]),
            peer: PeerId(peer),
            requests: 0,
            cut: false,
        }
    }

    /// Starts the service and opens controller and robot.
    pub(crate) fn open(&mut self, world: &mut World) -> Handles {
        self.call(world, &call::service_start("")).unwrap();
        let provider = world.sim.config().model.provider.clone();
        self.call(world, &call::controller_connect("", &provider, "localhost", "")).unwrap();
        let controller = self.client.value::<ControllerHandle>().unwrap();
        self.call(world, &call::controller_get_robot(controller, "Arm", "")).unwrap();
        Handles { controller, robot: self.client.value::<RobotHandle>().unwrap() }
    }

    /// Makes a call and polls it until its end, moving the clock to each next event.
    pub(crate) fn call(&mut self, world: &mut World, call: &impl Call) -> Result<HResult, ClientError> {
        self.call_with(world, call, self.client.timing())
    }

    /// Makes a call with its own timing.
    pub(crate) fn call_with(
        &mut self,
        world: &mut World,
        call: &impl Call,
        timing: Timing,
    ) -> Result<HResult, ClientError> {
        if self.cut {
            return Err(ClientError::Closed);
        }
        self.client.start(call, timing, world.now)?;
        for _ in 0..10_000 {
            self.send();
            self.serve(world);
            if self.cut {
                return Err(ClientError::Closed);
            }
            match self.client.poll_event(world.now).or_else(|| self.wait(world)) {
                Some(Event::Replied(code)) => return Ok(code),
                Some(Event::Failed(error)) => return Err(error),
                _ => {}
            }
        }
        panic!("{:?} never ends", call.function());
    }

    fn send(&mut self) {
        while !self.client.transmit().is_empty() {
            let bytes = self.client.transmit();
            let buffer = self.session.receive_buffer();
            let count = bytes.len();
            // a server that is busy with a datagram's call has no room for its repetition
            if buffer.len() >= count {
                buffer[..count].copy_from_slice(bytes);
                self.session.received(count);
            }
            self.requests += 1;
            self.client.transmitted(count);
        }
    }

    fn serve(&mut self, world: &mut World) {
        loop {
            let event = self.session.run(&mut world.sim, self.peer, world.now);
            let mut bytes = self.session.transmit().to_vec();
            if event.is_none() && bytes.is_empty() {
                return;
            }
            self.session.transmitted(bytes.len());
            if bytes.is_empty() {
                continue;
            }
            match world.sim.deliver(self.peer, &mut bytes) {
                Delivery::Send => {
                    self.client.receive_buffer()[..bytes.len()].copy_from_slice(&bytes);
                    self.client.received(bytes.len());
                }
                Delivery::Drop => {}
                Delivery::Disconnect => self.cut = true,
            }
        }
    }

    /// Moves the clock to the next event: a time limit of the client or a cycle of the controller.
    fn wait(&mut self, world: &mut World) -> Option<Event> {
        let next = [self.client.poll_timeout(), self.session.poll_timeout()].into_iter().flatten().min();
        world.now = world.now.max(next.unwrap_or(Instant::ZERO));
        world.sim.advance(world.now);
        self.client.handle_timeout(world.now)
    }
}
