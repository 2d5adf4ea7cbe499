//! The system variables of the controller. The variables of the robot are in [`arm`](crate::arm), those for tasks in
//! [`tasks`](crate::tasks).
//!
//! Reading a variable that can only be written answers `E_ACCESSDENIED`, writing one that can only be read
//! `E_CAO_NOT_WRITABLE`. Variables without a function in this model have the value of an idle controller: `@DEADMAN_SW`
//! and `@TSR_BUSY_STATUS` are false, `@AUTO_ENABLE` is true, `@IO_ALLOC_MODE` is 0. A scenario sets `@PROTECTIVE_STOP`.
//! `@MAKER_NAME` is as on a real controller; `@FIRMWARE` is "bcap-sim", by which a client recognises a virtual one.
//! Writing `@VAR_I_LEN` and the like changes the number of variables immediately; `@VAR_IO_LEN` is read-only. `@LOCK`, the
//! machine lock, is stored but has no effect.

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::Variant;

use super::Controller;
use crate::answer::{Answer, Answered};
use crate::errors::description;
use crate::table::Property;
use crate::value::{TRUTH, ValueResult, one_int, owned, truth};

type ControllerGetter = fn(&Controller) -> ValueResult;
type ControllerSetter = fn(&mut Controller, PeerId, &Variant<'_>) -> Answered;

const fn read(name: &'static str, get: ControllerGetter) -> Property<ControllerGetter, ControllerSetter> {
    Property::read(name, get)
}

/// The variables, in the order of Controller_GetVariableNames.
pub(super) const VARIABLES: &[Property<ControllerGetter, ControllerSetter>] = &[
    read("@MODE", |controller| owned(controller.mode() as i32)),
    read("@LOCK", |controller| owned(controller.locked)).and_write(put_lock, TRUTH),
    // the count of milliseconds wraps as a 32-bit counter does
    read("@TIME", |controller| owned((controller.shared.now.as_micros() / 1000) as i32)),
    read("@CURRENT_TIME", |controller| owned(controller.config().date(controller.shared.now)?)),
    read("@BUSY_STATUS", |controller| owned(controller.is_busy())),
    read("@TSR_BUSY_STATUS", |_| owned(false)),
    read("@NORMAL_STATUS", |controller| owned(code(controller).is_ok())),
    read("@ERROR_CODE", |controller| owned(code(controller).0)).and_write(put_error_code, "0, which clears the errors"),
    read("@ERROR_CODE_HEX", |controller| owned(format!("{:08X}", code(controller).to_u32()))),
    read("@ERROR_DESCRIPTION", |controller| {
        let code = code(controller);
        if code.is_ok() { owned("") } else { owned(description(code)) }
    }),
    read("@EMERGENCY_STOP", |controller| owned(controller.emergency_stopped())),
    read("@DEADMAN_SW", |_| owned(false)),
    read("@AUTO_ENABLE", |_| owned(true)),
    read("@PROTECTIVE_STOP", |controller| owned(controller.shared.panel.protective_stop)),
    read("@MAKER_NAME", |_| owned("DENSO CORPORATION")),
    read("@TYPE", |controller| owned(&controller.config().model.controller_type)),
    read("@VERSION", |controller| owned(&controller.config().version)),
    read("@FIRMWARE", |_| owned("bcap-sim")),
    read("@SERIAL_NO", |controller| owned(&controller.config().serial_number)),
    read("@IO_ALLOC_MODE", |_| owned(0)),
    read("@VAR_I_LEN", |controller| size(controller, Kind::I))
        .and_write(|controller, _, value| put_size(controller, Kind::I, value), SIZE),
    read("@VAR_F_LEN", |controller| size(controller, Kind::F))
        .and_write(|controller, _, value| put_size(controller, Kind::F, value), SIZE),
    read("@VAR_D_LEN", |controller| size(controller, Kind::D))
        .and_write(|controller, _, value| put_size(controller, Kind::D, value), SIZE),
    read("@VAR_V_LEN", |controller| size(controller, Kind::V))
        .and_write(|controller, _, value| put_size(controller, Kind::V, value), SIZE),
    read("@VAR_P_LEN", |controller| size(controller, Kind::P))
        .and_write(|controller, _, value| put_size(controller, Kind::P, value), SIZE),
    read("@VAR_J_LEN", |controller| size(controller, Kind::J))
        .and_write(|controller, _, value| put_size(controller, Kind::J, value), SIZE),
    read("@VAR_T_LEN", |controller| size(controller, Kind::T))
        .and_write(|controller, _, value| put_size(controller, Kind::T, value), SIZE),
    read("@VAR_S_LEN", |controller| size(controller, Kind::S))
        .and_write(|controller, _, value| put_size(controller, Kind::S, value), SIZE),
    read("@VAR_IO_LEN", |controller| size(controller, Kind::Io)),
];

/// The largest number of variables of a kind.
const SIZE_MAX: u16 = 32_766;

const SIZE: &str = "one number, 1 to 32766";

fn put_size(controller: &mut Controller, kind: Kind, value: &Variant<'_>) -> Answered {
    let count =
        u16::try_from(one_int(value)?).ok().filter(|n| (1..=SIZE_MAX).contains(n)).ok_or(HResult::E_INVALIDARG)?;
    *controller.shared.config.sizes.of_mut(kind) = count;
    controller.shared.variables.resize(kind, count);
    Ok(Answer::Done)
}

fn size(controller: &Controller, kind: Kind) -> ValueResult {
    owned(i32::from(controller.config().sizes.of(kind)))
}

/// Returns the code of the latest error.
fn code(controller: &Controller) -> HResult {
    controller.shared.errors.code()
}

fn put_lock(controller: &mut Controller, _: PeerId, value: &Variant<'_>) -> Answered {
    controller.locked = truth(value)?;
    Ok(Answer::Done)
}

fn put_error_code(controller: &mut Controller, peer: PeerId, value: &Variant<'_>) -> Answered {
    match one_int(value)? {
        0 => controller.clear_error(peer),
        _ => Err(HResult::E_INVALIDARG),
    }
}
