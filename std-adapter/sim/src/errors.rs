//! The errors of the controller: the list of current errors, and the log of all errors. A refused call is an error.

use std::collections::VecDeque;

use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::levels::Effects;

/// The capacity of each list; a full list drops its oldest entry.
const CAPACITY: usize = 1000;

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

/// The originator of an error, with its number in the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Origin {
    Controller = 0,
    Client = 3,
    Task = 4,
}

/// An error, and where it occurred.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Occurrence {
    pub(crate) error: ErrorEntry,
    pub(crate) origin: Origin,
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
    /// Enters an error into the log, and into the list of current errors, which contains each refusal of a client only once.
    /// Returns whether the error is new in the list.
    pub(crate) fn enter(&mut self, occurrence: Occurrence) -> bool {
        let code = occurrence.error.code;
        let again = occurrence.origin == Origin::Client && self.has(code);
        let is_new = Effects::of(code).is_present && !again;
        if is_new {
            push(&mut self.present, occurrence.clone());
        }
        push(&mut self.log, occurrence);
        is_new
    }

    /// Removes the errors that ClearError can remove.
    pub(crate) fn clear(&mut self) {
        self.present.retain(|entry| Effects::of(entry.error.code).lasts);
    }

    /// Returns whether an error is present.
    pub(crate) fn has(&self, code: HResult) -> bool {
        self.present.iter().any(|entry| entry.error.code == code)
    }

    /// Returns the latest error that ClearError cannot remove.
    pub(crate) fn lasting(&self) -> Option<HResult> {
        self.present.iter().map(|entry| entry.error.code).find(|code| Effects::of(*code).lasts)
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

    fn occurrence(code: u32, origin: Origin) -> Occurrence {
        let error = ErrorEntry { code: HResult::from_u32(code), at: Instant::ZERO };
        Occurrence { error, origin, place: None }
    }

    #[test]
    fn a_refusal_is_present_once_a_notice_never_and_a_fault_stays() {
        let mut errors = Errors::default();
        for (code, is_new) in [(0x8150_1003, true), (0x8150_1003, false), (0x8020_1418, false), (0x8540_0001, true)] {
            assert_eq!(errors.enter(occurrence(code, Origin::Client)), is_new, "{code:#X}");
        }
        assert_eq!((errors.present().len(), errors.log().len()), (2, 4));
        errors.clear();
        assert_eq!((errors.code(), errors.lasting()), (HResult::from_u32(0x8540_0001), Some(errors.code())));
    }

    #[test]
    fn the_lists_are_in_reverse_order_and_bounded() {
        let mut errors = Errors::default();
        for n in 0..1100 {
            errors.enter(occurrence(0x8320_0000 + n, Origin::Controller));
        }
        assert_eq!(errors.code(), HResult::from_u32(0x8320_0000 + 1099));
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
