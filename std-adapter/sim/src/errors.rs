//! The errors of the controller: the list of present errors, and the log of past errors and refused calls.

use std::collections::VecDeque;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

/// The capacity of each list; a full list drops its oldest entry.
const CAPACITY: usize = 256;

/// An error of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorEntry {
    /// Its code.
    pub code: HResult,
    /// When it occurred.
    pub at: Instant,
}

/// The line of a task's program at which an error has occurred.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SourceLine {
    pub(crate) program: String,
    /// From 1.
    pub(crate) line: i32,
}

/// An error, and where it occurred.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Occurrence {
    pub(crate) error: ErrorEntry,
    /// `None` for an error outside of tasks.
    pub(crate) place: Option<SourceLine>,
}

/// The lists of errors, both in reverse order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Errors {
    /// Index 0 of GetCurErrorInfo is the latest error, the greatest index the first cause.
    present: VecDeque<Occurrence>,
    log: VecDeque<Occurrence>,
}

impl Errors {
    /// Enters an error into both lists.
    pub(crate) fn raise(&mut self, code: HResult, at: Instant, place: Option<SourceLine>) {
        let occurrence = Occurrence { error: ErrorEntry { code, at }, place };
        push(&mut self.present, occurrence.clone());
        push(&mut self.log, occurrence);
    }

    /// Enters a refused call into the log only, if its code is one of the controller.
    pub(crate) fn refuse(&mut self, code: HResult, at: Instant) -> HResult {
        if code.level().is_some() {
            push(&mut self.log, Occurrence { error: ErrorEntry { code, at }, place: None });
        }
        code
    }

    pub(crate) fn clear(&mut self) {
        self.present.clear();
    }

    pub(crate) fn present(&self) -> &VecDeque<Occurrence> {
        &self.present
    }

    pub(crate) fn log(&self) -> &VecDeque<Occurrence> {
        &self.log
    }

    /// Returns the code of the latest error; `S_OK` without an error.
    pub(crate) fn code(&self) -> HResult {
        self.present.front().map_or(HResult::S_OK, |entry| entry.error.code)
    }
}

fn push<T>(list: &mut VecDeque<T>, entry: T) {
    list.truncate(CAPACITY - 1);
    list.push_front(entry);
}

/// Returns the description of a code that GetErrorDescription answers.
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
    fn the_lists_are_in_reverse_order_and_bounded() {
        let mut errors = Errors::default();
        for n in 0..300 {
            errors.raise(HResult::from_u32(0x8320_0000 + n), Instant::from_millis(n.into()), None);
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
