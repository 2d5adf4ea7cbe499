//! The configuration of a gateway: its robot, timeouts and rules.

use core::time::Duration;

use super::rules::Rules;
use bcap_core::bcap::client;

/// The configuration of a gateway.
///
/// # Examples
///
/// ```
/// use bcap_gateway::{Allow, Config, Rules};
/// use bcap_core::rac::VariableKind;
///
/// let put = [Allow::range(VariableKind::I, 0, 99)];
/// let config = Config { rules: Rules { put: &put, ..Rules::READ_ONLY }, ..Config::RC9 };
/// assert_eq!(config.provider, "CaoProv.DENSO.VRC9");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config<'a> {
    /// The link to the robot and the time limits of a call. A call that exceeds them ends the connection.
    pub client: client::Config,
    /// The option of Service_Start. With `WDT` the robot sends keep-alives while it works on a call.
    pub service: &'a str,
    /// The controller's name for Controller_Connect; any text.
    pub name: &'a str,
    /// The provider: `CaoProv.DENSO.VRC` or `CaoProv.DENSO.VRC9`.
    pub provider: &'a str,
    /// The machine that the provider runs on, seen from the robot.
    pub machine: &'a str,
    /// The option of Controller_Connect.
    pub option: &'a str,
    /// How long a request of a PLC may take, its waiting time included. Then it is answered with E_TIMEOUT.
    pub request_timeout: Duration,
    /// The silence after which the gateway reads the Slave Mode of the robot, to detect a disconnected robot.
    pub heartbeat: Duration,
    /// The pause before the second attempt to connect (exponential backoff: it doubles with each attempt).
    pub first_pause: Duration,
    /// Maximum pause between two attempts to connect.
    pub longest_pause: Duration,
    /// The rules for PLCs.
    pub rules: Rules<'a>,
}

impl Config<'_> {
    /// An RC8 over TCP, read-only: 3 s for a reply or keep-alive, 8 s for a call, 10 s for a request, pauses of 0.5 s to
    /// 16 s, a heartbeat after an idle time of 2 s.
    pub const RC8: Self = Self {
        client: client::Config {
            timing: client::Timing {
                deadline: Duration::from_secs(8),
                keep_alive: Duration::from_secs(8),
                ..client::Timing::TCP
            },
            ..client::Config::TCP
        },
        service: "WDT=400",
        name: "",
        provider: "CaoProv.DENSO.VRC",
        machine: "localhost",
        option: "",
        request_timeout: Duration::from_secs(10),
        heartbeat: Duration::from_secs(2),
        first_pause: Duration::from_millis(500),
        longest_pause: Duration::from_secs(16),
        rules: Rules::READ_ONLY,
    };

    /// An RC9 over TCP, otherwise as [`RC8`](Self::RC8).
    pub const RC9: Self = Self { provider: "CaoProv.DENSO.VRC9", ..Self::RC8 };
}
