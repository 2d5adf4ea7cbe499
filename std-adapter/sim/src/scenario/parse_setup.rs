//! Reads the section `[controller]` of a scenario from TOML, and refuses invalid ones.

use bcap_core::hresult::HResult;
use serde::Deserialize;

use super::setup::Setup;
use crate::config::{ABSENT, Mode, Permission, SpeedSetting, Token};
use crate::model::{FormatName, SlaveFormats};

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct SetupEntry {
    mode: Option<Mode>,
    token: Option<TokenName>,
    permission: Option<PermissionName>,
    emergency_stop: Option<bool>,
    battery_low: Option<bool>,
    warning: Option<bool>,
    protective_stop: Option<bool>,
    torque_off: bool,
    prepared: bool,
    errors: Vec<String>,
    arm: Option<ArmName>,
    motor: Option<bool>,
    licence: Option<bool>,
    slave_speed_setting: Option<u8>,
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
#[serde(try_from = "String")]
pub(super) struct TokenName(Token);

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum PermissionName {
    ReadWrite,
    ReadOnly,
    None,
}

#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum ArmName {
    Free,
    Taken,
}

impl TryFrom<String> for TokenName {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        Ok(Self(match name.as_str() {
            "any" => Token::Any,
            "pendant" => Token::TeachPendant,
            "other" => Token::Client(ABSENT),
            address => match address.parse() {
                Ok(address) => Token::Address(address),
                Err(_) => return Err(format!("a token is any, pendant, other or an IP address, not {name:?}")),
            },
        }))
    }
}

impl From<TokenName> for Token {
    fn from(name: TokenName) -> Self {
        name.0
    }
}

impl From<PermissionName> for Permission {
    fn from(name: PermissionName) -> Self {
        match name {
            PermissionName::ReadWrite => Self::ReadWrite,
            PermissionName::ReadOnly => Self::ReadOnly,
            PermissionName::None => Self::None,
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
        if self.motor == Some(true) && self.torque_off {
            return Err("the motor is off while the torque is off");
        }
        let slave_speed_setting = match self.slave_speed_setting {
            None => None,
            Some(0) => Some(SpeedSetting::Servo),
            Some(1) => Some(SpeedSetting::ServoByExtSpeed),
            Some(2) => Some(SpeedSetting::Command),
            Some(3) => Some(SpeedSetting::CommandByExtSpeed),
            Some(_) => return Err("`slave_speed_setting` is 0 to 3"),
        };
        let extended_axes = match self.axes {
            Some(axes @ 6..=8) => Some(axes - 6),
            None => None,
            Some(_) => return Err("`axes` is 6, 7 or 8"),
        };
        let (slave_speed, slave_acceleration) = (self.slave_speed.read()?, self.slave_acceleration.read()?);
        let formats = self.formats.as_deref().map(SlaveFormats::of);
        Ok(Setup {
            mode: self.mode,
            token: self.token.map(Token::from),
            permission: self.permission.map(Permission::from),
            emergency_stop: self.emergency_stop,
            battery_low: self.battery_low,
            warning: self.warning,
            protective_stop: self.protective_stop,
            torque_off: self.torque_off,
            prepared: self.prepared,
            errors,
            arm_taken: self.arm.map(|arm| arm == ArmName::Taken),
            motor: self.motor,
            licence: self.licence,
            slave_speed_setting,
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

/// Reads the name or the number of a code.
pub(super) fn read_code(text: &str) -> Result<HResult, &'static str> {
    let number = |digits: &str| {
        let number = u32::from_str_radix(digits, 16).ok()?;
        // a sign is not a digit
        (digits.len() == 8 && !digits.starts_with('+')).then(|| HResult::from_u32(number))
    };
    let code = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => number(digits),
        None => HResult::from_name(text),
    };
    code.ok_or("a code is a known name or eight hexadecimal digits, as in \"E_BUF_FULL\" or \"0x83201483\"")
}
