//! The arms of models, and arms that a controller of any model may drive, as data files.

use std::sync::OnceLock;

use serde::Deserialize;
use toml::Spanned;

use super::error::{ModelError, Wrong, located, text};
use crate::kinematics::{
    ACCELERATION_TIME, EXTENDED_RANGE, EXTENDED_SPEED, Geometry, Horizontal, Joints, Links, OutOfReach, Vertical,
};

/// Maximum length of a link in mm.
const LONGEST: f64 = 1e5;

/// The largest end of a range, in degrees or mm, and the highest speed: beyond them calculations lose all digits.
const LARGEST: f64 = 1e6;

/// A built-in arm that belongs to no [model](super::Profile). Its file names the source of each value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ArmProfile {
    /// VS-060: six axes.
    Vs060,
    /// VS-087: six axes.
    Vs087,
    /// HSR065: four axes.
    Hsr065,
}

impl ArmProfile {
    /// All built-in arms.
    pub const ALL: [Self; 3] = [Self::Vs060, Self::Vs087, Self::Hsr065];

    /// Returns the name of the arm, as `bcap sim --arm` has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Vs060 => "vs060",
            Self::Vs087 => "vs087",
            Self::Hsr065 => "hsr065",
        }
    }

    /// Returns the file of the arm.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Vs060 => include_str!("../../models/arms/vs060.toml"),
            Self::Vs087 => include_str!("../../models/arms/vs087.toml"),
            Self::Hsr065 => include_str!("../../models/arms/hsr065.toml"),
        }
    }

    /// Returns the arm.
    #[must_use]
    pub fn arm(self) -> &'static ArmModel {
        static ARMS: OnceLock<[ArmModel; 3]> = OnceLock::new();
        let parse = |arm: Self| ArmModel::parse(arm.text()).expect("a test parses all built-in arms");
        let [vs060, vs087, hsr065] = ARMS.get_or_init(|| Self::ALL.map(parse));
        match self {
            Self::Vs060 => vs060,
            Self::Vs087 => vs087,
            Self::Hsr065 => hsr065,
        }
    }
}

/// An arm: its file has `robot_type` and the section `[arm]` of a [model](super::Model).
///
/// # Examples
///
/// ```
/// use bcap_sim::model::ArmProfile;
/// use bcap_sim::{Config, Profile};
///
/// let config = Config::new(Profile::Rc8).with_arm(ArmProfile::Hsr065.arm());
/// assert_eq!(config.robot_type, "HSR065A1-N32-NNN-NNN A");
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ArmModel {
    /// `@TYPE_NAME` of the robot.
    pub robot_type: String,
    /// The dimensions, ranges and speeds of the arm.
    pub geometry: Geometry,
    /// The initial position: J1 to J6.
    pub home: Joints,
    /// The number of extended axes, 0 to 2.
    pub extended_axes: u8,
}

impl ArmModel {
    /// Reads an arm from TOML.
    ///
    /// # Errors
    ///
    /// A [`ModelError`] that names the line.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        let file: ArmFile = toml::from_str(text)?;
        file.read().map_err(|wrong| located(text, wrong))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmFile {
    robot_type: Spanned<String>,
    arm: Spanned<ArmEntry>,
}

impl ArmFile {
    fn read(self) -> Result<ArmModel, Wrong> {
        let (geometry, home, extended_axes) = ArmEntry::read(&self.arm)?;
        Ok(ArmModel { robot_type: text("robot_type", self.robot_type)?, geometry, home, extended_axes })
    }
}

/// The section `[arm]` of a model.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmEntry {
    #[serde(default)]
    kinematics: Kinematics,
    d1: Option<Spanned<f64>>,
    a1: Option<Spanned<f64>>,
    a2: Option<Spanned<f64>>,
    a3: Option<Spanned<f64>>,
    d4: Option<Spanned<f64>>,
    b4: Option<Spanned<f64>>,
    b6: Option<Spanned<f64>>,
    d6: Option<Spanned<f64>>,
    acceleration_time: Option<Spanned<f64>>,
    home: Spanned<Vec<f64>>,
    axes: Spanned<Vec<Spanned<AxisEntry>>>,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kinematics {
    #[default]
    Vertical,
    Horizontal,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct AxisEntry {
    range: (f64, f64),
    speed: f64,
}

/// A length of an arm: its key and its value.
type Length<'a> = (&'a str, &'a Option<Spanned<f64>>);

impl ArmEntry {
    /// Returns the arm, its initial position, and the number of its extended axes.
    pub(super) fn read(section: &Spanned<Self>) -> Result<(Geometry, Joints, u8), Wrong> {
        let (start, arm) = (section.span().start, section.get_ref());
        let links = arm.links(start)?;
        let joints = match links {
            Links::Vertical(_) => 6,
            Links::Horizontal(_) => 4,
        };
        let (ranges, speeds, extended) = arm.axes(joints)?;
        let acceleration_time = match &arm.acceleration_time {
            None => ACCELERATION_TIME,
            Some(time) if (0.001..=10.0).contains(time.get_ref()) => *time.get_ref(),
            Some(time) => {
                let problem = format!("`acceleration_time` is {}; it is 0.001 to 10 seconds", time.get_ref());
                return Err((time.span().start, problem));
            }
        };
        let geometry = Geometry { links, ranges, speeds, acceleration_time };
        Ok((geometry, arm.home(&geometry, joints)?, extended))
    }

    fn links(&self, start: usize) -> Result<Links, Wrong> {
        const ANY: f64 = -LONGEST;
        let length = |(key, value): Length<'_>, least: f64| match value {
            None => Err((start, format!("missing field `{key}`"))),
            Some(value) => match *value.get_ref() {
                n if (least..=LONGEST).contains(&n) => Ok(n),
                n => {
                    let problem = format!("`{key}` is {n}; it is a length in mm, {least} to {LONGEST}");
                    Err((value.span().start, problem))
                }
            },
        };
        // an offset that most arms lack
        let offset = |(key, value): Length<'_>| value.as_ref().map_or(Ok(0.0), |_| length((key, value), ANY));
        match self.kinematics {
            Kinematics::Vertical => Ok(Links::Vertical(Vertical {
                d1: length(("d1", &self.d1), 0.0)?,
                a1: offset(("a1", &self.a1))?,
                a2: length(("a2", &self.a2), 1.0)?,
                a3: length(("a3", &self.a3), ANY)?,
                d4: length(("d4", &self.d4), 1.0)?,
                b4: offset(("b4", &self.b4))?,
                b6: offset(("b6", &self.b6))?,
                d6: length(("d6", &self.d6), 0.0)?,
            })),
            Kinematics::Horizontal => {
                let others = [("a3", &self.a3), ("d4", &self.d4), ("b4", &self.b4), ("b6", &self.b6), ("d6", &self.d6)];
                let other = others.into_iter().find_map(|(key, value)| value.as_ref().map(|value| (key, value)));
                if let Some((key, value)) = other {
                    return Err((value.span().start, format!("`{key}`: a horizontal arm has d1, a1 and a2")));
                }
                Ok(Links::Horizontal(Horizontal {
                    d1: length(("d1", &self.d1), ANY)?,
                    a1: length(("a1", &self.a1), 1.0)?,
                    a2: length(("a2", &self.a2), 1.0)?,
                }))
            }
        }
    }

    /// Returns ranges, speeds, and the number of extended axes.
    #[expect(clippy::type_complexity, reason = "the three are one answer, read in one place")]
    fn axes(&self, joints: usize) -> Result<([(f64, f64); 8], [f64; 8], u8), Wrong> {
        let axes = self.axes.get_ref();
        let most = if joints == 6 { 2 } else { 0 };
        let extended = axes.len().checked_sub(joints).and_then(|n| u8::try_from(n).ok()).filter(|n| *n <= most);
        let Some(extended) = extended else {
            let count = if most == 0 { "4".to_owned() } else { "6 to 8".to_owned() };
            return Err((self.axes.span().start, format!("`axes` has {} elements; this arm has {count}", axes.len())));
        };
        // an axis that the arm lacks stays at 0
        let (none, any) = ((0.0, 0.0), (-EXTENDED_RANGE, EXTENDED_RANGE));
        let mut ranges = [none, none, none, none, none, none, any, any];
        let mut speeds = [EXTENDED_SPEED; 8];
        for (n, axis) in axes.iter().enumerate() {
            let AxisEntry { range: (low, high), speed } = *axis.get_ref();
            let wrong = |problem: &str| (axis.span().start, format!("J{}: {problem}", n + 1));
            if !(low.is_finite() && high.is_finite() && low < high) {
                return Err(wrong(&format!("the range is [{low}, {high}]; its first number is the lower one")));
            }
            if low < -LARGEST || high > LARGEST {
                return Err(wrong(&format!("the range is [{low}, {high}]; its ends are -{LARGEST} to {LARGEST}")));
            }
            // `home` has no extended axes: they begin at 0
            if n >= joints && !(low..=high).contains(&0.0) {
                return Err(wrong(&format!("the range is [{low}, {high}]; that of an extended axis contains 0")));
            }
            if !(speed > 0.0 && speed <= LARGEST) {
                return Err(wrong(&format!("the speed is {speed}; it is above 0, and at most {LARGEST}")));
            }
            (ranges[n], speeds[n]) = ((low, high), speed);
        }
        Ok((ranges, speeds, extended))
    }

    fn home(&self, geometry: &Geometry, joints: usize) -> Result<Joints, Wrong> {
        let (start, values) = (self.home.span().start, self.home.get_ref());
        if values.len() != joints {
            return Err((start, format!("`home` has {} elements; this arm has {joints} joints", values.len())));
        }
        let mut home = [0.0; 6];
        home.iter_mut().zip(values).for_each(|(joint, value)| *joint = *value);
        match geometry.out_of_range(&home) {
            Some(OutOfReach::Limits(axes)) => {
                Err((start, format!("`home`: J{} is outside its range", axes.trailing_zeros() + 1)))
            }
            _ => Ok(home),
        }
    }
}
