//! The functions of the protocol that execute a command, which a client names in text.

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::Request;

/// Returns whether a function executes a command.
pub(crate) fn executes(function: FunctionId) -> bool {
    matches!(
        function,
        FunctionId::CONTROLLER_EXECUTE
            | FunctionId::EXTENSION_EXECUTE
            | FunctionId::FILE_EXECUTE
            | FunctionId::ROBOT_EXECUTE
            | FunctionId::TASK_EXECUTE
    )
}

/// Returns the name of the command that a request executes, without surrounding blanks.
pub(crate) fn command_of(request: &Request<'_>) -> Option<String> {
    executes(request.function).then(|| request.text(1).to_string().trim().to_owned())
}
