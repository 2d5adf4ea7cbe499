//! The address of the controller: the option `--robot`, the environment variable `BCAP_ROBOT`, the profile, or a controller
//! on this machine, in this order.

use std::env;

use bcap_std::{Address, NetworkAddress, Protocol};

use crate::failure::Failure;

/// The port of RAC (RAC specification, section 3.2).
const RAC_PORT: u16 = 5006;

/// Returns the controller's address for b-CAP.
pub(crate) fn bcap(option: Option<&str>, profile: Option<&str>) -> Result<Address, Failure> {
    let text = option.map(str::to_owned).or_else(|| indirect(profile)).unwrap_or_else(|| "tcp:127.0.0.1".into());
    if text.split_once("://").is_some_and(|(scheme, _)| !is_protocol(scheme)) {
        // the library's message names the text and both forms
        return text.parse().map_err(wrong);
    }
    if text.split_once(':').is_some_and(|(scheme, _)| scheme.eq_ignore_ascii_case("serial")) {
        return text.parse().map_err(wrong);
    }
    NetworkAddress::parse_or_tcp(&without_slashes(&text), bcap_core::bcap::PORT).map(Address::Network).map_err(wrong)
}

/// Returns the controller's address for b-CAP, for a command that cannot use a serial line.
pub(crate) fn network(option: Option<&str>, profile: Option<&str>) -> Result<NetworkAddress, Failure> {
    match bcap(option, profile)? {
        Address::Network(address) => Ok(address),
        other => Err(Failure::Input(format!(
            "{other}: serial lines are not supported by this command; write tcp:HOST[:PORT] or udp:HOST[:PORT]"
        ))),
    }
}

fn is_protocol(scheme: &str) -> bool {
    ["tcp", "udp"].iter().any(|protocol| scheme.eq_ignore_ascii_case(protocol))
}

/// Writes `tcp://HOST/` as `tcp:HOST`.
fn without_slashes(text: &str) -> String {
    match text.split_once("://") {
        Some((scheme, rest)) if is_protocol(scheme) => format!("{scheme}:{}", rest.strip_suffix('/').unwrap_or(rest)),
        _ => text.to_owned(),
    }
}

/// Returns the controller's address for RAC. The port after a protocol in the environment variable or the profile is the
/// port of b-CAP, so only the host is used then.
pub(crate) fn rac(option: Option<&str>, profile: Option<&str>, port: Option<u16>) -> Result<NetworkAddress, Failure> {
    let rac_port = port.unwrap_or(RAC_PORT);
    if let Some(text) = option {
        let address = NetworkAddress::parse_or_tcp(&without_slashes(text), rac_port).map_err(wrong)?;
        return match address.protocol {
            Protocol::Tcp => Ok(address),
            Protocol::Udp => Err(Failure::Input(format!("{text}: RAC runs over TCP; write HOST[:PORT]"))),
        };
    }
    match indirect(profile) {
        Some(text) => {
            let text = without_slashes(&text);
            let names_protocol = text.parse::<Address>().is_ok();
            let address = NetworkAddress::parse_or_tcp(&text, rac_port).map_err(wrong)?;
            let port = if names_protocol { rac_port } else { address.port };
            Ok(NetworkAddress { protocol: Protocol::Tcp, port, ..address })
        }
        None => NetworkAddress::parse_or_tcp("127.0.0.1", rac_port).map_err(wrong),
    }
}

fn wrong(error: bcap_std::AddressError) -> Failure {
    Failure::Input(error.to_string())
}

/// Returns the address of the environment variable, or of the profile.
fn indirect(profile: Option<&str>) -> Option<String> {
    in_environment().or_else(|| profile.map(str::to_owned))
}

/// Returns the address of the environment variable.
pub(crate) fn in_environment() -> Option<String> {
    env::var("BCAP_ROBOT").ok().filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rac_runs_over_tcp() {
        assert_eq!(rac(Some("robot"), None, None).unwrap().to_string(), "tcp:robot:5006");
        assert_eq!(rac(Some("tcp://robot"), None, None).unwrap().to_string(), "tcp:robot:5006");
        assert!(rac(Some("udp:robot"), None, None).is_err());
        assert!(rac(Some("serial:/dev/ttyS0"), None, None).is_err());
    }

    #[test]
    fn a_command_without_serial_lines_says_so() {
        let Err(Failure::Input(message)) = network(Some("serial:/dev/ttyS0"), None) else { panic!("accepted") };
        assert!(message.starts_with("serial:/dev/ttyS0?baud=115200: serial lines are not supported"), "{message}");
    }

    #[test]
    fn the_protocol_is_tcp_unless_it_is_given() {
        for (text, address) in [
            ("192.168.0.1", "tcp:192.168.0.1:5007"),
            ("robot:7", "tcp:robot:7"),
            ("[fe80::1]:7", "tcp:[fe80::1]:7"),
            ("tcp://robot", "tcp:robot:5007"),
            ("UDP://robot:7/", "udp:robot:7"),
        ] {
            assert_eq!(bcap(Some(text), None).unwrap().to_string(), address);
        }
        for text in ["http://robot", "tcp://", "tcp:///", "serial:"] {
            assert!(bcap(Some(text), None).is_err(), "{text}");
        }
    }
}
