//! The current errors of a controller. While a stream of Slave Mode runs, nothing is sent that would end it.

use bcap_core::bcap::{FunctionId, StreamState};
use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, OwnedVariant, Variant};

use bcap_capture::value::data;

use crate::calls::{Calls, Failure, execute, needs_reconnect};
use crate::stream::StreamCheck;

/// The maximum number of errors that are read: each is a call.
const MOST: usize = 100;

/// Reads at most 100 current errors with their texts, the first cause first. The last text has the number of further errors.
/// Errors that another client clears during the reading are left out.
///
/// # Errors
///
/// [`Failure::skipped`] while a stream runs, or the error of a call.
pub fn present<C: Calls>(calls: &mut C, check: &mut StreamCheck) -> Result<Vec<(HResult, String)>, C::Error> {
    let mut count = count(calls, check)?;
    loop {
        // the last error is the first cause
        let errors = (0..count).rev().take(MOST).map(|index| error(calls, check, index)).collect::<Result<Vec<_>, _>>();
        let failure = match errors {
            Ok(errors) => return Ok(with_rest(errors, count)),
            Err(failure) if failure.code().is_none() || needs_reconnect(&failure) => return Err(failure),
            Err(failure) => failure,
        };
        let left = self::count(calls, check)?;
        if left >= count {
            return Err(failure);
        }
        count = left;
    }
}

/// Adds the number of errors that were not read to the last text.
fn with_rest(mut errors: Vec<(HResult, String)>, count: i32) -> Vec<(HResult, String)> {
    let left = usize::try_from(count).unwrap_or(0).saturating_sub(MOST);
    if let Some((_, text)) = errors.last_mut().filter(|_| left > 0) {
        *text = format!("{text} (and {left} further errors)");
    }
    errors
}

/// Reads the number of current errors.
///
/// # Errors
///
/// Same as [`present`].
pub fn count<C: Calls>(calls: &mut C, check: &mut StreamCheck) -> Result<i32, C::Error> {
    let count = checked(calls, check, "GetCurErrorCount", &())?;
    Ok(count.as_variant().as_i32().unwrap_or(0).max(0))
}

/// Reads a current error and its text.
///
/// # Errors
///
/// Same as [`present`].
pub fn error<C: Calls>(calls: &mut C, check: &mut StreamCheck, index: i32) -> Result<(HResult, String), C::Error> {
    let info = checked(calls, check, "GetCurErrorInfo", &index)?;
    let elements: Vec<Variant<'_>> = info.as_variant().as_array().map(|info| info.iter().collect()).unwrap_or_default();
    let code = elements.first().and_then(|code| code.as_i32()).map(HResult);
    let message = elements.get(1).map(|message| data::format(*message)).unwrap_or_default();
    Ok((code.unwrap_or_default(), message))
}

/// Clears the errors.
///
/// # Errors
///
/// Same as [`present`].
pub fn clear<C: Calls>(calls: &mut C) -> Result<(), C::Error> {
    let mut check = StreamCheck::default();
    // any other answer lets the user clear: a controller with errors may refuse slvGetMode
    if check.ask(calls)? == StreamState::Runs {
        check.require(calls, FunctionId::CONTROLLER_EXECUTE, Some("ClearError"))?;
    }
    execute(calls, "ClearError", &()).map(drop)
}

/// Executes a command of the controller, unless it would end a stream.
///
/// # Errors
///
/// Same as [`present`].
pub fn checked<C: Calls>(
    calls: &mut C,
    check: &mut StreamCheck,
    command: &str,
    parameter: &impl Encode,
) -> Result<OwnedVariant, C::Error> {
    check.require(calls, FunctionId::CONTROLLER_EXECUTE, Some(command))?;
    execute(calls, command, parameter)
}

/// Formats an error: its code, its meaning, and the controller's own text if that says something else.
#[must_use]
pub fn described(code: HResult, text: &str) -> String {
    let own = own(code, text);
    match code.meaning() {
        Some(meaning) if own.is_empty() => format!("{code} {meaning}"),
        Some(meaning) if !own.contains(meaning) => format!("{code} {meaning} The controller says: {own}"),
        _ => format!("{code} {own}").trim_end().to_owned(),
    }
}

/// Formats an error in one line.
#[must_use]
pub fn short(code: HResult, text: &str) -> String {
    let own = own(code, text);
    format!("{:#010X} {}", code.to_u32(), if own.is_empty() { code.meaning().unwrap_or_default() } else { own })
}

/// Returns the controller's own text; some controllers begin it with the name of the code.
#[must_use]
pub fn own(code: HResult, text: &str) -> &str {
    code.name().and_then(|name| text.strip_prefix(name)?.strip_prefix(": ")).unwrap_or(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_has_its_meaning_once_and_then_the_text_of_the_controller() {
        let (code, meaning) = (HResult::E_MOTOR_OFF, HResult::E_MOTOR_OFF.meaning().unwrap());
        for same in ["", meaning, &format!("E_MOTOR_OFF: {meaning}")] {
            assert_eq!(described(code, same), format!("{code} {meaning}"));
        }
        assert_eq!(described(code, "Motor is off."), format!("{code} {meaning} The controller says: Motor is off."));
        let unknown = HResult::from_u32(0x8550_F001);
        assert!(described(unknown, "New fault.").ends_with("published meaning. The controller says: New fault."));
        assert_eq!([described(HResult(-1), "text"), described(HResult(-1), "")], ["0xffffffff text", "0xffffffff"]);
    }
}
