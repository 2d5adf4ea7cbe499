//! The addresses of a robot that is used over all protocols.

use std::net::IpAddr;

use bcap_capture::proxy::Robot;
use bcap_std::{Address, NetworkAddress, blocking};
use clap::Args;

use crate::failure::Failure;
use crate::link::{LinkArgs, address};
use crate::session::connect::not_connected;

/// The addresses of a robot that is used over all protocols.
#[derive(Debug, Args)]
pub(crate) struct RobotPorts {
    /// The robot's address for b-CAP over UDP [default: as --robot]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_udp: Option<String>,

    /// The robot's address for RAC [default: the host of --robot and port 5006]
    #[arg(long, value_name = "HOST[:PORT]")]
    pub(crate) robot_rac: Option<String>,
}

/// Resolves the addresses of the command line.
pub(crate) fn resolve(args: &RobotPorts, link: &LinkArgs) -> Result<Robot, Failure> {
    let tcp = link.network_target()?;
    let udp = args.robot_udp.as_deref().map_or_else(|| Ok(tcp.clone()), |text| address::network(Some(text), None))?;
    let rac = address::rac(Some(args.robot_rac.as_deref().unwrap_or(&host(&tcp))), None, link.rac_port)?;
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
