//! The core's engine of slave mode against the virtual controller: two sides that were written apart must agree.
//!
//! Every call goes through the core's client and server, over a wire that is a stream or carries datagrams.

mod causes;
mod faults;
mod formats;
mod streams;
mod wire;

use bcap_core::hresult::HResult;
use bcap_core::slave::{
    Channel, Config as Stream, Engine, EngineAction, Extended, ExtendedAxes, Failure, Format, Mode, MoveReply, Pose,
    PoseType, ReceiveFormat, ReceivePose, SlaveMode, Step,
};
use bcap_core::time::Instant;
use bcap_sim::Config;

use crate::common::World;
use wire::{Link, Wire};

const MODES: [Mode; 3] = [Mode::Mode0, Mode::Mode1, Mode::Mode2];

/// An engine, its two connections and their controller.
struct Rig {
    world: World,
    wires: [Wire; 2],
    engine: Engine,
    /// The calls that the engine has made, and when.
    sent: Vec<(Instant, Step)>,
    /// Poses that were answered with their value.
    moves: u32,
    /// Checks each answer of slvMove as it arrives, against the controller that made it.
    look: fn(&Format, &MoveReply<'_>, &World),
}

impl Rig {
    fn new(link: Link, format: Format) -> Self {
        Self::with(link, format, Config { extended_axes: 2, ..Config::default() }, |_| {})
    }

    fn with(link: Link, format: Format, config: Config, change: impl FnOnce(&mut Stream)) -> Self {
        let mut world = World::with(config);
        let mut wires = [Wire::new(link, 1), Wire::new(Link::Tcp, 2)];
        let [motion, watch] = wires.each_mut().map(|wire| wire.open(&mut world));
        let mut config = Stream { watch: Some(watch), ..Stream::new(format, motion) };
        change(&mut config);
        let engine = Engine::new(config).unwrap();
        Self { world, wires, engine, sent: Vec::new(), moves: 0, look: |_, _, _| {} }
    }

    /// Makes the engine's call.
    fn call(&mut self, channel: Channel) {
        let wire = &mut self.wires[usize::from(channel == Channel::Watch)];
        let request = self.engine.request().unwrap();
        self.sent.push((self.world.now, request.step()));
        let timing = self.engine.timing(wire.client.link(), wire.client.timing());
        let result = wire.call_with(&mut self.world, &request, timing);
        match result {
            Ok(_) => {
                let format = self.engine.config().format;
                let reply = wire.client.reply().unwrap();
                if let Some(moved) = self.engine.handle_reply(&reply, self.world.now) {
                    self.moves += 1;
                    (self.look)(&format, &moved, &self.world);
                }
            }
            Err(error) => self.engine.handle_failure(Failure::from(error), self.world.now),
        }
    }

    /// Runs until the engine ends; `next` gives poses, `None` finishes.
    fn run(&mut self, mut next: impl FnMut(&mut Self) -> Option<Pose>) -> EngineAction {
        for _ in 0..20_000 {
            match self.engine.poll(self.world.now) {
                EngineAction::Call(_, channel) => self.call(channel),
                EngineAction::Wait(until) => {
                    self.world.now = self.world.now.max(until);
                    self.world.sim.advance(self.world.now);
                }
                EngineAction::Pose { .. } => match next(self) {
                    Some(pose) => self.engine.push(&pose).unwrap(),
                    None => self.engine.finish(),
                },
                end => return end,
            }
        }
        panic!("the engine does not end");
    }

    fn errors(&self) -> Vec<HResult> {
        self.world.sim.errors().map(|e| e.code).collect()
    }

    /// Counts the calls of a kind.
    fn sent(&self, step: Step) -> usize {
        self.sent.iter().filter(|(_, sent)| *sent == step).count()
    }
}

fn format(mode: Mode, pose: PoseType) -> Format {
    Format::new(SlaveMode { mode, pose }, ReceiveFormat::pose(ReceivePose::J))
}

/// Says where the stream began, with something added to one number.
fn from_start(rig: &Rig, number: usize, by: f64) -> Pose {
    let start = rig.engine.start_pose().unwrap();
    let mut numbers = start.numbers().to_vec();
    numbers[number] += by;
    let pose = Pose::from_numbers(start.layout().pose, &numbers).unwrap();
    match start.layout().extended {
        ExtendedAxes::None => pose,
        ExtendedAxes::Seven => pose.with_extended(Extended::Seven(0.0)),
        ExtendedAxes::Eight => pose.with_extended(Extended::Eight(0.0)),
        ExtendedAxes::Both => pose.with_extended(Extended::Both(0.0, 0.0)),
    }
}

/// Goes up by `height` in `cycles` cycles, at rest at both ends.
fn smooth(at: u16, count: u16) -> f64 {
    let x = f64::from(at) / f64::from(count);
    x * x * (3.0 - 2.0 * x)
}
