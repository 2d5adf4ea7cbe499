//! The address of the controller: `tcp:HOST[:PORT]`, `udp:HOST[:PORT]`, and `HOST[:PORT]` for RAC.
//!
//! A host is a name, an IPv4 address, or an IPv6 address in brackets, `tcp:[fe80::1]:5007`. The option `--robot` has
//! priority over the environment variable `BCAP_ROBOT`; the default is a controller on this machine.

use std::env;
use std::fmt;

use bcap_core::bcap;

use crate::error::Failure;

/// The port of RAC (S0:206).
const RAC_PORT: u16 = 5006;

/// The transport protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transport {
    Tcp,
    Udp,
}

/// A controller's address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Target {
    pub(crate) transport: Transport,
    /// A name or an address, without brackets.
    pub(crate) host: String,
    pub(crate) port: u16,
}

impl Target {
    /// Returns the controller's address for b-CAP.
    pub(crate) fn bcap(option: Option<&str>) -> Result<Self, Failure> {
        match option.map(str::to_owned).or_else(from_environment) {
            Some(text) => Self::parse_bcap(&text).map_err(Failure::Input),
            None => Ok(Self { transport: Transport::Tcp, host: "127.0.0.1".into(), port: bcap::PORT }),
        }
    }

    /// Returns the controller's address for RAC. The port in the environment variable is the port of b-CAP, so only its host
    /// is used.
    pub(crate) fn rac(option: Option<&str>) -> Result<Self, Failure> {
        let (text, from_environment) = match (option, from_environment()) {
            (Some(text), _) => (text.to_owned(), false),
            (None, Some(text)) => (text, true),
            (None, None) => ("127.0.0.1".into(), false),
        };
        let (scheme, rest) = split_scheme(&text);
        if !from_environment && scheme == Some(Transport::Udp) {
            return Err(Failure::Input(format!("{text}: RAC runs over TCP; write HOST[:PORT]")));
        }
        let (host, port) = parse_host(&text, rest).map_err(Failure::Input)?;
        let port = if from_environment && scheme.is_some() { None } else { port };
        Ok(Self { transport: Transport::Tcp, host, port: port.unwrap_or(RAC_PORT) })
    }

    fn parse_bcap(text: &str) -> Result<Self, String> {
        let (Some(transport), rest) = split_scheme(text) else {
            return Err(format!("{text}: write tcp:HOST[:PORT] or udp:HOST[:PORT], such as tcp:192.168.0.1"));
        };
        let (host, port) = parse_host(text, rest)?;
        Ok(Self { transport, host, port: port.unwrap_or(bcap::PORT) })
    }
}

fn from_environment() -> Option<String> {
    env::var("BCAP_ROBOT").ok().filter(|text| !text.is_empty())
}

/// Splits off `tcp:` or `udp:`.
fn split_scheme(text: &str) -> (Option<Transport>, &str) {
    match text.split_once(':') {
        Some((scheme, rest)) if scheme.eq_ignore_ascii_case("tcp") => (Some(Transport::Tcp), rest),
        Some((scheme, rest)) if scheme.eq_ignore_ascii_case("udp") => (Some(Transport::Udp), rest),
        _ => (None, text),
    }
}

/// Splits `HOST[:PORT]`; `text` is the whole address, for messages.
fn parse_host(text: &str, rest: &str) -> Result<(String, Option<u16>), String> {
    let (host, port) = match rest.strip_prefix('[') {
        Some(bracketed) => {
            let missing = || format!("{text}: the ] is missing; write an IPv6 address as tcp:[fe80::1]:5007");
            let (host, after) = bracketed.split_once(']').ok_or_else(missing)?;
            match (after, after.strip_prefix(':')) {
                ("", _) => (host, None),
                (_, Some(port)) => (host, Some(port)),
                _ => return Err(format!("{text}: only :PORT may follow the ]")),
            }
        }
        None if rest.matches(':').count() > 1 => {
            return Err(format!("{text}: write an IPv6 address in brackets, such as tcp:[fe80::1]:5007"));
        }
        None => match rest.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (rest, None),
        },
    };
    if host.is_empty() {
        return Err(format!("{text}: the host is missing; write a name or an IP address"));
    }
    let port = port.map(|port| match port.parse::<u16>() {
        Ok(number) if number > 0 => Ok(number),
        _ => Err(format!("{text}: {port:?} is not a port; write a number from 1 to 65535")),
    });
    Ok((host.to_owned(), port.transpose()?))
}

/// Writes the address as on the command line.
impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = match self.transport {
            Transport::Tcp => "tcp",
            Transport::Udp => "udp",
        };
        if self.host.contains(':') {
            write!(f, "{scheme}:[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{scheme}:{}:{}", self.host, self.port)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read() {
        for (text, shown) in [
            ("tcp:192.168.0.1", "tcp:192.168.0.1:5007"),
            ("udp:robot.local:6000", "udp:robot.local:6000"),
            ("TCP:[::1]", "tcp:[::1]:5007"),
            ("udp:[fe80::1]:7", "udp:[fe80::1]:7"),
        ] {
            let target = Target::parse_bcap(text).unwrap();
            assert_eq!(target.to_string(), shown);
            assert_eq!(Target::parse_bcap(shown).unwrap(), target);
        }
        let rac = |text| Target::rac(Some(text)).unwrap().to_string();
        assert_eq!(rac("192.168.0.1"), "tcp:192.168.0.1:5006");
        assert_eq!(rac("robot:7000"), "tcp:robot:7000");
        assert_eq!(rac("tcp:[::1]:7000"), "tcp:[::1]:7000");
    }

    #[test]
    fn errors_name_the_wrong_part_of_an_address() {
        for (text, word) in [
            ("192.168.0.1", "tcp:HOST"),
            ("com:1", "tcp:HOST"),
            ("tcp:", "host is missing"),
            ("tcp::5007", "host is missing"),
            ("tcp:a:b", "\"b\" is not a port"),
            ("tcp:a:0", "not a port"),
            ("tcp:a:65536", "not a port"),
            ("tcp:fe80::1", "brackets"),
            ("tcp:[::1", "]"),
            ("tcp:[::1]5007", "only :PORT may follow the ]"),
        ] {
            let error = Target::parse_bcap(text).unwrap_err();
            assert!(error.contains(word) && error.starts_with(text), "{error}");
        }
        assert!(Target::rac(Some("udp:a")).is_err());
    }
}
