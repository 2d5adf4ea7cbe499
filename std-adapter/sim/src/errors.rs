//! The controller's errors: those present, newest first, and the log of all that have been.

use std::collections::VecDeque;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

/// How many entries either list holds; the oldest give way.
const CAPACITY: usize = 256;

/// An error of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorEntry {
    /// Its code.
    pub code: HResult,
    /// When it occurred.
    pub at: Instant,
}

/// The lists of errors.
#[derive(Clone, Debug, Default)]
pub(crate) struct Errors {
    /// The newest first: index 0 of GetCurErrorInfo is the last error, the greatest index the first cause.
    present: VecDeque<ErrorEntry>,
    log: VecDeque<ErrorEntry>,
}

impl Errors {
    /// Enters an error into both lists.
    pub(crate) fn raise(&mut self, code: HResult, at: Instant) {
        push(&mut self.present, ErrorEntry { code, at });
        self.note(code, at);
    }

    /// Enters a refused call into the log only.
    pub(crate) fn note(&mut self, code: HResult, at: Instant) {
        push(&mut self.log, ErrorEntry { code, at });
    }

    pub(crate) fn clear(&mut self) {
        self.present.clear();
    }

    pub(crate) fn present(&self) -> &VecDeque<ErrorEntry> {
        &self.present
    }

    pub(crate) fn log(&self) -> &VecDeque<ErrorEntry> {
        &self.log
    }

    /// Returns the newest error's code, `S_OK` when there is none.
    pub(crate) fn code(&self) -> HResult {
        self.present.front().map_or(HResult::S_OK, |entry| entry.code)
    }
}

fn push(list: &mut VecDeque<ErrorEntry>, entry: ErrorEntry) {
    list.truncate(CAPACITY - 1);
    list.push_front(entry);
}

/// Returns a sentence about a code, as GetErrorDescription gives it.
pub(crate) fn description(code: HResult) -> String {
    let meaning = code.meaning().unwrap_or("An error without a published description.");
    match (code.name(), code.axis()) {
        (Some(name), _) => format!("{name}: {meaning}"),
        (None, Some(axis)) => format!("J{axis}: {meaning}"),
        (None, None) => meaning.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_comes_first_and_the_lists_are_bounded() {
        let mut errors = Errors::default();
        for n in 0..300 {
            errors.raise(HResult::from_u32(0x8320_0000 + n), Instant::from_millis(n.into()));
        }
        assert_eq!(errors.code(), HResult::from_u32(0x8320_0000 + 299));
        assert_eq!(errors.present().len(), CAPACITY);
        errors.clear();
        assert_eq!(errors.code(), HResult::S_OK);
        assert_eq!(errors.log().len(), CAPACITY);
    }

    #[test]
    fn descriptions_name_code_and_axis() {
        assert!(description(HResult::E_MOTOR_OFF).starts_with("E_MOTOR_OFF: "));
        assert!(description(HResult::from_u32(0x8320_4073)).starts_with("J3: "));
        assert!(!description(HResult::from_u32(0xc000_0001)).is_empty());
    }
}
