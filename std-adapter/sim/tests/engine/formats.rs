//! Every mode with every receive format, over TCP and over UDP, and each receive format with every send format.

use std::collections::BTreeSet;

use bcap_core::slave::{
    EngineAction, ExtendedAxes, Format, Mode, MoveReply, PoseType, ReceiveFormat, ReceivePose, SendFormat, SendIo,
    SlaveMode, Step, TimeUnit, UserIo,
};
use bcap_core::variant::Variant;
use bcap_sim::VariableKind;

use crate::common::{World, close};
use crate::engine::wire::{LINKS, Link};
use crate::engine::{MODES, Rig, format, from_start};

const MINI: i32 = 0x0005_0000;
const HAND: i32 = 0x0003_0000;
const USER: [u8; 2] = [0xa5, 0x3c];

/// The six of slvSendFormat.
fn send_formats() -> impl Iterator<Item = SendFormat> {
    let user = SendIo::User(UserIo::new(136, 2).unwrap());
    [SendIo::None, SendIo::Mini, user]
        .into_iter()
        .flat_map(|io| [false, true].map(|hand_io| SendFormat { io, hand_io }))
}

/// All of slvRecvFormat: five poses, three times, and each of four parts or not.
fn receive_formats() -> impl Iterator<Item = ReceiveFormat> {
    let poses = [ReceivePose::P, ReceivePose::J, ReceivePose::T, ReceivePose::PJ, ReceivePose::TJ];
    let times = [None, Some(TimeUnit::Millis), Some(TimeUnit::Micros)];
    poses.into_iter().flat_map(move |pose| times.map(|time| (pose, time))).flat_map(|(pose, time)| {
        (0..16).map(move |bits: u8| {
            let user_io = (bits & 1 != 0).then(|| UserIo::new(128, 4).unwrap());
            let (mini_io, hand_io, current) = (bits & 2 != 0, bits & 4 != 0, bits & 8 != 0);
            ReceiveFormat { pose, time, mini_io, user_io, hand_io, current }
        })
    })
}

/// Checks an answer, each number of it, against the controller that has made it.
fn check(format: &Format, moved: &MoveReply<'_>, world: &World) {
    let (send, receive) = (format.send, format.receive);
    assert_eq!(moved.pose().len(), receive.pose.len());
    assert_eq!(moved.joints().is_some(), !matches!(receive.pose, ReceivePose::P | ReceivePose::T));
    // the controller answers with six digits after the point
    assert!(moved.joints().is_none_or(|joints| close(&joints, &world.sim.axes(), 1e-6)), "{format:?}");
    let micros = i32::try_from(world.now.as_micros()).unwrap();
    let ticks = receive.time.map(|unit| if unit == TimeUnit::Millis { micros / 1000 } else { micros });
    assert_eq!(moved.timestamp().map(|stamp| (stamp.ticks, Some(stamp.unit))), ticks.map(|t| (t, receive.time)));
    // the read outputs equal the sent ones
    let mini = if send.io == SendIo::Mini { MINI } else { 0 };
    assert_eq!(moved.mini_io(), receive.mini_io.then_some(mini), "{format:?}");
    assert_eq!(moved.hand_io(), receive.hand_io.then_some(if send.hand_io { HAND } else { 0 }), "{format:?}");
    let user = if matches!(send.io, SendIo::User(_)) { [0, USER[0], USER[1], 0] } else { [0; 4] };
    assert_eq!(moved.user_io(), receive.user_io.is_some().then_some(&user[..]), "{format:?}");
    assert_eq!(moved.current().is_some(), receive.current);
}

/// Streams `count` poses and checks that all of them arrived.
fn stream(link: Link, format: Format, poses: u32) {
    let mut rig = Rig::new(link, format);
    rig.look = check;
    let mut count = 0;
    let end = rig.run(|rig| {
        count += 1;
        if format.send.io == SendIo::Mini {
            rig.engine.set_mini_io(MINI).unwrap();
        }
        if matches!(format.send.io, SendIo::User(_)) {
            rig.engine.set_user_io(&USER).unwrap();
        }
        if format.send.hand_io {
            rig.engine.set_hand_io(HAND).unwrap();
        }
        (count <= poses).then(|| from_start(rig, 0, 0.002 * f64::from(count)))
    });
    assert_eq!(end, EngineAction::Finished, "{link:?}, {format:?}: {:?}", rig.engine.fault());
    assert_eq!((rig.errors(), rig.world.sim.slave_mode(), rig.world.sim.arm_owner()), (vec![], 0, None));
    let moves = rig.sent(Step::Move);
    assert!(moves > poses as usize, "{moves} poses of {poses} and a stop");
    assert_eq!((moves, u64::from(rig.moves)), (rig.moves as usize, rig.world.sim.slave_counters().taken), "{format:?}");
    let on = |n: u32| rig.world.sim.variable::<16>(VariableKind::Io, n).unwrap().as_variant() == Variant::Bool(true);
    let ports: Vec<u32> = (0..160).filter(|n| on(*n)).collect();
    let mut expected = Vec::new();
    expected.extend((format.send.io == SendIo::Mini).then_some([16, 18]).into_iter().flatten());
    expected.extend(format.send.hand_io.then_some([64, 65]).into_iter().flatten());
    let user = matches!(format.send.io, SendIo::User(_)).then_some([136, 138, 141, 143, 146, 147, 148, 149]);
    expected.extend(user.into_iter().flatten());
    assert_eq!(ports, expected, "{format:?}");
}

/// Every receive format, and every send format, in the three modes with one type of pose. Requests and replies are encoded apart,
/// so the send formats take turns: over the links and modes each receive format meets all six of them.
fn every_format(pose: PoseType) {
    let sends: Vec<_> = send_formats().collect();
    let places = LINKS.into_iter().flat_map(|link| MODES.map(|mode| (link, mode)));
    let mut met = BTreeSet::new();
    for (place, (link, mode)) in places.enumerate() {
        for (number, receive) in receive_formats().enumerate() {
            let turn = (place + number) % sends.len();
            stream(link, Format { send: sends[turn], receive, ..format(mode, pose) }, 2);
            met.insert((number, turn));
        }
    }
    // poses, times and parts of the receive format; send formats
    assert_eq!(met.len(), (5 * 3 * 16) * 6);
}

#[test]
fn every_format_of_type_p_goes_to_the_controller_and_back() {
    every_format(PoseType::P);
}

#[test]
fn every_format_of_type_j_goes_to_the_controller_and_back() {
    every_format(PoseType::J);
}

#[test]
fn every_format_of_type_t_goes_to_the_controller_and_back() {
    every_format(PoseType::T);
}

#[test]
fn extended_axes_go_with_every_send_format() {
    let axes = [ExtendedAxes::None, ExtendedAxes::Seven, ExtendedAxes::Eight, ExtendedAxes::Both];
    for (link, mode) in LINKS.into_iter().flat_map(|link| MODES.map(|mode| (link, mode))) {
        for pose in [PoseType::P, PoseType::J, PoseType::T] {
            for (extended, send) in axes.into_iter().flat_map(|axes| send_formats().map(move |send| (axes, send))) {
                let mode = SlaveMode { mode, pose };
                stream(link, Format { extended, send, ..Format::new(mode, ReceiveFormat::pose(ReceivePose::PJ)) }, 2);
            }
        }
    }
}

#[test]
fn the_largest_frames_are_within_a_datagram() {
    let user_io = UserIo::new(128, 4).ok();
    let receive =
        ReceiveFormat { mini_io: true, user_io, hand_io: true, current: true, ..ReceiveFormat::pose(ReceivePose::TJ) };
    let send = SendFormat { io: SendIo::User(UserIo::new(136, 2).unwrap()), hand_io: true };
    for time in [None, Some(TimeUnit::Micros)] {
        let receive = ReceiveFormat { time, ..receive };
        stream(
            Link::Udp,
            Format { send, receive, extended: ExtendedAxes::Both, ..format(Mode::Mode2, PoseType::T) },
            20,
        );
    }
}
