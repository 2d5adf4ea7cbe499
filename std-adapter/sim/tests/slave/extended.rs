//! Extended joints and their option element.

use bcap_core::hresult::HResult;
use bcap_sim::Config;

use crate::common::{code, ok};
use crate::slave::{POSE, Rig, START, limit};

const OPTION: f64 = 4_194_304.0; // 0x00400000

#[test]
fn extended_joints_follow_their_option() {
    let config = Config { extended_axes: 2, ..Config::default() };
    let step = |mode: i32, pose: &[f64]| -> Result<(f64, f64), HResult> {
        let mut rig = Rig::with(config.clone());
        rig.execute("slvChangeMode", mode);
        let (result, _) = rig.slv_move(pose);
        if result.is_err() {
            return Err(result);
        }
        rig.cycles(2);
        assert_eq!(rig.errors(), []);
        Ok((rig.here()[6], rig.here()[7]))
    };
    let trans = [364.16, 0.0, 278.5355, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 5.0];
    let of = |start: &[f64], more: &[f64]| [start, more].concat();
    // P: 7 + option + values
    assert_eq!(step(0x101, &POSE), Ok((0.0, 0.0)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 64.0, 0.1])), Ok((0.1, 0.0)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 128.0, 0.2])), Ok((0.0, 0.2)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 192.0, 0.1, 0.2])), Ok((0.1, 0.2)));
    // J: the values have their places
    let joints = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.1, 0.2];
    assert_eq!(step(0x102, &joints), Ok((0.0, 0.0)), "without the option they stay");
    assert_eq!(step(0x102, &of(&joints, &[OPTION + 64.0])), Ok((0.1, 0.0)));
    assert_eq!(step(0x102, &of(&joints, &[OPTION + 128.0])), Ok((0.0, 0.2)));
    assert_eq!(step(0x102, &of(&joints, &[OPTION + 192.0])), Ok((0.1, 0.2)));
    // T: 10 + option + values
    assert_eq!(step(0x103, &of(&trans, &[OPTION + 64.0, 0.1])), Ok((0.1, 0.0)));
    assert_eq!(step(0x103, &of(&trans, &[OPTION + 128.0, 0.2])), Ok((0.0, 0.2)));
    assert_eq!(step(0x103, &of(&trans, &[OPTION + 192.0, 0.1, 0.2])), Ok((0.1, 0.2)));
    // as the vendor's driver sends it: one element more, with a bit for each joint, or 0
    assert_eq!(step(0x102, &of(&START, &[OPTION + 63.0])), Ok((0.0, 0.0)));
    assert_eq!(step(0x101, &of(&POSE, &[0.0])), Ok((0.0, 0.0)));
    // values without an option, options without values, no options
    for more in
        [&[OPTION + 64.0][..], &[OPTION + 192.0, 0.1], &[OPTION, 0.1], &[64.0, 0.1], &[OPTION + 0.5], &[0.0, 0.1]]
    {
        assert_eq!(step(0x101, &of(&POSE, more)), Err(HResult::E_INVALIDARG), "{more:?}");
    }
    assert_eq!(step(0x102, &of(&START, &[OPTION, 0.0])), Err(HResult::E_INVALIDARG));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 128.0, 1001.0])), Err(limit(0x8320_4070, 8)));
    assert_eq!(step(0x101, &of(&POSE, &[OPTION + 64.0, -1001.0])), Err(limit(0x8320_4070, 7)));
}

#[test]
fn an_arm_without_extended_joints_refuses_their_option() {
    let mut rig = Rig::enter(0x102);
    let with = |bits: f64| [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 1e-307, 3e-313, OPTION + bits];
    assert_eq!(rig.slv_move(with(64.0)), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move(with(63.0)).0, HResult::S_OK, "what is in unused joints is not looked at");
    let mut rig = Rig::with(Config { extended_axes: 1, ..Config::default() });
    rig.execute("slvChangeMode", 0x102);
    assert_eq!(rig.slv_move(with(128.0)), code(HResult::E_INVALIDARG));
    assert_eq!(rig.slv_move(with(64.0)).0, HResult::S_OK);
}

#[test]
fn extended_joints_have_limits_and_are_told_afterwards() {
    let mut rig = Rig::with(Config { extended_axes: 2, ..Config::default() });
    rig.execute("slvChangeMode", 0x102);
    let to = |j7: f64, j8: f64| [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, j7, j8, OPTION + 192.0];
    rig.slv_move(to(0.3, -0.3));
    rig.cycles(2);
    assert_eq!(rig.execute("slvChangeMode", 0), ok(&()));
    let expected = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.3, -0.3];
    assert_eq!(rig.execute("CurJnt", ()), ok(&expected));
    assert_eq!(rig.world.robot_get(rig.client, "@CURRENT_ANGLE"), ok(&expected));
    rig.execute("slvChangeMode", 0x102);
    rig.slv_move(to(0.3, 6.0));
    rig.cycles(1);
    assert_eq!(rig.errors(), [limit(0x8420_4050, 8)]);
}
