//! `bcap get`.

use crate::args::Get;
use crate::error::Failure;
use crate::selection::{Selection, expand};
use crate::session::Session;
use crate::value::text;
use crate::variables::{get_one, last_packet, paths, print_each};
use bcap_capture::hex;

/// Runs `bcap get`.
pub(crate) fn get(args: &Get, session: &mut Session, json: bool) -> Result<(), Failure> {
    let names = expand(session, &Selection::parse_each(&args.names)?)?;
    print_each(&names, &paths(&names)?, json, |path| match last_packet(session, &path.to_string()) {
        Some(bytes) => text(&hex::spaced(&bytes)),
        None => get_one(session, path),
    })
}
