//! Slave Mode: the engine against replies that the input makes up.

use bcap_core::bcap::call::{Call, ControllerHandle, RobotHandle};
use bcap_core::bcap::slave::{
    Action, AxisLimits, Config, Engine, Failure, Format, Handles, Mode, Pose, PoseType, ReceiveFormat, ReceivePose,
    SlaveMode,
};
use bcap_core::bcap::{Decoder, FrameWriter};
use bcap_core::time::Instant;

/// Runs an engine for as many steps as the input has bytes; returns how many replies it could read.
pub fn stream(input: &[u8]) -> u32 {
    let mut read = 0_u32;
    for (mode, pose) in [(Mode::Mode0, PoseType::P), (Mode::Mode1, PoseType::J), (Mode::Mode2, PoseType::T)] {
        let mode = SlaveMode { mode, pose };
        let handles = Handles { controller: ControllerHandle(1), robot: RobotHandle(2) };
        let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
        let config = Config { limits: AxisLimits::uniform(100.0, 1000.0), ..Config::new(format, handles) };
        if let Ok(mut engine) = Engine::new(config) {
            read = read.wrapping_add(run(&mut engine, pose, input));
        }
    }
    read
}

fn run(engine: &mut Engine, kind: PoseType, input: &[u8]) -> u32 {
    let mut read = 0_u32;
    let mut now = Instant::ZERO;
    for (step, byte) in input.iter().enumerate() {
        let number = f64::from(*byte);
        match engine.poll(now) {
            Action::Call(..) => read = read.wrapping_add(u32::from(call(engine, *byte, now))),
            Action::Pose { due } => {
                now = due;
                let pose = match kind {
                    PoseType::P => Pose::p([number; 7]),
                    PoseType::J => Pose::j([number; 8]),
                    PoseType::T => Pose::t([number; 10]),
                };
                if engine.push(&pose).is_err() || step % 100 == 99 {
                    engine.stop();
                }
            }
            Action::Wait(until) => now = until,
            Action::Finished => break,
            Action::Faulted => {
                let known = engine.fault().is_some_and(|fault| fault.code().is_some() || fault.is_underflow());
                if engine.recover().is_err() || known {
                    break;
                }
            }
        }
    }
    read.wrapping_add(u32::from(engine.margin(now).is_some() || engine.start_pose().is_some()))
}

/// Makes the call that the engine wants, and hands a reply in that `byte` chooses.
fn call(engine: &mut Engine, byte: u8, now: Instant) -> bool {
    let mut buffer = [0; 512];
    let Some(request) = engine.request() else { return false };
    let Ok(mut frame) = FrameWriter::new(&mut buffer) else { return false };
    let sent = request.arguments(&mut frame).is_ok() && frame.finish(1, 0, request.function().0).is_ok();
    let Ok(mut frame) = FrameWriter::new(&mut buffer) else { return false };
    let pose = [f64::from(byte); 8];
    let value = match byte % 5 {
        0 => frame.argument(&pose),
        1 => frame.argument(&i32::from(byte)),
        2 => frame.argument(&(pose, 1_i32, 2_i32)),
        3 => frame.argument(&"ITP"),
        _ => frame.argument(&()),
    };
    let code = if byte % 16 == 15 { -1 } else { 0 };
    let reply = frame.finish(1, 0, code).ok().and_then(|bytes| Decoder::TCP.decode_datagram(bytes).ok());
    match reply.filter(|_| value.is_ok() && sent) {
        Some(reply) => engine.handle_reply(&reply, now).is_some(),
        None => {
            engine.handle_failure(Failure::Timeout, now);
            false
        }
    }
}
