//! Which calls neither move nor write: the gate of `bcap replay` and `bcap fuzz`.

/// Returns whether a call of the function opens, reads or releases; `has_option` tells whether its third argument is anything but
/// the empty text. `function` is a name such as `Variable_GetValue`, or `GET` of RAC.
pub(crate) fn reads(function: &str, has_option: bool) -> bool {
    let is_session =
        ["Service_Start", "Service_Stop", "Controller_Connect", "Controller_Disconnect"].contains(&function);
    let is_read = function == "GET" || function.contains("_Get") || function.ends_with("_Release");
    // opening a file with an option may create it
    let creates = function.ends_with("_GetFile") && has_option;
    is_session || (is_read && !creates)
}
