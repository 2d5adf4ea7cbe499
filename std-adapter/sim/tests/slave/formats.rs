//! Formats: what slvMove carries and answers.

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::{Encode, Variant};
use bcap_sim::{Config, Model, Profile, SlaveConfig, SlaveFormats, VariableKind};

use crate::common::{Value, code, doubles, ok, value};
use crate::slave::{Rig, START, assert_close, j1};

/// Returns the items of an answer; an answer that is not an array of VARIANT is its only item.
fn items(answer: &Value) -> Vec<String> {
    match answer.as_variant() {
        Variant::Array(array) if array.items::<f64>().is_none() && array.items::<u8>().is_none() => {
            array.iter().map(|item| shape(&item.flatten())).collect()
        }
        other => vec![shape(&other)],
    }
}

/// Names a value by its only possible meaning in an answer.
fn shape(value: &Variant<'_>) -> String {
    match value {
        Variant::I4(_) => "I4".to_owned(),
        Variant::Array(array) => match (array.items::<f64>(), array.items::<u8>()) {
            (Some(numbers), _) => format!("R8[{}]", numbers.len()),
            (_, Some(bytes)) => format!("UI1[{}]", bytes.len()),
            _ => panic!("{array:?}"),
        },
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_receive_format_has_its_items_in_order_with_every_send_format() {
    let mut rig = Rig::new();
    for send in [0x0000, 0x0020, 0x0100, 0x0120, 0x0200, 0x0220] {
        for (pose, numbers) in [(1, 7), (2, 8), (3, 10), (4, 15), (5, 18)] {
            for extras in 0..32 {
                let bits = [(1, 0x0010), (2, 0x0100), (4, 0x0200), (8, 0x0020), (16, 0x0040)];
                let has = |extra: i32| extras & extra != 0;
                let receive = bits.iter().filter(|(n, _)| has(*n)).fold(pose, |format, (_, bit)| format | bit);
                assert_eq!(rig.execute("slvSendFormat", send), ok(&()));
                assert_eq!(rig.execute("slvRecvFormat", receive), ok(&()));
                rig.execute("slvChangeMode", 0x102);

                let mini: i32 = 0x0001_0000;
                let data = [0xff_u8, 0x01];
                let mut param: Vec<&dyn Encode> = vec![&START];
                if send & 0x0100 != 0 {
                    param.push(&mini);
                }
                if send & 0x0200 != 0 {
                    param.extend([&128 as &dyn Encode, &16, &data]);
                }
                if has(4) {
                    param.extend([&136 as &dyn Encode, &24]);
                }
                if send & 0x0020 != 0 {
                    param.push(&mini);
                }
                let (result, answer) = match param[..] {
                    [pose] => rig.slv_move(pose),
                    _ => rig.slv_move(param.as_slice()),
                };
                assert_eq!(result, HResult::S_OK, "{send:#x} {receive:#x}");

                let mut expected = vec![format!("R8[{numbers}]")];
                if has(1) {
                    expected.insert(0, "I4".to_owned());
                }
                expected.extend(has(2).then(|| "I4".to_owned()));
                expected.extend(has(4).then(|| "UI1[3]".to_owned()));
                expected.extend(has(8).then(|| "I4".to_owned()));
                expected.extend(has(16).then(|| "R8[8]".to_owned()));
                rig.cycles(1);
                assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
                assert_eq!(items(&answer), expected, "{send:#x} {receive:#x}");
            }
        }
    }
}

#[test]
fn the_answers_pose_is_where_the_robot_is_in_every_kind() {
    for (format, variables) in [
        (1, &["@CURRENT_POSITION"][..]),
        (2, &["@CURRENT_ANGLE"]),
        (3, &["@CURRENT_TRANS"]),
        (4, &["@CURRENT_POSITION", "@CURRENT_ANGLE"]),
        (5, &["@CURRENT_TRANS", "@CURRENT_ANGLE"]),
    ] {
        let mut rig = Rig::new();
        let other = rig.world.client(2);
        rig.execute("slvRecvFormat", format);
        rig.execute("slvChangeMode", 0x102);
        rig.slv_move([0.4, 45.1, 89.9, 0.2, 45.0, 0.3, 0.0, 0.0]);
        rig.world.pass(12);
        let (_, answer) = rig.slv_move(START);
        let told: Vec<f64> = variables.iter().flat_map(|name| doubles(&rig.world.robot_get(other, name).1)).collect();
        assert_close(&doubles(&answer), &told, 1e-12);
        assert!((rig.here()[0] - 0.2).abs() < 1e-12, "in the middle of a cycle");
    }
}

#[test]
fn poses_of_all_kinds_go_the_same_way() {
    let mut rig = Rig::new();
    let way: Vec<[f64; 8]> = (1..=5)
        .map(|n| f64::from(n * n) * 0.01)
        .map(|d| [d, 45.0 + d, 90.0 - d, d, 45.0 - d, 2.0 * d, 0.0, 0.0])
        .collect();
    let mut ends = Vec::new();
    for (mode, command) in [(0x101, "J2P"), (0x102, ""), (0x103, "J2T")] {
        let mut poses: Vec<Vec<f64>> = way.iter().map(|j| j.to_vec()).collect();
        if !command.is_empty() {
            poses = poses.iter().map(|j| doubles(&rig.execute(command, j.as_slice()).1)).collect();
        }
        let mut rig = Rig::enter(mode);
        for pose in &poses {
            assert_eq!(rig.slv_move(pose.as_slice()).0, HResult::S_OK);
            rig.cycles(1);
        }
        rig.cycles(1);
        ends.push(rig.here());
        assert_eq!(rig.errors(), []);
    }
    for end in ends {
        // the answers of J2P and J2T are rounded
        assert_close(&end, &way[4], 1e-5);
    }
}

#[test]
fn time_stamps_count_ms_or_us() {
    for (param, scale) in [(&[0x12, 0][..], 1), (&[0x12, 1], 1000), (&[0x12], 1)] {
        let mut rig = Rig::new();
        assert_eq!(rig.execute("slvRecvFormat", param), ok(&()));
        rig.execute("slvChangeMode", 0x102);
        rig.world.now = Instant::from_micros(1_234_567);
        let (_, answer) = rig.slv_move(START);
        let Variant::Array(answer) = answer.as_variant() else { panic!("no array") };
        let expected = if scale == 1 { 1234 } else { 1_234_567 };
        assert_eq!(answer.get(0).map(Variant::flatten), Some(Variant::I4(expected)), "{param:?}");
    }
}

#[test]
fn currents_tell_of_acceleration_and_speed() {
    let mut rig = Rig::new();
    rig.execute("slvRecvFormat", 0x42);
    rig.execute("slvChangeMode", 0x102);
    let current = |rig: &mut Rig, angle: f64| -> Vec<f64> {
        let (_, answer) = rig.slv_move(j1(angle));
        let Variant::Array(answer) = answer.as_variant() else { panic!("no array") };
        answer.get(1).unwrap().flatten().as_array().unwrap().items::<f64>().unwrap().iter().collect()
    };
    assert_eq!(current(&mut rig, 0.24), [0.0; 8]);
    rig.cycles(1);
    // half of the acceleration, and 30 of 450 degrees per second
    let percent = current(&mut rig, 0.48);
    assert_close(&percent, &[50.0 + 30.0 / 450.0 * 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1e-9);
}

fn io(rig: &Rig, n: u32) -> bool {
    rig.world.sim.variable::<16>(VariableKind::Io, n).unwrap().as_variant() == Variant::Bool(true)
}

#[test]
fn io_travels_inside_slv_move() {
    let mut rig = Rig::new();
    for n in [3, 50, 60, 200] {
        rig.world.sim.set_variable(VariableKind::Io, n, &Variant::Bool(true)).unwrap();
    }
    rig.execute("slvSendFormat", 0x0120);
    rig.execute("slvRecvFormat", 0x0322);
    rig.execute("slvChangeMode", 0x002);
    // MiniIO: outputs 16 and 31 and an input; user IO to be read: 200 to 215; HandIO: outputs 64 and 71, and 72
    let mini = (1_u32 << 16 | 1 << 31 | 1 << 5).cast_signed();
    let hand = 1_i32 << 16 | 1 << 23 | 1 << 24;
    let (result, answer) = rig.slv_move((START, mini, 200, 16, hand));
    assert_eq!(result, HResult::S_OK);
    let expected: &[&dyn Encode] =
        &[&START, &(1_u32 << 16 | 1 << 31 | 1 << 3).cast_signed(), &[1_u8, 0], &(1_i32 << 16 | 1 << 23 | 1 << 2)];
    assert_eq!(answer, value(expected));
    let on: Vec<u32> = (0..512).filter(|n| io(&rig, *n)).collect();
    assert_eq!(on, [3, 16, 31, 50, 60, 64, 71, 200]);

    // a pose that is not stored writes nothing
    for _ in 0..2 {
        rig.slv_move((START, mini, 200, 16, hand));
    }
    assert_eq!(rig.slv_move((START, 0, 200, 16, 0)).0, HResult::E_BUF_FULL);
    assert!(io(&rig, 16));
}

#[test]
fn a_model_says_which_io_are_mini_io_hand_io_and_user_io() {
    let text = Profile::Rc9.text();
    let text = text.replace(
        "mini_io = { first = 0, read = [0, 15], write = [16, 31] }",
        "mini_io = { first = 100, read = [100, 101], write = [102, 103] }",
    );
    let text = text.replace("user_io = 128", "user_io = 256");
    let mut rig = Rig::with(Config::of(Model::parse(&text).unwrap()));
    for n in [101, 105, 264] {
        rig.world.sim.set_variable(VariableKind::Io, n, &Variant::Bool(true)).unwrap();
    }
    rig.execute("slvSendFormat", 0x0100);
    rig.execute("slvRecvFormat", 0x0302);
    rig.execute("slvChangeMode", 0x202);
    // all bits are sent; only those of 102 and 103 are written, and those of 100 to 103 are read
    let (result, answer) = rig.slv_move((START, -1, 256, 16));
    assert_eq!((result, answer), ok(&(START, 0b1110, [0_u8, 1])));
    let on: Vec<u32> = (0..512).filter(|n| io(&rig, *n)).collect();
    assert_eq!(on, [101, 102, 103, 105, 264]);
    assert_eq!(rig.slv_move((START, -1, 248, 16)), code(HResult::E_INVALIDARG));
}

#[test]
fn user_io_is_written_and_read() {
    let mut rig = Rig::new();
    rig.execute("slvSendFormat", 0x0200);
    rig.execute("slvRecvFormat", 0x0202);
    rig.execute("slvChangeMode", 0x202);
    let (result, answer) = rig.slv_move((START, 136, 16, [0x81_u8, 0x02], 128, 32));
    assert_eq!((result, answer), ok(&(START, [0_u8, 0x81, 0x02, 0])));
    let on: Vec<u32> = (0..512).filter(|n| io(&rig, *n)).collect();
    assert_eq!(on, [136, 143, 145]);
    for (param, error) in [
        // the offset: from 128 on, a multiple of 8
        ((START, 120, 8, [1_u8].as_slice(), 128, 8), HResult::E_INVALIDARG),
        ((START, 129, 8, &[1], 128, 8), HResult::E_INVALIDARG),
        ((START, 128, 8, &[1], -8, 8), HResult::E_INVALIDARG),
        // the size counts bits
        ((START, 128, 1, &[1], 128, 8), HResult::E_INVALIDARG),
        ((START, 128, 16, &[1], 128, 8), HResult::E_INVALIDARG),
        ((START, 128, 8, &[1], 128, -8), HResult::E_INVALIDARG),
        // there are 512 IO
        ((START, 512, 8, &[1], 128, 8), HResult::DISP_E_BADINDEX),
        ((START, 504, 8, &[1], 504, 16), HResult::DISP_E_BADINDEX),
    ] {
        assert_eq!(rig.slv_move(param), code(error), "{param:?}");
    }
    assert_eq!(rig.slv_move((START, 504, 8, [0x80_u8], 504, 8)), ok(&(START, [0x80_u8])));
}

#[test]
fn a_withheld_pose_writes_its_io_when_it_is_stored() {
    let mut rig = Rig::new();
    rig.execute("slvSendFormat", 0x0100);
    rig.execute("slvChangeMode", 0x202);
    for _ in 0..3 {
        assert_eq!(rig.slv_move((START, 0)).0, HResult::S_OK);
    }
    let peer = rig.client.peer;
    let fourth = call::robot_execute(rig.client.robot, "slvMove", (START, 1 << 20));
    rig.world.begin(peer, &fourth);
    assert!(!io(&rig, 20));
    assert_eq!(rig.world.run_again(peer, &fourth), ok(&START));
    assert!(io(&rig, 20));
}

#[test]
fn numbers_of_mixed_types_are_converted() {
    let mut rig = Rig::enter(0x102);
    assert_eq!(rig.slv_move((0.0_f64, 45, 90_i16, 0_u8, 45.0_f32, 0_i64, 0, 0)), ok(&START));
    assert_eq!(rig.slv_move([0, 45, 90, 0, 45, 0, 0, 0]), ok(&START));
    assert_eq!(rig.slv_move([0.0_f32, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]), ok(&START));
    assert_eq!(rig.slv_move((0, 45, 90, 0, 45, 0, 0, "0")), code(HResult::E_INVALIDARGTYPE));

    let mut rig = Rig::new();
    rig.execute("slvSendFormat", 0x0220);
    rig.execute("slvChangeMode", 0x102);
    // user IO: offset, size in bits, the bytes; then HandIO
    let pose = [0, 45, 90, 0, 45, 0, 0, 0];
    assert_eq!(rig.slv_move((pose, 128.0_f64, 16_i16, [1, 2], 0_u8)).0, HResult::S_OK);
    assert!(io(&rig, 128) && io(&rig, 137) && !io(&rig, 129));
    assert_eq!(rig.slv_move((pose, 128, 16, [1, 256], 0)).0, HResult::DISP_E_OVERFLOW);
    assert_eq!(rig.slv_move((pose, 128, 16, [1.0_f64, 2.0], 0)).0, HResult::S_OK);
}

#[test]
fn parameters_that_do_not_fit_the_formats_are_refused_and_change_nothing() {
    let mut rig = Rig::enter(0x002);
    let wrong = HResult::E_INVALIDARGTYPE;
    assert_eq!(rig.slv_move((START, 1)), code(wrong));
    assert_eq!(rig.slv_move("J(0,45,90,0,45,0)"), code(wrong));
    assert_eq!(rig.slv_move(()), code(wrong));
    for pose in [&[0.0; 7][..], &[0.0; 10], &[]] {
        assert_eq!(rig.slv_move(pose), code(HResult::E_INVALIDARG), "{pose:?}");
    }
    let mut pose = START;
    pose[2] = f64::NAN;
    assert_eq!(rig.slv_move(pose), code(HResult::E_INVALIDARG));
    assert_eq!((rig.mode(), rig.errors()), (0x002, vec![]));

    let mut rig = Rig::new();
    rig.execute("slvSendFormat", 0x0100);
    rig.execute("slvChangeMode", 0x002);
    assert_eq!(rig.slv_move(START), code(wrong));
    assert_eq!(rig.slv_move((START, "1.5")), code(HResult::DISP_E_TYPEMISMATCH));
    assert_eq!(rig.slv_move((START, 1.5_f64)), code(HResult::DISP_E_TYPEMISMATCH));
    assert_eq!(rig.slv_move((START, 1, 2)), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move(&[&START as &dyn Encode][..]), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move((START, 1)).0, HResult::S_OK);
}

#[test]
fn formats_are_checked_and_kept_for_each_client() {
    let mut rig = Rig::new();
    let other = rig.world.client(2);
    for format in [1, 0x10, 0x0300, 0x0320, 0x0040, 0x0400, -1] {
        assert_eq!(rig.execute("slvSendFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    for format in [0, 6, 0x10, 0x82, 0x402, -1] {
        assert_eq!(rig.execute("slvRecvFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    assert_eq!(rig.execute("slvRecvFormat", [2, 2]), code(HResult::E_INVALIDARG));
    assert_eq!(rig.execute("slvRecvFormat", [2, 0, 0]), code(HResult::E_INVALIDARG));
    // another client's formats are its own
    assert_eq!(rig.world.robot(other, "slvRecvFormat", 1), ok(&()));
    rig.execute("slvChangeMode", 0x102);
    assert_eq!(rig.slv_move(START), ok(&START));
}

#[test]
fn a_profile_has_not_every_format() {
    let mut rig = Rig::with(Config::new(Profile::Cobotta));
    for format in [0x0020, 0x0120, 0x0220] {
        assert_eq!(rig.execute("slvSendFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    assert_eq!(rig.execute("slvRecvFormat", 0x22), code(HResult::E_INVALIDARG));
    assert_eq!(rig.execute("slvRecvFormat", 0x0102), ok(&()));
    assert_eq!(rig.execute("slvSendFormat", 0x0100), ok(&()));
    let formats = SlaveFormats { user_io: false, current: false, mini_io: false, ..SlaveFormats::ALL };
    let slave = SlaveConfig { formats, ..SlaveConfig::default() };
    let mut rig = Rig::with(Config { slave, ..Config::new(Profile::Rc9) });
    for format in [0x0202, 0x0102, 0x0042] {
        assert_eq!(rig.execute("slvRecvFormat", format), code(HResult::E_INVALIDARG), "{format:#x}");
    }
    assert_eq!(rig.execute("slvSendFormat", 0x0220), code(HResult::E_INVALIDARG));
    assert_eq!(rig.execute("slvSendFormat", 0x0020), ok(&()));
}
