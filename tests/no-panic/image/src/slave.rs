//! Slave Mode: streams in every mode, answered by whatever frames are in the input.

use bcap_core::bcap::client::{self, Client};
use bcap_core::bcap::{Decoder, Progress, call};
use bcap_core::endpoint::Endpoint;
use bcap_core::slave::{self, Engine, EngineAction};
use bcap_core::time::Instant;

/// Streams in Slave Mode in formats from the input, answered by the frames in it; returns the number of accepted poses.
pub fn stream(input: &[u8]) -> u32 {
    let mut sum = 0_u32;
    for code in 0..0x204 {
        let Some(mode) = slave::SlaveMode::from_code(code) else { continue };
        for bits in [0, input.first().copied().unwrap_or(0), 0xff] {
            sum = sum.wrapping_add(run(mode, bits, input).unwrap_or(0));
        }
    }
    sum
}

/// Runs an engine in the format that `bits` selects.
fn run(mode: slave::SlaveMode, bits: u8, input: &[u8]) -> Option<u32> {
    let number = f64::from(i32::from_le_bytes(*input.first_chunk()?)) / 1e7;
    let user = slave::UserIo::new(u16::from(bits).wrapping_add(121), bits & 7).ok();
    let on = |bit: u8| bits & bit != 0;
    let io = user.map_or(if on(1) { slave::SendIo::Mini } else { slave::SendIo::None }, slave::SendIo::User);
    let receive = slave::ReceiveFormat {
        time: on(2).then_some(slave::TimeUnit::Micros),
        mini_io: on(4),
        user_io: user,
        hand_io: on(8),
        current: on(16),
        pose: if on(32) { slave::ReceivePose::TJ } else { slave::ReceivePose::J },
    };
    let extended = if on(64) { slave::ExtendedAxes::Both } else { slave::ExtendedAxes::None };
    let send = slave::SendFormat { io, hand_io: on(128) };
    let format = slave::Format { mode, extended, send, receive };
    let handles = slave::Handles { controller: call::ControllerHandle(1), robot: call::RobotHandle(2) };
    let limits = slave::AxisLimits::uniform(number, number);
    let config = slave::Config { limits, watch: on(1).then_some(handles), ..slave::Config::new(format, handles) };
    let mut engine = Engine::<300>::new(config).ok()?;
    let mut client = Client::new(client::Config::TCP, [0; 512], [0; 512]);
    let (mut now, mut rest, mut moved) = (Instant::ZERO, input, 0_u32);
    for turn in 0..2000_u32 {
        match engine.poll(now) {
            EngineAction::Call(..) => {
                client.start(&engine.request()?, client.timing(), now).ok()?;
                moved = moved.wrapping_add(u32::from(client.transmit().len() > 100));
                client.abandon();
                match Decoder::TCP.decode(rest) {
                    Ok(Progress::Complete(frame, used)) => {
                        rest = rest.get(used..).unwrap_or(input);
                        let reply = engine.handle_reply(&frame, now);
                        moved = moved.wrapping_add(reply.map_or(0, |reply| read_move(&reply)));
                    }
                    Ok(Progress::NeedMore(_)) => {
                        rest = input;
                        engine.handle_failure(slave::Failure::Timeout, now);
                    }
                    Err(error) => {
                        rest = rest.get(1..).unwrap_or(input);
                        engine.handle_failure(client::ClientError::Malformed(error).into(), now);
                    }
                }
            }
            EngineAction::Pose { deadline } => {
                let pose = engine.last_pose().as_slice().first_chunk::<8>().map_or([number; 8], |pose| *pose);
                let mut pose = slave::Pose::from_numbers(mode.pose, pose.get(..mode.pose.len()).unwrap_or(&pose))?;
                if on(64) {
                    pose = pose.with_extended(slave::Extended::Both(number, f64::from(turn)));
                }
                let outputs = [engine.set_mini_io(3), engine.set_hand_io(5), engine.set_user_io(input.get(..2)?)];
                moved = moved.wrapping_add(u32::from(outputs.iter().all(Result::is_ok)));
                if engine.push(&pose).is_err() || turn % 100 == 99 {
                    engine.stop();
                }
                now = now.max(deadline).saturating_add(config.cycle);
            }
            EngineAction::Wait(until) => now = until,
            EngineAction::Finished => break,
            EngineAction::Faulted => {
                let known =
                    engine.fault().is_some_and(|f| f.is_underflow() || f.code().is_some() || f.errors().len() > 1);
                moved = moved.wrapping_add(u32::from(known));
                if engine.recover().is_err() {
                    engine.stop();
                }
            }
        }
    }
    let stats = engine.stats();
    Some(moved.wrapping_add(stats.rtt.quantile(999)).wrapping_add(stats.jitter.max()).wrapping_add(stats.late))
}

fn read_move(reply: &slave::MoveReply<'_>) -> u32 {
    let numbers = [
        reply.joints().is_some_and(|joints| joints.contains(&1.0)),
        reply.position().is_some() || reply.transform().is_some(),
        reply.timestamp().is_some_and(|time| time.micros_since(time) == 0),
        reply.mini_io() == reply.hand_io(),
        reply.user_io().is_some_and(|bytes| bytes.contains(&1)),
        reply.current().is_some_and(|current| current.contains(&1.0)),
        reply.pose().len() > 8,
    ];
    numbers.iter().fold(0, |sum, fit| sum.wrapping_add(u32::from(*fit)))
}
