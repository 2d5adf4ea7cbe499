//! The variables that the user selects: the controller says how many there are of a kind.

use bcap_capture::value::selection::{Selection, names_of};
pub(crate) use bcap_live::variables::expand;

use crate::failure::Failure;

/// Returns the names of all selected variables without a session, where `I*` is an error.
pub(crate) fn expand_offline(selections: &[Selection]) -> Result<Vec<String>, Failure> {
    names_of(selections, |kind| {
        let name = kind.name();
        Err(Failure::Input(format!(
            "{name}*: RAC does not tell how many variables there are; write a range such as {name}1-{name}50"
        )))
    })
}
