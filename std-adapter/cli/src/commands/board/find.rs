//! `bcap board find`.

use std::io;
use std::time::Duration;

use bcap_provision::search::{self, Board};
use clap::Args;
use serde_json::json;

use crate::failure::Failure;
use crate::link::LinkArgs;
use crate::output;

/// Finds the gateway boards of the networks of this computer
///
/// It asks with three broadcasts over UDP, and prints a line for each board that answers within --timeout [default: 1 s]: its address,
/// the port of RAC, its MAC address, the board, the version, and its name from the setting `hostname`. A board answers only hosts of
/// its own network, unless its settings have find=no.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap board find
  bcap board find 192.168.0.255
  bcap board find 192.168.0.9 --json")]
pub(crate) struct Find {
    /// Boards or broadcast addresses (HOST[:PORT]) [default: the broadcast address of each network of this computer]
    #[arg(value_name = "HOST")]
    pub(crate) hosts: Vec<String>,
}

/// Maximum time in which boards must answer.
const LIMIT: Duration = Duration::from_secs(1);

pub(super) fn find(args: &Find, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let limit = link.within(LIMIT).timeout();
    let failed = |error: io::Error| Failure::Connection {
        message: format!("cannot ask the network: {error}"),
        hint: "check that this computer has an address in the network of the board".into(),
    };
    let targets = search::targets(&args.hosts).map_err(failed)?;
    let boards = search::ask(&targets, limit).map_err(failed)?;
    for board in boards.values() {
        let (line, object) = shown(board);
        output::print_result(json, &object, &line)?;
    }
    if !boards.is_empty() {
        return Ok(());
    }
    let names: Vec<String> = targets.iter().map(ToString::to_string).collect();
    Err(Failure::Connection {
        message: format!("no board answers at {} within {} ms", names.join(", "), limit.as_millis()),
        hint: "a board answers once it has an address, which it also prints on its console, and only to its own network; a firewall \
               may drop the answer"
            .into(),
    })
}

fn shown(board: &Board) -> (String, serde_json::Value) {
    let Board { name, board, version, address: (address, prefix), port, mac, .. } = board;
    let [a, b, c, d, e, f] = mac;
    let mac = format!("{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{f:02x}");
    let line = format!("{address}:{port}  {mac}  {board} {version}  {name}");
    let object = json!({ "address": address, "prefix": prefix, "port": port, "mac": mac, "board": board, "version": version, "name": name });
    (line.trim_end().to_owned(), object)
}
