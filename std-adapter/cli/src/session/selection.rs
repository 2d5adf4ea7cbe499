//! The variables that the user selects: the controller says how many there are of a kind.

use bcap_capture::value::describe;
use bcap_capture::value::selection::{Selection, names_of};
use bcap_core::rac::VariableKind;
use bcap_std::ObjectPath;

use crate::failure::Failure;
use crate::session::Session;
use crate::session::variables::get_one;

/// The most variables of a kind: an index has 16 bits.
const LONGEST: u32 = 1 << 16;

/// Returns the names of all selected variables, in order; asks the controller how many variables a kind has.
pub(crate) fn expand(session: &mut Session, selections: &[Selection]) -> Result<Vec<String>, Failure> {
    names_of(selections, |kind| count(session, kind))
}

/// Returns the names of all selected variables without a session, where `I*` is an error.
pub(crate) fn expand_offline(selections: &[Selection]) -> Result<Vec<String>, Failure> {
    names_of(selections, |kind| {
        let name = kind.name();
        Err(Failure::Input(format!(
            "{name}*: RAC does not tell how many variables there are; write a range such as {name}1-{name}50"
        )))
    })
}

/// Reads the number of variables of a kind, such as `@VAR_I_LEN`.
pub(crate) fn count(session: &mut Session, kind: VariableKind) -> Result<u32, Failure> {
    let name = format!("@VAR_{}_LEN", kind.name());
    let value = get_one(session, &ObjectPath::variable(&name)?)?;
    value.convert().ok().filter(|count| *count <= LONGEST).ok_or_else(|| Failure::Unexpected {
        message: format!("{name} is {}, which is not a number from 0 to {LONGEST}", describe(Some(&value))),
        hint: "use a range, such as I1-I50".into(),
    })
}
