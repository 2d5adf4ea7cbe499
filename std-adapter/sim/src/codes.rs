//! The codes of the controller's refusals that have no constant in [`HResult`].
//!
//! "seen" is the error log of a real RC8A with a VS087A4, in a public repository (jtcass01/denso_api); "listed" is the maker's
//! list of error codes, in the repository nkawa/Denso_CobottaPro900_MQTT_Control.

use bcap_core::hresult::HResult;

/// The command needs Auto mode. Seen.
pub const MANUAL_MODE: HResult = HResult::from_u32(0x8150_1012);
/// The emergency stop is pressed. Seen.
pub const EMERGENCY_STOP: HResult = HResult::from_u32(0x8150_101A);
/// The emergency stop is pressed: the answer to ManualReset. Seen by a public program on a COBOTTA PRO.
pub const RESET_IN_EMERGENCY_STOP: HResult = HResult::from_u32(0x8350_0178);
/// An error of level 5 is present. Seen.
pub const FAULT_PRESENT: HResult = HResult::from_u32(0x8250_1009);
/// An argument of a motion has a wrong value, text or type, or is missing. Seen 52 times in one log, which has none of the listed
/// codes 0x8150001C to 0x81500027 for missing arguments and for the argument n.
pub const WRONG_ARGUMENT: HResult = HResult::from_u32(0x8150_001B);
/// The arm group of TakeArm does not exist. Listed.
pub const UNDEFINED_GROUP: HResult = HResult::from_u32(0x8350_0003);
/// The client owns another arm group. Seen.
pub const OTHER_GROUP: HResult = HResult::from_u32(0x8350_0042);
/// The second number of TakeArm is not 0 or 1. Listed.
pub const WRONG_KEEP: HResult = HResult::from_u32(0x8350_3010);
/// Robot_Change during a motion. Listed.
pub const CHANGE_IN_MOTION: HResult = HResult::from_u32(0x8350_010F);
/// A task owns the arm. Listed.
pub const ARM_OF_TASK: HResult = HResult::from_u32(0x8350_0079);
/// The goal of a motion is out of reach. Seen.
pub const UNREACHABLE: HResult = HResult::from_u32(0x8320_1501);
/// A straight path is too near to a singular point. Seen.
pub const SINGULAR: HResult = HResult::from_u32(0x8320_1504);
/// A straight path ends in another figure. Listed.
pub const OTHER_FIGURE: HResult = HResult::from_u32(0x8320_1401);
/// The goal of a motion is beyond the limit of axis n, the last digit. Seen.
pub const GOAL_BEYOND_LIMIT: HResult = HResult::from_u32(0x8320_4230);
/// Axis n, the last digit, passes its limit on the way. Listed.
pub const PATH_BEYOND_LIMIT: HResult = HResult::from_u32(0x8320_4070);
/// A pose to be converted is out of reach. Listed.
pub const CONVERSION_UNREACHABLE: HResult = HResult::from_u32(0x8120_1503);
/// A pose to be converted is singular. Listed.
pub const CONVERSION_SINGULAR: HResult = HResult::from_u32(0x8120_1506);
/// A pose to be converted is beyond the limit of axis n, the last digit. Listed.
pub const CONVERSION_BEYOND_LIMIT: HResult = HResult::from_u32(0x8120_4120);

/// Returns the code of a range for an axis, counted from 0.
pub(crate) const fn of_axis(range: HResult, axis: u32) -> HResult {
    HResult::from_u32(range.to_u32() + axis + 1)
}
