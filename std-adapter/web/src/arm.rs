//! The dimensions of arms, from the model files of the virtual controller.

use bcap_live::axis::Axis;
use bcap_live::jog::{FASTEST, FASTEST_MM};
use bcap_sim::kinematics::{Geometry, Links};
use bcap_sim::{ArmProfile, Profile};
use serde_json::{Value, json};

/// Returns the dimensions of an arm by its `@TYPE_NAME`, in mm; `None` for one without a model file.
pub(crate) fn dimensions(type_name: &str) -> Option<Value> {
    geometry(type_name).map(|geometry| json!(geometry.links))
}

fn geometry(type_name: &str) -> Option<Geometry> {
    let models = Profile::ALL.iter().map(|profile| profile.model()).map(|model| (&model.robot_type, model.geometry));
    let arms = ArmProfile::ALL.iter().map(|profile| profile.arm()).map(|arm| (&arm.robot_type, arm.geometry));
    let (_, geometry) = models.chain(arms).find(|(known, _)| is_of_series(type_name, known))?;
    Some(geometry)
}

/// Maximum length of a tool, in mm. A longer tool moves faster than the computed speed; a jog measures that, and halts.
const TOOL: f64 = 500.0;

/// The speed for an arm without a model file, in percent: 1 % of 720 degrees/s at 2 m is 250 mm/s.
const SLOWEST: f64 = 1.0;

/// Returns the speed for an axis, in percent, at which no joint alone moves a point of the arm or its tool faster than a jog may. Steps
/// of the work coordinates move several joints: the jog measures their speed.
pub(crate) fn percent(type_name: &str, axis: Axis) -> f64 {
    let Some(geometry) = geometry(type_name) else { return SLOWEST };
    let (reach, slide) = match geometry.links {
        Links::Vertical(arm) => {
            let lengths = [arm.d1, arm.a1, arm.a2, arm.a3, arm.d4, arm.b4, arm.b6, arm.d6];
            (lengths.iter().map(|length| length.abs()).sum::<f64>(), None)
        }
        // the third axis moves in mm
        Links::Horizontal(arm) => (arm.d1.abs() + arm.a1.abs() + arm.a2.abs(), Some(2)),
        _ => return SLOWEST,
    };
    let fastest = |axis: usize| match geometry.speeds.get(axis).copied().unwrap_or(f64::INFINITY) {
        speed if Some(axis) == slide => speed,
        speed => speed.to_radians() * (reach + TOOL),
    };
    let speed = match axis {
        Axis::Joint(joint) => fastest(usize::from(joint) - 1),
        Axis::Coordinate(_) => (0..6).map(fastest).fold(0.0, f64::max),
    };
    (FASTEST_MM / speed * 100.0).min(FASTEST)
}

/// Returns the units of the joints of an arm; an empty one for an extended axis, and for an arm without a model file, which may turn
/// or slide.
pub(crate) fn units(type_name: &str, joints: usize) -> Vec<&'static str> {
    let known: &[&str] = match geometry(type_name).map(|geometry| geometry.links) {
        Some(Links::Vertical(_)) => &["°"; 6],
        Some(Links::Horizontal(_)) => &["°", "°", "mm", "°"],
        _ => &[],
    };
    known.iter().copied().chain(std::iter::repeat("")).take(joints).collect()
}

/// Returns whether an arm has the lengths of a known one: the options of an arm follow a dash, and a controller may add a letter.
fn is_of_series(type_name: &str, known: &str) -> bool {
    let series = known.split(['-', ' ']).next().unwrap_or_default();
    type_name.strip_prefix(series).is_some_and(|rest| !rest.starts_with(|next: char| next.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jog_is_slower_than_its_limit() {
        // J1 of the default arm: 375 degrees/s at 930 + 500 mm
        let joint = percent("VS060A3-AV6", Axis::Joint(1));
        assert!((joint - 2.67).abs() < 0.01, "{joint}");
        let line = percent("VS060A3-AV6", Axis::Coordinate(0));
        assert!(line < joint && line > 1.0, "{line}");
        assert_eq!(percent("unknown", Axis::Coordinate(0)), SLOWEST);
    }

    #[test]
    fn a_joint_that_slides_is_in_mm() {
        assert_eq!(units("HSR065A1-N32-NNN-NNN A", 6), ["°", "°", "mm", "°", "", ""]);
        assert_eq!(units("VS060A3-AV6", 7), ["°", "°", "°", "°", "°", "°", ""]);
        assert_eq!(units("unknown", 2), ["", ""]);
    }

    #[test]
    fn an_arm_has_the_lengths_of_its_model_file() {
        let hsr = dimensions("HSR065A1-N32-NNN-NNN A").unwrap();
        assert_eq!(hsr, json!({ "kind": "horizontal", "d1": 0.0, "a1": 375.0, "a2": 275.0 }));
        assert_eq!(dimensions("HSR065A1-other"), Some(hsr));
        assert_eq!(dimensions("VS087A4-AV6").unwrap()["kind"], "vertical");
        assert_eq!(dimensions("VS0871"), None, "another series");
        assert_eq!(dimensions(""), None);
    }
}
