//! Arms against the figures of their sources, and poses against their joints.

use proptest::prelude::*;

use super::*;
use crate::model::{ArmProfile, Profile};

const ARM: Geometry = Geometry::DEFAULT;

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance), "{a:?} is not {b:?}");
}

/// A number that is the same for 180 and -180.
fn turn(degrees: f64) -> f64 {
    degrees.to_radians().cos()
}

#[test]
fn the_pose_of_the_guides_slave_move_has_the_joints_of_its_reply() {
    let joints = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0];
    let pose = ARM.forward(&joints).to_xyz_rpy();
    assert_close(&pose[..3], &[364.16, 0.0, 278.5355], 1e-3);
    assert_close(&[turn(pose[3]), turn(pose[4]), turn(pose[5])], &[turn(180.0), turn(0.0), turn(180.0)], 1e-9);
    assert_eq!(ARM.figure(&joints), 5);

    let guide = Frame::from_xyz_rpy([364.16, 0.0, 278.5355, 180.0, 1.272222e-14, 180.0]);
    assert_close(&ARM.inverse(&guide, 5, &[0.0; 6]).unwrap(), &joints, 1e-4);
}

#[test]
fn the_straight_arm_is_as_high_as_its_parts() {
    let frame = ARM.forward(&[0.0; 6]);
    assert_close(&frame.position, &[-10.0, 0.0, 345.0 + 250.0 + 255.0 + 70.0], 1e-9);
    assert_close(&frame.to_xyz_rpy()[3..], &[0.0; 3], 1e-9);
    assert_eq!(
        ARM.inverse_nearest(&Frame::from_xyz_rpy([0.0, 0.0, 2000.0, 0.0, 0.0, 0.0]), &[0.0; 6]),
        Err(OutOfReach::Unreachable)
    );
}

#[test]
fn a_line_keeps_to_the_line() {
    let from = Frame::from_xyz_rpy([300.0, 0.0, 300.0, 180.0, 0.0, 180.0]);
    let to = Frame::from_xyz_rpy([300.0, 100.0, 350.0, 180.0, 0.0, 90.0]);
    let middle = from.towards(&to, 0.5).to_xyz_rpy();
    assert_close(&middle[..3], &[300.0, 50.0, 325.0], 1e-9);
    assert_close(&[middle[5]], &[135.0], 1e-9);
    assert_close(&[from.distance(&to).1], &[90.0], 1e-9);
    assert_close(&from.towards(&to, 1.0).to_trans(), &to.to_trans(), 1e-9);
}

#[test]
fn half_turns_have_an_axis() {
    for degrees in [[180.0, 0.0, 0.0], [0.0, 180.0, 0.0], [0.0, 0.0, 180.0], [180.0, 0.0, 45.0]] {
        let [rx, ry, rz] = degrees;
        let to = Frame::from_xyz_rpy([0.0, 0.0, 0.0, rx, ry, rz]);
        let from = Frame::from_xyz_rpy([0.0; 6]);
        assert_close(&from.towards(&to, 1.0).to_trans(), &to.to_trans(), 1e-9);
        assert_close(&[from.distance(&to).1], &[180.0], 1e-9);
    }
}

#[test]
fn vectors_that_span_no_plane_are_no_transform() {
    assert!(Frame::from_trans([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]).is_none());
    assert!(Frame::from_trans([0.0; 9]).is_none());
}

/// All arms: the default one, the arms of the models, and the others.
fn arms() -> Vec<(&'static str, Geometry)> {
    let models = [("cobotta", Profile::Cobotta), ("cobotta pro", Profile::CobottaPro)];
    let models = models.map(|(name, profile)| (name, profile.model().geometry));
    let others = ArmProfile::ALL.map(|arm| (arm.name(), arm.arm().geometry));
    [("default", ARM)].into_iter().chain(models).chain(others).collect()
}

fn arm(name: &str) -> Geometry {
    arms().into_iter().find(|(other, _)| *other == name).unwrap().1
}

/// The chain of each public description (URDF), multiplied out in double precision by another program.
#[test]
fn each_arm_is_where_its_description_puts_it() {
    const A: Joints = [20.0, 30.0, 50.0, -40.0, 60.0, 70.0];
    const B: Joints = [-100.0, -20.0, 130.0, 80.0, -35.0, -60.0];
    // the orientation of these arms depends on the joints only
    const TURN_A: [f64; 6] = [0.537341, 0.795787, 0.279263, 0.761354, -0.315286, -0.566511];
    const TURN_B: [f64; 6] = [0.670537, -0.720437, 0.177058, -0.695862, -0.693517, -0.186573];
    let upright = |orient: [f64; 2]| [orient[0], orient[1], 0.0, 0.0, 0.0, 1.0];
    for (name, joints, position, turn) in [
        ("vs060", A, [472.591116, 130.541361, 631.424501], TURN_A),
        ("vs060", B, [-80.142735, -226.808084, 525.337048], TURN_B),
        ("vs087", A, [692.846314, 204.783734, 829.425287], TURN_A),
        ("vs087", B, [-105.802819, -339.804514, 669.962596], TURN_B),
        ("cobotta", A, [275.098365, 43.949647, 382.570903], TURN_A),
        ("cobotta", B, [-36.664551, -121.988038, 218.091598], TURN_B),
        ("cobotta pro", A, [709.044044, 253.643312, 533.800634], TURN_A),
        ("cobotta pro", B, [-157.353124, -349.164616, 664.816245], TURN_B),
        ("hsr065", [20.0, 30.0, 50.0, -40.0, 0.0, 0.0], [529.151325, 338.919776, 50.0], upright([-0.173648, 0.984808])),
        (
            "hsr065",
            [-100.0, -70.0, -30.0, 300.0, 0.0, 0.0],
            [-335.940199, -417.056156, -30.0],
            upright([-0.766044, -0.642788]),
        ),
    ] {
        let trans = arm(name).forward(&joints).to_trans();
        assert_close(&trans[..3], &position, 2e-6);
        assert_close(&trans[3..], &turn, 2e-6);
    }
}

#[test]
fn each_figure_has_other_joints_for_the_same_pose() {
    // one pose that an arm reaches with each shoulder, elbow and wrist, far from the ends of the ranges
    let (spherical, offset) = (arm("vs060"), arm("cobotta pro"));
    for (arm, joints) in
        [(spherical, [10.0, -20.0, 60.0, 20.0, 50.0, 30.0]), (offset, [10.0, -20.0, 60.0, 20.0, 50.0, 30.0])]
    {
        let frame = arm.forward(&joints);
        let solutions: Vec<Joints> = (0..8).filter_map(|fig| arm.inverse(&frame, fig, &joints).ok()).collect();
        assert!(solutions.len() >= 4, "{solutions:?}");
        for (n, a) in solutions.iter().enumerate() {
            assert_close(&arm.forward(a).to_trans(), &frame.to_trans(), 1e-6);
            assert!(solutions[..n].iter().all(|b| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1.0)));
        }
        for fig in 0..8 {
            if let Ok(joints) = arm.inverse(&frame, fig, &joints) {
                assert_eq!(arm.figure(&joints), fig);
            }
        }
    }
}

#[test]
fn an_arm_of_four_axes_has_four_figures() {
    let arm = arm("hsr065");
    let righty = [30.0, 60.0, 10.0, 20.0, 0.0, 0.0];
    let frame = arm.forward(&righty);
    assert_eq!(arm.figure(&righty), 0);
    for fig in [0, 1, 16, 17] {
        let joints = arm.inverse(&frame, fig, &righty).unwrap();
        assert_eq!(arm.figure(&joints), fig);
        assert_close(&arm.forward(&joints).to_trans(), &frame.to_trans(), 1e-9);
        assert_eq!((joints[1] < 0.0, joints[3].abs() > 180.0), (fig & 1 != 0, fig & 16 != 0));
    }
    assert_close(&arm.inverse(&frame, 0, &righty).unwrap(), &righty, 1e-9);
}

#[test]
fn poses_out_of_reach_name_an_axis() {
    let xyz = |x: f64, y: f64, z: f64, rx: f64| Frame::from_xyz_rpy([x, y, z, rx, 0.0, 0.0]);
    for (name, frame, reason) in [
        ("vs060", xyz(800.0, 0.0, 345.0, 90.0), OutOfReach::Unreachable),
        ("vs087", xyz(0.0, 0.0, 2000.0, 0.0), OutOfReach::Unreachable),
        ("cobotta", xyz(2000.0, 0.0, 180.0, 180.0), OutOfReach::Unreachable),
        ("cobotta pro", xyz(3000.0, 0.0, 210.0, 180.0), OutOfReach::Unreachable),
        // beyond both links, inside the smallest circle, above the stroke, behind the range of J1, tilted
        ("hsr065", xyz(651.0, 0.0, 0.0, 0.0), OutOfReach::Unreachable),
        ("hsr065", xyz(50.0, 0.0, 0.0, 0.0), OutOfReach::Unreachable),
        ("hsr065", xyz(400.0, 0.0, 221.0, 0.0), OutOfReach::Limits(4)),
        ("hsr065", xyz(-649.0, 0.0, 0.0, 0.0), OutOfReach::Limits(1)),
        ("hsr065", xyz(400.0, 0.0, 0.0, 180.0), OutOfReach::Unreachable),
        ("hsr065", xyz(400.0, 0.0, 0.0, 1.0), OutOfReach::Unreachable),
    ] {
        assert_eq!(arm(name).inverse_nearest(&frame, &[0.0; 6]), Err(reason), "{name}");
    }
}

#[test]
fn at_a_singular_wrist_j4_stays() {
    for name in ["default", "vs060", "vs087", "cobotta"] {
        let arm = arm(name);
        let joints = [10.0, 20.0, 70.0, 30.0, 0.0, 15.0];
        let back = arm.inverse(&arm.forward(&joints), arm.figure(&joints), &joints).unwrap();
        assert_close(&back, &joints, 1e-5);
    }
    // the first link and the second are of different length, so only J2 = 0 is singular: J1 and J4 follow from the pose
    let arm = arm("hsr065");
    let joints = [25.0, 0.0, 0.0, 10.0, 0.0, 0.0];
    assert_close(&arm.inverse(&arm.forward(&joints), 0, &[0.0; 6]).unwrap(), &joints, 1e-4);
}

/// Joints of an arm, each at a part of its range.
fn joints_at(arm: &Geometry, parts: [f64; 6]) -> Joints {
    [0, 1, 2, 3, 4, 5].map(|n| arm.ranges[n].0 + (arm.ranges[n].1 - arm.ranges[n].0) * parts[n])
}

/// Returns whether joints are next to a singularity, where a solution exists but is ill-conditioned.
fn is_singular(arm: &Geometry, joints: &Joints) -> bool {
    let frame = arm.forward(joints);
    match &arm.links {
        Links::Vertical(links) => {
            let centre = Vertical { b6: 0.0, d6: 0.0, ..*links }.forward(joints);
            let across = (centre.position[0].hypot(centre.position[1]) - links.b4.abs()).abs();
            // the solutions of an arm with an offset wrist may meet before the arm is stretched
            let stretched = if links.b6 == 0.0 { 0.5 } else { 5.0 };
            links.elbow_bend(joints[2]).to_degrees().abs() < stretched || joints[4].abs() < 0.5 || across < 1.0
        }
        Links::Horizontal(_) => joints[1].abs() < 0.5 || frame.position[0].hypot(frame.position[1]) < 1.0,
    }
}

proptest! {
    #[test]
    fn joints_come_back_from_their_pose_and_figure(parts in prop::array::uniform6(0.001..0.999)) {
        for (name, arm) in arms() {
            let joints = joints_at(&arm, parts);
            if is_singular(&arm, &joints) {
                continue;
            }
            let back = arm.inverse(&arm.forward(&joints), arm.figure(&joints), &joints);
            prop_assert!(back.is_ok(), "{name}: {joints:?}");
            assert_close(&back.unwrap(), &joints, 1e-5);
        }
    }

    #[test]
    fn poses_come_back_from_their_joints(parts in prop::array::uniform6(0.001..0.999)) {
        for (name, arm) in arms() {
            let joints = joints_at(&arm, parts);
            let frame = arm.forward(&joints);
            let near = arm.inverse_nearest(&frame, &joints);
            prop_assert!(near.is_ok(), "{name}: {joints:?}");
            assert_close(&arm.forward(&near.unwrap()).to_trans(), &frame.to_trans(), 1e-4);
            let [x, y, z, rx, ry, rz] = frame.to_xyz_rpy();
            assert_close(&Frame::from_xyz_rpy([x, y, z, rx, ry, rz]).to_trans(), &frame.to_trans(), 1e-6);
            assert_close(&Frame::from_trans(frame.to_trans()).unwrap().to_trans(), &frame.to_trans(), 1e-6);
        }
    }
}

#[test]
fn a_pose_is_reached_whose_j6_is_half_a_turn_away() {
    let arm = arm("cobotta");
    let joints =
        [-149.7, 23.234164053285667, 64.72228384245628, 113.36185395694861, -10.131587921629915, -101.56662622162115];
    let near = [-149.7, -59.84, 18.122, -169.66, -94.77, 78.55984838046945];
    let frame = arm.forward(&joints);
    let reached = arm.inverse_nearest(&frame, &near).unwrap();
    assert_close(&arm.forward(&reached).to_trans(), &frame.to_trans(), 1e-4);
}

/// Checks that an arm reaches a pose from joints elsewhere. The numbers are parts of the ranges.
fn is_reached(name: &str, arm: &Geometry, parts: [f64; 6], from: [f64; 6]) {
    let (joints, near) = (joints_at(arm, parts), joints_at(arm, from));
    if is_singular(arm, &joints) {
        return;
    }
    let frame = arm.forward(&joints);
    let reached = arm.inverse_nearest(&frame, &near);
    assert!(reached.is_ok(), "{name}: {joints:?} from {near:?}");
    assert_close(&arm.forward(&reached.unwrap()).to_trans(), &frame.to_trans(), 1e-4);
}

#[test]
fn a_pose_is_reached_whose_two_solutions_are_close() {
    let cases = [
        (
            "cobotta pro",
            [0.001, 0.6630333059488001, 0.5201314746775373, 0.8056997302375345, 0.2391503298914916, 0.001],
            [0.001, 0.001, 0.001, 0.001, 0.001, 0.350291366590014],
        ),
        (
            "cobotta pro",
            [0.001, 0.001, 0.5910861402126132, 0.67863296248778, 0.2465787983251534, 0.4124612175130326],
            [0.001; 6],
        ),
        // three solutions within 8 degrees of J6
        (
            "cobotta",
            [
                0.001,
                0.39088157996117495,
                0.041937773196979306,
                0.41237433441028803,
                0.4249199970359908,
                0.8022815926582876,
            ],
            [0.001; 6],
        ),
    ];
    for (name, parts, from) in cases {
        is_reached(name, &arm(name), parts, from);
    }
}

proptest! {
    /// The two ends of the search for J6.
    #[test]
    fn poses_are_reached_from_half_a_turn_of_j6(parts in prop::array::uniform6(0.001..0.999), j6 in -170..=170) {
        for name in ["cobotta", "cobotta pro"] {
            let arm = arm(name);
            let mut joints = joints_at(&arm, parts);
            joints[5] = f64::from(j6);
            if is_singular(&arm, &joints) {
                continue;
            }
            for turn in [-180.0, 180.0] {
                let mut near = joints;
                near[5] += turn;
                let back = arm.inverse(&arm.forward(&joints), arm.figure(&joints), &near);
                prop_assert!(back.is_ok(), "{name}: {joints:?} from {near:?}");
            }
        }
    }

    /// The ends of the reach, where the slope of the function that is searched is infinite.
    #[test]
    fn a_stretched_arm_with_an_offset_wrist_is_found(
        parts in prop::array::uniform6(0.001..0.999),
        j3 in prop::sample::select(vec![0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2]),
    ) {
        let arm = arm("cobotta pro");
        let mut joints = joints_at(&arm, parts);
        joints[2] = j3;
        prop_assume!(!is_singular(&arm, &[joints[0], joints[1], 90.0, joints[3], joints[4], joints[5]]));
        let frame = arm.forward(&joints);
        let back = arm.inverse(&frame, arm.figure(&joints), &joints);
        prop_assert!(back.is_ok(), "{joints:?}");
        assert_close(&arm.forward(&back.unwrap()).to_trans(), &frame.to_trans(), 1e-3);
    }
}

#[test]
fn a_pose_beyond_all_numbers_is_out_of_reach_at_once() {
    for far in [1e160, 1e300, f64::INFINITY, f64::NAN] {
        let frame = Frame { position: [far, 0.0, 300.0], ..arm("cobotta").forward(&[0.0; 6]) };
        assert!(arm("cobotta").inverse_nearest(&frame, &[0.0; 6]).is_err(), "{far}");
    }
}

/// Less than usual, because each case searches on all arms; `PROPTEST_CASES` sets another number.
fn few_cases() -> ProptestConfig {
    let usual = ProptestConfig::default();
    let cases = if std::env::var_os("PROPTEST_CASES").is_some() { usual.cases } else { 48 };
    ProptestConfig { cases, ..usual }
}

proptest! {
    #![proptest_config(few_cases())]

    /// From joints far away, J6 of an arm with an offset wrist is searched.
    #[test]
    fn poses_are_reached_from_any_joints(parts in prop::array::uniform6(0.001..0.999), from in prop::array::uniform6(0.001..0.999)) {
        for (name, arm) in arms() {
            is_reached(name, &arm, parts, from);
        }
    }
}
