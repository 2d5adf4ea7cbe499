//! The codec, the client and the engine without a link. An empty case is subtracted from the others as the cost of the loop.

#![allow(clippy::expect_used, reason = "a program of the developer may panic")]

use std::error::Error;
use std::hint::black_box;

use bcap_core::bcap::call::{self, Call, ControllerHandle, RobotHandle, VariableHandle};
use bcap_core::bcap::client::{self, Client};
use bcap_core::bcap::header::field;
use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::slave::{
    AxisLimits, Config, Engine, EngineAction, Format, Handles, Mode, Pose, PoseType, PreparedMove, ReceiveFormat,
    ReceivePose, SlaveMode, Step,
};
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, VariantBuf};

/// Repetitions of the two runs.
const FEW: u64 = 100;
const MANY: u64 = 1100;

/// Buffers and inputs of the cases, made outside of the counted part.
struct Bench {
    buffer: [u8; 512],
    pose: [f64; 8],
    request: Vec<u8>,
    reply: Vec<u8>,
    strings: Vec<u8>,
    mixed_strings: Vec<u8>,
    text_pose: VariantBuf<64>,
    text_fractions: VariantBuf<64>,
    text_doubles: VariantBuf<128>,
    slv_move: PreparedMove,
    slv_pose: Pose,
    client: Client<[u8; 512]>,
    engine: Engine,
    slv_reply: Vec<u8>,
}

struct Case {
    name: &'static str,
    /// Instructions that one run may take, 5 % above the measured ones; `None` for a figure that is only shown.
    bar: Option<u64>,
    run: fn(&mut Bench),
}

/// A position with its figure, as RAC carries it.
const TEXT_POSE: &[u8] = b"8196,1,2,3,4,5,6,-1";
/// One as a robot sends it.
const TEXT_FRACTIONS: &[u8] = b"8196,350.25,-12.5,410.123,179.998,-0.523,90.75,5";
/// The same as R8.
const TEXT_DOUBLES: &[u8] = b"8197,350.25,-12.5,410.123,179.998,-0.523,90.75,5";

/// The first case is the empty one.
const CASES: &[Case] = &[
    Case { name: "(empty)", bar: None, run: empty },
    Case { name: "encode GetValue request", bar: Some(43), run: encode_get_value },
    Case { name: "encode slvMove request, 8 doubles", bar: Some(248), run: encode_slv_move },
    Case { name: "patch slvMove request and serial, 8 doubles", bar: Some(112), run: patch_slv_move },
    Case { name: "decode slvMove request, 8 doubles", bar: Some(501), run: decode_slv_move },
    Case { name: "decode slvMove reply, 4 elements", bar: Some(667), run: decode_slv_reply },
    Case { name: "decode 100 strings, array of BSTR", bar: Some(3_238), run: decode_strings },
    Case { name: "parse text 8196,1,2,3,4,5,6,-1", bar: Some(1_084), run: parse_pose },
    Case { name: "print text 8196,1,2,3,4,5,6,-1", bar: Some(1_321), run: print_pose },
    Case { name: "parse text 8196,350.25,-12.5,410.123,...", bar: Some(1_420), run: parse_fractions },
    Case { name: "print text 8196,350.25,-12.5,410.123,...", bar: Some(3_243), run: print_fractions },
    Case { name: "print text 8197,350.25,-12.5,410.123,...", bar: Some(3_176), run: print_doubles },
    Case { name: "decode 100 strings, array of VARIANT", bar: None, run: decode_mixed_strings },
    Case { name: "a cycle of the engine, its reply decoded", bar: None, run: engine_cycle },
    Case { name: "start and abandon that call in a client", bar: None, run: start_slv_move },
    Case { name: "check slvMove request, nothing read", bar: None, run: check_slv_move },
    Case { name: "check slvMove reply, nothing read", bar: None, run: check_slv_reply },
    Case { name: "check 100 strings, nothing read", bar: None, run: check_strings },
];

fn main() -> Result<(), Box<dyn Error>> {
    if let Some((case, times, _)) = bcap_instructions::arguments() {
        let case = CASES.get(case).ok_or("no such case")?;
        repeat(black_box(case.run), times);
        return Ok(());
    }
    let count = |case| bcap_instructions::count(case, FEW, MANY, &[]);
    bcap_instructions::print_head();
    let empty = count(0)?;
    let mut within = true;
    for (index, case) in CASES.iter().enumerate().skip(1) {
        within &= bcap_instructions::print(case.name, count(index)?.saturating_sub(empty), case.bar);
    }
    if within { Ok(()) } else { Err("a figure is over its bar".into()) }
}

/// Runs a case many times; what callgrind watches.
fn repeat(run: fn(&mut Bench), times: u64) {
    let mut bench = Bench::new();
    for _ in 0..times {
        run(black_box(&mut bench));
    }
}

impl Bench {
    fn new() -> Self {
        let pose = [364.16, 0.0, 278.5355, 180.0, 1.25e-14, 180.0, 5.0, 0.0];
        let text: Vec<String> = (0..100).map(|n| format!("string{n:02}")).collect();
        let text: Vec<&str> = text.iter().map(String::as_str).collect();
        let dynamic: Vec<&dyn Encode> = text.iter().map(|s| s as &dyn Encode).collect();
        let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
        let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
        let bench = Self {
            buffer: [0; 512],
            pose,
            request: frame(64, &[&3_i32, &"slvMove", &pose]),
            reply: frame(0, &[&(pose, 1_i32, 2_i32, 3_i32)]),
            strings: frame(0, &[&text.as_slice()]),
            mixed_strings: frame(0, &[&dynamic.as_slice()]),
            text_pose: VariantBuf::parse_text(TEXT_POSE).expect("it is a pose"),
            text_fractions: VariantBuf::parse_text(TEXT_FRACTIONS).expect("it is a pose"),
            text_doubles: VariantBuf::parse_text(TEXT_DOUBLES).expect("it is a pose"),
            slv_move: PreparedMove::new(RobotHandle(3), &format).expect("256 bytes hold it"),
            slv_pose: Pose::j(pose),
            client: Client::new(client::Config::TCP, [0; 512], [0; 512]),
            engine: streaming(&pose, format),
            slv_reply: frame(0, &[&pose]),
        };
        assert_eq!((bench.request.len(), bench.reply.len()), (132, 126), "the frames of a slave-mode cycle");
        bench
    }
}

/// Creates an engine that wants its first pose.
fn streaming(pose: &[f64; 8], format: Format) -> Engine {
    let handles = Handles { controller: ControllerHandle(2), robot: RobotHandle(3) };
    let limits = AxisLimits::uniform(100.0, 800.0);
    let mut engine = Engine::new(Config { limits, ..Config::new(format, handles) }).expect("256 bytes hold it");
    while let EngineAction::Call(step, _) = engine.poll(Instant::ZERO) {
        let bytes = if step == Step::Position { frame(0, &[pose]) } else { frame(0, &[&()]) };
        let reply = Decoder::TCP.decode_datagram(&bytes).expect("a frame");
        assert!(engine.handle_reply(&reply, Instant::ZERO).is_none(), "there is no slvMove yet");
    }
    engine
}

/// Creates a frame of any size.
fn frame(code: i32, arguments: &[&dyn Encode]) -> Vec<u8> {
    let mut buffer = vec![0; 16 * 1024];
    let mut frame = FrameWriter::new(&mut buffer).expect("16 KiB hold a header");
    for argument in arguments {
        frame.argument(*argument).expect("16 KiB hold the arguments");
    }
    frame.finish(9, 0, code).expect("16 KiB hold the frame").to_vec()
}

#[inline(never)]
fn empty(bench: &mut Bench) {
    black_box(bench);
}

#[inline(never)]
fn encode_get_value(bench: &mut Bench) {
    let call = call::variable_get_value(VariableHandle(black_box(3)));
    black_box(encode(&call, &mut bench.buffer));
}

#[inline(never)]
fn encode_slv_move(bench: &mut Bench) {
    let call = call::robot_execute(RobotHandle(black_box(3)), "slvMove", black_box(&bench.pose));
    black_box(encode(&call, &mut bench.buffer));
}

#[inline(never)]
fn patch_slv_move(bench: &mut Bench) {
    let patched = bench.slv_move.set_pose(black_box(&bench.slv_pose)).is_ok();
    black_box(patched);
    let call = black_box(&bench.slv_move);
    let serial = black_box(9_u16).to_le_bytes();
    // the work of a client with it: a copy into its buffer, and the serial
    if let Some(frame) = call.prepared()
        && let Some(target) = black_box(&mut bench.buffer).get_mut(..frame.len())
    {
        target.copy_from_slice(frame);
        if let Some(fields) = target.get_mut(field::SERIAL) {
            fields.copy_from_slice(&serial);
        }
        black_box(target);
    }
}

#[inline(never)]
fn engine_cycle(bench: &mut Bench) {
    let now = black_box(Instant::ZERO);
    let pushed = bench.engine.push(black_box(&bench.slv_pose)).is_ok();
    let action = bench.engine.poll(now);
    let _ = black_box((pushed, action));
    if let Some(request) = bench.engine.request()
        && let Some(frame) = request.prepared()
        && let Some(target) = black_box(&mut bench.buffer).get_mut(..frame.len())
    {
        target.copy_from_slice(frame);
        black_box(target);
    }
    let Ok(Progress::Complete(reply, _)) = Decoder::TCP.decode(black_box(&bench.slv_reply)) else { return };
    black_box(bench.engine.handle_reply(&reply, now).is_some());
    let wanted = bench.engine.poll(now);
    let _ = black_box(wanted);
}

#[inline(never)]
fn start_slv_move(bench: &mut Bench) {
    let patched = bench.slv_move.set_pose(black_box(&bench.slv_pose)).is_ok();
    black_box(patched);
    black_box(bench.client.start(&bench.slv_move, bench.client.timing(), black_box(Instant::ZERO)).is_ok());
    bench.client.abandon();
}

/// Writes the frame of a call, as the client does.
#[inline(always)]
fn encode<'b, C: Call>(call: &C, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
    // a client's buffer has a length that is unknown to the compiler
    let mut frame = FrameWriter::new(black_box(buffer)).ok()?;
    call.arguments(&mut frame).ok()?;
    frame.finish(black_box(9), 0, call.function().0).ok()
}

#[inline(never)]
fn decode_slv_move(bench: &mut Bench) {
    black_box(read_slv_move(black_box(&bench.request)));
}

/// Reads all of a slvMove request: the handle, the command's name and the eight doubles.
#[inline(always)]
fn read_slv_move(bytes: &[u8]) -> Option<(i32, usize, [f64; 8])> {
    let Ok(Progress::Complete(frame, _)) = Decoder::TCP.decode(bytes) else { return None };
    let mut args = frame.args.iter();
    let (handle, command, pose) = (args.next()?, args.next()?, args.next()?);
    Some((handle.as_i32()?, command.as_bstr()?.len(), pose.as_array()?.items()?.to_array()?))
}

#[inline(never)]
fn decode_slv_reply(bench: &mut Bench) {
    black_box(read_slv_reply(black_box(&bench.reply)));
}

/// Reads all of a slvMove reply: the pose and three integers.
#[inline(always)]
fn read_slv_reply(bytes: &[u8]) -> Option<([f64; 8], i32, i32, i32)> {
    let Ok(Progress::Complete(frame, _)) = Decoder::TCP.decode(bytes) else { return None };
    let mut elements = frame.value()?.as_array()?.iter();
    let pose = elements.next()?.as_array()?.items()?.to_array()?;
    Some((pose, elements.next()?.as_i32()?, elements.next()?.as_i32()?, elements.next()?.as_i32()?))
}

#[inline(never)]
fn decode_strings(bench: &mut Bench) {
    let Ok(Progress::Complete(frame, _)) = Decoder::TCP.decode(black_box(&bench.strings)) else { return };
    let Some(strings) = frame.value().and_then(|v| v.as_array()).and_then(|a| a.strings()) else { return };
    for text in strings {
        black_box(text.as_bytes());
    }
}

#[inline(never)]
fn parse_pose(_: &mut Bench) {
    black_box(VariantBuf::<64>::parse_text(black_box(TEXT_POSE)).is_ok());
}

#[inline(never)]
fn print_pose(bench: &mut Bench) {
    black_box(black_box(&bench.text_pose).as_variant().to_text(&mut bench.buffer).is_ok());
}

#[inline(never)]
fn parse_fractions(_: &mut Bench) {
    black_box(VariantBuf::<64>::parse_text(black_box(TEXT_FRACTIONS)).is_ok());
}

#[inline(never)]
fn print_fractions(bench: &mut Bench) {
    black_box(black_box(&bench.text_fractions).as_variant().to_text(&mut bench.buffer).is_ok());
}

#[inline(never)]
fn print_doubles(bench: &mut Bench) {
    black_box(black_box(&bench.text_doubles).as_variant().to_text(&mut bench.buffer).is_ok());
}

#[inline(never)]
fn decode_mixed_strings(bench: &mut Bench) {
    let Ok(Progress::Complete(frame, _)) = Decoder::TCP.decode(black_box(&bench.mixed_strings)) else { return };
    let Some(array) = frame.value().and_then(|v| v.as_array()) else { return };
    for text in array {
        black_box(text.as_bstr().map(|text| text.as_bytes()));
    }
}

#[inline(never)]
fn check_slv_move(bench: &mut Bench) {
    black_box(Decoder::TCP.decode(black_box(&bench.request)).is_ok());
}

#[inline(never)]
fn check_slv_reply(bench: &mut Bench) {
    black_box(Decoder::TCP.decode(black_box(&bench.reply)).is_ok());
}

#[inline(never)]
fn check_strings(bench: &mut Bench) {
    black_box(Decoder::TCP.decode(black_box(&bench.strings)).is_ok());
}
