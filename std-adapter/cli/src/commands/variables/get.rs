//! `bcap get`.

use bcap_capture::hex;
use clap::Args;

use crate::failure::{Failure, with_finding};
use crate::output::print;
use crate::session::Session;
use crate::session::variables::{expand, get_one, paths};
use bcap_capture::value::named::shown;
use bcap_capture::value::selection::Selection;
use bcap_core::variant::OwnedVariant as Value;

/// The names that the b-CAP Tester calls `$LAST_SEND_PACKET$` and `$LAST_RECEIVE_PACKET$`. They stay as they are.
pub(crate) const LAST_PACKETS: [&str; 2] = ["$LAST_SEND_PACKET$", "$LAST_RECEIVE_PACKET$"];

/// Reads variables
///
/// NAME is a variable of the controller, such as I1, P10 or @MODE, or of an object: robot/@SERVO_ON,
/// robot:Arm0/@CURRENT_POSITION, task:Pro1/@STATUS. I1-I50 is a range, and 'I*' are all variables of a kind (quote it).
/// With --json a line is {"name":"I1","vt":3,"v":5}; `bcap decode --help` describes `vt` and `v`. Without --json the numbers
/// of an R8 array, such as a pose, have at most 15 digits. $LAST_SEND_PACKET$ and $LAST_RECEIVE_PACKET$ are the bytes of the
/// last packets before them.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap get I1
  bcap get --robot tcp:192.168.0.1 --json P1 P2 robot/@CURRENT_POSITION
  bcap get I1-I50 IO128-IO135 'S*'
  bcap get I1 '$LAST_SEND_PACKET$' '$LAST_RECEIVE_PACKET$'
  BCAP_ROBOT=udp:192.168.0.1 bcap get task:Pro1/@STATUS")]
pub(crate) struct Get {
    /// The variables
    #[arg(value_name = "NAME", required = true)]
    pub(crate) names: Vec<String>,
}

/// Runs `bcap get`.
pub(crate) fn get(args: &Get, session: &mut Session, json: bool) -> Result<(), Failure> {
    let names = expand(session, &Selection::parse_each(&args.names)?)?;
    print_each(&names, &paths(&names)?, json, |path| match last_packet(session, &path.to_string()) {
        Some(bytes) => Ok(Value::new(&hex::spaced(&bytes))?),
        None => get_one(session, path),
    })
}

/// Reads variables in order and prints their values; continues after a refusal.
pub(crate) fn print_each<V>(
    names: &[String],
    variables: &[V],
    json: bool,
    mut read: impl FnMut(&V) -> Result<Value, Failure>,
) -> Result<(), Failure> {
    let mut refused = 0;
    let done = names.iter().zip(variables).try_for_each(|(name, variable)| match read(variable) {
        Ok(value) => Ok(print(&shown(name, &value, json), json)?),
        Err(failure @ Failure::Refused { .. }) => {
            failure.print(json, Some(name));
            refused += 1;
            Ok(())
        }
        Err(failure) => Err(failure),
    });
    let found = if refused > 0 { Err(Failure::SomeRefused { refused, total: names.len() }) } else { Ok(()) };
    with_finding(done, found)
}

/// Returns the packet of a variable of the b-CAP Tester's debug mode (b-CAP specification, Table 6-1); `None` for
/// another name.
pub(crate) fn last_packet(session: &Session, name: &str) -> Option<Vec<u8>> {
    match LAST_PACKETS.iter().position(|known| name.strip_prefix("variable:").unwrap_or(name) == *known)? {
        0 => Some(session.packets.last_sent()),
        _ => Some(session.packets.last_received()),
    }
}
