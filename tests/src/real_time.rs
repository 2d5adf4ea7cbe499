//! Tests of streams in real time on a busy machine.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

/// The attempts of [`repeated`].
const ATTEMPTS: usize = 10;

/// The messages of a starved stream: the buffer of the controller ran empty, its reply was late, or the tools that run next to
/// the stream were too slow for it.
const STARVED: [&str; 3] =
    ["E_COMMAND_BUFFER_EMPTY", "slvMove: no reply in time", "the stream was over before the tools"];

/// Repeats a test in real time if its stream was starved: on a busy machine a pose can be so late that the buffer of the
/// controller is empty, or a reply so late that the stream ends. Such a stream says nothing about the code under test. Any
/// other failure is final.
///
/// # Panics
///
/// As the test, or when each of ten streams was starved.
pub fn repeated(test: impl Fn()) {
    for attempt in 1..=ATTEMPTS {
        let Err(panic) = catch_unwind(AssertUnwindSafe(&test)) else { return };
        if attempt == ATTEMPTS || !STARVED.iter().any(|text| message(&*panic).contains(text)) {
            resume_unwind(panic);
        }
        eprintln!("attempt {attempt}: the machine was too busy for the stream");
    }
}

fn message(panic: &(dyn Any + Send)) -> &str {
    match panic.downcast_ref::<String>() {
        Some(text) => text,
        None => panic.downcast_ref::<&str>().copied().unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn only_a_starved_stream_is_repeated() {
        let runs = Cell::new(0);
        repeated(|| {
            runs.set(runs.get() + 1);
            assert!(runs.get() >= 3, "{}", STARVED[runs.get() - 1]);
        });
        assert_eq!(runs.get(), 3);
        let other = catch_unwind(|| repeated(|| panic!("the robot moves")));
        assert_eq!(message(&*other.unwrap_err()), "the robot moves");
    }
}
