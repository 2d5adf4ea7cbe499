//! What a virtual controller is like when it is switched on.

use std::path::PathBuf;
use std::time::Duration;

use bcap_core::handler::PeerId;

use crate::executor::Executor;
use crate::explain::Observer;
use crate::kinematics::Joints;
use crate::slave::{SlaveConfig, SlaveFormats};
use crate::variables::Sizes;

/// A model of controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Profile {
    /// RC8: provider `CaoProv.DENSO.VRC`.
    #[default]
    Rc8,
    /// RC9: provider `CaoProv.DENSO.VRC9`; it has StoState and ManualReset.
    Rc9,
    /// COBOTTA: provider `CaoProv.DENSO.VRC`; it has StoState and ManualReset, has to be prepared before it moves (see
    /// [`preparation`](crate::preparation)), and slave mode has no HandIO.
    Cobotta,
}

impl Profile {
    /// Returns the name of the provider that Controller_Connect wants.
    #[must_use]
    pub const fn provider(self) -> &'static str {
        match self {
            Self::Rc8 | Self::Cobotta => "CaoProv.DENSO.VRC",
            Self::Rc9 => "CaoProv.DENSO.VRC9",
        }
    }

    /// Returns the controller's type, `@TYPE`.
    #[must_use]
    pub const fn type_name(self) -> &'static str {
        match self {
            Self::Rc8 => "RC8",
            Self::Rc9 => "RC9",
            Self::Cobotta => "COBOTTA",
        }
    }

    /// Returns a type of robot that such a controller has, `@TYPE_NAME`.
    ///
    /// COBOTTA: the one that the public ROS 2 driver asks for. RC8, RC9: the arm whose lengths
    /// [`kinematics`](crate::kinematics) has, spelled as public launch files spell its sister, `VS060A3`.
    #[must_use]
    pub const fn robot_type(self) -> &'static str {
        match self {
            Self::Rc8 | Self::Rc9 => "VS050A3",
            Self::Cobotta => "CVR038A1",
        }
    }

    /// Returns a version of its software that public sources name, `@VERSION`.
    ///
    /// The public ROS 2 driver clears errors of a COBOTTA from 2.8.0 on, and calls ManualReset of an RC9 from 1.4.0 on.
    #[must_use]
    pub const fn version(self) -> &'static str {
        match self {
            Self::Rc8 | Self::Cobotta => "2.8.0",
            Self::Rc9 => "1.4.0",
        }
    }

    /// Tells whether it has to be prepared before its motor is switched on.
    pub(crate) const fn wants_preparation(self) -> bool {
        matches!(self, Self::Cobotta)
    }

    /// Tells whether the emergency stop takes the torque away until ManualReset.
    pub(crate) const fn has_safe_torque_off(self) -> bool {
        matches!(self, Self::Rc9 | Self::Cobotta)
    }
}

/// The operation mode; the numbers are those of `@MODE`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Manual mode.
    Manual = 1,
    /// Teach check mode.
    TeachCheck = 2,
    /// Auto mode, the only one in which clients and tasks may move the robot.
    #[default]
    Auto = 3,
}

/// A client that is not here: no server gives this number to one of its own.
pub(crate) const ABSENT: PeerId = PeerId(u32::MAX);

/// Who has the executable token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Token {
    /// Anybody.
    #[default]
    Any,
    /// The teach pendant; every client is refused with `E_TOKEN_NOT_ETHERNET`.
    TeachPendant,
    /// One client; the others are refused with `E_TOKEN_ADDRESS`.
    Client(PeerId),
}

/// The communication permission.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Permission {
    /// Variables can be read and written.
    #[default]
    ReadWrite,
    /// Writing a variable is refused with `E_CAO_NOT_WRITABLE`.
    ReadOnly,
}

/// A virtual controller's settings.
///
/// # Examples
///
/// ```
/// use bcap_sim::{Config, Controller, Profile};
///
/// let controller = Controller::new(Config { serial_number: "08B0001".into(), ..Config::new(Profile::Rc9) });
/// assert_eq!(controller.config().profile.provider(), "CaoProv.DENSO.VRC9");
/// ```
#[derive(Clone, Debug)]
pub struct Config {
    /// The model.
    pub profile: Profile,
    /// Takes the provider of any profile in Controller_Connect.
    pub any_provider: bool,
    /// The numbers of user variables.
    pub sizes: Sizes,
    /// The mode at the start.
    pub mode: Mode,
    /// The executable token at the start.
    pub token: Token,
    /// The communication permission.
    pub permission: Permission,
    /// The wall clock at [`Instant::ZERO`](bcap_core::time::Instant::ZERO): milliseconds since 1970-01-01 00:00.
    pub wall_clock_origin_ms: i64,
    /// Where the robot stands at the start, and where GoHome brings it: J1 to J6 in degrees.
    pub home: Joints,
    /// The time from switching the motor on until it is on.
    pub motor_on_delay: Duration,
    /// Whether writing true to `@SERVO_ON` answers when the motor is on. False answers at once, and the motor is on
    /// `motor_on_delay` later.
    pub servo_on_waits: bool,
    /// The internal speed at the start, in percent.
    pub speed: f32,
    /// The external speed at the start, in percent.
    pub ext_speed: f32,
    /// Slave mode: licence, limits, formats.
    pub slave: SlaveConfig,
    /// Axes beyond the sixth, 0 to 2: J7 and J8.
    pub extended_axes: u8,
    /// The folder whose files the controller has; without one it has none, and says so.
    pub files: Option<PathBuf>,
    /// Where the work with these files is done.
    pub file_work: Executor,
    /// Is told why arguments were refused.
    pub observer: Observer,
    /// The names of the tasks.
    pub tasks: Vec<String>,
    /// The time of one cycle of a task.
    pub task_cycle: Duration,
    /// The lines of a task, which take equal parts of its cycle.
    pub task_lines: u32,
    /// The most objects that one client may hold; one more is refused with `E_MAX_OBJECT`.
    pub max_objects: usize,
    /// `@SERIAL_NO`, and SysInfo 0.
    pub serial_number: String,
    /// `@VERSION`.
    pub version: String,
    /// `@TYPE_NAME` of the robot. It does not change the arm's lengths, ranges and speeds.
    pub robot_type: String,
    /// The robot's name, as Controller_GetRobotNames answers it.
    pub arm_name: String,
}

impl Config {
    /// Makes the settings of a controller in Auto mode that anybody may use, with its motor off.
    #[must_use]
    pub fn new(profile: Profile) -> Self {
        Self {
            profile,
            any_provider: false,
            sizes: Sizes::default(),
            mode: Mode::Auto,
            token: Token::Any,
            permission: Permission::ReadWrite,
            wall_clock_origin_ms: 0,
            home: [0.0, 45.0, 90.0, 0.0, 45.0, 0.0],
            motor_on_delay: Duration::from_millis(300),
            servo_on_waits: true,
            speed: 100.0,
            ext_speed: 100.0,
            slave: SlaveConfig {
                formats: SlaveFormats { hand_io: profile != Profile::Cobotta, ..SlaveFormats::ALL },
                ..SlaveConfig::default()
            },
            extended_axes: 0,
            files: None,
            file_work: Executor::default(),
            observer: Observer::default(),
            tasks: ["Pro1", "Pro2", "Pro3"].map(str::to_owned).to_vec(),
            task_cycle: Duration::from_secs(1),
            task_lines: 10,
            max_objects: 1000,
            serial_number: "VIRTUAL".to_owned(),
            version: profile.version().to_owned(),
            robot_type: profile.robot_type().to_owned(),
            arm_name: "Arm0".to_owned(),
        }
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::new(Profile::default())
    }
}
