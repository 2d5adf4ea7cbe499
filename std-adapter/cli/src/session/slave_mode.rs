//! The check before a call that would end a stream of Slave Mode, for commands that make many such calls.

use bcap_core::bcap::FunctionId;
pub(crate) use bcap_live::stream::StreamCheck;

use crate::failure::Failure;
use crate::session::Session;

/// Fails if a stream of Slave Mode runs that a call would end.
pub(crate) fn spare(session: &mut Session, function: FunctionId, command: Option<&str>) -> Result<(), Failure> {
    StreamCheck::default().require(session, function, command)
}
