//! The settings and their parser.

use core::net::{Ipv4Addr, SocketAddrV4};
use core::str;
use core::time::Duration;

use bcap_core::rac;
#[cfg(feature = "modbus")]
use bcap_gateway::modbus::Entry;
use bcap_gateway::{Network, Rate, Rules};

use crate::host::{Own, is_host, is_host_in, is_other};
use crate::mac;
#[cfg(feature = "modbus")]
use crate::modbus_map::ModbusMap;
use crate::rules::{List, RuleMemory};
use crate::{InvalidLine, SettingError};

/// The settings of a board; its texts borrow from the block.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings<'a> {
    /// The robot controller.
    pub robot: Robot,
    /// The provider to connect to.
    pub provider: &'a str,
    /// The machine that the provider runs on, seen from the robot.
    pub machine: &'a str,
    /// The option of Controller_Connect.
    pub option: &'a str,
    /// The option of Service_Start.
    pub service: &'a str,
    /// The variable that the images `bare` and `node` read.
    pub variable: &'a str,
    /// Whether the board requests an address by DHCP.
    pub dhcp: bool,
    /// The board's address when no DHCP server answers, and the length of its network prefix in bits; `None` means none.
    pub address: Option<(Ipv4Addr, u8)>,
    /// The default gateway, used with `address`.
    pub gateway: Option<Ipv4Addr>,
    /// The MAC address; `None` means one derived from the chip's id ([`mac::from_unique_id`](crate::mac::from_unique_id)).
    pub mac: Option<[u8; 6]>,
    /// The name sent with DHCP; at most 32 characters.
    pub hostname: Option<&'a str>,
    /// The Wi-Fi network, if there is one.
    #[cfg(feature = "wifi")]
    pub ssid: Option<&'a str>,
    /// Its passphrase; empty for an open network.
    #[cfg(feature = "wifi")]
    pub passphrase: &'a str,
    /// Whether the board answers [`find`](crate::find).
    pub find: bool,
    /// The port of the echo server, if there is one.
    pub echo: Option<u16>,
    /// The idle time after which a PLC's connection is closed; `None` means never.
    pub idle: Option<Duration>,
    /// The idle time after which a PLC's connection may be closed to make room for another PLC.
    pub evict: Duration,
    /// The idle time after which a TCP keep-alive is sent to a PLC.
    pub keep_alive: Duration,
    /// The port of the page of the board's state, if there is one.
    #[cfg(feature = "health")]
    pub health: Option<u16>,
    /// The password of the page of the settings; without one there is no such page.
    #[cfg(feature = "health")]
    pub password: Option<&'a str>,
    /// Where messages of syslog are sent, if anywhere.
    #[cfg(feature = "health")]
    pub syslog: Option<SocketAddrV4>,
    /// The server of SNTP, if there is one.
    #[cfg(feature = "health")]
    pub ntp: Option<SocketAddrV4>,
    /// The port of Modbus TCP, if PLCs may use it.
    #[cfg(feature = "modbus")]
    pub modbus: Option<u16>,
    #[cfg(feature = "modbus")]
    modbus_map: ModbusMap,
    #[cfg(feature = "signature")]
    updaters: heapless::Vec<Network, UPDATERS>,
    convert: bool,
    rate: Rate,
    lists: List,
}

/// The TCP port of updates.
#[cfg(feature = "signature")]
pub const UPDATE_PORT: u16 = 5010;
/// The maximum number of networks of hosts that may send updates.
#[cfg(feature = "signature")]
const UPDATERS: usize = 4;

/// The address of the robot controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Robot {
    /// The transport of b-CAP.
    pub transport: Transport,
    /// The controller's address and port.
    pub address: SocketAddrV4,
}

/// The transport of b-CAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// TCP.
    Tcp,
    /// UDP.
    Udp,
}

impl Default for Settings<'_> {
    fn default() -> Self {
        // the factory setting of a controller
        let robot = Ipv4Addr::new(192, 168, 0, 1);
        Self {
            robot: Robot { transport: Transport::Tcp, address: SocketAddrV4::new(robot, 5007) },
            provider: "CaoProv.DENSO.VRC9",
            machine: "localhost",
            option: "",
            service: "WDT=400",
            variable: "I1",
            dhcp: true,
            address: None,
            gateway: None,
            mac: None,
            hostname: None,
            #[cfg(feature = "wifi")]
            ssid: None,
            #[cfg(feature = "wifi")]
            passphrase: "",
            find: true,
            echo: None,
            idle: None,
            evict: Duration::from_secs(10),
            keep_alive: Duration::from_secs(5),
            #[cfg(feature = "health")]
            health: None,
            #[cfg(feature = "health")]
            password: None,
            #[cfg(feature = "health")]
            syslog: None,
            #[cfg(feature = "health")]
            ntp: None,
            #[cfg(feature = "modbus")]
            modbus: None,
            #[cfg(feature = "modbus")]
            modbus_map: ModbusMap::default(),
            #[cfg(feature = "signature")]
            updaters: heapless::Vec::new(),
            convert: false,
            rate: Rate::UNLIMITED,
            lists: List::default(),
        }
    }
}

impl<'a> Settings<'a> {
    /// Parses the text of a block up to the first NUL; calls `invalid` with each line that is skipped.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_board::{RuleMemory, Settings};
    ///
    /// let settings = Settings::read(b"robot=192.168.0.1:5007\nput=I/0-99=-10..10\n", |line, _| panic!("{line:?}"));
    /// assert_eq!(settings.robot.address.port(), 5007);
    /// let mut memory = RuleMemory::new();
    /// let rules = settings.rules(&mut memory);
    /// assert_eq!(rules.put[0].last, 99);
    /// assert_eq!(rules.put[0].values[0].max, 10.0);
    /// ```
    #[must_use]
    pub fn read(text: &'a [u8], mut invalid: impl FnMut(&'a [u8], SettingError)) -> Self {
        let mut settings = Self::default();
        let text = text.split(|byte| *byte == 0).next().unwrap_or_default();
        for line in text.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            if let Err(error) = settings.set(line) {
                settings.lists.distrust();
                invalid(line, error);
            }
        }
        settings
    }

    /// Checks the text of a block as the board does.
    ///
    /// # Errors
    ///
    /// The first [`InvalidLine`].
    #[inline(never)]
    pub fn check(text: &'a [u8]) -> Result<(), InvalidLine<'a>> {
        let mut lines = text.split(|byte| *byte == b'\n');
        let mut invalid =
            lines.find(|line| line.contains(&0)).map(|line| InvalidLine { line, error: SettingError::Nul });
        let _ = Self::read(text, |line, error| {
            invalid.get_or_insert(InvalidLine { line, error });
        });
        invalid.map_or(Ok(()), Err)
    }

    /// Returns the settings in a file: its lines without comments, without spaces around them, and not empty.
    ///
    /// A comment begins with a `#` at the beginning of a line or after a blank, so a value may contain `#`.
    pub fn lines_of_file(text: &'a str) -> impl Iterator<Item = &'a str> {
        text.lines().map(|line| without_comment(line).trim()).filter(|line| !line.is_empty())
    }

    /// Returns whether a line was invalid, so that every PUT is refused.
    #[must_use]
    pub const fn has_invalid_line(&self) -> bool {
        self.lists.is_distrusted()
    }

    /// Returns the rules for PLCs.
    #[must_use]
    pub fn rules<'r, 's: 'r>(&'s self, memory: &'r mut RuleMemory<'s>) -> Rules<'r> {
        self.lists.rules(memory, self.convert, self.rate)
    }

    /// Returns the lines that a page neither shows nor changes: each key with its `=`, and its value.
    #[cfg(feature = "health")]
    pub(crate) fn secrets(&self) -> impl Iterator<Item = [&'a str; 2]> {
        #[cfg(feature = "wifi")]
        let passphrase = Some(self.passphrase).filter(|text| !text.is_empty());
        #[cfg(not(feature = "wifi"))]
        let passphrase = None;
        let secrets = [("password=", self.password), ("passphrase=", passphrase)];
        secrets.into_iter().filter_map(|(key, value)| Some([key, value?]))
    }

    /// Returns whether the settings in a text leave unchanged how hosts reach the pages of the board.
    ///
    /// Not inlined, as `check`: the settings take 2.5 KB of the stack during the call.
    #[cfg(feature = "health")]
    #[inline(never)]
    pub(crate) fn is_reached_with(&self, text: &[u8]) -> bool {
        self.is_reached_as(&Settings::read(text, |_, _| {}))
    }

    #[cfg(feature = "health")]
    fn is_reached_as(&self, other: &Settings<'_>) -> bool {
        #[cfg(feature = "wifi")]
        let is_same_network = self.ssid == other.ssid;
        #[cfg(not(feature = "wifi"))]
        let is_same_network = true;
        let place = |settings: &Settings<'_>| (settings.dhcp, settings.address, settings.gateway, settings.mac);
        is_same_network
            && place(self) == place(other)
            && self.health == other.health
            && self.lists.networks() == other.lists.networks()
    }

    /// Returns the map from the registers and coils of Modbus to variables.
    #[cfg(feature = "modbus")]
    #[must_use]
    pub fn modbus_map(&self) -> &[Entry] {
        self.modbus_map.entries()
    }

    /// Returns the idle time after which a client of Modbus loses its connection. A client above the maximum number is refused
    /// and evicts none, so a silent client must not stay connected.
    #[cfg(all(feature = "modbus", any(feature = "embassy", test)))]
    pub(crate) fn modbus_idle(&self) -> Duration {
        self.idle.map_or(self.evict, |idle| idle.min(self.evict))
    }

    fn set(&mut self, line: &'a [u8]) -> Result<(), SettingError> {
        let line = str::from_utf8(line).ok().and_then(|line| line.split_once('='));
        let (key, text) = line.ok_or(SettingError::Key)?;
        match key {
            "robot" => self.robot = valid(robot(text).filter(|robot| self.is_other(*robot.address.ip())))?,
            "provider" => self.provider = text,
            "machine" => self.machine = text,
            "option" => self.option = text,
            "service" => self.service = text,
            "variable" => self.variable = text,
            "dhcp" => self.dhcp = valid(yes(text))?,
            "address" => self.address = Some(valid(network(text).filter(|own| self.are_others(*own)))?),
            "gateway" => self.gateway = Some(valid(host(text).filter(|gateway| self.is_other(*gateway)))?),
            "mac" => self.mac = Some(valid(mac::parse(text))?),
            "hostname" => self.hostname = Some(valid(hostname(text))?),
            #[cfg(feature = "wifi")]
            "ssid" => self.ssid = Some(valid(Some(text).filter(|text| (1..=32).contains(&text.len())))?),
            #[cfg(feature = "wifi")]
            "passphrase" => self.passphrase = valid(Some(text).filter(|text| matches!(text.len(), 0 | 8..=63)))?,
            "find" => self.find = valid(yes(text))?,
            "get" => self.lists.allow_get(text)?,
            "put" => self.lists.allow_put(Network::ANY, text)?,
            "allow" => self.lists.allow_clients(valid(Network::parse(text))?)?,
            "idle" => self.idle = Some(valid(seconds(text))?),
            "evict" => self.evict = valid(seconds(text))?,
            "keepalive" => self.keep_alive = valid(seconds(text))?,
            "convert" => self.convert = valid(yes(text))?,
            "rate" => self.rate = valid(rate(text))?,
            "echo" => self.echo = Some(self.port(key, text)?),
            #[cfg(feature = "health")]
            "health" => self.health = Some(self.port(key, text)?),
            #[cfg(feature = "health")]
            "password" => self.password = Some(valid(password(text))?),
            #[cfg(feature = "health")]
            "syslog" => {
                self.syslog = Some(valid(server(text, crate::syslog::PORT).filter(|to| self.is_other(*to.ip())))?);
            }
            #[cfg(feature = "health")]
            "ntp" => self.ntp = Some(valid(server(text, crate::sntp::PORT).filter(|to| self.is_other(*to.ip())))?),
            #[cfg(feature = "modbus")]
            "modbus" => self.modbus = Some(self.port(key, text)?),
            #[cfg(feature = "modbus")]
            "register" => self.modbus_map.add(Entry::registers(text)?)?,
            #[cfg(feature = "modbus")]
            "coil" => self.modbus_map.add(Entry::coils(text)?)?,
            #[cfg(feature = "signature")]
            "update" => self.allow_updates(text)?,
            _ => match key.strip_prefix("put@") {
                Some(clients) => self.lists.allow_put(Network::parse(clients).ok_or(SettingError::Clients)?, text)?,
                None => return Err(SettingError::Key),
            },
        }
        Ok(())
    }

    /// Returns whether any host may send updates over the network.
    #[cfg(feature = "signature")]
    #[must_use]
    pub fn has_updaters(&self) -> bool {
        !self.updaters.is_empty()
    }

    /// Returns whether this host may send updates over the network.
    #[cfg(feature = "signature")]
    #[must_use]
    pub fn may_update(&self, host: Ipv4Addr) -> bool {
        self.updaters.iter().any(|network| network.contains(Some(host)))
    }

    #[cfg(feature = "signature")]
    fn allow_updates(&mut self, text: &str) -> Result<(), SettingError> {
        self.updaters.push(valid(Network::parse(text))?).map_err(|_| SettingError::Value)
    }

    /// Returns whether an address can be another machine's: it is neither the board's nor the broadcast of its network.
    fn is_other(&self, address: Ipv4Addr) -> bool {
        self.address.is_none_or(|own| is_other(own, address))
    }

    /// Returns whether the board may have an address that a DHCP server leases.
    #[cfg(any(feature = "embassy", test))]
    pub(crate) fn accepts(&self, own: Own) -> bool {
        is_host_in(own) && self.are_others(own)
    }

    /// Returns whether no configured machine conflicts with this address of the board.
    fn are_others(&self, own: Own) -> bool {
        #[cfg(feature = "health")]
        let [collector, clock] = [self.syslog, self.ntp].map(|server| server.map(|address| *address.ip()));
        #[cfg(not(feature = "health"))]
        let (collector, clock) = (None, None);
        let mut others = [Some(*self.robot.address.ip()), self.gateway, collector, clock].into_iter().flatten();
        others.all(|other| is_other(own, other))
    }

    /// Parses the port of a service, which no other service of the board may have.
    fn port(&self, key: &str, text: &str) -> Result<u16, SettingError> {
        let port = valid(port(text))?;
        let services = [
            ("rac", Some(rac::PORT)),
            #[cfg(feature = "signature")]
            ("update", Some(UPDATE_PORT)),
            ("echo", self.echo),
            #[cfg(feature = "health")]
            ("health", self.health),
            #[cfg(feature = "modbus")]
            ("modbus", self.modbus),
        ];
        match services.iter().any(|(other, used)| *other != key && *used == Some(port)) {
            true => Err(SettingError::Port),
            false => Ok(port),
        }
    }
}

fn valid<T>(value: Option<T>) -> Result<T, SettingError> {
    value.ok_or(SettingError::Value)
}

/// Returns whether a line has a secret, even if the line is invalid: its key begins like `password` or `passphrase`.
#[cfg(feature = "health")]
pub(crate) fn is_secret(line: &str) -> bool {
    line.trim_start().get(..4).is_some_and(|start| start.eq_ignore_ascii_case("pass"))
}

/// Accepts a password without blanks, which a file of settings and a browser pass on unchanged.
#[cfg(feature = "health")]
fn password(value: &str) -> Option<&str> {
    let is_long_enough = (crate::access::LEAST..=crate::access::MOST).contains(&value.len());
    (is_long_enough && value.bytes().all(|byte| byte.is_ascii_graphic())).then_some(value)
}

/// Parses a time of 1 s to an hour.
fn seconds(value: &str) -> Option<Duration> {
    value.parse().ok().filter(|seconds| (1..=3600).contains(seconds)).map(Duration::from_secs)
}

fn port(value: &str) -> Option<u16> {
    value.parse().ok().filter(|port| *port > 0)
}

#[cfg(feature = "health")]
fn server(value: &str, usual: u16) -> Option<SocketAddrV4> {
    let (address, number) = match value.split_once(':') {
        Some((address, number)) => (address, port(number)?),
        None => (value, usual),
    };
    Some(SocketAddrV4::new(host(address)?, number))
}

/// Returns a line up to its comment.
fn without_comment(line: &str) -> &str {
    let mut hashes = line.match_indices('#').map(|(at, _)| line.split_at(at).0);
    hashes.find(|before| before.is_empty() || before.ends_with([' ', '\t'])).unwrap_or(line)
}

/// Parses an address that one machine can have.
fn host(value: &str) -> Option<Ipv4Addr> {
    value.parse().ok().filter(|address| is_host(*address))
}

fn network(value: &str) -> Option<Own> {
    let (address, prefix) = value.split_once('/')?;
    let own = (address.parse().ok()?, prefix.parse().ok().filter(|prefix| *prefix <= 32)?);
    is_host_in(own).then_some(own)
}

fn robot(value: &str) -> Option<Robot> {
    let (transport, address) = match value.split_once(':')? {
        ("tcp", address) => (Transport::Tcp, address),
        ("udp", address) => (Transport::Udp, address),
        _ => (Transport::Tcp, value),
    };
    let (address, number) = address.split_once(':')?;
    Some(Robot { transport, address: SocketAddrV4::new(host(address)?, port(number)?) })
}

fn yes(value: &str) -> Option<bool> {
    match value {
        "yes" => Some(true),
        "no" => Some(false),
        _ => None,
    }
}

/// Accepts a host name without dots (RFC 1123) that fits the 32 bytes that embassy-net sends.
fn hostname(value: &str) -> Option<&str> {
    let is_name = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-';
    let has_hyphen_at_end = value.starts_with('-') || value.ends_with('-');
    ((1..=32).contains(&value.len()) && value.bytes().all(is_name) && !has_hyphen_at_end).then_some(value)
}

fn rate(value: &str) -> Option<Rate> {
    let (per_second, burst) = value.split_once('/').unwrap_or((value, value));
    let per_second = per_second.parse().ok()?;
    Some(Rate { per_second, burst: burst.parse().ok().filter(|burst| *burst > 0)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn read(text: &str) -> Settings<'_> {
        Settings::read(text.as_bytes(), |line, _| panic!("{}", String::from_utf8_lossy(line)))
    }

    use std::string::String;

    #[test]
    fn two_services_cannot_have_one_port() {
        for (text, column) in [("echo=5006", 6), ("modbus=502\nhealth=502", 8), ("health=7\necho=7", 6)] {
            let invalid = Settings::check(text.as_bytes()).unwrap_err();
            assert_eq!((invalid.error, invalid.column()), (SettingError::Port, column), "{text}");
        }
        let settings = Settings::check(b"modbus=502\nmodbus=502\nhealth=80\necho=7");
        assert_eq!(settings, Ok(()), "a later line with the key replaces the earlier one");
        let error = "this port is in use: RAC has 5006, and modbus, health and echo need a port each";
        assert_eq!(std::string::ToString::to_string(&SettingError::Port), error);
    }

    #[test]
    fn an_empty_block_has_defaults_and_allows_no_put() {
        let settings = read("");
        assert_eq!(settings, Settings::default());
        assert_eq!(settings.rules(&mut RuleMemory::new()), Rules::READ_ONLY);
        assert_eq!(Settings::read(&[0; 64], |_, _| panic!()), Settings::default());
        assert_eq!(Settings::read(b"\0echo=7\n", |_, _| panic!()).echo, None, "text after the end is not read");
    }

    #[test]
    fn every_key_is_parsed() {
        let settings = read(
            "robot=udp:192.168.0.1:5008\nprovider=P\nmachine=m\noption=Server=10.6.235.60\nservice=\nvariable=P7\n\
             dhcp=no\naddress=192.168.0.9/16\ngateway=192.168.0.254\nmac=02:00:00:BC:a9:7f\nhostname=cell-7\nfind=no\necho=7\nconvert=yes\n\
             rate=50/10\nidle=60\nevict=3600\nkeepalive=1\n",
        );
        let expected = Settings {
            robot: Robot { transport: Transport::Udp, address: SocketAddrV4::new(Ipv4Addr::new(192, 168, 0, 1), 5008) },
            provider: "P",
            machine: "m",
            option: "Server=10.6.235.60",
            service: "",
            variable: "P7",
            dhcp: false,
            address: Some((Ipv4Addr::new(192, 168, 0, 9), 16)),
            gateway: Some(Ipv4Addr::new(192, 168, 0, 254)),
            mac: Some([2, 0, 0, 0xbc, 0xa9, 0x7f]),
            hostname: Some("cell-7"),
            find: false,
            echo: Some(7),
            idle: Some(Duration::from_secs(60)),
            evict: Duration::from_secs(3600),
            keep_alive: Duration::from_secs(1),
            convert: true,
            rate: Rate { per_second: 50, burst: 10 },
            ..Settings::default()
        };
        assert_eq!(settings, expected);
        assert_eq!(read("rate=5").rate, Rate { per_second: 5, burst: 5 });
        for tcp in ["robot=10.0.2.2:1", "robot=tcp:10.0.2.2:1"] {
            assert_eq!(read(tcp).robot.transport, Transport::Tcp);
        }
    }

    #[cfg(feature = "wifi")]
    #[test]
    fn a_wifi_network_has_a_name_and_a_passphrase_as_802_11_allows() {
        let settings = read("ssid=cell 7\npassphrase=a passphrase\n");
        assert_eq!((settings.ssid, settings.passphrase), (Some("cell 7"), "a passphrase"));
        assert_eq!(read("passphrase=").passphrase, "");
        let long = "x".repeat(64);
        let too_long = [std::format!("ssid={}", &long[..33]), std::format!("passphrase={long}")];
        for line in ["ssid=", "passphrase=1234567", &too_long[0], &too_long[1]] {
            assert_eq!(Settings::check(line.as_bytes()).unwrap_err().error, SettingError::Value, "{line}");
        }
    }

    #[cfg(feature = "signature")]
    #[test]
    fn only_the_hosts_of_the_settings_may_send_updates() {
        let settings = read("update=10.0.0.7\nupdate=192.168.0.0/24");
        for (host, may) in [([10, 0, 0, 7], true), ([192, 168, 0, 200], true), ([10, 0, 0, 8], false), ([0; 4], false)]
        {
            assert_eq!(settings.may_update(host.into()), may, "{host:?}");
        }
        assert!(settings.has_updaters() && !read("put=I").has_updaters(), "off without a setting");
        let many = "update=10.0.0.7\n".repeat(UPDATERS + 1);
        assert!(Settings::check(many.as_bytes()).is_err() && Settings::check(b"update=yes").is_err());
        assert!(Settings::check(b"modbus=5010").is_err(), "the port of updates");
    }

    #[cfg(feature = "health")]
    #[test]
    fn a_collector_has_the_port_of_syslog_unless_another_is_given() {
        let address = Ipv4Addr::new(10, 0, 2, 2);
        assert_eq!(read("health=80\nsyslog=10.0.2.2").syslog, Some(SocketAddrV4::new(address, 514)));
        assert_eq!(read("syslog=10.0.2.2:5140").syslog, Some(SocketAddrV4::new(address, 5140)));
        assert_eq!(read("ntp=10.0.2.2").ntp, Some(SocketAddrV4::new(address, 123)));
        assert_eq!(read("ntp=10.0.2.2:1123").ntp, Some(SocketAddrV4::new(address, 1123)));
        assert_eq!(read("health=80").health, Some(80));
        assert_eq!((Settings::default().health, Settings::default().syslog), (None, None), "off without a setting");
    }

    #[cfg(feature = "health")]
    #[test]
    fn settings_tell_their_secrets_and_whether_hosts_reach_the_board_as_before() {
        let first = read("health=80\npassword=12345678\nallow=10.0.0.0/8\nput=I");
        assert_eq!(first.secrets().collect::<Vec<_>>(), [["password=", "12345678"]]);
        assert_eq!(read("health=80").secrets().count(), 0);
        for (text, expected) in [
            ("put=F\nallow=10.0.0.0/8\nhealth=80\nhostname=a\nrobot=10.0.0.1:5007", true),
            ("allow=10.0.0.0/8", false),
            ("allow=10.0.0.0/8\nhealth=81", false),
            ("allow=10.0.0.0/9\nhealth=80", false),
            ("health=80", false),
            ("allow=10.0.0.0/8\nhealth=80\ndhcp=no", false),
            ("allow=10.0.0.0/8\nhealth=80\naddress=10.0.0.9/8", false),
            ("allow=10.0.0.0/8\nhealth=80\ngateway=10.0.0.1", false),
            ("allow=10.0.0.0/8\nhealth=80\nmac=02:00:00:bc:a9:03", false),
        ] {
            assert_eq!(read(text).is_reached_as(&first), expected, "{text}");
        }
    }

    #[cfg(feature = "modbus")]
    #[test]
    fn a_silent_client_of_modbus_is_evicted_also_with_a_long_idle_time() {
        for (text, seconds) in [("", 10), ("evict=20", 20), ("idle=3600", 10), ("idle=5", 5)] {
            assert_eq!(read(text).modbus_idle(), Duration::from_secs(seconds), "{text}");
        }
    }

    #[test]
    fn a_comment_begins_at_a_line_or_after_a_blank() {
        let file = "# a board\nprovider=a#b\n  # indented\nmachine=m # the machine\noption=#1\n\nservice=\t#\n";
        let lines: Vec<_> = Settings::lines_of_file(file).collect();
        assert_eq!(lines, ["provider=a#b", "machine=m", "option=#1", "service="]);
    }

    #[test]
    fn the_first_invalid_line_is_named_with_the_column() {
        for (text, column, error) in [
            ("echo=7\nput=I/3-1\n", 7, "invalid index range 3-1: the first index is above the last"),
            ("put@10.0.0.0/8=X", 16, "unknown kind of variable: expected one of I F D S V P J T IO"),
            ("put@10.0.0=I", 5, "invalid network: expected put@ADDRESS[/PREFIX]=RULE"),
            ("get=I=1..2", 7, "a get has no ranges of values; only a put has"),
            ("hostname=-x\ncolour=red", 10, "invalid value for this key"),
            ("colour=red", 1, "expected KEY=VALUE with a known key"),
            ("provider=a\0b\nput=I", 11, "a setting cannot contain NUL"),
        ] {
            let found = Settings::check(text.as_bytes()).unwrap_err();
            assert_eq!((found.column(), std::format!("{}", found.error).as_str()), (column, error), "{text:?}");
        }
        assert_eq!(Settings::check(b"echo=7\n\nput=I\n"), Ok(()));
    }

    #[test]
    fn another_machine_has_another_address_than_the_board_and_no_broadcast_address() {
        let keys: &[&str] = &[
            "robot=HOST:5007",
            "gateway=HOST",
            #[cfg(feature = "health")]
            "syslog=HOST",
            #[cfg(feature = "health")]
            "ntp=HOST",
        ];
        for (own, host, is_valid) in [
            ("192.168.0.7/24", "192.168.0.8", true),
            ("192.168.0.7/24", "192.168.0.7", false),
            ("192.168.0.7/24", "192.168.0.255", false),
            ("192.168.0.7/24", "192.168.0.0", false),
            ("192.168.0.7/16", "192.168.0.255", true),
            // other networks, whose prefix is unknown, and networks without a broadcast address
            ("192.168.0.7/24", "10.0.0.255", true),
            ("192.168.0.6/31", "192.168.0.7", true),
            ("192.168.0.6/32", "192.168.0.6", false),
            ("10.0.0.1/0", "192.168.0.7", true),
        ] {
            for key in keys {
                let (own, line) = (std::format!("address={own}"), key.replace("HOST", host));
                for text in [std::format!("{own}\n{line}"), std::format!("{line}\n{own}")] {
                    assert_eq!(Settings::check(text.as_bytes()).is_ok(), is_valid, "{text}");
                }
            }
        }
    }

    #[test]
    fn an_invalid_line_is_reported_and_forbids_every_put() {
        for line in [
            "robot=10.0.2.2",
            "robot=robot:5007",
            "robot=http:10.0.2.2:5007",
            "robot=0.0.0.0:5007",
            "robot=255.255.255.255:5007",
            "robot=udp:224.0.0.1:5007",
            "robot=127.0.0.1:5007",
            "robot=10.0.2.2:0",
            "robot=10.0.2.2:5007:1",
            "address=10.0.2.15",
            "address=10.0.2.15/33",
            "address=0.0.0.0/0",
            "address=224.0.0.1/24",
            "address=255.255.255.255/32",
            "address=127.0.0.1/8",
            "address=10.0.2.255/24",
            "address=10.0.2.0/24",
            "gateway=10.0.2",
            "gateway=0.0.0.0",
            "gateway=239.1.2.3",
            "gateway=255.255.255.255",
            "mac=02:00:00:bc:a9",
            "mac=02:00:00:bc:a9:03:04",
            "mac=03:00:00:bc:a9:03",
            "mac=00:00:00:00:00:00",
            "mac=2:0:0:bc:a9:3",
            "hostname=",
            "hostname=cell_7",
            "hostname=-cell",
            "hostname=cell.plant",
            "hostname=a-name-of-33-characters-is-refused",
            "dhcp=maybe",
            "convert=",
            "find=no ",
            "rate=x",
            "rate=5/0",
            "echo=0",
            "idle=0",
            "evict=3601",
            "keepalive=x",
            "allow=10.0.2",
            "allow=10.0.2.0/33",
            "put@10.0.2=I",
            "put@=I",
            "echo=65536",
            #[cfg(feature = "health")]
            "health=0",
            #[cfg(feature = "health")]
            "syslog=10.0.2.2:0",
            #[cfg(feature = "health")]
            "syslog=224.0.0.1",
            #[cfg(feature = "health")]
            "ntp=pool.ntp.org",
            #[cfg(feature = "health")]
            "ntp=255.255.255.255",
            #[cfg(feature = "health")]
            "password=",
            #[cfg(feature = "health")]
            "password=1234567",
            #[cfg(feature = "health")]
            "password=with a blank",
            #[cfg(feature = "health")]
            "password=1234567890123456789012345678901234567890123456789012345678901234",
            #[cfg(feature = "modbus")]
            "modbus=0",
            #[cfg(feature = "modbus")]
            "register=1=S/1",
            #[cfg(feature = "modbus")]
            "coil=1=I/1",
            "colour=red",
            "nonsense",
            "provider=\u{fffd}\u{fffd}=x", // valid: a provider may have any name
        ] {
            let text = ["put=I\n", line, "\nput=F\necho=9"].concat();
            let mut reported = Vec::new();
            let settings = Settings::read(text.as_bytes(), |line, _| reported.push(line));
            if line.starts_with("provider") {
                assert!(reported.is_empty());
                continue;
            }
            assert_eq!(reported, [line.as_bytes()]);
            assert_eq!(settings.rules(&mut RuleMemory::new()), Rules::READ_ONLY, "{line}");
            assert_eq!(settings.echo, Some(9), "the lines after it are read");
        }
        let mut told = 0;
        let _ = Settings::read(b"provider=\xff\xfe\n", |_, _| told += 1);
        assert_eq!(told, 1, "no UTF-8");
    }
}
