//! Requests that a controller refuses, and that a lenient one tolerates and names.

use std::sync::{Arc, Mutex};

use bcap_core::bcap::call;
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_sim::codes::WRONG_ARGUMENT;
use bcap_sim::explain::Observer;
use bcap_sim::{Config, Profile};

use crate::common::{World, code};

type Seen = Arc<Mutex<Vec<String>>>;

/// A controller, and the texts that it has tolerated.
fn controller(profile: Profile, lenient: bool) -> (World, Seen) {
    let seen = Seen::default();
    let tell = Arc::clone(&seen);
    let observer = Observer::new(move |code, text| {
        if code == HResult::S_OK {
            tell.lock().unwrap().push(text.to_owned());
        }
    });
    (World::with(Config { lenient, observer, ..Config::new(profile) }), seen)
}

fn texts(seen: &Seen) -> Vec<String> {
    std::mem::take(&mut *seen.lock().unwrap())
}

#[test]
fn the_provider_of_another_model_is_refused_or_named() {
    let connect = || call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", "");
    let (mut strict, seen) = controller(Profile::Rc9, false);
    strict.call(PeerId(1), call::service_start(""));
    assert_eq!(strict.call(PeerId(1), connect()), code(HResult::E_CAO_PROV_INVALID));
    assert!(texts(&seen).is_empty());
    let (mut lenient, seen) = controller(Profile::Rc9, true);
    lenient.call(PeerId(1), call::service_start(""));
    assert_eq!(lenient.call(PeerId(1), connect()).0, HResult::S_OK);
    let text = r#"Controller_Connect: provider "CaoProv.DENSO.VRC" is not that of RC9, "CaoProv.DENSO.VRC9""#;
    assert_eq!(texts(&seen), [text]);
    let unknown = call::controller_connect("", "CaoProv.DENSO.VRC7", "localhost", "");
    assert_eq!(lenient.call(PeerId(1), unknown), code(HResult::E_CAO_PROV_INVALID));
}

#[test]
fn an_unknown_option_is_refused_or_ignored_by_name() {
    for lenient in [false, true] {
        let (mut world, seen) = controller(Profile::Rc8, lenient);
        let client = world.client(1);
        let task = world.task(client, "Pro1");
        let peer = client.peer;
        let provider = "CaoProv.DENSO.VRC";
        let results = [
            world.call(peer, call::controller_connect("", provider, "localhost", "@IfNotMember, Servr=1")).0,
            world.call(peer, call::controller_get_robot(client.controller, "Arm", "ID=0, @IfMember")).0,
            world.call(peer, call::controller_get_variable(client.controller, "I1", "@IfNotMembr")).0,
            world.call(peer, call::robot_get_variable(client.robot, "@SPEED", "x=(1,2)")).0,
            world.call(peer, call::task_get_variable(task, "@STATUS", "x")).0,
            world.call(peer, call::controller_get_task(client.controller, "Pro2", "x")).0,
            world.call(peer, call::task_stop(task, 1, "fast")).0,
        ];
        let expected = if lenient { HResult::S_OK } else { HResult::E_INVALIDARG };
        // stopping a stopped task has no effect
        let as_expected = |result: &HResult| *result == expected || lenient && *result == HResult::S_FALSE;
        assert!(results.iter().all(as_expected), "{lenient} {results:?}");
        let named: Vec<_> = ["Servr", "@IfMember", "@IfNotMembr", "x", "x", "x", "fast"].to_vec();
        let texts = texts(&seen);
        assert_eq!(texts.len(), if lenient { named.len() } else { 0 }, "{texts:?}");
        for (text, name) in texts.iter().zip(named) {
            assert!(text.ends_with(&format!(": unknown option {name:?} is ignored")), "{text}");
        }
    }
}

#[test]
fn an_unknown_option_of_a_motion_is_refused_or_ignored_by_name() {
    for (lenient, expected) in [(false, WRONG_ARGUMENT), (true, HResult::S_OK)] {
        let (mut world, seen) = controller(Profile::Rc8, lenient);
        let client = world.mover(1);
        assert_eq!(world.move_to(client, 1, "J(10,45,90,0,45,0)", "TEMPO=1000, SPEED=50"), expected);
        let text = r#"a motion: unknown option "TEMPO" is ignored"#;
        assert_eq!(texts(&seen), if lenient { vec![text] } else { vec![] });
        // a known option with an invalid value is not tolerated
        assert_eq!(world.move_to(client, 1, "J(10,45,90,0,45,0)", "SPEED=x"), WRONG_ARGUMENT);
    }
}

#[test]
fn an_unknown_option_of_the_service_is_refused_or_ignored_by_name() {
    let start = |options| call::service_start(options);
    let (mut strict, seen) = controller(Profile::Rc8, false);
    assert_eq!(strict.call(PeerId(1), start("WDT=400,WTD=400")), code(HResult::E_INVALIDARG));
    assert_eq!(strict.call(PeerId(1), start(",wdt=400,InvokeTimeout=180000")), code(HResult::S_OK));
    assert!(texts(&seen).is_empty());
    let (mut lenient, seen) = controller(Profile::Rc8, true);
    assert_eq!(lenient.call(PeerId(1), start("WDT=400,WTD=400")), code(HResult::S_OK));
    assert_eq!(texts(&seen), [r#"Service_Start: unknown option "WTD" is ignored"#]);
}

#[test]
fn the_options_of_public_programs_are_known() {
    let (mut world, _) = controller(Profile::Rc8, false);
    let client = world.client(1);
    for option in ["", "@IfNotMember", "@EventDisable=false,Wpj=*", "@IfNotMember=true, WPJ={a,b.wpj}", "Interval=8"] {
        let connect = call::controller_connect("", "CaoProv.DENSO.VRC", "localhost", option);
        assert_eq!(world.call(client.peer, connect).0, HResult::S_OK, "{option}");
    }
    for option in ["", "ID=0", "@ifnotmember", "@IfNotMember=true"] {
        let robot = call::controller_get_robot(client.controller, "Arm", option);
        assert_eq!(world.call(client.peer, robot).0, HResult::S_OK, "{option}");
    }
}

#[test]
fn the_provider_of_an_electric_hand_has_a_code_of_its_own() {
    for lenient in [false, true] {
        let (mut world, _) = controller(Profile::Rc8, lenient);
        world.call(PeerId(1), call::service_start(""));
        let hand = call::controller_connect("", "CaoProv.DENSO.ESC11PCI", "", "BoardID=0,BoardType=2,ChannelNo=0");
        assert_eq!(world.call(PeerId(1), hand), code(HResult::E_NOTIMPL));
        let other = call::controller_connect("", "CaoProv.DENSO.ESC12", "", "");
        assert_eq!(world.call(PeerId(1), other), code(HResult::E_CAO_PROV_INVALID));
    }
}

#[test]
fn each_model_accepts_its_own_provider_only() {
    for profile in Profile::ALL {
        let (mut world, _) = controller(profile, false);
        world.call(PeerId(1), call::service_start(""));
        for provider in ["CaoProv.DENSO.VRC", "CaoProv.DENSO.VRC9"] {
            let expected = if provider == profile.provider() { HResult::S_OK } else { HResult::E_CAO_PROV_INVALID };
            let connect = call::controller_connect("", provider, "localhost", "");
            assert_eq!(world.call(PeerId(1), connect).0, expected, "{profile:?} {provider}");
        }
    }
    let rac = Profile::ALL.map(|profile| profile.model().rac);
    assert_eq!(rac, [true, true, false, true, false]);
}

#[test]
fn the_machine_is_not_checked_and_server_is_a_known_option() {
    let (mut world, _) = controller(Profile::Rc9, false);
    world.call(PeerId(1), call::service_start(""));
    for machine in ["localhost", "192.168.0.1", "", "cell7"] {
        let connect = call::controller_connect("", "CaoProv.DENSO.VRC9", machine, "Server=192.168.0.1");
        assert_eq!(world.call(PeerId(1), connect).0, HResult::S_OK, "{machine}");
    }
}
