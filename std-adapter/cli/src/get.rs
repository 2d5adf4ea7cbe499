//! `bcap get`.

use crate::args::{Get, LinkArgs};
use crate::error::Failure;
use crate::selection::{Selection, expand};
use crate::session::with_session;
use crate::variables::{get_one, paths, print_each};

/// Runs `bcap get`.
pub(crate) fn get(args: &Get, link: &LinkArgs, json: bool) -> Result<(), Failure> {
    let selections = Selection::parse_each(&args.names)?;
    with_session(link, |session| {
        let names = expand(session, &selections)?;
        print_each(&names, &paths(&names)?, json, |path| get_one(session, path))
    })
}
