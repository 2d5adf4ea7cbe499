//! The calls and procedures of the core's connections, over all three kinds of links.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::time::Duration;

use bcap_core::bcap::Link;
use bcap_core::bcap::Object;
use bcap_core::bcap::call;
use bcap_core::bcap::client::Timing;
use bcap_core::io::asynch::{Running, Transport as _};
use bcap_core::position::Joints;
use bcap_core::procedure::{
    Motion, MotionConfig, MotionStart, PathStep, Provider, Target, give_arm, move_and_wait, open, open_path,
    open_robot, prepare_robot, read_variable, release, release_controller, release_robot, write_variable,
};
use bcap_core::slave::{
    Config, Cycle, Engine, Format, MOVE_FRAME, Mode, Next, PoseType, ReceiveFormat, ReceivePose, SlaveMode,
};

use crate::cancellation::sweep::{Rig, Sweep, Work, finish, usual};

const LINKS: [Link; 3] = [Link::Stream, Link::Datagram, Link::Serial];

/// The timing of a call that brings its own, as a slvMove does.
fn short() -> Timing {
    Timing { attempt_timeout: Duration::from_millis(16), attempts: 3, ..usual(Link::Datagram) }
}

const MOVE: MotionStart<&str, &str> =
    MotionStart::Move { interpolation: 1, pose: "J(0.5,45,90,0,45,0)", option: "NEXT" };

fn end() -> Target {
    Target::joints(Joints::new([0.5, 45.0, 90.0, 0.0, 45.0, 0.0]), 6)
}

fn config() -> MotionConfig {
    MotionConfig::within(Duration::from_secs(10))
}

fn ready(rig: &mut Rig) {
    finish(rig.motion.run(prepare_robot(rig.handles.robot, [0, 1], true))).unwrap();
}

/// Streams two poses and leaves.
fn stream<'a>(rig: &'a mut Rig, is_watched: bool) -> Work<'a> {
    Box::pin(async move {
        let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
        let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
        let watch = is_watched.then_some(rig.watching);
        let mut engine = Engine::<MOVE_FRAME>::new(Config { watch, ..Config::new(format, rig.handles) }).unwrap();
        let mut hold = |cycle: &Cycle<'_>| if cycle.number < 2 { Next::Pose(*cycle.start) } else { Next::Finish };
        match is_watched {
            true => rig.motion.run_watched(&mut rig.watch, engine.stream(&mut hold)).await.is_ok(),
            false => rig.motion.run(engine.stream(&mut hold)).await.is_ok(),
        }
    })
}

/// Drops calls and procedures at every await point; returns how many each function has.
pub(crate) fn all() -> BTreeMap<&'static str, usize> {
    let mut points = BTreeMap::new();
    let mut add = |name: &'static str, found: Result<usize, String>| {
        *points.entry(name).or_default() += found.unwrap_or_else(|fault| panic!("{fault}"));
    };
    for kind in LINKS {
        let sweep = |name, prepare| Sweep { name, kind, piece: 1, prepare };
        let idle: fn(&mut Rig) = |_| {};
        add("call", sweep("call", idle).run(|rig| Box::pin(get(rig))));
        add(
            "call_with",
            sweep("call_with", idle).run(|rig| {
                let call = call::controller_get_robot_names(rig.handles.controller, "");
                Box::pin(async { rig.motion.call_with(call, short()).await.is_ok() })
            }),
        );
        add(
            "exchange",
            sweep("exchange", idle).run(|rig| {
                let call = call::controller_get_robot_names(rig.handles.controller, "");
                Box::pin(async { rig.motion.exchange(call).await.is_ok() })
            }),
        );
        procedures(kind, &mut add);
        let piece = if kind == Link::Stream { 3 } else { 64 };
        let long = |name, prepare| Sweep { name, kind, piece, prepare };
        add("run", long("run a stream", idle).run(|rig| stream(rig, false)));
        add("run_watched", long("run_watched", idle).run(|rig| stream(rig, true)));
        add(
            "run",
            long("move_and_wait", ready).run(|rig| {
                let motion = move_and_wait(rig.handles, MOVE, end(), config());
                Box::pin(async { rig.motion.run(motion).await.is_ok_and(|motion| motion == Motion::Arrived) })
            }),
        );
        add("advance", long("advance", ready).run(|rig| Box::pin(advance(rig))));
        again(long("move_and_wait", ready).run_again(|rig| move_and_wait(rig.handles, MOVE, end(), config())));
    }
    points
}

/// Runs a motion by steps, as a caller that makes other calls in between does.
async fn advance(rig: &mut Rig) -> bool {
    let mut running = Running::new(move_and_wait(rig.handles, MOVE, end(), config()));
    loop {
        match rig.motion.advance(&mut running).await {
            ControlFlow::Continue(at) => rig.motion.transport().sleep_until(at).await,
            ControlFlow::Break(ended) => return ended.is_ok_and(|motion| motion == Motion::Arrived),
        }
    }
}

async fn get(rig: &mut Rig) -> bool {
    rig.motion.call(call::controller_get_robot_names(rig.handles.controller, "")).await.is_ok()
}

fn again(result: Result<(), String>) {
    result.unwrap_or_else(|fault| panic!("{fault}"));
}

/// Sweeps a procedure that runs over one connection, and runs it again after each drop.
macro_rules! procedure {
    ($kind:ident, $add:ident, $name:literal, $prepare:expr, $make:expr) => {{
        let sweep = Sweep { name: $name, kind: $kind, piece: 1, prepare: $prepare };
        $add(
            "run",
            sweep.run(|rig| {
                let procedure = $make(rig);
                Box::pin(async { rig.motion.run(procedure).await.is_ok() })
            }),
        );
        again(sweep.run_again($make));
    }};
}

fn procedures(kind: Link, add: &mut impl FnMut(&'static str, Result<usize, String>)) {
    let idle: fn(&mut Rig) = |_| {};
    procedure!(kind, add, "open", idle, |_: &Rig| open(Provider::RC8));
    procedure!(kind, add, "open_robot", idle, |_: &Rig| open_robot(Provider::RC8, None));
    procedure!(kind, add, "open_path", idle, |rig: &Rig| {
        let path = [PathStep { object: Object::Robot, name: None }, PathStep::variable("@SERVO_ON")];
        open_path(rig.handles.controller, &path).unwrap()
    });
    procedure!(kind, add, "release", idle, |rig: &Rig| release(&[(Object::Robot, rig.handles.robot.0)]));
    procedure!(kind, add, "release_controller", idle, |rig: &Rig| release_controller(rig.handles.controller));
    procedure!(kind, add, "release_robot", idle, |rig: &Rig| release_robot(rig.handles));
    procedure!(kind, add, "read_variable", idle, |rig: &Rig| {
        read_variable(rig.handles.controller, "I1", |value| value.as_i32()).unwrap()
    });
    procedure!(kind, add, "write_variable", idle, |rig: &Rig| {
        write_variable(rig.handles.controller, "I1", &5_i32).unwrap()
    });
    procedure!(kind, add, "prepare_robot", idle, |rig: &Rig| prepare_robot(rig.handles.robot, [0, 1], true));
    procedure!(kind, add, "give_arm", ready, |rig: &Rig| give_arm(rig.handles.robot));
}

/// The former implementation, before calls had their own timing: it changed the client's timing, and restored it after
/// the reply.
async fn change_timing_and_call(rig: &mut Rig) -> bool {
    let usual = rig.motion.client().timing();
    rig.motion.client().set_timing(short());
    let replied = get(rig).await;
    rig.motion.client().set_timing(usual);
    replied
}

/// The effect of dropping a faulty call.
struct OnDrop<'a, F: FnMut(&mut Rig)>(&'a mut Rig, Option<F>);

impl<F: FnMut(&mut Rig)> Drop for OnDrop<'_, F> {
    fn drop(&mut self) {
        if let Some(fault) = &mut self.1 {
            fault(self.0);
        }
    }
}

async fn call_and<F: FnMut(&mut Rig)>(rig: &mut Rig, on_drop: F) -> bool {
    let mut guard = OnDrop(rig, Some(on_drop));
    let replied = get(guard.0).await;
    guard.1 = None;
    replied
}

#[test]
fn planted_faults_are_found() {
    for kind in LINKS {
        let sweep = |name| Sweep { name, kind, piece: 1, prepare: |_| {} };
        let fault = sweep("timing").run(|rig| Box::pin(change_timing_and_call(rig))).unwrap_err();
        assert!(fault.contains(" polls: the timing: sent at"), "{fault}");
        // a call that is made again when it is dropped
        let call_again = |rig: &mut Rig| assert!(finish(get(rig)));
        let fault = sweep("twice").run(|rig| Box::pin(call_and(rig, call_again))).unwrap_err();
        assert!(fault.contains(" polls: executed"), "{fault}");
    }
    // the rest of a request is dropped, so the next request begins in the middle of it
    let forget = |rig: &mut Rig| rig.motion.client().reset();
    let sweep = Sweep { name: "reset", kind: Link::Stream, piece: 1, prepare: |_| {} };
    let fault = sweep.run(|rig| Box::pin(call_and(rig, forget))).unwrap_err();
    assert!(fault.contains("the reply is"), "{fault}");
}
