//! The arguments of the connection to a controller, of all commands.

pub(crate) mod address;
pub(crate) mod profiles;

use std::path::PathBuf;
use std::time::Duration;

use bcap_capture::duration;
use bcap_capture::trace::Level;
use bcap_std::{Address, Model, NetworkAddress, Protocol};
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::failure::Failure;
use crate::link::profiles::{Profiles, provider_of};

/// The default time limit for an answer.
const DEFAULT_TIMEOUT: Duration = Duration::from_secs(3);

/// The connection to the controller.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Connection")]
pub(crate) struct LinkArgs {
    /// The controller: [tcp:|udp:]HOST[:PORT] or serial:PATH; for rac HOST[:PORT] [env: BCAP_ROBOT=]
    /// [default: tcp:127.0.0.1]; `bcap help connection` has the other options
    ///
    /// Without a protocol it is TCP; tcp://HOST is accepted too. Write IPv6 addresses in brackets: tcp:[fe80::1]:5007. A serial
    /// line may have settings, here with the defaults: 'serial:/dev/ttyUSB0?baud=115200&parity=none&stop=1'. `rac`, `raw`,
    /// `doctor`, `gateway`, `proxy`, `replay`, `conform` and `fuzz` need a network.
    #[arg(long, global = true, value_name = "ADDRESS")]
    robot: Option<String>,

    /// The time limit of the whole command, in ms or with a unit (2s) [default: 3 s for each answer or keep-alive]
    ///
    /// It covers connecting, all calls with their keep-alives, and the end of the session. `watch` and `slave record` apply
    /// it to each round; `doctor` to each link, and then to all other checks together; `scan` to each port; `slave play`, `slave cosine`,
    /// `gateway`, `replay` and `fuzz` to each answer; `proxy` to connecting; `shell` and `run` to each line. A motion of `move` has
    /// --within instead. Without this option a controller can keep a call alive for 10 s in `halt`, and any other for
    /// 180 s. Over UDP the attempts (--attempts) share the time.
    #[arg(long, global = true, hide_short_help = true, value_name = "MS", env = "BCAP_TIMEOUT", value_parser = duration::parse)]
    timeout: Option<Duration>,

    /// The provider to connect to: its name, or rc8, rc9, cobotta or cobotta-pro [default: CaoProv.DENSO.VRC, and
    /// CaoProv.DENSO.VRC9 if the controller refuses it]
    ///
    /// A profile remembers the second. `gateway` starts without its robot, and `fuzz` sends nothing but its sessions, so both try
    /// only one.
    #[arg(long, global = true, hide_short_help = true, value_name = "NAME", env = "BCAP_PROVIDER")]
    provider: Option<String>,

    /// The machine name of Controller_Connect [default: localhost; the host of --robot for CaoProv.DENSO.VRC9]
    #[arg(long, global = true, hide_short_help = true, value_name = "NAME", env = "BCAP_MACHINE")]
    machine: Option<String>,

    /// The option of Controller_Connect, such as @EventDisable=false [default: empty]
    #[arg(long, global = true, hide_short_help = true, value_name = "TEXT", env = "BCAP_OPTION")]
    option: Option<String>,

    /// The attempts of a call over UDP, 1 to 7; other numbers become the nearest. They share the time limit of an answer,
    /// at least 100 ms each, so that the controller's keep-alives arrive before an attempt ends
    #[arg(
        long,
        global = true,
        hide_short_help = true,
        value_name = "N",
        env = "BCAP_ATTEMPTS",
        default_value_t = 5,
        allow_negative_numbers = true
    )]
    pub(crate) attempts: i64,

    /// The time limit of each attempt, in place of --timeout: an answer may then take this time, times --attempts
    #[arg(long, global = true, hide_short_help = true, value_name = "MS", value_parser = duration::parse)]
    attempt_timeout: Option<Duration>,

    /// The port of RAC, for an address without a port for RAC [default: 5006]
    #[arg(long, global = true, hide_short_help = true, value_name = "PORT", env = "BCAP_RAC_PORT")]
    pub(crate) rac_port: Option<u16>,

    /// A profile of ~/.config/bcap/config.toml, whose values apply where neither an option nor an environment variable is
    /// given
    #[arg(long, global = true, hide_short_help = true, value_name = "NAME", env = "BCAP_PROFILE")]
    profile: Option<String>,

    /// The address of the profile.
    #[arg(skip)]
    profile_address: Option<String>,

    /// Records what the command sends and receives as packets in this file, for `bcap decode` and Wireshark
    ///
    /// The file is pcapng. A serial line has no packets. `sim` and `proxy` record their clients, `gateway` its PLCs and the
    /// robot.
    #[arg(long, global = true, hide_short_help = true, value_name = "FILE.pcapng")]
    pub(crate) write: Option<PathBuf>,

    /// Prints each packet that is sent (->) and received (<-) on the standard error: headers, values, or bytes next to
    /// the values. `monitor`, `gateway`, `proxy`, `replay`, `conform`, `fuzz`, `slave play` and `slave cosine` do not
    /// have it
    #[arg(long, global = true, hide_short_help = true, value_name = "LEVEL", num_args = 0..=1, require_equals = true,
          default_missing_value = "bytes", value_parser = level())]
    pub(crate) trace: Option<Level>,
}

impl LinkArgs {
    /// Adds the values of the profile, where neither an option nor an environment variable is given.
    pub(crate) fn with_profile(&self) -> Result<Self, Failure> {
        let Some(name) = self.profile.as_deref().filter(|name| !name.is_empty()) else { return Ok(self.clone()) };
        let profiles = Profiles::read()?;
        let (profile, link) = (profiles.find(name)?, self.clone());
        Ok(Self {
            timeout: link.timeout.or(profile.timeout),
            provider: link.provider.or_else(|| profile.provider.clone()),
            machine: link.machine.or_else(|| profile.machine.clone()),
            option: link.option.or_else(|| profile.option.clone()),
            rac_port: link.rac_port.or(profile.rac_port),
            profile_address: profile.address.clone(),
            ..link
        })
    }

    /// Adds the values of the profile, as far as they do not hinder a halt: its time limit is ignored, and a profile that
    /// cannot be read is reported and ignored if --robot or BCAP_ROBOT names the controller.
    pub(crate) fn with_profile_for_halt(&self) -> Result<Self, Failure> {
        match self.with_profile() {
            Ok(link) => Ok(Self { timeout: self.timeout, ..link }),
            Err(failure) if self.robot.is_some() || address::in_environment().is_some() => {
                failure.print(false, None);
                Ok(self.clone())
            }
            Err(failure) => Err(failure),
        }
    }

    /// Returns the options with the values of a profile, which has an address.
    #[cfg(feature = "web")]
    pub(crate) fn for_profile(&self, name: &str) -> Result<Self, Failure> {
        let Some(address) = Profiles::read()?.find(name)?.address.clone() else {
            let remedy = "write address = \"tcp:HOST\" there";
            return Err(Failure::Input(format!("the profile {name} has no address; {remedy}")));
        };
        Self { profile: Some(name.to_owned()), ..self.at(&address) }.with_profile()
    }

    /// Returns where the controller is, for a program that connects by itself.
    #[cfg(feature = "web")]
    pub(crate) fn access(&self) -> Result<bcap_live::link::Access, Failure> {
        Ok(bcap_live::link::Access {
            address: self.target()?,
            provider: (!self.has_default_provider()).then(|| self.provider().to_owned()),
            machine: self.machine.clone().filter(|name| !name.is_empty()),
            option: self.option().to_owned(),
            tap: bcap_live::tap::Tap::default(),
        })
    }

    /// Returns the provider to connect to.
    pub(crate) fn provider(&self) -> &str {
        self.provider.as_deref().filter(|name| !name.is_empty()).map_or("CaoProv.DENSO.VRC", provider_of)
    }

    /// Returns the profile, if its address is used.
    pub(crate) fn profile(&self) -> Option<&str> {
        let has_address = self.robot.is_none() && address::in_environment().is_none();
        self.profile.as_deref().filter(|name| has_address && !name.is_empty())
    }

    /// Returns the machine name of Controller_Connect.
    pub(crate) fn machine(&self) -> String {
        match (self.machine.as_deref().filter(|name| !name.is_empty()), self.target()) {
            (Some(name), _) => name.to_owned(),
            // b-CAP specification for RC9, Table 6-1
            (None, Ok(Address::Network(target))) if self.provider() == Model::Rc9.provider() => target.host,
            _ => "localhost".to_owned(),
        }
    }

    /// Returns the option of Controller_Connect.
    pub(crate) fn option(&self) -> &str {
        self.option.as_deref().unwrap_or_default()
    }

    /// Returns the same options for the controller at another address.
    pub(crate) fn at(&self, address: &str) -> Self {
        Self { robot: Some(address.to_owned()), ..self.clone() }
    }

    /// Returns whether no provider was given.
    pub(crate) fn has_default_provider(&self) -> bool {
        self.provider.as_ref().is_none_or(String::is_empty)
    }

    /// Returns the same options with a provider.
    pub(crate) fn with_provider(&self, provider: &str) -> Self {
        Self { provider: Some(provider.to_owned()), ..self.clone() }
    }

    /// Returns the options for a virtual controller of this process, with the same time limits.
    pub(crate) fn for_virtual(&self, address: &str, provider: &str) -> Self {
        Self {
            provider: Some(provider.to_owned()),
            machine: None,
            option: None,
            trace: None,
            write: None,
            ..self.at(address)
        }
    }

    /// Returns the controller's address for b-CAP.
    pub(crate) fn target(&self) -> Result<Address, Failure> {
        address::bcap(self.robot.as_deref(), self.profile_address.as_deref())
    }

    /// Returns the controller's address for b-CAP, for a command that cannot use a serial line.
    pub(crate) fn network_target(&self) -> Result<NetworkAddress, Failure> {
        address::network(self.robot.as_deref(), self.profile_address.as_deref())
    }

    /// Returns the controller's address for RAC.
    pub(crate) fn rac_target(&self) -> Result<NetworkAddress, Failure> {
        address::rac(self.robot.as_deref(), self.profile_address.as_deref(), self.rac_port)
    }

    /// Returns the time limit for connecting, and for each answer or keep-alive.
    pub(crate) fn timeout(&self) -> Duration {
        let all = self.attempt_timeout.map(|each| each * u32::from(self.wanted_attempts()));
        all.or(self.timeout).unwrap_or(DEFAULT_TIMEOUT)
    }

    /// Returns the time limit of the whole command; `None` if the user set no limit.
    pub(crate) const fn limit(&self) -> Option<Duration> {
        if self.attempt_timeout.is_some() { None } else { self.timeout }
    }

    /// Limits the whole command even if the user gave no limit.
    pub(crate) fn limited(&self) -> Self {
        self.within(DEFAULT_TIMEOUT)
    }

    /// Limits the whole command to this time unless the user gave a limit.
    pub(crate) fn within(&self, limit: Duration) -> Self {
        Self { timeout: self.timeout.or(Some(limit)), attempt_timeout: None, ..self.clone() }
    }

    /// Limits the whole command, for a halt: to the default limit at least, because Robot_Halt returns when the robot rests.
    pub(crate) fn for_halt(&self) -> Self {
        Self { timeout: Some(self.timeout().max(DEFAULT_TIMEOUT)), attempt_timeout: None, ..self.clone() }
    }

    /// Returns the attempts of a call over UDP (b-CAP specification, Table 6-1).
    pub(crate) fn attempts(&self) -> u8 {
        let room = self.timeout().as_millis() / SHORTEST_ATTEMPT.as_millis();
        self.wanted_attempts().min(u8::try_from(room).unwrap_or(u8::MAX)).max(1)
    }

    fn wanted_attempts(&self) -> u8 {
        u8::try_from(self.attempts.clamp(1, 7)).unwrap_or(7)
    }

    /// Refuses `--trace` for a command whose connections it cannot see.
    pub(crate) fn untraced(&self) -> Result<&Self, Failure> {
        match self.trace {
            None => Ok(self),
            Some(_) => Err(Failure::Input(
                "this command has no --trace; record its packets with tcpdump and use `bcap decode FILE.pcap`".into(),
            )),
        }
    }

    /// Returns whether the controller is at a serial line.
    pub(crate) fn is_serial(&self) -> bool {
        matches!(self.target(), Ok(Address::Serial(_)))
    }

    /// Returns the option of Service_Start: a third of an attempt as keep-alive interval, from 80 ms to 400 ms. If the first
    /// keep-alive arrived after the attempt, a long call would fail or be repeated.
    pub(crate) fn start_option(&self) -> String {
        let is_udp = matches!(self.network_target(), Ok(NetworkAddress { protocol: Protocol::Udp, .. }));
        let attempt = self.timeout().as_millis() / if is_udp { u128::from(self.attempts()) } else { 1 };
        // a server refuses intervals below 80 ms (b-CAP specification, Table 4-1)
        match (attempt / 3).clamp(80, 400) {
            interval if interval < attempt => format!("WDT={interval}"),
            _ => String::new(),
        }
    }
}

/// Parses the level of `--trace`.
fn level() -> impl TypedValueParser<Value = Level> {
    PossibleValuesParser::new([
        PossibleValue::new("headers").help("Serial number, function or result code, and size"),
        PossibleValue::new("values").help("The decoded values too"),
        PossibleValue::new("bytes").help("The values next to their bytes"),
    ])
    .try_map(|level| level.parse::<Level>())
}

/// Minimum time of an attempt of a call over UDP: longer than the minimum keep-alive interval.
const SHORTEST_ATTEMPT: Duration = Duration::from_millis(100);
