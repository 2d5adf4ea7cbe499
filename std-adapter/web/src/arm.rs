//! The dimensions of arms, from the model files of the virtual controller.

use bcap_sim::kinematics::{Geometry, Links};
use bcap_sim::{ArmProfile, Profile};
use serde_json::{Value, json};

/// Returns the dimensions of an arm by its `@TYPE_NAME`, in mm; `None` for one without a model file.
pub(crate) fn dimensions(type_name: &str) -> Option<Value> {
    let models = Profile::ALL.iter().map(|profile| profile.model()).map(|model| (&model.robot_type, model.geometry));
    let arms = ArmProfile::ALL.iter().map(|profile| profile.arm()).map(|arm| (&arm.robot_type, arm.geometry));
    let (_, geometry) = models.chain(arms).find(|(known, _)| is_of(series(known), type_name))?;
    Some(links(&geometry))
}

/// Returns the part of a type name that tells the lengths: the options of an arm follow a dash.
fn series(type_name: &str) -> &str {
    type_name.split(['-', ' ']).next().unwrap_or_default()
}

/// Returns whether an arm is of a series: a controller may add a letter and the options to its name.
fn is_of(series: &str, type_name: &str) -> bool {
    type_name.strip_prefix(series).is_some_and(|rest| !rest.starts_with(|next: char| next.is_ascii_digit()))
}

fn links(geometry: &Geometry) -> Value {
    match geometry.links {
        Links::Vertical(arm) => json!({
            "kind": "vertical", "d1": arm.d1, "a1": arm.a1, "a2": arm.a2, "a3": arm.a3, "d4": arm.d4, "b4": arm.b4,
            "b6": arm.b6, "d6": arm.d6,
        }),
        Links::Horizontal(arm) => json!({ "kind": "horizontal", "d1": arm.d1, "a1": arm.a1, "a2": arm.a2 }),
        _ => Value::Null,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
