//! The section `[controller]` of a scenario: what the controller is like when it begins.

use bcap_core::hresult::HResult;
use serde::Deserialize;

use super::file::read_code;
use crate::config::{ABSENT, Config, Mode, Permission, Token};
use crate::controller::Controller;
use crate::robot::Servo;
use crate::slave::SlaveFormats;

/// What a controller is like when a scenario begins; `None` and no errors leave it as it is.
///
/// # Examples
///
/// ```
/// use bcap_sim::{Config, Controller, Mode, Scenario};
///
/// let mut controller = Controller::new(Config::default());
/// controller.play(Scenario::parse("[controller]\nmode = 'manual'")?);
/// assert_eq!(controller.mode(), Mode::Manual);
/// # Ok::<(), bcap_sim::scenario::ScenarioError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Setup {
    /// The mode switch.
    pub mode: Option<Mode>,
    /// Who has the executable token.
    pub token: Option<Token>,
    /// The communication permission.
    pub permission: Option<Permission>,
    /// Whether the emergency stop is pressed.
    pub emergency_stop: Option<bool>,
    /// The errors that are present, the first cause first.
    pub errors: Vec<HResult>,
    /// Whether a client that is not here has the arm authority.
    pub arm_taken: Option<bool>,
    /// Whether the motor is on.
    pub motor: Option<bool>,
    /// Whether slave mode has its licence.
    pub licence: Option<bool>,
    /// The formats that slave mode has.
    pub formats: Option<SlaveFormats>,
    /// `@VERSION`.
    pub version: Option<String>,
    /// `@TYPE_NAME` of the robot.
    pub robot_type: Option<String>,
    /// The robot's name.
    pub arm_name: Option<String>,
    /// Axes beyond the sixth, 0 to 2.
    pub extended_axes: Option<u8>,
    /// Whether writing true to `@SERVO_ON` answers when the motor is on.
    pub servo_on_waits: Option<bool>,
    /// Limits of speed in slave mode, for J1 to J8; `None` leaves that axis as it is.
    pub slave_speed: [Option<f64>; 8],
    /// Likewise of acceleration.
    pub slave_acceleration: [Option<f64>; 8],
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct SetupEntry {
    mode: Option<ModeName>,
    token: Option<TokenName>,
    permission: Option<PermissionName>,
    emergency_stop: Option<bool>,
    errors: Vec<String>,
    arm: Option<ArmName>,
    motor: Option<bool>,
    licence: Option<bool>,
    formats: Option<Vec<FormatName>>,
    version: Option<String>,
    robot_type: Option<String>,
    arm_name: Option<String>,
    axes: Option<u8>,
    servo_on_waits: Option<bool>,
    slave_speed: AxesEntry,
    slave_acceleration: AxesEntry,
}

/// A value for some of the axes.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct AxesEntry {
    j1: Option<f64>,
    j2: Option<f64>,
    j3: Option<f64>,
    j4: Option<f64>,
    j5: Option<f64>,
    j6: Option<f64>,
    j7: Option<f64>,
    j8: Option<f64>,
}

impl AxesEntry {
    fn read(&self) -> Result<[Option<f64>; 8], &'static str> {
        let Self { j1, j2, j3, j4, j5, j6, j7, j8 } = *self;
        let limits = [j1, j2, j3, j4, j5, j6, j7, j8];
        match limits.iter().flatten().all(|limit| *limit > 0.0 && limit.is_finite()) {
            true => Ok(limits),
            false => Err("a limit of slave_speed or slave_acceleration is a finite number above 0"),
        }
    }
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ModeName {
    Auto,
    Manual,
    TeachCheck,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum TokenName {
    Any,
    Pendant,
    Other,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum PermissionName {
    ReadWrite,
    ReadOnly,
}

#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ArmName {
    Free,
    Taken,
}

#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum FormatName {
    MiniIo,
    HandIo,
    UserIo,
    Current,
}

impl From<ModeName> for Mode {
    fn from(name: ModeName) -> Self {
        match name {
            ModeName::Auto => Self::Auto,
            ModeName::Manual => Self::Manual,
            ModeName::TeachCheck => Self::TeachCheck,
        }
    }
}

impl From<TokenName> for Token {
    fn from(name: TokenName) -> Self {
        match name {
            TokenName::Any => Self::Any,
            TokenName::Pendant => Self::TeachPendant,
            TokenName::Other => Self::Client(ABSENT),
        }
    }
}

impl From<PermissionName> for Permission {
    fn from(name: PermissionName) -> Self {
        match name {
            PermissionName::ReadWrite => Self::ReadWrite,
            PermissionName::ReadOnly => Self::ReadOnly,
        }
    }
}

impl SetupEntry {
    pub(super) fn read(self) -> Result<Setup, &'static str> {
        let errors = self.errors.iter().map(|code| read_code(code)).collect::<Result<Vec<_>, _>>()?;
        if errors.iter().any(|code| code.is_ok()) {
            return Err("an error is a code that begins with 8, as in \"0x84201482\"");
        }
        if self.motor == Some(true) && (self.emergency_stop == Some(true) || !errors.is_empty()) {
            return Err("the motor is off while the emergency stop is pressed or an error is present");
        }
        let extended_axes = match self.axes {
            Some(axes @ 6..=8) => Some(axes - 6),
            None => None,
            Some(_) => return Err("`axes` is 6, 7 or 8"),
        };
        let (slave_speed, slave_acceleration) = (self.slave_speed.read()?, self.slave_acceleration.read()?);
        let formats = self.formats.map(|list| SlaveFormats {
            mini_io: list.contains(&FormatName::MiniIo),
            hand_io: list.contains(&FormatName::HandIo),
            user_io: list.contains(&FormatName::UserIo),
            current: list.contains(&FormatName::Current),
        });
        Ok(Setup {
            mode: self.mode.map(Mode::from),
            token: self.token.map(Token::from),
            permission: self.permission.map(Permission::from),
            emergency_stop: self.emergency_stop,
            errors,
            arm_taken: self.arm.map(|arm| arm == ArmName::Taken),
            motor: self.motor,
            licence: self.licence,
            formats,
            version: self.version,
            robot_type: self.robot_type,
            arm_name: self.arm_name,
            extended_axes,
            servo_on_waits: self.servo_on_waits,
            slave_speed,
            slave_acceleration,
        })
    }
}

impl Controller {
    /// Brings the controller into the state that a scenario begins with.
    pub(super) fn set_up(&mut self, setup: &Setup) {
        if let Some(pressed) = setup.emergency_stop {
            self.press_emergency_stop(pressed);
        }
        setup.errors.iter().for_each(|code| self.raise(*code));
        match setup.motor {
            Some(true) => {
                self.preparation.motion = true;
                self.torque_off = false;
                self.robot.servo = Servo::On;
            }
            Some(false) => self.motor_off(HResult::E_MOTOR_OFF),
            None => {}
        }
        if let Some(taken) = setup.arm_taken {
            // nothing moves without the authority of who has commanded it
            self.abort_motion(HResult::E_ABORT);
            self.robot.arm = taken.then_some((ABSENT, 0));
        }
        if let Some(mode) = setup.mode {
            self.turn_mode_switch(mode);
        }
        if let Some(token) = setup.token {
            self.set_token(token);
        }
        if let Some(permission) = setup.permission {
            self.set_permission(permission);
        }
        self.config_mut().set_up(setup);
    }
}

impl Config {
    /// Takes over what a scenario says about the model.
    fn set_up(&mut self, setup: &Setup) {
        self.slave.licensed = setup.licence.unwrap_or(self.slave.licensed);
        self.slave.formats = setup.formats.unwrap_or(self.slave.formats);
        for (limits, own) in [
            (&mut self.slave.speed_limits, setup.slave_speed),
            (&mut self.slave.acceleration_limits, setup.slave_acceleration),
        ] {
            limits.iter_mut().zip(own).for_each(|(limit, own)| *limit = own.or(*limit));
        }
        self.servo_on_waits = setup.servo_on_waits.unwrap_or(self.servo_on_waits);
        self.extended_axes = setup.extended_axes.unwrap_or(self.extended_axes);
        let texts = [
            (&mut self.version, &setup.version),
            (&mut self.robot_type, &setup.robot_type),
            (&mut self.arm_name, &setup.arm_name),
        ];
        for (text, own) in texts {
            if let Some(own) = own {
                text.clone_from(own);
            }
        }
    }
}
