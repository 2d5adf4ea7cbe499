//! System variables, errors, commands and tasks over the handler of b-CAP.

use std::time::Duration;

use bcap_core::bcap::call::{self, VariableHandle};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::{OleDate, Variant};
use bcap_sim::codes::MANUAL_MODE;
use bcap_sim::{Config, Mode, Profile, Scenario, SysStateBit, TaskStatus, Token};

use crate::common::{Client, Value, World, code, ok, value};

#[test]
fn system_variables_have_their_types() {
    let mut world = World::with(Config { wall_clock_origin_ms: 1_700_000_000_000, ..Config::new(Profile::Rc9) });
    let client = world.client(1);
    world.pass(1234);
    let date = OleDate::from_unix_millis(1_700_000_001_234).unwrap();
    let expected: [(&str, Value); 20] = [
        ("@MODE", value(&3)),
        ("@LOCK", value(&false)),
        ("@TIME", value(&1234)),
        ("@CURRENT_TIME", value(&date)),
        ("@BUSY_STATUS", value(&false)),
        ("@TSR_BUSY_STATUS", value(&false)),
        ("@NORMAL_STATUS", value(&true)),
        ("@ERROR_CODE", value(&0)),
        ("@ERROR_CODE_HEX", value("00000000")),
        ("@ERROR_DESCRIPTION", value("")),
        ("@EMERGENCY_STOP", value(&false)),
        ("@DEADMAN_SW", value(&false)),
        ("@AUTO_ENABLE", value(&true)),
        ("@PROTECTIVE_STOP", value(&false)),
        ("@TYPE", value("RC9")),
        ("@SERIAL_NO", value("VIRTUAL")),
        ("@VERSION", value("1.4.0")),
        ("@MAKER_NAME", value("DENSO CORPORATION")),
        ("@FIRMWARE", value("bcap-sim")),
        ("@IO_ALLOC_MODE", value(&0)),
    ];
    for (name, value) in expected {
        assert_eq!(world.get(client, name), (HResult::S_OK, value), "{name}");
        if !["@LOCK", "@ERROR_CODE"].contains(&name) {
            assert_eq!(world.put(client, name, 1), HResult::E_CAO_NOT_WRITABLE, "{name}");
        }
    }
    assert_eq!(world.put(client, "@LOCK", true), HResult::S_OK);
    assert_eq!(world.get(client, "@LOCK"), ok(&true));
    assert_eq!(world.put(client, "@LOCK", "yes"), HResult::E_INVALIDARGTYPE);
}

#[test]
fn errors_are_listed_newest_first_with_the_first_cause_last() {
    let mut world = World::new();
    let client = world.client(1);
    let (first, second) = (HResult::E_SLVMODE_ON, HResult::E_SLVMODE_OFF);
    world.sim.inject_error(first, Instant::from_millis(10));
    world.sim.inject_error(second, Instant::from_millis(20));
    assert_eq!(world.execute(client, "GetCurErrorCount", ()), ok(&2));
    assert_eq!(world.get(client, "@ERROR_CODE"), ok(&second.0));
    assert_eq!(world.get(client, "@ERROR_CODE_HEX"), ok("83500121"));
    assert_eq!(world.get(client, "@NORMAL_STATUS"), ok(&false));

    let text = |world: &mut World, code: HResult| {
        let (_, value) = world.execute(client, "GetErrorDescription", code.0);
        value.as_variant().as_bstr().unwrap().to_string()
    };
    assert!(text(&mut world, first).contains("refused in slave mode"));
    for (index, code, millis) in [(0, second, 20), (1, first, 10)] {
        let message = text(&mut world, code);
        let at = OleDate::from_unix_millis(millis).unwrap();
        let expected = ok(&(code.0, message.as_str(), code.0, 0, "", 0, 0, at));
        assert_eq!(world.execute(client, "GetCurErrorInfo", index), expected);
    }
    assert_eq!(world.execute(client, "GetCurErrorInfo", 2), code(HResult::DISP_E_BADINDEX));
    assert_eq!(world.execute(client, "GetCurErrorInfo", -1), code(HResult::DISP_E_BADINDEX));
    assert_eq!(world.execute(client, "GetCurErrorInfo", ()), code(HResult::E_INVALIDARG));

    assert_eq!(world.execute(client, "clearerror", ()), ok(&()));
    assert_eq!(world.execute(client, "GetCurErrorCount", ()), ok(&0));
    assert_eq!(world.get(client, "@ERROR_CODE"), ok(&0));
    assert_eq!(world.execute(client, "GetErrorLogCount", ()), ok(&2));
}

#[test]
fn the_log_has_the_time_and_the_message() {
    let mut world = World::with(Config { wall_clock_origin_ms: 0, ..Config::default() });
    let client = world.client(1);
    world.sim.inject_error(HResult::E_MOTOR_OFF, Instant::from_millis(86_400_000 + 3_723_004));
    let (_, entry) = world.execute(client, "GetErrorLog", 0);
    let items: Vec<_> = entry.as_variant().as_array().unwrap().iter().collect();
    assert_eq!(items.len(), 15);
    let numbers: Vec<_> = items[..10].iter().map(|n| n.as_i32().unwrap()).collect();
    // a Friday
    assert_eq!(numbers, [HResult::E_MOTOR_OFF.0, 1970, 1, 5, 2, 1, 2, 3, 4, 90_123_004]);
    assert!(items[12].as_bstr().unwrap().to_string().starts_with("E_MOTOR_OFF"));
    assert_eq!(world.execute(client, "GetErrorLog", 1), code(HResult::DISP_E_BADINDEX));
}

#[test]
fn a_written_error_code_of_zero_clears() {
    let mut world = World::new();
    let client = world.client(1);
    world.sim.inject_error(HResult::E_MOTOR_OFF, world.now);
    assert_eq!(world.put(client, "@ERROR_CODE", 5), HResult::E_INVALIDARG);
    assert_eq!(world.get(client, "@ERROR_CODE"), ok(&HResult::E_MOTOR_OFF.0));
    assert_eq!(world.put(client, "@ERROR_CODE", 0_i64), HResult::S_OK);
    assert_eq!(world.get(client, "@ERROR_CODE"), ok(&0));
}

#[test]
fn descriptions_take_a_code_in_any_form() {
    let mut world = World::new();
    let client = world.client(1);
    let expected = world.execute(client, "GetErrorDescription", HResult::E_MOTOR_OFF.0);
    assert_eq!(expected.0, HResult::S_OK);
    assert_eq!(world.execute(client, "GetErrorDescription", HResult::E_MOTOR_OFF), expected);
    assert_eq!(world.execute(client, "GetErrorDescription", HResult::E_MOTOR_OFF.to_u32()), expected);
    assert_eq!(world.execute(client, "GetErrorDescription", i64::from(HResult::E_MOTOR_OFF.to_u32())), expected);
    assert_eq!(world.execute(client, "GetErrorDescription", u64::MAX), code(HResult::E_INVALIDARGTYPE));
    assert_eq!(world.execute(client, "GetErrorDescription", true), code(HResult::E_INVALIDARGTYPE));
}

fn state(world: &mut World, client: Client) -> Vec<u32> {
    let (_, value) = world.execute(client, "SysState", ());
    let Variant::I4(bits) = value.as_variant() else { panic!("SysState is {value:?}") };
    (0..32).filter(|n| bits >> n & 1 != 0).collect()
}

#[test]
fn sys_state_tells_each_thing_by_its_bit() {
    let mut world = World::new();
    let client = world.client(1);
    let quiet = [
        SysStateBit::Initialized,
        SysStateBit::Auto,
        SysStateBit::TokenOutside,
        SysStateBit::AutoEnable,
        SysStateBit::Calibrated,
    ];
    let mut expected = quiet.map(|bit| bit as u32).to_vec();
    assert_eq!(state(&mut world, client), expected);

    world.robot(client, "Motor", 1);
    expected.push(SysStateBit::ServoOn as u32);
    expected.sort_unstable();
    assert_eq!(state(&mut world, client), expected);

    world.sim.emergency_stop(true, world.now);
    world.sim.set_mode(Mode::TeachCheck, world.now);
    world.sim.set_token(Token::TeachPendant);
    let stopped = [
        SysStateBit::Initialized,
        SysStateBit::EmergencyStop,
        SysStateBit::AutoEnable,
        SysStateBit::Calibrated,
        SysStateBit::Manual,
    ];
    assert_eq!(state(&mut world, client), stopped.map(|bit| bit as u32));
    assert_eq!(world.get(client, "@MODE"), ok(&2));
    assert_eq!(world.execute(client, "SysInfo", 0), ok("VIRTUAL"));
    assert_eq!(world.execute(client, "SysInfo", 15), ok(&0));
    assert_eq!(world.execute(client, "SysInfo", 17), code(HResult::E_INVALIDARG));
}

#[test]
fn a_scenario_sets_the_warnings_of_sys_state() {
    let mut world = World::new();
    let client = world.client(1);
    let before = state(&mut world, client);
    let text = "[controller]\nbattery_low = true\nwarning = true\nprotective_stop = true";
    world.sim.play(Scenario::parse(text).unwrap());
    let set: Vec<_> = state(&mut world, client).into_iter().filter(|bit| !before.contains(bit)).collect();
    assert_eq!(set, [SysStateBit::Battery, SysStateBit::Warning, SysStateBit::ProtectiveStop].map(|bit| bit as u32));
    assert_eq!(world.execute(client, "SysInfo", 15), ok(&-1));
    assert_eq!(world.get(client, "@PROTECTIVE_STOP"), ok(&true));
}

#[test]
fn sys_state_tells_that_the_robot_brakes_for_halt() {
    let mut world = World::new();
    let client = world.mover(1);
    world.call(client.peer, call::robot_move(client.robot, 1, "J(90,45,90,0,45,0)", "NEXT"));
    world.pass(200);
    assert!(!state(&mut world, client).contains(&(SysStateBit::Stopping as u32)));
    world.begin(client.peer, &call::robot_halt(client.robot, ""));
    assert!(state(&mut world, client).contains(&(SysStateBit::Stopping as u32)));
    world.pass(2000);
    assert!(!state(&mut world, client).contains(&(SysStateBit::Stopping as u32)));
}

#[test]
fn a_task_runs_on_the_given_clock() {
    let mut world = World::with(Config { task_cycle: Duration::from_millis(200), ..Config::default() });
    let client = world.client(1);
    let task = world.task(client, "pro1");
    let status = call::task_execute(task, "GetStatus", ());
    let get = |world: &mut World, name: &str| {
        let handle = VariableHandle(world.handle(client.peer, call::task_get_variable(task, name, "")));
        world.call(client.peer, call::variable_get_value(handle))
    };
    assert_eq!(world.call(client.peer, &status), ok(&2));
    assert_eq!(world.call(client.peer, call::task_start(task, 1, "")), code(HResult::S_OK));
    world.pass(50);
    assert_eq!(world.call(client.peer, &status), ok(&3));
    assert_eq!(get(&mut world, "@LINE_NO"), ok(&[3, 0]));
    assert_eq!(get(&mut world, "@CYCLE_TIME"), ok(&200));
    assert_eq!(get(&mut world, "@ELAPSED_TIME"), ok(&50));
    assert_eq!(get(&mut world, "@PRIORITY"), code(HResult::E_ACCESSDENIED));
    assert_eq!(world.get(client, "@BUSY_STATUS"), ok(&true));
    assert!(state(&mut world, client).contains(&(SysStateBit::Running as u32)));
    assert!(!state(&mut world, client).contains(&(SysStateBit::CycleComplete as u32)));
    let again = call::task_start(task, 2, "");
    assert_eq!(world.call(client.peer, again), code(HResult::E_CAO_CMD_EXECUTE));
    world.pass(150);
    assert_eq!(world.call(client.peer, &status), ok(&2));
    assert_eq!(world.sim.task("Pro1"), Some((TaskStatus::Ready, 1)));
    assert!(state(&mut world, client).contains(&(SysStateBit::CycleComplete as u32)));
    assert_eq!(world.call(client.peer, call::task_stop(task, 0, "")), code(HResult::S_FALSE));
    assert_eq!(world.call(client.peer, call::task_start(task, 5, "")), code(HResult::E_INVALIDARG));
    assert_eq!(world.call(client.peer, call::task_stop(task, 5, "")), code(HResult::E_INVALIDARG));
    assert_eq!(world.call(client.peer, call::task_execute(task, "Dance", ())), code(HResult::E_INVALID_CMD_NAME));
    assert_eq!(world.call(client.peer, call::task_get_file_name(task)), ok("Pro1.pcs"));
}

#[test]
fn a_task_stops_as_it_is_told() {
    // mode of Task_Stop, status soon after, status at the end
    let cases = [
        (0, TaskStatus::Suspended, TaskStatus::Suspended),
        (1, TaskStatus::Suspended, TaskStatus::Suspended),
        (2, TaskStatus::Running, TaskStatus::StepStop),
        (3, TaskStatus::Running, TaskStatus::Ready),
        (4, TaskStatus::Ready, TaskStatus::Ready),
    ];
    for (mode, soon, late) in cases {
        let mut world = World::new();
        let client = world.client(1);
        let task = world.task(client, "Pro2");
        world.call(client.peer, call::task_start(task, 2, ""));
        world.pass(2550);
        assert!(!state(&mut world, client).contains(&(SysStateBit::ContinueStart as u32)));
        assert_eq!(world.call(client.peer, call::task_stop(task, mode, "")), code(HResult::S_OK));
        world.pass(1);
        assert_eq!(world.sim.task("Pro2").map(|t| t.0), Some(soon), "mode {mode}");
        world.pass(2000);
        assert_eq!(world.sim.task("Pro2").map(|t| t.0), Some(late), "mode {mode}");
        let stopped = matches!(late, TaskStatus::Suspended | TaskStatus::StepStop);
        assert_eq!(state(&mut world, client).contains(&(SysStateBit::ContinueStart as u32)), stopped, "mode {mode}");
        assert_eq!(world.sim.task("Pro1"), Some((TaskStatus::Ready, 0)));
    }
}

#[test]
fn tasks_need_what_motions_need_and_are_stopped_by_errors() {
    let mut world = World::new();
    let client = world.client(1);
    let task = world.task(client, "Pro3");
    let start = || call::task_start(task, 2, "");
    world.sim.set_mode(Mode::Manual, world.now);
    assert_eq!(world.call(client.peer, start()), code(MANUAL_MODE));
    world.sim.set_mode(Mode::Auto, world.now);
    world.sim.set_token(Token::TeachPendant);
    assert_eq!(world.call(client.peer, start()), code(HResult::E_TOKEN_NOT_ETHERNET));
    world.sim.set_token(Token::Any);
    assert_eq!(world.call(client.peer, start()), code(HResult::E_ERROR_PRESENT));
    world.execute(client, "ClearError", ());
    assert_eq!(world.call(client.peer, start()), code(HResult::S_OK));
    // level 1 lets them run, level 2 suspends, level 4 resets
    world.sim.inject_error(HResult::from_u32(0x8150_0001), world.now);
    assert_eq!(world.sim.task("Pro3").map(|t| t.0), Some(TaskStatus::Running));
    world.sim.inject_error(HResult::from_u32(0x8220_0001), world.now);
    assert_eq!(world.sim.task("Pro3").map(|t| t.0), Some(TaskStatus::Suspended));
    world.execute(client, "ClearError", ());
    assert_eq!(world.call(client.peer, start()), code(HResult::S_OK));
    world.sim.inject_error(HResult::from_u32(0x8420_0001), world.now);
    assert_eq!(world.sim.task("Pro3").map(|t| t.0), Some(TaskStatus::Ready));
    world.clear(client);
    assert_eq!(world.call(client.peer, start()), code(HResult::S_OK));
    world.sim.emergency_stop(true, world.now);
    assert_eq!(world.sim.task("Pro3").map(|t| t.0), Some(TaskStatus::Ready));
}

#[test]
fn tasks_start_and_stop_through_variables() {
    let mut world = World::new();
    let client = world.client(1);
    let task = world.task(client, "Pro1");
    let mut open = |name| VariableHandle(world.handle(client.peer, call::task_get_variable(task, name, "")));
    let (start, stop, status) = (open("@START"), open("@Stop"), open("@STATUS"));
    assert_eq!(world.call(client.peer, call::variable_put_value(start, 2)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::variable_get_value(status)), ok(&3));
    assert_eq!(world.call(client.peer, call::variable_put_value(stop, 1)), code(HResult::S_OK));
    assert_eq!(world.call(client.peer, call::variable_get_value(status)), ok(&1));
    assert_eq!(world.call(client.peer, call::variable_put_value(status, 1)), code(HResult::E_CAO_NOT_WRITABLE));
    assert_eq!(world.call(client.peer, call::variable_get_value(start)), code(HResult::E_ACCESSDENIED));
}
