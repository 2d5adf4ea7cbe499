//! The models of controllers, as data files.
//!
//! Five are built in ([`Profile`]); their files in `std-adapter/sim/models` name the source of each value. A copy of such a
//! file, changed, is another model: [`Model::parse`], `bcap sim --model FILE.toml`. All keys are required except as named
//! below, and unknown ones are refused.
//!
//! | section       | content                                                                              |
//! |---------------|--------------------------------------------------------------------------------------|
//! | -             | name, `type` (`@TYPE`; the name if it is absent), provider, version, type and name of the robot, `motor_on_ms` (300 if it is absent), RAC |
//! | `[functions]` | the commands in addition to the commands of all models                               |
//! | `[slave]`     | the parts of the formats of Slave Mode, and which IO they are                        |
//! | `[variables]` | the number of variables of each kind, with the IO                                    |
//! | `[arm]`       | its dimensions ([`kinematics`](crate::kinematics)), home position, ranges and speeds |
//!
//! The arm has `kinematics = "vertical"` (six axes, the default) or `"horizontal"` (four). The lengths a1, b4 and b6 of six axes
//! may be omitted, and are 0 then. `acceleration_time`, in seconds, may be omitted, and is 0.2 then. A controller of any model drives another arm with [`ArmModel`], `bcap sim --arm`.

mod arm;
mod error;

use std::ops::Range;
use std::sync::OnceLock;
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;

use self::arm::ArmEntry;
pub use self::arm::{ArmModel, ArmProfile};
pub use self::error::ModelError;
use self::error::{Wrong, located, text};
use crate::kinematics::{Geometry, Joints};
use crate::variables::Sizes;

/// The time that the motor takes to switch on; a decision.
const MOTOR_ON: Duration = Duration::from_millis(300);

/// A model of controller that is built in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Profile {
    /// RC8: provider `CaoProv.DENSO.VRC`.
    #[default]
    Rc8,
    /// RC8A: as RC8, with another name.
    Rc8a,
    /// RC9: provider `CaoProv.DENSO.VRC9`; it has StoState and ManualReset.
    Rc9,
    /// COBOTTA: provider `CaoProv.DENSO.VRC`; it has StoState and ManualReset, needs a preparation before it moves (see
    /// [`preparation`](crate::preparation)), and its Slave Mode has no HandIO.
    Cobotta,
    /// COBOTTA PRO: as RC9, with another name and another type of robot.
    CobottaPro,
}

impl Profile {
    /// All built-in models.
    pub const ALL: [Self; 5] = [Self::Rc8, Self::Rc8a, Self::Rc9, Self::Cobotta, Self::CobottaPro];

    /// Returns the file of the model.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Rc8 => include_str!("../models/rc8.toml"),
            Self::Rc8a => include_str!("../models/rc8a.toml"),
            Self::Rc9 => include_str!("../models/rc9.toml"),
            Self::Cobotta => include_str!("../models/cobotta.toml"),
            Self::CobottaPro => include_str!("../models/cobotta_pro.toml"),
        }
    }

    /// Returns the model.
    #[must_use]
    pub fn model(self) -> &'static Model {
        static MODELS: OnceLock<[Model; 5]> = OnceLock::new();
        let parse = |profile: Self| Model::parse(profile.text()).expect("a test parses all built-in models");
        let [rc8, rc8a, rc9, cobotta, cobotta_pro] = MODELS.get_or_init(|| Self::ALL.map(parse));
        match self {
            Self::Rc8 => rc8,
            Self::Rc8a => rc8a,
            Self::Rc9 => rc9,
            Self::Cobotta => cobotta,
            Self::CobottaPro => cobotta_pro,
        }
    }

    /// Returns the name of the provider that Controller_Connect accepts.
    #[must_use]
    pub fn provider(self) -> &'static str {
        &self.model().provider
    }
}

/// A model of controller.
///
/// # Examples
///
/// ```
/// use bcap_sim::{Config, Model, Profile};
///
/// let text = Profile::Rc9.text().replace("VS060A3", "VM060A1");
/// let config = Config::of(Model::parse(&text)?);
/// assert_eq!(config.robot_type, "VM060A1");
/// # Ok::<(), bcap_sim::model::ModelError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Model {
    /// The name of the model.
    pub name: String,
    /// `@TYPE`: the key `type`, or the name.
    pub controller_type: String,
    /// The name of the provider that Controller_Connect accepts.
    pub provider: String,
    /// `@VERSION`.
    pub version: String,
    /// `@TYPE_NAME` of the robot.
    pub robot_type: String,
    /// The robot's name.
    pub arm_name: String,
    /// The time that the motor takes to switch on: the key `motor_on_ms`, or 300 ms.
    pub motor_on: Duration,
    /// Whether it has a RAC server. A program that serves a [`Controller`](crate::Controller) serves RAC only if it does.
    pub rac: bool,
    /// The commands that exist in addition to the commands of all models.
    pub functions: Functions,
    /// The formats of Slave Mode.
    pub formats: SlaveFormats,
    /// The IO of Slave Mode.
    pub slave_io: SlaveIo,
    /// The numbers of user variables.
    pub sizes: Sizes,
    /// The dimensions, ranges and speeds of the arm.
    pub geometry: Geometry,
    /// The initial position: J1 to J6 in degrees.
    pub home: Joints,
    /// The number of extended axes, 0 to 2.
    pub extended_axes: u8,
}

/// The commands that only some models have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Functions {
    /// StoState, ManualReset and ResetStoState: the emergency stop removes the torque until ManualReset.
    pub safe_torque_off: bool,
    /// ManualResetPreparation, MotionPreparation, GetMotionPreparationState and AutoCal: the motor needs a preparation.
    pub preparation: bool,
    /// The commands of the hand.
    pub hand: bool,
}

/// The IO that slvMove reads and writes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlaveIo {
    /// MiniIO.
    pub mini: SlaveIoPart,
    /// HandIO.
    pub hand: SlaveIoPart,
    /// The number of the first user IO.
    pub user: usize,
}

/// The IO of MiniIO or HandIO: 32 bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlaveIoPart {
    /// The number of the IO of bit 0.
    pub first: usize,
    /// The IO that can only be read.
    pub read: Range<usize>,
    /// The IO that can be read and written.
    pub write: Range<usize>,
}

/// The parts of the formats of Slave Mode that a controller has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlaveFormats {
    /// MiniIO, 0x0100.
    pub mini_io: bool,
    /// HandIO, 0x0020.
    pub hand_io: bool,
    /// User IO, 0x0200.
    pub user_io: bool,
    /// The currents of the axes, 0x0040.
    pub current: bool,
}

impl SlaveFormats {
    /// All parts.
    pub const ALL: Self = Self { mini_io: true, hand_io: true, user_io: true, current: true };

    /// Makes the formats with these parts.
    pub(crate) fn of(list: &[FormatName]) -> Self {
        let has = |name| list.contains(&name);
        Self {
            mini_io: has(FormatName::MiniIo),
            hand_io: has(FormatName::HandIo),
            user_io: has(FormatName::UserIo),
            current: has(FormatName::Current),
        }
    }
}

/// A part of the formats of Slave Mode, as models and scenarios name it.
#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FormatName {
    MiniIo,
    HandIo,
    UserIo,
    Current,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ModelFile {
    name: Spanned<String>,
    #[serde(rename = "type")]
    controller_type: Option<Spanned<String>>,
    provider: Spanned<String>,
    version: Spanned<String>,
    robot_type: Spanned<String>,
    arm_name: Spanned<String>,
    motor_on_ms: Option<u16>,
    rac: bool,
    functions: Functions,
    slave: SlaveEntry,
    variables: SizesEntry,
    arm: Spanned<ArmEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SlaveEntry {
    formats: Vec<FormatName>,
    mini_io: Spanned<IoEntry>,
    hand_io: Spanned<IoEntry>,
    user_io: Spanned<u16>,
}

/// The IO of a part; the ranges include their last IO.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct IoEntry {
    first: u16,
    read: [u16; 2],
    write: [u16; 2],
}

impl IoEntry {
    fn read(key: &str, entry: &Spanned<Self>, io: u16) -> Result<SlaveIoPart, Wrong> {
        let Self { first, read, write } = *entry.get_ref();
        let bits = first..=first.saturating_add(31);
        if [read, write].iter().any(|[from, to]| from > to || !bits.contains(from) || !bits.contains(to)) {
            let problem = format!("`{key}`: `read` and `write` are ranges of the IO {first} to {}", bits.end());
            return Err((entry.span().start, problem));
        }
        if *bits.end() >= io {
            let problem =
                format!("`{key}`: it ends at IO{}, and `io` is {io}: accepted `first` + 31 below `io`", bits.end());
            return Err((entry.span().start, problem));
        }
        let range = |[from, to]: [u16; 2]| usize::from(from)..usize::from(to) + 1;
        Ok(SlaveIoPart { first: first.into(), read: range(read), write: range(write) })
    }
}

/// Reads the first IO of the user's part.
fn user_io(first: &Spanned<u16>, io: u16) -> Result<usize, Wrong> {
    let number = *first.get_ref();
    if !number.is_multiple_of(8) || number > io {
        return Err((first.span().start, format!("`user_io` is {number}: accepted multiples of 8, 0 to `io`, {io}")));
    }
    Ok(number.into())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SizesEntry {
    i: u16,
    f: u16,
    d: u16,
    v: u16,
    p: u16,
    j: u16,
    t: u16,
    s: u16,
    io: u16,
}

impl Model {
    /// Reads a model from TOML.
    ///
    /// # Errors
    ///
    /// A [`ModelError`] that names the line.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        let file: ModelFile = toml::from_str(text)?;
        file.read().map_err(|wrong| located(text, wrong))
    }
}

impl ModelFile {
    fn read(self) -> Result<Model, Wrong> {
        let SizesEntry { i, f, d, v, p, j, t, s, io } = self.variables;
        let (geometry, home, extended_axes) = ArmEntry::read(&self.arm)?;
        let name = text("name", self.name)?;
        let controller_type = self.controller_type.map_or_else(|| Ok(name.clone()), |own| text("type", own))?;
        Ok(Model {
            name,
            controller_type,
            provider: text("provider", self.provider)?,
            version: text("version", self.version)?,
            robot_type: text("robot_type", self.robot_type)?,
            arm_name: text("arm_name", self.arm_name)?,
            motor_on: self.motor_on_ms.map_or(MOTOR_ON, |ms| Duration::from_millis(ms.into())),
            rac: self.rac,
            functions: self.functions,
            formats: SlaveFormats::of(&self.slave.formats),
            slave_io: SlaveIo {
                mini: IoEntry::read("mini_io", &self.slave.mini_io, io)?,
                hand: IoEntry::read("hand_io", &self.slave.hand_io, io)?,
                user: user_io(&self.slave.user_io, io)?,
            },
            sizes: Sizes { i, f, d, v, p, j, t, s, io },
            geometry,
            home,
            extended_axes,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_built_in_models_are_valid() {
        let names = Profile::ALL.map(|profile| Model::parse(profile.text()).unwrap().name);
        assert_eq!(names, ["RC8", "RC8A", "RC9", "COBOTTA", "COBOTTA PRO"]);
        for profile in Profile::ALL {
            assert_eq!(profile.model(), &Model::parse(profile.text()).unwrap());
        }
        assert_eq!(
            Profile::Cobotta.model().functions,
            Functions { safe_torque_off: true, preparation: true, hand: true }
        );
        assert!(!Profile::Cobotta.model().formats.hand_io && Profile::Rc9.model().formats.hand_io);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        let valid = Profile::Rc9.text();
        let line = |part: &str| valid.lines().position(|line| line.contains(part)).unwrap() + 1;
        for (from, to, at, problem) in [
            ("name = \"RC9\"", "name = \" \"", line("name = \"RC9\""), "`name` is empty"),
            ("d1 = 345.0", "d1 = -1.0", line("d1 = 345.0"), "`d1` is -1"),
            ("a2 = 250.0", "a2 = nan", line("a2 = 250.0"), "`a2` is NaN"),
            ("d1 = 345.0", "d1 = 1e6", line("d1 = 345.0"), "`d1` is 1000000"),
            ("speed = 330.0", "speed = 0.0", line("speed = 330.0"), "J2: the speed is 0"),
            ("speed = 330.0", "speed = 1e7", line("speed = 330.0"), "J2: the speed is 10000000"),
            ("range = [-270.0, 270.0]", "range = [-270.0, 1e300]", line("speed = 450.0"), "J4: the range"),
            ("range = [-270.0, 270.0]", "range = [270.0, -270.0]", line("speed = 450.0"), "J4: the range"),
            (
                "write = [64, 71]",
                "write = [64, 80]",
                line("hand_io = {"),
                "`hand_io`: `read` and `write` are ranges of the IO 48 to 79",
            ),
            ("read = [0, 15]", "read = [15, 0]", line("mini_io = {"), "`mini_io`"),
            (
                "io = 512",
                "io = 79",
                line("hand_io = {"),
                "`hand_io`: it ends at IO79, and `io` is 79: accepted `first` + 31 below `io`",
            ),
            ("io = 512", "io = 31", line("mini_io = {"), "`mini_io`: it ends at IO31, and `io` is 31"),
            (
                "user_io = 128",
                "user_io = 130",
                line("user_io = 128"),
                "`user_io` is 130: accepted multiples of 8, 0 to `io`, 512",
            ),
            ("user_io = 128", "user_io = 520", line("user_io = 128"), "`user_io` is 520"),
            ("home = [0.0, 45.0", "home = [0.0, 200.0", line("home = [0.0"), "`home`: J2"),
            ("    { range = [-360.0, 360.0], speed = 720.0 },\n", "", line("axes = ["), "`axes` has 5 elements"),
        ] {
            assert!(valid.contains(from), "{from}");
            let error = Model::parse(&valid.replace(from, to)).unwrap_err().to_string();
            assert!(error.starts_with(&format!("line {at}: ")) && error.contains(problem), "{to}: {error}");
        }
        let sixth = "    { range = [-360.0, 360.0], speed = 720.0 },\n";
        for (from, to, problem) in [
            (
                sixth,
                [sixth, "    { range = [1.0, 100.0], speed = 1.0 },\n"].concat().as_str(),
                "J7: the range is [1, 100]",
            ),
            ("io = 512", "io = 70000", "70000"),
            ("hand = false", "hands = false", "unknown field `hands`"),
            ("version = ", "# version = ", "missing field `version`"),
            ("\"hand_io\"", "\"foot_io\"", "foot_io"),
        ] {
            let error = Model::parse(&valid.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains("line ") && error.contains(problem), "{to}: {error}");
        }
    }
}
