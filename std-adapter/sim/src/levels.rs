//! The effects of an error, by its level: the second digit of its code.
//!
//! | level | what it is | motion | motor | tasks | cleared by ClearError |
//! |---|---|---|---|---|---|
//! | 0 | a notice, in the log only | continues | stays | continue | nothing to clear |
//! | 1 | a refused call | continues | stays | continue | yes |
//! | 2 | a limit of manual operation | stops immediately | stays | suspended | yes |
//! | 3 | an error of a motion | stops immediately | off | reset | yes |
//! | 4 | an error of speed, current or Slave Mode | stops immediately | off | reset | yes |
//! | 5 | a fault of the controller | stops immediately | off | reset | no |
//!
//! Some codes of higher levels only refuse a call, and have the effects of level 1. A full buffer of Slave Mode is a notice.

use std::ops::RangeInclusive;

use bcap_core::hresult::HResult;

/// The effect of an error on the tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TaskStop {
    Continue,
    Suspend,
    Reset,
}

/// The effects of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Effects {
    /// It is in the list of current errors until ClearError.
    pub(crate) is_present: bool,
    /// Motions and Slave Mode stop immediately.
    pub(crate) stops: bool,
    pub(crate) motor_off: bool,
    pub(crate) tasks: TaskStop,
    /// ClearError does not remove it.
    pub(crate) lasts: bool,
}

const NOTICE: Effects =
    Effects { is_present: false, stops: false, motor_off: false, tasks: TaskStop::Continue, lasts: false };
const REFUSAL: Effects = Effects { is_present: true, ..NOTICE };
const STOP: Effects = Effects { stops: true, tasks: TaskStop::Suspend, ..REFUSAL };
const ERROR: Effects = Effects { motor_off: true, tasks: TaskStop::Reset, ..STOP };
const FAULT: Effects = Effects { lasts: true, ..ERROR };

/// The effects of the levels 0 to 5.
const LEVELS: [Effects; 6] = [NOTICE, REFUSAL, STOP, ERROR, ERROR, FAULT];

/// Codes above level 1 that only refuse a call: by the state of the controller, the token and the arm; a stopped motion; a pose
/// without Slave Mode; Robot_Change; ManualReset; TakeArm; electric hands.
const REFUSALS: [RangeInclusive<u32>; 12] = [
    0x8250_1000..=0x8250_1FFF,
    0x8350_1000..=0x8350_1031,
    // 0x83501032 ends Slave Mode
    0x8350_1033..=0x8350_1FFF,
    0x8350_0003..=0x8350_0003,
    0x8350_0042..=0x8350_0042,
    0x8350_0076..=0x8350_0079,
    0x8350_010F..=0x8350_010F,
    0x8350_0121..=0x8350_0121,
    0x8350_0178..=0x8350_0178,
    0x8350_0372..=0x8350_0372,
    0x8350_3010..=0x8350_3010,
    0x8358_5000..=0x8358_7FFF,
];

impl Effects {
    /// Returns the effects of a code; one that is not of the controller stops as level 2 does.
    pub(crate) fn of(code: HResult) -> Self {
        if code == HResult::E_BUF_FULL {
            // the pose is sent again
            return NOTICE;
        }
        if REFUSALS.iter().any(|range| range.contains(&code.listed().to_u32())) {
            return REFUSAL;
        }
        code.level().and_then(|level| LEVELS.get(usize::from(level))).copied().unwrap_or(STOP)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_of_higher_levels_touch_nothing() {
        let of = |code| Effects::of(HResult::from_u32(code));
        for code in [0x8150_1003, 0x8250_1009, 0x8350_1024, 0x8350_1029, 0x8350_0076, 0xC350_1024] {
            assert_eq!(of(code), REFUSAL, "{code:#X}");
        }
        assert_eq!([of(0x8350_1032), of(0x8320_1501), of(0x8420_1486)], [ERROR; 3]);
        assert_eq!([of(0x8020_1418), of(0x8220_4011), of(0x8540_0001)], [NOTICE, STOP, FAULT]);
        assert_eq!(of(0x8000_4005), STOP);
    }
}
