//! `bcap scan`: finds controllers.

use std::collections::BTreeSet;
use std::io::{self, IsTerminal};
use std::net::Ipv4Addr;
use std::thread;
use std::time::Duration;

use bcap_std::{Address, NetworkAddress, Protocol};
use clap::Args;
use if_addrs::{IfAddr, Interface};

use super::variable;
use crate::commands::robot_ports::host;
use crate::commands::variables::rac;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::link::profiles::Profiles;
use crate::link::{LinkArgs, address};
use crate::output::print_result;
use crate::session::Session;
use crate::session::confirm::Question;
use crate::session::variables::{short_type, shown};

/// Finds controllers on hosts and in networks
///
/// Without an argument it asks the addresses of the profiles, and on a terminal, after a question, each address in the networks of
/// this machine: of a network with more than 1,024 addresses the 256 around the machine's own.
///
/// It asks each address over b-CAP (TCP and UDP) and RAC: at most 50 addresses at a time, and one port after the other. A line
/// has the model, the version, the type of the robot, and the ports that answer. It only reads variables, never takes the arm,
/// and asks nothing that would end a stream of Slave Mode. --timeout applies to each port [default: 1 s].
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap scan
  bcap scan 192.168.0.0/24
  bcap scan 192.168.0.1 cell2.local:5007 --json")]
pub(crate) struct Scan {
    /// Hosts (HOST[:PORT]) or networks (192.168.0.0/24), together at most 1,024 addresses [default: the addresses of the profiles and, after a question, of the networks of this machine]
    #[arg(value_name = "HOST|NETWORK")]
    pub(crate) targets: Vec<String>,
}

/// The maximum number of addresses of a scan.
const MOST: usize = 1024;
/// The maximum number of addresses that are probed at the same time.
const AT_ONCE: usize = 50;
/// The time limit of each port, which an unused address costs.
const LIMIT: Duration = Duration::from_secs(1);

/// Runs `bcap scan`.
pub(crate) fn scan(args: &Scan, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let (targets, link) = (targets(&args.targets)?, &link.within(LIMIT));
    let mut count = 0;
    for group in targets.chunks(AT_ONCE) {
        let probes = thread::scope(|scope| {
            let probe = |target| thread::Builder::new().spawn_scoped(scope, move || Found::at(target, link));
            let probes = group.iter().map(probe).collect::<Result<Vec<_>, _>>()?;
            Ok::<_, Failure>(probes.into_iter().filter_map(|probe| probe.join().ok()).collect::<Vec<_>>())
        })?;
        Interrupt::of_process().map_or(Ok(()), |interrupt| interrupt.check("interrupted"))?;
        for found in probes.iter().filter(|found| found.ports.iter().any(|(_, answers)| *answers)) {
            count += 1;
            found.print(json)?;
        }
    }
    if count > 0 {
        return Ok(());
    }
    Err(Failure::Connection {
        message: format!("no controller answers at the {} addresses", targets.len()),
        hint: "check the addresses and the network, or allow more time with --timeout".into(),
    })
}

/// Returns the addresses to probe.
fn targets(words: &[String]) -> Result<Vec<NetworkAddress>, Failure> {
    let mut targets = Vec::new();
    let mut found = Vec::new();
    if words.is_empty() {
        let profiles = Profiles::read()?;
        for text in profiles.by_name.values().filter_map(|profile| profile.address.as_deref()) {
            if let Address::Network(target) = address::bcap(Some(text), None)? {
                targets.push(target);
            }
        }
        found = agreed_networks()?;
        if targets.is_empty() && found.is_empty() {
            let path = profiles.path.display();
            return Err(Failure::Input(format!("{path} has no network address; write one, such as 192.168.0.0/24")));
        }
    }
    for word in words.iter().chain(&found) {
        targets.extend(expand(word)?);
    }
    if targets.len() > MOST {
        return Err(Failure::Input(format!("{} addresses are too many: a scan has at most {MOST}", targets.len())));
    }
    Ok(targets)
}

/// Returns the networks of this machine, if the user agrees, on a terminal, to scan them.
fn agreed_networks() -> Result<Vec<String>, Failure> {
    let networks: BTreeSet<String> = match if_addrs::get_if_addrs() {
        Ok(interfaces) if io::stdin().is_terminal() => interfaces.iter().filter_map(network_of).collect(),
        _ => return Ok(Vec::new()),
    };
    let networks = Vec::from_iter(networks);
    let what = format!("asks each address of {} over b-CAP and RAC", networks.join(", "));
    let (warning, refused) = ("Other machines can notice that.", "only the profiles are asked");
    if networks.is_empty() {
        return Ok(networks);
    }
    match (Question { what: &what, warning, refused }).ask() {
        Ok(()) => Ok(networks),
        Err(Failure::Input(_)) => Ok(Vec::new()),
        Err(failure) => Err(failure),
    }
}

/// Returns the network of an interface, as `expand` reads it.
fn network_of(interface: &Interface) -> Option<String> {
    let IfAddr::V4(address) = &interface.addr else { return None };
    let is_host = address.is_loopback() || address.is_link_local() || address.prefixlen > 30;
    let bits = if address.prefixlen < 22 { 24 } else { address.prefixlen };
    let base = Ipv4Addr::from_bits(address.ip.to_bits() & (u32::MAX << (32 - u32::from(bits).min(31))));
    (!is_host).then(|| format!("{base}/{bits}"))
}

/// Returns the addresses of a network, or the address of a host.
fn expand(word: &str) -> Result<Vec<NetworkAddress>, Failure> {
    let network = |text: &str| address::network(Some(text), None);
    let Some((base, bits)) = word.split_once('/').and_then(|(base, bits)| Some((base.parse::<Ipv4Addr>().ok()?, bits)))
    else {
        return Ok(vec![network(word)?]);
    };
    let bits = bits.parse().ok().filter(|bits| (22..=32).contains(bits));
    let bits: u32 = bits.ok_or_else(|| Failure::Input(format!("{word}: write a network from /22 (1,024) to /32")))?;
    let mask = u32::MAX << (32 - bits);
    let (first, last) = (base.to_bits() & mask, base.to_bits() | !mask);
    // the first and the last address of a network do not belong to hosts
    let hosts = if bits < 31 { first + 1..=last - 1 } else { first..=last };
    hosts.map(|bits| network(&Ipv4Addr::from_bits(bits).to_string())).collect()
}

/// The answers at an address.
struct Found {
    host: String,
    /// Model, version and type of the robot.
    about: [Option<String>; 3],
    /// TCP, UDP and RAC: the port, and whether it answers.
    ports: [(u16, bool); 3],
}

impl Found {
    fn at(target: &NetworkAddress, link: &LinkArgs) -> Self {
        let mut about = [const { None }; 3];
        let bcap = [Protocol::Tcp, Protocol::Udp].map(|protocol| {
            let address = NetworkAddress { protocol, ..target.clone() };
            let mut session = Session::new(&link.at(&address.to_string()));
            let connected = session.connect();
            if connected.is_ok() && about[0].is_none() {
                about = ["@TYPE", "@VERSION", "robot/@TYPE_NAME"]
                    .map(|name| variable(&mut session, name).ok().flatten().map(|value| shown(&value)));
            }
            (target.port, answers(&connected))
        });
        let link = link.at(&host(target));
        let rac = (link.rac_target().map_or(0, |target| target.port), answers(&rac::probe(&link)));
        Self { host: target.host.clone(), about, ports: [bcap[0], bcap[1], rac] }
    }

    fn print(&self, json: bool) -> Result<(), Failure> {
        let [kind, version, robot] = &self.about;
        let kind = kind.as_deref().map(short_type);
        let [tcp, udp, rac] = self.ports.map(|(port, answers)| answers.then_some(port));
        let object = serde_json::json!({
            "host": self.host, "model": kind, "version": version, "robot": robot, "tcp": tcp, "udp": udp, "rac": rac
        });
        let ports = [("TCP", tcp), ("UDP", udp), ("RAC", rac)];
        let ports: Vec<_> = ports.iter().filter_map(|(name, port)| Some(format!("{name} {}", (*port)?))).collect();
        let shown = |text: Option<&str>| text.unwrap_or("-").to_owned();
        let about = [kind.as_deref(), version.as_deref(), robot.as_deref()].map(shown).join("  ");
        Ok(print_result(json, &object, &format!("{}  {about}  {}", self.host, ports.join(", ")))?)
    }
}

/// Returns whether a server answered, even with a refusal.
const fn answers<T>(asked: &Result<T, Failure>) -> bool {
    matches!(asked, Ok(_) | Err(Failure::Refused { .. }))
}
