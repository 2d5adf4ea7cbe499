//! The section `[controller]` of a scenario: the initial state of the controller.

use bcap_core::hresult::HResult;

use crate::config::{Config, Mode, Permission, SpeedSetting, Token};
use crate::model::SlaveFormats;

/// The state of a controller when a scenario begins. `None`, and an empty list of errors, leave the state unchanged.
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
    /// The holder of the executable token.
    pub token: Option<Token>,
    /// The communication permission.
    pub permission: Option<Permission>,
    /// Whether the emergency stop is pressed.
    pub emergency_stop: Option<bool>,
    /// Whether the battery is exhausted: SysState and SysInfo 15.
    pub battery_low: Option<bool>,
    /// Whether the robot warns: SysState.
    pub warning: Option<bool>,
    /// Whether the protective stop is shown as active, by SysState and `@PROTECTIVE_STOP`; it stops nothing.
    pub protective_stop: Option<bool>,
    /// Whether the torque is off, as after an emergency stop that was released. Models without StoState ignore it.
    pub torque_off: bool,
    /// Whether a COBOTTA is prepared, as a person prepares it at the arm. Models without a preparation ignore it.
    pub prepared: bool,
    /// The current errors, in order of occurrence.
    pub errors: Vec<HResult>,
    /// Whether a client that is not connected owns the arm.
    pub arm_taken: Option<bool>,
    /// Whether the motor is on.
    pub motor: Option<bool>,
    /// Whether Slave Mode has its licence.
    pub licence: Option<bool>,
    /// The limits of Slave Mode: parameter 153.
    pub slave_speed_setting: Option<SpeedSetting>,
    /// The formats of Slave Mode.
    pub formats: Option<SlaveFormats>,
    /// `@VERSION`.
    pub version: Option<String>,
    /// `@TYPE_NAME` of the robot.
    pub robot_type: Option<String>,
    /// The robot's name.
    pub arm_name: Option<String>,
    /// The number of extended axes, 0 to 2.
    pub extended_axes: Option<u8>,
    /// Whether writing true to `@SERVO_ON` answers when the motor is on.
    pub servo_on_waits: Option<bool>,
    /// Limits of speed in Slave Mode, for J1 to J8; `None` leaves an axis unchanged.
    pub slave_speed: [Option<f64>; 8],
    /// The same for acceleration.
    pub slave_acceleration: [Option<f64>; 8],
}

impl Setup {
    /// Applies the settings of the model.
    pub(crate) fn apply(&self, config: &mut Config) {
        config.slave.licensed = self.licence.unwrap_or(config.slave.licensed);
        config.slave.speed_setting = self.slave_speed_setting.unwrap_or(config.slave.speed_setting);
        config.slave.formats = self.formats.unwrap_or(config.slave.formats);
        for (limits, own) in [
            (&mut config.slave.speed_limits, self.slave_speed),
            (&mut config.slave.acceleration_limits, self.slave_acceleration),
        ] {
            limits.iter_mut().zip(own).for_each(|(limit, own)| *limit = own.or(*limit));
        }
        config.servo_on_waits = self.servo_on_waits.unwrap_or(config.servo_on_waits);
        if let Some(axes) = self.extended_axes.filter(|_| config.geometry.joints() == 6) {
            config.extended_axes = axes;
        }
        let texts = [
            (&mut config.version, &self.version),
            (&mut config.robot_type, &self.robot_type),
            (&mut config.arm_name, &self.arm_name),
        ];
        for (text, own) in texts {
            if let Some(own) = own {
                text.clone_from(own);
            }
        }
    }
}
