//! The settings of a virtual controller.

use std::net::IpAddr;
use std::path::PathBuf;
use std::time::Duration;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::OleDate;
use serde::{Deserialize, Serialize};

use crate::executor::Executor;
use crate::explain::Observer;
use crate::kinematics::{Geometry, Joints};
use crate::model::{ArmModel, Model, Profile, SlaveFormats};
use crate::trace::Recorder;
use crate::variables::Sizes;

/// The operation mode, with the numbers of `@MODE`. Serialized, it is a name: `manual`, `teach_check` or `auto`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Manual mode.
    Manual = 1,
    /// Teach check mode.
    TeachCheck = 2,
    /// Auto mode, the only one in which clients and tasks may move the robot.
    #[default]
    Auto = 3,
}

/// The providers of electric hands that public programs connect to at the same controller. This model has no such hand.
const HAND_PROVIDERS: &[&str] = &["CaoProv.DENSO.ESC11PCI"];

/// The provider of a PC for all controllers of the maker.
const PC_PROVIDER: &str = "CaoProv.DENSO.RC8";

/// A client that is not connected: no server gives this number to a client.
pub(crate) const ABSENT: PeerId = PeerId(u32::MAX);

/// Returns the number under which the task at this place owns the arm: no server gives it to a client.
pub(crate) fn peer_of_task(place: usize) -> PeerId {
    PeerId(u32::try_from(place).map_or(0, |place| ABSENT.0.saturating_sub(1).saturating_sub(place)))
}

/// The holder of the executable token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Token {
    /// Every client.
    #[default]
    Any,
    /// The teach pendant: the controller refuses every client with `E_TOKEN_NOT_ETHERNET`.
    TeachPendant,
    /// One client: the controller refuses the others with `E_TOKEN_ADDRESS`.
    Client(PeerId),
    /// The clients of one address, as [`Controller::connected`](crate::Controller::connected) names it: the controller refuses
    /// the others with `E_TOKEN_ADDRESS`.
    Address(IpAddr),
}

/// The communication permission. Robot_Halt is never refused for it, so that a client can stop the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Permission {
    /// Clients may read and write variables.
    #[default]
    ReadWrite,
    /// Writing a variable answers `E_CAO_NOT_WRITABLE`, and any other call that writes or moves `E_ACCESSDENIED`.
    ReadOnly,
    /// Reading also answers `E_ACCESSDENIED`. A client can open and release objects.
    None,
}

/// The limits of speed and acceleration in Slave Mode: the controller's parameter 153, "Speed setting for b-CAP Slave".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpeedSetting {
    /// The limits of the drives: 1.2 times the command limit of speed, and 4 times the command limit of acceleration.
    #[default]
    Servo = 0,
    /// The same, multiplied by the external speed and the external acceleration.
    ServoByExtSpeed = 1,
    /// The limits of a motion command: the speeds of the [arm](Geometry), and the accelerations that reach them in its time.
    Command = 2,
    /// The same, multiplied by the external speed and the external acceleration.
    CommandByExtSpeed = 3,
}

/// The settings of Slave Mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlaveConfig {
    /// Whether the controller has the licence.
    pub licensed: bool,
    /// Parameter 153.
    pub speed_setting: SpeedSetting,
    /// Limits of speed for J1 to J8 in degrees or mm per second. `None` uses the limit that `speed_setting` gives the axis.
    /// The external speed scales both, where `speed_setting` says so.
    pub speed_limits: [Option<f64>; 8],
    /// The same for acceleration, in degrees or mm per second squared.
    pub acceleration_limits: [Option<f64>; 8],
    /// The formats that the controller has.
    pub formats: SlaveFormats,
    /// The number of cycles that [`Controller::slave_record`](crate::Controller::slave_record) keeps.
    pub record: usize,
}

impl Default for SlaveConfig {
    /// Licensed, with the drives' limits, all formats, and a record of two minutes.
    fn default() -> Self {
        Self {
            licensed: true,
            speed_setting: SpeedSetting::default(),
            speed_limits: [None; 8],
            acceleration_limits: [None; 8],
            formats: SlaveFormats::ALL,
            record: 15_000,
        }
    }
}

/// A virtual controller's settings.
///
/// # Examples
///
/// ```
/// use bcap_sim::{Config, Controller, Profile};
///
/// let controller = Controller::new(Config { serial_number: "08B0001".into(), ..Config::new(Profile::Rc9) });
/// assert_eq!(controller.config().model.provider, "CaoProv.DENSO.VRC9");
/// ```
#[derive(Clone, Debug)]
pub struct Config {
    /// The model. The other settings begin with its values.
    pub model: Model,
    /// Whether it tolerates requests that a real controller may refuse: the provider of another model, and unknown
    /// options. It passes each tolerated text to `observer`.
    pub lenient: bool,
    /// The numbers of user variables.
    pub sizes: Sizes,
    /// The initial mode.
    pub mode: Mode,
    /// The initial holder of the executable token.
    pub token: Token,
    /// The communication permission.
    pub permission: Permission,
    /// The wall clock at [`Instant::ZERO`](bcap_core::time::Instant::ZERO): milliseconds since 1970-01-01 00:00.
    pub wall_clock_origin_ms: i64,
    /// The dimensions, ranges and speeds of the arm.
    pub geometry: Geometry,
    /// The initial position, which is also the target of GoHome: J1 to J6 in degrees.
    pub home: Joints,
    /// The time that the motor takes to switch on.
    pub motor_on_delay: Duration,
    /// Whether writing true to `@SERVO_ON` answers when the motor is on. Otherwise it answers immediately, and the motor is on
    /// `motor_on_delay` later.
    pub servo_on_waits: bool,
    /// The initial internal speed, in percent.
    pub speed: f32,
    /// The initial external speed, in percent.
    pub ext_speed: f32,
    /// Slave Mode: licence, limits, formats.
    pub slave: SlaveConfig,
    /// The number of extended axes, 0 to 2: J7 and J8.
    pub extended_axes: u8,
    /// The folder with the controller's files. Without one, the functions of files answer `E_NOTIMPL`.
    pub files: Option<PathBuf>,
    /// Runs the jobs that access these files.
    pub file_executor: Executor,
    /// Receives the reason of each refused argument, and each tolerated text.
    pub observer: Observer,
    /// Receives the trajectory of the arm.
    pub recorder: Recorder,
    /// The names of the tasks.
    pub tasks: Vec<String>,
    /// The time of one cycle of a task.
    pub task_cycle: Duration,
    /// The number of lines of a task. Each takes the same part of its cycle.
    pub task_lines: u32,
    /// The largest number of objects that one client may open, not counting its service; opening another answers
    /// `E_MAX_OBJECT`. The server has a separate limit: 1,000 objects per connection, including the service.
    pub max_objects: usize,
    /// `@SERIAL_NO`, and SysInfo 0.
    pub serial_number: String,
    /// `@VERSION`.
    pub version: String,
    /// `@TYPE_NAME` of the robot. It does not affect the lengths, ranges and speeds of the arm.
    pub robot_type: String,
    /// The robot's name, as Controller_GetRobotNames answers it.
    pub arm_name: String,
}

impl Config {
    /// Makes the settings of a built-in model, in Auto mode with its motor off, which every client may use.
    #[must_use]
    pub fn new(profile: Profile) -> Self {
        Self::of(profile.model().clone())
    }

    /// Makes the same settings of any model.
    #[must_use]
    pub fn of(model: Model) -> Self {
        Self {
            lenient: false,
            sizes: model.sizes,
            mode: Mode::Auto,
            token: Token::Any,
            permission: Permission::ReadWrite,
            wall_clock_origin_ms: 0,
            geometry: model.geometry,
            home: model.home,
            motor_on_delay: model.motor_on,
            servo_on_waits: true,
            speed: 100.0,
            ext_speed: 100.0,
            slave: SlaveConfig { formats: model.formats, ..SlaveConfig::default() },
            extended_axes: model.extended_axes,
            files: None,
            file_executor: Executor::default(),
            observer: Observer::default(),
            recorder: Recorder::default(),
            tasks: ["Pro1", "Pro2", "Pro3"].map(str::to_owned).to_vec(),
            task_cycle: Duration::from_secs(1),
            task_lines: 10,
            max_objects: 1000,
            serial_number: "VIRTUAL".to_owned(),
            version: model.version.clone(),
            robot_type: model.robot_type.clone(),
            arm_name: model.arm_name.clone(),
            model,
        }
    }

    /// Replaces the arm: its dimensions, ranges, speeds, initial position, extended axes and type.
    #[must_use]
    pub fn with_arm(mut self, arm: &ArmModel) -> Self {
        (self.geometry, self.home, self.extended_axes) = (arm.geometry, arm.home, arm.extended_axes);
        self.robot_type.clone_from(&arm.robot_type);
        self
    }

    /// Refuses an unknown option, or ignores it and notifies the observer.
    pub(crate) fn unknown_option(&self, function: &str, key: &str) -> Result<(), HResult> {
        if !self.lenient {
            return Err(HResult::E_INVALIDARG);
        }
        self.observer.tolerated(&format!("{function}: unknown option {key:?} is ignored"));
        Ok(())
    }

    /// Checks the provider that a client names, optionally with the address of the controller.
    pub(crate) fn check_provider(&self, name: &str, has_server: bool) -> Result<(), HResult> {
        let own = self.model.provider.as_str();
        if own.eq_ignore_ascii_case(name) {
            return Ok(());
        }
        // the provider on PCs: a COBOTTA accepts it if the client names the address
        if PC_PROVIDER.eq_ignore_ascii_case(name) {
            return if has_server { Ok(()) } else { Err(HResult::E_INVALIDARG) };
        }
        if HAND_PROVIDERS.iter().any(|provider| provider.eq_ignore_ascii_case(name)) {
            return Err(HResult::E_NOTIMPL);
        }
        if !self.lenient || !Profile::ALL.iter().any(|profile| profile.provider().eq_ignore_ascii_case(name)) {
            return Err(HResult::E_CAO_PROV_INVALID);
        }
        let model = &self.model.name;
        self.observer.tolerated(&format!("Controller_Connect: provider {name:?} is not that of {model}, {own:?}"));
        Ok(())
    }

    /// Returns whether the version is at least this one; a version without numbers always is.
    pub(crate) fn version_is_from(&self, first: &[u32]) -> bool {
        let numbers = self.version.split('.').map(|number| number.trim().parse().unwrap_or(u32::MAX));
        numbers.ge(first.iter().copied())
    }

    /// Returns the wall clock at a time of the model.
    ///
    /// # Errors
    ///
    /// `DISP_E_OVERFLOW` for a time that a DATE cannot express.
    pub(crate) fn date(&self, at: Instant) -> Result<OleDate, HResult> {
        let millis = i64::try_from(at.as_micros() / 1000).unwrap_or(i64::MAX);
        let millis = self.wall_clock_origin_ms.saturating_add(millis);
        OleDate::from_unix_millis(millis).ok_or(HResult::DISP_E_OVERFLOW)
    }

    /// Returns the day of the week of a time: 0 Sunday to 6.
    pub(crate) fn weekday(&self, at: Instant) -> i32 {
        let millis = i128::from(self.wall_clock_origin_ms) + i128::from(at.as_micros() / 1000);
        // 1970-01-01 was a Thursday
        i32::try_from((millis.div_euclid(86_400_000) + 4).rem_euclid(7)).unwrap_or(0)
    }

    /// Returns the microseconds of a time within its second of the wall clock.
    pub(crate) fn microsecond(&self, at: Instant) -> i32 {
        let origin = i128::from(self.wall_clock_origin_ms) * 1000;
        i32::try_from((origin + i128::from(at.as_micros())).rem_euclid(1_000_000)).unwrap_or(0)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::new(Profile::default())
    }
}
