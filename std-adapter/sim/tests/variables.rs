//! Sessions, handles and variables over the handler of b-CAP.

use bcap_core::bcap::call::{self, CommandHandle, ControllerHandle, RobotHandle, TaskHandle, VariableHandle};
use bcap_core::bcap::server::Handler as _;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::variant::{Encode, Null, OleDate};
use bcap_sim::{Config, Permission, Profile, Sizes};

use crate::common;
use crate::common::{World, code, ok, value};

#[test]
fn a_session_has_the_handles_of_the_guide() {
    let mut world = World::new();
    let peer = PeerId(7);
    assert_eq!(world.call(peer, call::service_start("")), code(HResult::S_OK));
    let connect = call::controller_connect("b-CAP", "CaoProv.DENSO.VRC", "192.168.0.1", "");
    assert_eq!(world.call(peer, connect), ok(&2));
    let controller = ControllerHandle(2);
    assert_eq!(world.call(peer, call::controller_get_variable(controller, "IO150", "")), ok(&3));
    let io = VariableHandle(3);
    assert_eq!(world.call(peer, call::variable_get_value(io)), ok(&false));
    assert_eq!(world.call(peer, call::variable_put_value(io, true)), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::variable_get_value(io)), ok(&true));
    // the sample program writes VT_I4 -1
    assert_eq!(world.call(peer, call::variable_put_value(io, 0)), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::variable_put_value(io, -1)), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::variable_get_value(io)), ok(&true));
    assert_eq!(world.call(peer, call::variable_release(io)), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::variable_get_value(io)), code(HResult::E_HANDLE));
    assert_eq!(world.call(peer, call::controller_disconnect(controller)), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::service_stop()), code(HResult::S_OK));
    assert_eq!(world.sim.open_objects(), 0);
}

#[test]
fn nothing_works_before_the_service_has_started() {
    let mut world = World::new();
    let connect = || call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", "");
    assert_eq!(world.call(PeerId(1), connect()), code(HResult::E_NOT_CONNECTED));
    let client = world.client(1);
    assert_eq!(world.call(client.peer, call::service_stop()), code(HResult::S_OK));
    let name = call::controller_get_name(client.controller);
    assert_eq!(world.call(client.peer, name), code(HResult::E_NOT_CONNECTED));
    assert_eq!(world.call(client.peer, connect()), code(HResult::E_NOT_CONNECTED));
}

#[test]
fn each_profile_has_its_provider() {
    let cases = [
        (Profile::Rc8, false, "CaoProv.DENSO.VRC", HResult::S_OK),
        (Profile::Rc8, false, "caoprov.denso.vrc", HResult::S_OK),
        (Profile::Rc8, false, "CaoProv.DENSO.VRC9", HResult::E_CAO_PROV_INVALID),
        (Profile::Rc9, false, "CaoProv.DENSO.VRC9", HResult::S_OK),
        (Profile::Rc9, false, "CaoProv.DENSO.VRC", HResult::E_CAO_PROV_INVALID),
        (Profile::Rc9, true, "CaoProv.DENSO.VRC", HResult::S_OK),
        (Profile::Rc8, true, "CaoProv.DENSO.VRC9", HResult::S_OK),
        // an electric hand has a separate code
        (Profile::Rc8, true, "CaoProv.DENSO.ESC11PCI", HResult::E_NOTIMPL),
        (Profile::Rc8, true, "", HResult::E_CAO_PROV_INVALID),
    ];
    for (profile, lenient, provider, expected) in cases {
        let mut world = World::with(Config { lenient, ..Config::new(profile) });
        world.call(PeerId(1), call::service_start(""));
        let option = "@IfNotMember, Server=10.0.0.1, Interval=8";
        let (result, _) = world.call(PeerId(1), call::controller_connect("", provider, "localhost", option));
        assert_eq!(result, expected, "{profile:?} {lenient} {provider}");
    }
}

#[test]
fn a_handle_is_good_for_its_client_and_its_kind_only() {
    let mut world = World::new();
    let (one, two) = (world.client(1), world.client(2));
    let variable = world.variable(one, "I1");
    assert_ne!(one.controller, two.controller);
    assert_eq!(world.call(two.peer, call::variable_get_value(variable)), code(HResult::E_HANDLE));
    assert_eq!(world.call(two.peer, call::variable_release(variable)), code(HResult::E_HANDLE));
    assert_eq!(world.call(one.peer, call::robot_release(RobotHandle(variable.0))), code(HResult::E_HANDLE));
    assert_eq!(world.call(one.peer, call::variable_get_value(VariableHandle(0))), code(HResult::E_HANDLE));
    assert_eq!(world.call(one.peer, call::variable_get_value(VariableHandle(-1))), code(HResult::E_HANDLE));
    assert_eq!(world.call(one.peer, call::task_get_name(TaskHandle(one.robot.0))), code(HResult::E_HANDLE));
    assert_eq!(world.call(one.peer, call::variable_get_value(variable)), ok(&0));

    let before = world.sim.open_objects();
    world.sim.left(one.peer, world.now);
    assert_eq!(world.sim.open_objects(), before - 3);
    assert_eq!(world.call(two.peer, call::controller_get_name(two.controller)), ok(&"b-CAP 2"));
}

#[test]
fn objects_are_limited() {
    let mut world = World::with(Config { max_objects: 4, ..Config::default() });
    let client = world.client(1);
    let get = || call::controller_get_variable(client.controller, "I1", "");
    let first = world.handle(client.peer, get());
    world.handle(client.peer, get());
    assert_eq!(world.call(client.peer, get()), code(HResult::E_MAX_OBJECT));
    world.call(client.peer, call::variable_release(VariableHandle(first)));
    assert_eq!(world.call(client.peer, get()).0, HResult::S_OK);
    // another client has its own count
    world.client(2);
}

/// Writes `sent` and expects to read `read`.
fn round_trip(name: &str, sent: impl Encode, read: &(impl Encode + ?Sized)) {
    let mut world = World::new();
    let client = world.client(1);
    assert_eq!(world.put(client, name, &sent), HResult::S_OK, "{name} := {:?}", value(&sent));
    assert_eq!(world.get(client, name), ok(read), "{name}");
}

/// Writes `sent`, expects a code and the old value.
fn refused(name: &str, sent: impl Encode, expected: HResult) {
    let mut world = World::new();
    let client = world.client(1);
    let before = world.get(client, name);
    assert_eq!(world.put(client, name, &sent), expected, "{name} := {:?}", value(&sent));
    assert_eq!(world.get(client, name), before, "{name}");
}

#[test]
fn values_are_read_in_the_types_of_a_controller() {
    round_trip("I0", i32::MIN, &i32::MIN);
    round_trip("F99", 1.5_f32, &1.5_f32);
    round_trip("D1", 0.1, &0.1);
    round_trip("S1", "aé😀\0", "aé😀\0");
    round_trip("V1", [1.0_f32, 2.0, 3.0], &[1.0_f32, 2.0, 3.0]);
    round_trip("P1", [1.5_f32; 7], &[1.5_f32; 7]);
    round_trip("J1", [1.5_f32; 8], &[1.5_f32; 8]);
    round_trip("T1", [1.5_f32; 10], &[1.5_f32; 10]);
    round_trip("IO511", true, &true);
    round_trip("IOB8", 0xa5_u8, &0xa5_u8);
    round_trip("IOW8", -2_i16, &-2_i16);
    round_trip("IOD8", -2, &-2);
    round_trip("IOF8", 0.5_f32, &0.5_f32);
}

#[test]
fn other_types_are_converted_without_loss_or_refused() {
    round_trip("I1", 7_i16, &7);
    round_trip("I1", 7_u64, &7);
    round_trip("I1", -3.0_f64, &-3);
    round_trip("F1", 7, &7.0_f32);
    round_trip("F1", 0.1_f64, &0.1_f32);
    round_trip("D1", 7_u8, &7.0_f64);
    round_trip("D1", 0.5_f32, &0.5_f64);
    round_trip("V1", [1.0_f64, 2.0, 3.0], &[1.0_f32, 2.0, 3.0]);
    round_trip("V1", (1, 2.5_f64, 3.0_f32), &[1.0_f32, 2.5, 3.0]);
    round_trip("J1", [1_i32, 2, 3, 4, 5, 6, 7, 8], &[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    round_trip("IO1", -1, &true);
    round_trip("IOW8", -1, &-1_i16);
    round_trip("IOW8", 65535, &-1_i16);

    refused("I1", 1.5, HResult::DISP_E_TYPEMISMATCH);
    refused("I1", 3e9, HResult::DISP_E_OVERFLOW);
    refused("I1", 3_000_000_000_u32, HResult::DISP_E_OVERFLOW);
    refused("I1", u64::MAX, HResult::DISP_E_OVERFLOW);
    refused("I1", "1", HResult::E_INVALIDARGTYPE);
    refused("I1", (), HResult::E_INVALIDARGTYPE);
    refused("I1", Null, HResult::E_INVALIDARGTYPE);
    refused("I1", true, HResult::E_INVALIDARGTYPE);
    refused("I1", [1], HResult::E_INVALIDARGTYPE);
    refused("F1", 1e39, HResult::DISP_E_OVERFLOW);
    refused("F1", "1", HResult::E_INVALIDARGTYPE);
    refused("D1", OleDate::from_raw(1.0), HResult::E_INVALIDARGTYPE);
    refused("S1", 1, HResult::E_INVALIDARGTYPE);
    refused("P1", [1.0_f32; 5], HResult::E_INVALIDARG);
    round_trip("P1", [1.0_f32; 6], &[1.0_f32, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0]);
    round_trip("P1", [0, 0, 7], &[0.0_f32, 0.0, 7.0, 0.0, 0.0, 0.0, -1.0]);
    refused("P1", [1.0_f32; 8], HResult::E_INVALIDARG);
    refused("J1", [1.0_f32; 0], HResult::E_INVALIDARG);
    refused("V1", 1.0_f32, HResult::E_INVALIDARGTYPE);
    refused("V1", ["1", "2", "3"], HResult::E_INVALIDARGTYPE);
    refused("T1", [1e39; 10], HResult::DISP_E_OVERFLOW);
    refused("IO1", "TRUE", HResult::E_INVALIDARGTYPE);
    refused("IOB8", 256, HResult::DISP_E_OVERFLOW);
}

#[test]
fn names_and_indices_are_checked() {
    let mut world = World::with(Config { sizes: Sizes { i: 5, s: 0, ..Sizes::default() }, ..Config::default() });
    let client = world.client(1);
    let mut open = |name: &str| world.call(client.peer, call::controller_get_variable(client.controller, name, "")).0;
    for name in ["I4", "i[4]", "I[0]", "I*", "S*", "IO511", "IOD480", "@MODE", "@Mode", " @mode "] {
        assert_eq!(open(name), HResult::S_OK, "{name}");
    }
    for name in ["I5", "S0", "IO512", "IOD481", "P100", "I4294967296"] {
        assert_eq!(open(name), HResult::DISP_E_BADINDEX, "{name}");
    }
    for name in ["", "X1", "I", "I-1", "@NOTHING", "@CURRENT_POSITION", "MODE", "I 1"] {
        assert_eq!(open(name), HResult::E_CAO_OBJECT_NOTFOUND, "{name:?}");
    }
    assert_eq!(world.get(client, "@VAR_I_LEN"), ok(&5));
    assert_eq!(world.get(client, "@VAR_S_LEN"), ok(&0));
    assert_eq!(world.get(client, "@VAR_IO_LEN"), ok(&512));
    for kind in ["F", "D", "V", "P", "J", "T"] {
        assert_eq!(world.get(client, &format!("@VAR_{kind}_LEN")), ok(&100));
    }
}

#[test]
fn a_wildcard_reads_what_put_id_has_chosen() {
    let mut world = World::new();
    let client = world.client(1);
    for n in 0..100 {
        assert_eq!(world.put(client, &format!("I{n}"), n * n), HResult::S_OK);
    }
    let all = world.variable(client, "I*");
    assert_eq!(world.call(client.peer, call::variable_get_value(all)), ok(&0));
    assert_eq!(world.call(client.peer, call::variable_get_id(all)), ok(&0));
    for n in 0..100 {
        assert_eq!(world.call(client.peer, call::variable_put_id(all, n)), code(HResult::S_OK));
        assert_eq!(world.call(client.peer, call::variable_get_id(all)), ok(&n));
        assert_eq!(world.call(client.peer, call::variable_get_value(all)), ok(&(n * n)));
    }
    assert_eq!(world.call(client.peer, call::variable_put_value(all, -7)), code(HResult::S_OK));
    assert_eq!(world.get(client, "I99"), ok(&-7));
    assert_eq!(world.call(client.peer, call::variable_put_id(all, 100)), code(HResult::DISP_E_BADINDEX));
    assert_eq!(world.call(client.peer, call::variable_put_id(all, -1)), code(HResult::DISP_E_BADINDEX));
    assert_eq!(world.call(client.peer, call::variable_put_id(all, [1.5])), code(HResult::DISP_E_TYPEMISMATCH));
    // the last good one stays
    assert_eq!(world.call(client.peer, call::variable_get_value(all)), ok(&-7));
    // the index of a plain variable is part of its name
    let one = world.variable(client, "I1");
    assert_eq!(world.call(client.peer, call::variable_put_id(one, 2)), code(HResult::E_CAO_NOT_WRITABLE));
    assert_eq!(world.call(client.peer, call::variable_get_id(one)), ok(&1));
}

#[test]
fn a_wildcard_of_definitions_is_chosen_again_and_again() {
    let mut world = World::new();
    let client = world.mover(1);
    let tools = [1, 2].map(|n| {
        let tool = [10.0 * f64::from(n), 0.0, 0.0, 0.0, 0.0, 0.0];
        let named = world.robot_variable(client, &format!("Tool{n}"));
        assert_eq!(world.call(client.peer, call::variable_put_value(named, tool)), code(HResult::S_OK));
        // the number is part of the name
        assert_eq!(world.call(client.peer, call::variable_put_id(named, 3)), code(HResult::E_CAO_NOT_WRITABLE));
        assert_eq!(world.call(client.peer, call::variable_get_id(named)), ok(&n));
        tool
    });
    for name in ["Tool*", "tool*_1"] {
        let all = world.robot_variable(client, name);
        for (n, tool) in [(1, tools[0]), (2, tools[1]), (1, tools[0])] {
            assert_eq!(world.call(client.peer, call::variable_put_id(all, n)), code(HResult::S_OK));
            assert_eq!(world.call(client.peer, call::variable_get_id(all)), ok(&n));
            assert_eq!(world.call(client.peer, call::variable_get_value(all)), ok(&tool), "{name} {n}");
        }
    }
}

#[test]
fn both_protocols_see_one_state() {
    let mut world = World::new();
    let client = world.client(1);
    assert_eq!(world.rac("PUT:RC8:10:F:4,123.01"), code(HResult::S_OK));
    assert_eq!(world.get(client, "F10"), ok(&123.01_f32));
    assert_eq!(world.rac("GET:RC8:10:F:"), ok(&123.01_f32));
    world.put(client, "IO5", true);
    assert_eq!(world.rac("GET:RC8:5:IO:"), ok(&true));
    assert_eq!(world.rac("PUT:RC8:1:P:8196,1,2,3,4,5,6,-1"), code(HResult::S_OK));
    assert_eq!(world.get(client, "P1"), ok(&[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0]));
    assert_eq!(world.rac("PUT:RC8:2:S:8,Test, one"), code(HResult::S_OK));
    assert_eq!(world.get(client, "S2"), ok("Test, one"));

    assert_eq!(world.rac("GET:RC8:100:I:"), code(HResult::DISP_E_BADINDEX));
    assert_eq!(world.rac("PUT:RC8:1:I:5,0.5"), code(HResult::DISP_E_TYPEMISMATCH));
    assert_eq!(world.rac("PUT:RC8:1:P:8196,1,2"), code(HResult::E_INVALIDARG));
    world.sim.set_permission(Permission::None);
    assert_eq!(world.rac("GET:RC8:5:IO:"), code(HResult::E_ACCESSDENIED));
    world.sim.set_permission(Permission::ReadOnly);
    assert_eq!(world.rac("PUT:RC8:1:I:3,1"), code(HResult::E_CAO_NOT_WRITABLE));
    assert_eq!(world.put(client, "I1", 1), HResult::E_CAO_NOT_WRITABLE);
    assert_eq!(world.put(client, "@LOCK", true), HResult::E_CAO_NOT_WRITABLE);
    assert_eq!(world.get(client, "I1"), ok(&0));

    // a RAC client that disconnects releases nothing of the b-CAP client with the same number
    bcap_core::rac::server::Handler::left(&mut world.sim, client.peer, world.now);
    assert_eq!(world.get(client, "I1"), ok(&0));
}

#[test]
fn names_tags_and_times_of_objects() {
    let mut world = World::with(Config { wall_clock_origin_ms: 1_700_000_000_123, ..Config::default() });
    let client = world.client(1);
    let variable = world.variable(client, "p[3]");
    let peer = client.peer;
    assert_eq!(world.call(peer, call::controller_get_name(client.controller)), ok(&"b-CAP"));
    assert_eq!(world.call(peer, call::robot_get_name(client.robot)), ok(&"Arm"));
    assert_eq!(world.call(peer, call::variable_get_name(variable)), ok(&"p[3]"));
    assert_eq!(world.call(peer, call::variable_get_help(variable)), ok(&"The user variable p[3]."));
    assert_eq!(world.call(peer, call::controller_get_attribute(client.controller)), ok(&0));

    assert_eq!(world.call(peer, call::robot_get_tag(client.robot)), ok(&()));
    assert_eq!(world.call(peer, call::robot_put_tag(client.robot, (1, "two", [3.0]))), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::robot_get_tag(client.robot)), ok(&(1, "two", [3.0])));
    assert_eq!(world.call(peer, call::controller_get_id(client.controller)), ok(&()));
    assert_eq!(world.call(peer, call::controller_put_id(client.controller, 9)), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::controller_get_id(client.controller)), ok(&9));

    world.now = bcap_core::time::Instant::from_micros(2_000_456);
    world.call(peer, call::variable_get_value(variable));
    world.pass(60_000);
    let date = OleDate::from_unix_millis(1_700_000_002_123).unwrap();
    assert_eq!(world.call(peer, call::variable_get_date_time(variable)), ok(&date));
    assert_eq!(world.call(peer, call::variable_get_microsecond(variable)), ok(&123_456));
    world.call(peer, call::variable_put_value(variable, [0.0_f32; 7]));
    let date = OleDate::from_unix_millis(1_700_000_062_123).unwrap();
    assert_eq!(world.call(peer, call::variable_get_date_time(variable)), ok(&date));
}

#[test]
fn lists_of_names_open_what_they_name() {
    let mut world = World::new();
    let client = world.client(1);
    let list = |reply: common::Reply| -> Vec<String> {
        let array = reply.1.as_variant().as_array().unwrap();
        array.strings().unwrap().map(|s| s.to_string()).collect()
    };
    let variables = list(world.call(client.peer, call::controller_get_variable_names(client.controller, "")));
    assert!(["@MODE", "@ERROR_CODE", "I*", "IO*", "IOB*"].iter().all(|name| variables.iter().any(|v| v == name)));
    for name in &variables {
        let handle = world.variable(client, name);
        if name.starts_with('@') {
            assert_eq!(world.call(client.peer, call::variable_get_value(handle)).0, HResult::S_OK, "{name}");
        }
    }
    let robots = list(world.call(client.peer, call::controller_get_robot_names(client.controller, "")));
    assert_eq!(robots, ["Arm0"]);
    for name in list(world.call(client.peer, call::robot_get_variable_names(client.robot, ""))) {
        assert_eq!(world.robot_get(client, &name).0, HResult::S_OK, "{name}");
    }
    let tasks = list(world.call(client.peer, call::controller_get_task_names(client.controller, "")));
    assert_eq!(tasks, ["Pro1", "Pro2", "Pro3"]);
    let task = world.task(client, "PRO1");
    assert_eq!(world.call(client.peer, call::task_get_name(task)), ok(&"Pro1"));
    for name in list(world.call(client.peer, call::task_get_variable_names(task, ""))) {
        let handle = VariableHandle(world.handle(client.peer, call::task_get_variable(task, &name, "")));
        let expected = if ["@START", "@STOP", "@PRIORITY"].contains(&name.as_str()) {
            HResult::E_ACCESSDENIED
        } else {
            HResult::S_OK
        };
        assert_eq!(world.call(client.peer, call::variable_get_value(handle)).0, expected, "{name}");
    }
    let second = call::controller_get_robot(client.controller, "Arm", "ID=1");
    assert_eq!(world.call(client.peer, second), code(HResult::E_CAO_OBJECT_NOTFOUND));
    let first = call::controller_get_robot(client.controller, "", "id=0");
    assert_eq!(world.call(client.peer, first).0, HResult::S_OK);
    let none = call::controller_get_task(client.controller, "Pro4", "");
    assert_eq!(world.call(client.peer, none), code(HResult::E_CAO_OBJECT_NOTFOUND));
}

#[test]
fn what_is_not_modelled_says_so() {
    let mut world = World::new();
    let client = world.client(1);
    let c = client.controller;
    assert_eq!(world.call(client.peer, call::controller_get_file(c, "a.pcs", "")), code(HResult::E_NOTIMPL));
    assert_eq!(world.call(client.peer, call::controller_get_file_names(c, "")), code(HResult::E_NOTIMPL));
    assert_eq!(world.robot(client, "ForceCtrl", ()), code(HResult::E_NOTIMPL));
    assert_eq!(world.execute(client, "SetAutoMode", ()), code(HResult::E_NOTIMPL));
    // an RC8 does not have the variables of a COBOTTA
    assert_eq!(world.execute(client, "HandStop", ()), code(HResult::E_INVALID_CMD_NAME));
    assert_eq!(world.robot(client, "MotionPreparation", ()), code(HResult::E_INVALID_CMD_NAME));
    assert_eq!(world.robot(client, "Sing", ()), code(HResult::E_INVALID_CMD_NAME));
    assert_eq!(world.execute(client, "Sing", ()), code(HResult::E_INVALID_CMD_NAME));
}

#[test]
fn what_a_client_leaves_behind_has_a_largest_size() {
    let mut world = World::new();
    let client = world.client(1);
    let peer = client.peer;
    let (fits, over) = ([7_u8; 4000], [7_u8; 4100]);
    let too_large = code(HResult::E_OUTOFMEMORY);
    assert_eq!(world.call(peer, call::robot_put_tag(client.robot, &fits[..])), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::robot_put_tag(client.robot, 7)), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::robot_put_tag(client.robot, &over[..])), too_large);
    assert_eq!(world.call(peer, call::robot_get_tag(client.robot)), ok(&7), "what was there stays");
    assert_eq!(world.call(peer, call::controller_put_id(client.controller, &over[..])), too_large);
    let command = CommandHandle(world.handle(peer, call::controller_get_command(client.controller, "Motor", "")));
    assert_eq!(world.call(peer, call::command_put_parameters(command, &over[..])), too_large);
    assert_eq!(world.call(peer, call::command_put_parameters(command, &fits[..])), code(HResult::S_OK));
    assert_eq!(world.call(peer, call::command_execute(command, 0)), code(HResult::E_INVALIDARG), "so many numbers");
    let name = "x".repeat(1025);
    let robot = |name| call::controller_get_robot(client.controller, name, "");
    assert_eq!(world.call(peer, robot(&name)), too_large);
    world.handle(peer, robot(&name[1..]));
}

#[test]
fn texts_are_as_long_as_a_packet_and_fill_the_memory() {
    let mut world = World::new();
    let client = world.client(1);
    assert_eq!(world.put(client, "@VAR_S_LEN", 600), HResult::S_OK);
    // 128 KiB each
    let text = "x".repeat(64 << 10);
    for n in 0..512 {
        assert_eq!(world.put(client, &format!("S{n}"), text.as_str()), HResult::S_OK, "{n}");
    }
    assert_eq!(world.put(client, "S512", "x"), HResult::E_OUTOFMEMORY);
    assert_eq!(world.put(client, "S0", text.as_str()), HResult::S_OK, "it replaces its own text");
    assert_eq!(world.put(client, "S0", "seven"), HResult::S_OK);
    assert_eq!(world.put(client, "S512", "x"), HResult::S_OK);
    assert_eq!(world.get(client, "S0"), ok("seven"));
    assert_eq!(world.put(client, "@VAR_S_LEN", 1), HResult::S_OK);
    assert_eq!(world.put(client, "@VAR_S_LEN", 600), HResult::S_OK);
    assert_eq!(world.put(client, "S511", text.as_str()), HResult::S_OK, "removed variables free their memory");
}
