//! The arguments of `bcap gateway`.

use std::net::SocketAddr;
use std::path::PathBuf;

use bcap_gateway::Network;
use bcap_gateway::modbus::Entry;
use clap::Args;

use crate::rules::{AllowPut, network};

/// Lets PLCs that speak RAC or Modbus TCP read, and if rules allow it write, the variables of a robot that speaks b-CAP
///
/// Prints one line, `ready rac=IP:PORT` and with --modbus `modbus=IP:PORT`, when it listens, then the audit log: one JSON object a line for every request and
/// for each change of the robot's session. While the robot is disconnected, every request is answered with E_NOT_CONNECTED
/// at once. SIGINT, SIGTERM and SIGHUP end it with 0, after running requests have been answered.
#[derive(Debug, Args)]
#[command(after_help = "\
A file of rules. By default everything may be read and nothing written.
  clients = [\"10.0.0.0/24\"]               # who may connect; left out, all clients
  convert = true                            # a value of another type is converted where nothing is lost
  rate = { per_second = 50, burst = 10 }    # for each client
  [[get]]
  kind = \"P\"
  [[put]]
  kind = \"I\"
  index = [0, 99]                           # or one number
  values = [-10, 10]                        # or a list of ranges, one for each element
  clients = \"10.0.0.7\"                    # for this client or network only
The same file may have the map of Modbus, before the first [[get]] or [[put]].
  register = [\"100=I/10-19:i16\", \"200=F/0-9\"]
  coil = [\"0=IO/128-143\"]
Examples:
  bcap gateway --robot tcp:192.168.0.1
  bcap gateway --robot udp:192.168.0.1 --allow-put I/0-99,IO/128-143 --allow-put F/5=0..1
  bcap gateway --rac [::]:5006 --clients 10.0.0.0/24 --robot tcp:192.168.0.1 --rules rules.toml --audit /var/log/gateway.jsonl
  bcap gateway --robot tcp:192.168.0.1 --modbus 127.0.0.1:5020 --register 100=I/10-19:i16 --coil 0=IO/128-143")]
pub(crate) struct Gateway {
    /// Where RAC listens
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:5006")]
    pub(crate) rac: SocketAddr,

    /// Where Modbus TCP listens, usually on port 502; off by default. The map says which variables its clients read and write
    #[arg(long, value_name = "ADDR")]
    pub(crate) modbus: Option<SocketAddr>,

    /// Maps holding registers to variables: ADDRESS=KIND[/FIRST[-LAST]][:FORMAT][:low]; can be repeated
    ///
    /// Addresses count from 0. FORMAT is i16, u16 or i32 for I, and f32 or f64 for D. A number begins with its high register,
    /// with low with its low one.
    #[arg(long, value_name = "ENTRY", requires = "modbus", value_parser = Entry::registers)]
    pub(crate) register: Vec<Entry>,

    /// Maps coils to variables: ADDRESS=IO[/FIRST[-LAST]]; can be repeated
    #[arg(long, value_name = "ENTRY", requires = "modbus", value_parser = Entry::coils)]
    pub(crate) coil: Vec<Entry>,

    /// The rules for clients, in TOML
    #[arg(long, value_name = "FILE")]
    pub(crate) rules: Option<PathBuf>,

    /// The networks whose clients may connect, in addition to the rules: IPv4 ADDRESS[/PREFIX], several separated by commas.
    /// Without any, all clients may
    ///
    /// The connection of any other client is reset. A client that connects over IPv6 belongs to no network except 0.0.0.0/0.
    #[arg(long, value_name = "NETWORKS", value_delimiter = ',', value_parser = network)]
    pub(crate) clients: Vec<Network>,

    /// Allows variables to be written, in addition to the rules: KIND[/FIRST[-LAST]][=MIN..MAX[,MIN..MAX]...], several
    /// separated by commas
    ///
    /// Each range is about one element of the value, the last range also about the elements after it.
    #[arg(long, value_name = "RULES", value_parser = AllowPut::parse)]
    pub(crate) allow_put: Vec<AllowPut>,

    /// Connections of one IP address at the same time, of 64 in all, with RAC and Modbus
    #[arg(long, value_name = "COUNT", default_value_t = 16)]
    pub(crate) clients_per_address: usize,

    /// The seconds of silence after which a connection may be closed when another needs its slot. The connection that has
    /// been idle longest is closed first
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    pub(crate) evict_after: u32,

    /// Where the audit log goes; a file is appended to, - is the standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    pub(crate) audit: PathBuf,

    /// The lines a second that one IP address may cause in the audit log, and ten times as many at once. Further lines are
    /// counted only; 0 writes all. Successful writes are always logged
    #[arg(long, value_name = "LINES", default_value_t = 10)]
    pub(crate) audit_rate: u32,

    /// The size in MiB at which a log file is renamed to FILE.1 and a new file begins; 0 for any size
    #[arg(long, value_name = "MIB", default_value_t = 16)]
    pub(crate) audit_size: u32,

    /// The number of old log files to keep; FILE.1 is the newest
    #[arg(long, value_name = "COUNT", default_value_t = 4)]
    pub(crate) audit_keep: u32,
}
