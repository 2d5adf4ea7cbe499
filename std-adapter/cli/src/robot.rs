//! The addresses of a robot that is used over all protocols.

use std::net::IpAddr;

use bcap_capture::proxy::Robot;
use bcap_std::{Address, NetworkAddress, blocking};

use crate::args::{LinkArgs, RobotPorts};
use crate::connection::not_connected;
use crate::error::Failure;
use crate::target;

/// Resolves the addresses of the command line.
pub(crate) fn resolve(args: &RobotPorts, link: &LinkArgs) -> Result<Robot, Failure> {
    let tcp = link.network_target()?;
    let udp = match &args.robot_udp {
        Some(text) => target::network(Some(text), None)?,
        None => tcp.clone(),
    };
    let rac = target::rac(Some(args.robot_rac.as_deref().unwrap_or(&host(&tcp))), None, link.rac_port())?;
    let resolve = |address: &NetworkAddress| {
        blocking::resolve(address, Some(link.timeout()))
            .map_err(|error| not_connected(&error, &Address::Network(address.clone())))
    };
    let udp = resolve(&udp)?.first().copied().ok_or_else(|| Failure::Input(format!("{udp} has no address")))?;
    Ok(Robot { tcp: resolve(&tcp)?, udp, rac: resolve(&rac)? })
}

/// A host in the form of `--robot`: an IPv6 address has brackets.
pub(crate) fn host(address: &NetworkAddress) -> String {
    match address.host.parse() {
        Ok(IpAddr::V6(host)) => format!("[{host}]"),
        _ => address.host.clone(),
    }
}
