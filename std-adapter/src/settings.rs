//! How a [`Controller`](crate::blocking::Controller) opens its session.

use std::time::Duration;

use bcap_core::bcap::client::Timing;
use bcap_core::bcap::server::StartOptions;
use bcap_core::procedure::Provider;

use crate::connect::Options;

/// The model of a controller, which determines its provider.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Model {
    /// RC8 and RC8A.
    Rc8,
    /// RC9 and COBOTTA PRO.
    Rc9,
    /// COBOTTA.
    Cobotta,
}

impl Model {
    /// Returns the name of the provider (b-CAP specification, section 4.1.2).
    #[must_use]
    pub const fn provider(self) -> &'static str {
        match self {
            Self::Rc8 | Self::Cobotta => Provider::RC8.provider,
            Self::Rc9 => Provider::RC9.provider,
        }
    }
}

/// The options of Service_Start (b-CAP specification, Table 4-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ServiceOptions {
    /// The interval of the controller's keep-alives while a call runs, 80 ms or more.
    pub watchdog: Duration,
    /// The maximum run time of a call, 80 ms or more.
    pub invoke_timeout: Duration,
}

impl Default for ServiceOptions {
    /// A keep-alive every 400 ms, and 180 s for a call.
    fn default() -> Self {
        Self { watchdog: Duration::from_millis(400), invoke_timeout: Duration::from_secs(180) }
    }
}

/// The minimum of both options.
const MIN: Duration = StartOptions::MIN;

impl ServiceOptions {
    /// Sets the interval of keep-alives; less than 80 ms becomes 80 ms.
    ///
    /// There is no way to switch keep-alives off: without them a long motion would look like a lost connection.
    #[must_use]
    pub fn watchdog(self, watchdog: Duration) -> Self {
        Self { watchdog: watchdog.max(MIN), ..self }
    }

    /// Sets the maximum run time of a call; less than 80 ms becomes 80 ms.
    #[must_use]
    pub fn invoke_timeout(self, invoke_timeout: Duration) -> Self {
        Self { invoke_timeout: invoke_timeout.max(MIN), ..self }
    }

    /// Returns the text of the option.
    pub(crate) fn to_text(self) -> String {
        let Self { watchdog, invoke_timeout } = self;
        format!("WDT={},InvokeTimeout={}", watchdog.max(MIN).as_millis(), invoke_timeout.max(MIN).as_millis())
    }

    /// Returns the client's time limits that match these options: a call is abandoned after four missing keep-alives, but not
    /// before the time limits of `timing`.
    pub(crate) fn timing(self, timing: Timing) -> Timing {
        // a second more than the controller, so that its own error arrives
        let limit = self.invoke_timeout.saturating_add(Duration::from_secs(1));
        Timing {
            attempt_timeout: timing.attempt_timeout.max(self.watchdog.saturating_mul(4)),
            deadline: limit,
            keep_alive: limit,
            ..timing
        }
    }
}

/// How a controller for tokio connects again after a lost connection: the delay between two attempts doubles from `min` to
/// `max`, less a random part of up to one half.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Backoff {
    /// The first delay.
    pub min: Duration,
    /// The longest delay.
    pub max: Duration,
}

setters! { Backoff {
    min: Duration;
    max: Duration;
} }

impl Default for Backoff {
    /// From 100 ms to 10 s.
    fn default() -> Self {
        Self { min: Duration::from_millis(100), max: Duration::from_secs(10) }
    }
}

/// The controller to connect to, and the settings of the connection.
///
/// # Examples
///
/// ```
/// use std::time::Duration;
///
/// use bcap_std::{ServiceOptions, Settings};
///
/// let service = ServiceOptions::default().watchdog(Duration::from_millis(200));
/// let settings = Settings::cobotta().robot("Arm0").service(service);
/// assert_eq!(settings.model.provider(), "CaoProv.DENSO.VRC");
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Settings {
    /// The model.
    pub model: Model,
    /// The name of the robot; `None` is the first robot that the controller lists.
    pub robot: Option<String>,
    /// The option of Controller_Connect.
    pub connect_option: String,
    /// The options of Service_Start.
    pub service: ServiceOptions,
    /// How the socket connects.
    pub options: Options,
    /// How a controller for tokio connects again. Blocking ones do not.
    pub reconnect: Backoff,
    /// Whether the end of the program, or of the connection, leaves the robot as it is: a motion in progress is not halted, the
    /// motor stays on, and only the controller determines when the arm becomes free. The default is `false`: the robot is
    /// halted, the motor that was switched on is switched off, and the arm is given back.
    pub keep: bool,
}

impl Settings {
    /// Returns the defaults for a model.
    #[must_use]
    pub fn new(model: Model) -> Self {
        let (service, options, reconnect) = Default::default();
        Self { model, robot: None, connect_option: String::new(), service, options, reconnect, keep: false }
    }

    /// Returns the defaults for an RC8.
    #[must_use]
    pub fn rc8() -> Self {
        Self::new(Model::Rc8)
    }

    /// Returns the defaults for an RC9 or a COBOTTA PRO.
    #[must_use]
    pub fn rc9() -> Self {
        Self::new(Model::Rc9)
    }

    /// Returns the defaults for a COBOTTA.
    #[must_use]
    pub fn cobotta() -> Self {
        Self::new(Model::Cobotta)
    }

    /// Sets how a controller for tokio connects again.
    #[must_use]
    pub fn reconnect(self, reconnect: Backoff) -> Self {
        Self { reconnect, ..self }
    }

    /// Sets whether the end of the program leaves the robot as it is: moving, with its motor on.
    #[must_use]
    pub fn keep(self, keep: bool) -> Self {
        Self { keep, ..self }
    }

    /// Returns the options of the socket, with the time limits that match the options of Service_Start.
    pub(crate) fn socket_options(&self) -> Options {
        let mut options = self.options;
        options.tcp.timing = self.service.timing(options.tcp.timing);
        options.udp.timing = self.service.timing(options.udp.timing);
        options.serial.timing = self.service.timing(options.serial.timing);
        options
    }

    /// Sets the name of the robot.
    #[must_use]
    pub fn robot(self, name: impl Into<String>) -> Self {
        Self { robot: Some(name.into()), ..self }
    }

    /// Sets the option of Controller_Connect.
    #[must_use]
    pub fn connect_option(self, option: impl Into<String>) -> Self {
        Self { connect_option: option.into(), ..self }
    }

    /// Sets the options of Service_Start.
    #[must_use]
    pub fn service(self, service: ServiceOptions) -> Self {
        Self { service, ..self }
    }

    /// Sets how the socket connects, and the time limit of an attempt of a call; it is at least four times
    /// [`ServiceOptions::watchdog`]. A whole call may take a second more than [`ServiceOptions::invoke_timeout`], whatever deadline
    /// the options have: limit a single call by `Controller::within`.
    #[must_use]
    pub fn options(self, options: Options) -> Self {
        Self { options, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_service_always_has_a_watchdog() {
        let options = ServiceOptions::default();
        assert_eq!(options.to_text(), "WDT=400,InvokeTimeout=180000");
        let shortest = options.watchdog(Duration::ZERO).invoke_timeout(Duration::from_millis(1));
        assert_eq!(shortest.to_text(), "WDT=80,InvokeTimeout=80");
        let by_hand = ServiceOptions { watchdog: Duration::ZERO, ..options };
        assert_eq!(by_hand.to_text(), "WDT=80,InvokeTimeout=180000");
    }

    #[test]
    fn a_call_outlasts_the_controllers_own_limit() {
        let options = ServiceOptions::default().watchdog(Duration::from_secs(2)).invoke_timeout(Duration::from_secs(9));
        let timing = options.timing(Timing::TCP);
        assert_eq!((timing.attempt_timeout, timing.deadline), (Duration::from_secs(8), Duration::from_secs(10)));
        assert_eq!(timing.keep_alive, timing.deadline);
    }
}
