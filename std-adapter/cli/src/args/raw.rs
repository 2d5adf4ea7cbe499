//! The arguments of `bcap raw`.

use clap::Args;

/// Sends packets as they are written, and shows each reply
///
/// It starts no service and changes no byte: serial numbers, handles and errors are the writer's. PACKET is hexadecimal
/// digits, as for `bcap decode`, or JSON, as for `bcap encode`; one PACKET may hold several frames of hexadecimal digits.
/// Without PACKET, or with `-`, each line of the standard input is one. After each packet the command waits for its reply, at
/// most for --timeout (3 s); keep-alives (S_EXECUTING) are shown, and it waits on.
///
/// With --listen it is the server: it waits for a client, and answers each request with the next packet.
#[derive(Debug, Args)]
#[command(after_help = r#"Examples:
  bcap raw '{"name":"ServiceStart","args":[{"vt":8,"v":""}]}' '{"name":"ServiceStop","serial":2}'
  bcap raw 01100000000100000002000000000004 --robot udp:192.168.0.1 --loop 10
  bcap raw --listen udp:127.0.0.1:5007 '{"code":0}'"#)]
pub(crate) struct Raw {
    /// The packets
    #[arg(value_name = "PACKET")]
    pub(crate) packets: Vec<String>,

    /// Sends all packets this number of times; Ctrl-C ends that
    #[arg(long = "loop", value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) rounds: u64,

    /// Waits for a client at tcp:ADDRESS:PORT or udp:ADDRESS:PORT instead of connecting; port 0 takes a free one. Prints
    /// `ready` and the address
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) listen: Option<String>,

    /// Prints only the reply to the last packet of each round
    #[arg(long)]
    pub(crate) last: bool,
}
