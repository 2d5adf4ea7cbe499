//! The cases for devices, a file for each group.

mod arguments;
mod frames;
mod functions;
mod handles;
mod rac;
mod sessions;
mod slave;
mod tasks;
mod timeouts;
mod types;
mod udp;
mod variables;

use crate::case::Case;

/// Returns all cases, by group.
pub(crate) fn all() -> Vec<Case> {
    let mut cases = Vec::new();
    for table in [
        frames::CASES,
        arguments::CASES,
        types::CASES,
        sessions::CASES,
        timeouts::CASES,
        udp::CASES,
        handles::CASES,
        variables::CASES,
        tasks::CASES,
        slave::CASES,
        rac::CASES,
    ] {
        cases.extend_from_slice(table);
    }
    cases.extend(functions::cases());
    cases.extend(variables::system());
    cases.extend(slave::formats());
    cases.sort_by_key(Case::group);
    cases
}
