//! The bytes of Slave Mode: encoding, decoding, and refused input.

extern crate std;

mod engine;

use crate::endpoint::Endpoint;
use std::string::ToString;
use std::vec::Vec;

use super::*;
use crate::bcap::call::{Call, RobotHandle};
use crate::bcap::client::{self, Client};
use crate::bcap::{Decoder, FrameWriter, Link};
use crate::position::{Joints, Position, Transform};
use crate::time::Instant;
use crate::variant::{Encode, VarType, Variant, VariantBuf};

const ROBOT: RobotHandle = RobotHandle(3);

/// The frames that the specification prints, from `tests/vectors`.
const SPEC: &str = include_str!("../../../tests/vectors/bcap-rc9-spec.jsonl");

/// Finds a frame of the specification by its name.
fn vector(name: &str) -> Vec<u8> {
    let named = std::format!("\"name\": \"{name}\"");
    let line = SPEC.lines().find(|line| line.contains(&named)).unwrap();
    let (_, rest) = line.split_once("\"hex\": \"").unwrap();
    let (hex, _) = rest.split_once('"').unwrap();
    hex.as_bytes().chunks(2).map(|d| u8::from_str_radix(str::from_utf8(d).unwrap(), 16).unwrap()).collect()
}

/// Encodes a call as a client with this next serial.
fn request(call: impl Call, serial: u16) -> Vec<u8> {
    let mut client = Client::new(client::Config::TCP, [0; 512], [0; 512]);
    for _ in 1..serial {
        client.start(&get_mode(ROBOT), client.timing(), Instant::ZERO).unwrap();
        client.abandon();
    }
    client.start(&call, client.timing(), Instant::ZERO).unwrap();
    client.transmit().to_vec()
}

fn format(mode: Mode, pose: PoseType) -> Format {
    Format::new(SlaveMode { mode, pose }, ReceiveFormat::pose(ReceivePose::J))
}

/// The pose of the specification's slvMove, whose RY is close to 0.
fn spec_pose() -> Pose {
    Pose::p([364.16, 0.0, 278.5355, 180.0, f64::from_bits(0x3d0c_a5dc_4a86_8a80), 180.0, 5.0])
}

#[test]
fn the_frames_of_the_specification_are_reproduced() {
    let mode = SlaveMode { mode: Mode::Mode0, pose: PoseType::P };
    assert_eq!(request(change_mode(ROBOT, Some(mode)), 8), vector("spec_slvchangemode_001_tx"));
    assert_eq!(request(change_mode(ROBOT, None), 10), vector("spec_slvchangemode_000_tx"));

    let format = format(Mode::Mode0, PoseType::P);
    let expected = vector("spec_slvmove_tx");
    let tail = &expected[67..expected.len() - 1];
    assert_eq!(tail.len(), 56);
    let numbers: Vec<f64> = tail.chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
    let pose = Pose::from_numbers(PoseType::P, &numbers).unwrap();
    assert!(pose.as_slice().iter().zip(spec_pose().as_slice()).all(|(a, b)| (a - b).abs() < 1e-4));
    assert_eq!(request(slv_move(ROBOT, &format, &pose, Outputs::default()).unwrap(), 9), expected);

    let mut prepared = PreparedMove::<MOVE_FRAME>::new(ROBOT, &format).unwrap();
    prepared.set_pose(&Pose::p([1.0; 7])).unwrap();
    prepared.set_pose(&pose).unwrap();
    assert_eq!(request(&prepared, 9), expected);
}

#[test]
fn the_reply_of_the_specification_is_read() {
    let bytes = vector("spec_slvmove_rx");
    let frame = Decoder::TCP.decode_datagram(&bytes).unwrap();
    let reply = ReceiveFormat::pose(ReceivePose::J).read(frame.value().unwrap()).unwrap();
    let joints = reply.joints().unwrap();
    assert!((joints[1] - 45.0).abs() < 1e-4 && (joints[2] - 90.0).abs() < 1e-4);
    // joints that the robot does not have are not 0
    assert!(joints[6] != 0.0 && joints[7] != 0.0);
    assert_eq!((reply.pose().len(), reply.position(), reply.transform(), reply.timestamp()), (8, None, None, None));

    let error = ReceiveFormat::pose(ReceivePose::P).read(frame.value().unwrap()).unwrap_err();
    assert_eq!(error.to_string(), "the pose in the reply to slvMove has 8 elements instead of 7");
    for name in ["spec_slvchangemode_001_rx", "spec_slvchangemode_000_rx"] {
        let bytes = vector(name);
        assert_eq!(Decoder::TCP.decode_datagram(&bytes).unwrap().value(), Some(Variant::Empty));
    }
}

#[test]
fn every_mode_has_the_number_of_the_specification() {
    let mut codes = Vec::new();
    for mode in [Mode::Mode0, Mode::Mode1, Mode::Mode2] {
        for pose in [PoseType::P, PoseType::J, PoseType::T] {
            let mode = SlaveMode { mode, pose };
            assert_eq!(SlaveMode::from_code(mode.code()), Some(mode));
            codes.push(mode.code());
        }
    }
    assert_eq!(codes, [1, 2, 3, 0x101, 0x102, 0x103, 0x201, 0x202, 0x203]);
    for code in [0, 4, 0x100, 0x301, 0x211, -1, i32::MIN] {
        assert_eq!(SlaveMode::from_code(code), None, "{code:#x}");
    }
    assert_eq!(SlaveMode { mode: Mode::Mode2, pose: PoseType::J }.to_string(), "mode 2, type J");
}

/// All send formats, with the number that slvSendFormat takes.
fn send_formats() -> Vec<(SendFormat, i32)> {
    let user = UserIo::new(128, 2).unwrap();
    let mut all = Vec::new();
    for (io, code) in [(SendIo::None, 0), (SendIo::Mini, 0x100), (SendIo::User(user), 0x200)] {
        all.push((SendFormat { io, hand_io: false }, code));
        all.push((SendFormat { io, hand_io: true }, code | 0x20));
    }
    all
}

/// The expected elements of slvMove, written independently of the code.
fn expected_elements(format: &Format, pose: &Pose) -> Vec<VariantBuf<128>> {
    let mut elements = std::vec![VariantBuf::new(&pose.as_slice()).unwrap()];
    let mut put = |value: &dyn Encode| elements.push(VariantBuf::new(value).unwrap());
    match format.send.code() & 0x300 {
        0x100 => put(&0x1234_i32),
        0x200 => {
            put(&128_i32);
            put(&16_i32);
            put(&[0xaa_u8, 0x55].as_slice());
        }
        _ => {}
    }
    if format.receive.code() & 0x200 != 0 {
        put(&136_i32);
        put(&24_i32);
    }
    if format.send.code() & 0x20 != 0 {
        put(&0x77_i32);
    }
    elements
}

#[test]
fn slv_move_has_its_elements_in_order_in_every_format() {
    let poses = [Pose::p([1.5; 7]), Pose::j([2.5; 8]), Pose::t([0.5; 10])];
    let axes = [None, Some(Extended::Seven(7.0)), Some(Extended::Eight(8.0)), Some(Extended::Both(7.0, 8.0))];
    let mut seen = 0;
    for (send, code) in send_formats() {
        assert_eq!(send.code(), code);
        for user_io in [None, Some(UserIo::new(136, 3).unwrap())] {
            for (plain, extended) in poses.iter().flat_map(|pose| axes.map(|axes| (*pose, axes))) {
                let pose = extended.map_or(plain, |axes| plain.with_extended(axes));
                let format = Format {
                    extended: pose.layout().extended,
                    send,
                    receive: ReceiveFormat { user_io, ..ReceiveFormat::pose(ReceivePose::PJ) },
                    ..format(Mode::Mode1, pose.layout().pose)
                };
                let outputs = Outputs { mini_io: 0x1234, hand_io: 0x77, user_io: &[0xaa, 0x55] };
                let bytes = request(slv_move(ROBOT, &format, &pose, outputs).unwrap(), 1);
                check_elements(&bytes, &expected_elements(&format, &pose));
                check_prepared(&format, &pose, outputs, &bytes);
                seen += 1;
            }
        }
    }
    assert_eq!(seen, 6 * 2 * 12);
}

fn check_elements(bytes: &[u8], expected: &[VariantBuf<128>]) {
    let frame = Decoder::TCP.decode_datagram(bytes).unwrap();
    assert_eq!(frame.args.get(0), Some(Variant::I4(3)));
    assert_eq!(frame.args.get(1).unwrap().as_bstr().unwrap(), "slvMove");
    let parameter = frame.args.get(2).unwrap();
    if let [pose] = expected {
        assert_eq!(parameter, pose.as_variant());
        return;
    }
    let array = parameter.as_array().unwrap();
    assert_eq!(array.element(), VarType::VARIANT);
    assert!(array.iter().eq(expected.iter().map(VariantBuf::as_variant)), "{array:?}");
}

/// The prepared frame is the same for any earlier content, and on every link.
fn check_prepared(format: &Format, pose: &Pose, outputs: Outputs<'_>, bytes: &[u8]) {
    let mut prepared = PreparedMove::<MOVE_FRAME>::new(ROBOT, format).unwrap();
    for (pose, outputs) in
        [(Pose::zero(pose.layout()), Outputs { mini_io: -1, hand_io: -1, user_io: &[0xff, 0xff] }), (*pose, outputs)]
    {
        prepared.set_pose(&pose).unwrap();
        assert_eq!(prepared.set_mini_io(outputs.mini_io).is_ok(), format.send.io == SendIo::Mini);
        assert_eq!(prepared.set_hand_io(outputs.hand_io).is_ok(), format.send.hand_io);
        assert_eq!(prepared.set_user_io(outputs.user_io).is_ok(), matches!(format.send.io, SendIo::User(_)));
    }
    assert_eq!(request(&prepared, 1), bytes);

    let mut client = Client::new(client::Config::SERIAL, [0; 512], [0; 512]);
    client.start(&prepared, client.timing(), Instant::ZERO).unwrap();
    let serial = Decoder::SERIAL.decode_datagram(client.transmit()).unwrap();
    assert_eq!(serial.args, Decoder::TCP.decode_datagram(bytes).unwrap().args);

    let mut client = Client::new(client::Config::UDP, [0; 512], [0; 512]);
    client.start(&prepared, client.timing(), Instant::ZERO).unwrap();
    let datagram = Decoder::UDP.decode_datagram(client.transmit()).unwrap();
    assert_eq!((datagram.serial, datagram.reserved), (1, 1));
}

#[test]
fn extended_joints_have_the_positions_of_the_specification() {
    let p = Pose::p([0.0; 7]);
    assert_eq!(p.with_extended(Extended::Seven(1.5)).as_slice()[7..], [4_194_368.0, 1.5]);
    assert_eq!(p.with_extended(Extended::Both(1.5, 2.5)).as_slice()[7..], [4_194_496.0, 1.5, 2.5]);
    let j = Pose::j([9.0; 8]).with_extended(Extended::Eight(2.5));
    assert_eq!(j.as_slice()[6..], [9.0, 2.5, 4_194_432.0]);
    let t = Pose::t([0.0; 10]);
    assert_eq!(t.with_extended(Extended::Eight(2.5)).as_slice()[10..], [4_194_432.0, 2.5]);
    let lens =
        |pose: Pose| [pose, pose.with_extended(Extended::Seven(0.0)), pose.with_extended(Extended::Both(0.0, 0.0))];
    assert_eq!(lens(p).map(|pose| pose.as_slice().len()), [7, 9, 10]);
    assert_eq!(lens(j).map(|pose| pose.as_slice().len()), [9, 9, 9]);
    assert_eq!(lens(t).map(|pose| pose.as_slice().len()), [10, 12, 13]);
    // from both axes to one
    let one = p.with_extended(Extended::Both(1.0, 2.0)).with_extended(Extended::Seven(3.0));
    assert_eq!(one, p.with_extended(Extended::Seven(3.0)));
}

#[test]
fn values_of_variables_become_poses() {
    let p = Position::new([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]).figure(7);
    assert_eq!(Pose::from(p), Pose::p([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]));
    let t = Transform::new([1.0, 2.0, 3.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    assert_eq!(Pose::from(t), Pose::t([1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, -1.0]));
    assert_eq!(Pose::from(Joints::new([1.0])), Pose::j([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
}

#[test]
fn data_that_differs_from_the_format_is_refused() {
    let format = format(Mode::Mode2, PoseType::J);
    let error = slv_move(ROBOT, &format, &spec_pose(), Outputs::default()).err().unwrap();
    assert_eq!(error.to_string(), "the format has poses of type J, this pose is P");
    let pose = Pose::j([0.0; 8]).with_extended(Extended::Seven(1.0));
    assert!(matches!(slv_move(ROBOT, &format, &pose, Outputs::default()).err(), Some(FormatError::Layout { .. })));

    let io = SendIo::User(UserIo::new(128, 2).unwrap());
    let format = Format { send: SendFormat { io, hand_io: false }, ..format };
    let outputs = Outputs { user_io: &[1, 2, 3], ..Outputs::default() };
    let error = slv_move(ROBOT, &format, &Pose::j([0.0; 8]), outputs).err().unwrap();
    assert_eq!(error, FormatError::UserIoLength { expected: 2, found: 3 });

    assert_eq!(UserIo::new(120, 1), Err(FormatError::UserIoOffset(120)));
    assert_eq!(UserIo::new(130, 1), Err(FormatError::UserIoOffset(130)));
    assert_eq!(UserIo::new(128, 0), Err(FormatError::UserIoEmpty));
    assert_eq!(Pose::from_numbers(PoseType::P, &[0.0; 6]), None);
    assert_eq!(Pose::from_numbers(PoseType::T, &[0.0; 11]), None);
    assert_eq!(Pose::from_numbers(PoseType::J, &[1.0; 6]).unwrap().as_slice()[5..], [1.0, 0.0, 0.0]);
    assert!(PreparedMove::<100>::new(ROBOT, &format).is_err());
}

#[test]
fn receive_formats_have_the_numbers_of_the_specification() {
    for (pose, code) in
        [ReceivePose::P, ReceivePose::J, ReceivePose::T, ReceivePose::PJ, ReceivePose::TJ].into_iter().zip(1..)
    {
        assert_eq!(ReceiveFormat::pose(pose).code(), code);
    }
    let all = ReceiveFormat {
        time: Some(TimeUnit::Micros),
        mini_io: true,
        user_io: Some(UserIo::new(128, 1).unwrap()),
        hand_io: true,
        current: true,
        ..ReceiveFormat::pose(ReceivePose::PJ)
    };
    assert_eq!(all.code(), 0x374);
    let parameter = |format: ReceiveFormat| {
        let bytes = request(receive_format(ROBOT, format), 1);
        let frame = Decoder::TCP.decode_datagram(&bytes).unwrap();
        frame.args.get(2).unwrap().as_array().and_then(|array| array.items::<i32>()).and_then(|items| items.to_array())
    };
    assert_eq!(parameter(all), Some([0x374, 1]));
    assert_eq!(parameter(ReceiveFormat { time: Some(TimeUnit::Millis), ..all }), Some([0x374, 0]));
    assert_eq!(parameter(ReceiveFormat::pose(ReceivePose::J)), Some([2, 0]));
}

/// Writes a reply in the order of the specification's table.
fn reply(format: &ReceiveFormat, numbers: &[f64]) -> VariantBuf<512> {
    let user_io: Vec<u8> = format.user_io.map_or(Vec::new(), |range| std::vec![0xc3; usize::from(range.bytes())]);
    let current = [0.25; 8];
    let mut elements: Vec<&dyn Encode> = Vec::new();
    if format.code() & 0x10 != 0 {
        elements.push(&-5_i32);
    }
    let numbers: &dyn Encode = &numbers;
    elements.push(numbers);
    if format.code() & 0x100 != 0 {
        elements.push(&0x11_i32);
    }
    let user_io = user_io.as_slice();
    if format.code() & 0x200 != 0 {
        elements.push(&user_io);
    }
    if format.code() & 0x20 != 0 {
        elements.push(&0x22_i32);
    }
    if format.code() & 0x40 != 0 {
        elements.push(&current);
    }
    match elements.as_slice() {
        [pose] if format.code() < 0x10 => VariantBuf::new(pose).unwrap(),
        all => VariantBuf::new(all).unwrap(),
    }
}

#[test]
fn every_receive_format_is_read_in_order() {
    let poses = [ReceivePose::P, ReceivePose::J, ReceivePose::T, ReceivePose::PJ, ReceivePose::TJ];
    let numbers: Vec<f64> = (1..=18_u8).map(f64::from).collect();
    let mut seen = 0;
    for bits in 0..48_u8 {
        for pose in poses {
            let time = match bits / 16 {
                0 => None,
                1 => Some(TimeUnit::Millis),
                _ => Some(TimeUnit::Micros),
            };
            let on = |bit: u8| bits & bit != 0;
            let user_io = on(4).then(|| UserIo::new(128, 3).unwrap());
            let format = ReceiveFormat { pose, time, mini_io: on(1), user_io, hand_io: on(2), current: on(8) };
            let value = reply(&format, &numbers[..pose.len()]);
            let read = format.read(value.as_variant()).unwrap();
            assert!(read.pose().iter().eq(numbers[..pose.len()].iter().copied()));
            assert_eq!(read.timestamp(), time.map(|unit| Timestamp { ticks: -5, unit }));
            assert_eq!(read.mini_io(), on(1).then_some(0x11));
            assert_eq!(read.hand_io(), on(2).then_some(0x22));
            assert_eq!(read.user_io(), on(4).then_some([0xc3; 3].as_slice()));
            assert_eq!(read.current(), on(8).then_some([0.25; 8]));
            let first_joint = match pose {
                ReceivePose::P | ReceivePose::T => None,
                ReceivePose::J => Some(1.0),
                ReceivePose::PJ => Some(8.0),
                ReceivePose::TJ => Some(11.0),
            };
            assert_eq!(read.joints().map(|j| j[0]), first_joint);
            // a missing number is refused, and so is any other selection of elements
            assert!(format.read(reply(&format, &numbers[1..pose.len()]).as_variant()).is_err());
            let other = ReceiveFormat { current: !format.current, ..format };
            assert!(other.read(value.as_variant()).is_err());
            seen += 1;
        }
    }
    assert_eq!(seen, 240);
}

#[test]
fn errors_name_the_element() {
    let format = ReceiveFormat { mini_io: true, hand_io: true, ..ReceiveFormat::pose(ReceivePose::J) };
    let read = |value: &dyn Encode| {
        let value = VariantBuf::<256>::new(value).unwrap();
        format.read(value.as_variant()).unwrap_err()
    };
    let error = read(&([0.0; 8], 1_i32));
    assert_eq!((error.part, error.kind), (ReplyPart::HandIo, MoveReplyErrorKind::Missing));
    let error = read(&([0.0; 8], 1.5, 1_i32));
    assert_eq!((error.part, error.kind), (ReplyPart::MiniIo, MoveReplyErrorKind::Type(VarType::R8)));
    let error = read(&([0.0; 8], 1_i32, 2_i32, 3_i32));
    assert_eq!(error.kind, MoveReplyErrorKind::Length { expected: 3, found: 4 });
    let error = read(&[0.0; 8]);
    assert_eq!((error.part, error.kind), (ReplyPart::Whole, MoveReplyErrorKind::Type(VarType::R8.array_of())));
}

#[test]
fn timestamps_wrap_as_their_counter_does() {
    let at = |ticks| Timestamp { ticks, unit: TimeUnit::Millis };
    assert_eq!(at(i32::MIN).micros_since(at(i32::MAX)), 1000);
    assert_eq!(at(-1).micros_since(at(-9)), 8000);
}

#[test]
fn quantiles_are_at_most_an_eighth_too_large() {
    let mut histogram = Histogram::new();
    assert_eq!((histogram.quantile(500), histogram.max()), (0, 0));
    for us in 0..100_000 {
        histogram.record(us);
    }
    for permille in [1, 500, 990, 999, 1000] {
        let (found, exact) = (histogram.quantile(permille), permille * 100);
        assert!(found + 1 >= exact && found <= exact + exact / 8, "{permille}: {found} instead of {exact}");
    }
    histogram.record(u32::MAX);
    assert_eq!((histogram.max(), histogram.count()), (u32::MAX, 100_001));
    assert_eq!(histogram.iter().map(|(_, count)| count).sum::<u32>(), 100_001);
    assert!(histogram.iter().zip(histogram.iter().skip(1)).all(|((a, _), (b, _))| a < b));
}

#[test]
fn lengths_are_those_of_the_frames() {
    let range = UserIo::new(128, 3).unwrap();
    let written = |values: &[&dyn Encode]| {
        let mut buffer = [0; 512];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        match values {
            [alone] => frame.argument(*alone).unwrap(),
            values => frame.argument(&values).unwrap(),
        }
        frame.finish(1, 0, 0).unwrap().len()
    };
    let [axes, io] = [4, 3].map(|count| 0..count);
    for (extended, io) in axes.flat_map(|axes| io.clone().map(move |io| (axes, io))) {
        let extended = [ExtendedAxes::None, ExtendedAxes::Seven, ExtendedAxes::Eight, ExtendedAxes::Both][extended];
        let io = [SendIo::None, SendIo::Mini, SendIo::User(range)][io];
        for extras in 0..64 {
            let has = |extra: u8| extras & extra != 0;
            let receive = ReceiveFormat {
                pose: ReceivePose::TJ,
                time: has(1).then_some(TimeUnit::Micros),
                mini_io: has(2),
                user_io: has(4).then_some(range),
                hand_io: has(8),
                current: has(16),
            };
            let send = SendFormat { io, hand_io: has(32) };
            let format = Format { extended, send, receive, ..format(Mode::Mode2, PoseType::T) };
            let [request, reply] = format.frame_lengths(Link::Stream);
            assert_eq!(PreparedMove::<512>::new(ROBOT, &format).unwrap().as_bytes().len(), request, "{format:?}");
            let parts: [(bool, &dyn Encode); 6] = [
                (has(1), &1_i32),
                (true, &[0.0; 18]),
                (has(2), &1_i32),
                (has(4), &[1_u8; 3]),
                (has(8), &1_i32),
                (has(16), &[0.0; 8]),
            ];
            let values: Vec<&dyn Encode> = parts.into_iter().filter_map(|(has, value)| has.then_some(value)).collect();
            assert_eq!(written(&values), reply, "{format:?}");
            assert_eq!(format.frame_lengths(Link::Serial), [request + 2, reply + 2]);
        }
    }
}

/// A trajectory that sets outputs with each pose.
struct Outputting {
    bytes: [u8; 2],
}

impl Trajectory for Outputting {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        Next::Pose(*cycle.start)
    }

    fn outputs(&mut self) -> Option<Outputs<'_>> {
        Some(Outputs { mini_io: 7, hand_io: 9, user_io: &self.bytes })
    }
}

#[test]
fn a_prepared_move_takes_the_outputs_of_its_format() {
    let user = SendIo::User(UserIo::new(128, 2).unwrap());
    for (io, hand_io) in [(SendIo::None, false), (SendIo::Mini, true), (user, true), (user, false)] {
        let format = Format { send: SendFormat { io, hand_io }, ..format(Mode::Mode0, PoseType::P) };
        let mut prepared = PreparedMove::<512>::new(ROBOT, &format).unwrap();
        let mut trajectory = Outputting { bytes: [1, 2] };
        let outputs = trajectory.outputs().unwrap();
        prepared.set_outputs(outputs).unwrap();
        let pose = spec_pose();
        prepared.set_pose(&pose).unwrap();
        let expected = slv_move(ROBOT, &format, &pose, outputs).unwrap();
        assert_eq!(request(prepared.clone(), 1), request(expected, 1), "{io:?}");
        let short = prepared.set_outputs(Outputs { user_io: &[1], ..outputs });
        assert_eq!(short.is_err(), matches!(io, SendIo::User(_)));
    }
}
