//! Attacks that succeeded against an earlier version of this project.
//!
//! Attacks on only the `bcap` command are in `std-adapter/cli/tests/attacks.rs`, replies before their request in
//! `tests/tests/early_replies.rs`.

mod fifo;
mod forged_datagrams;
mod keep_alives;
mod objects;
mod slots;

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_testkit::value::Value;
use bcap_tests::hooked::Hooked;
use bcap_tests::served::{Application, Served};

use self::fifo::a_fifo_among_the_files;
use self::forged_datagrams::a_forged_first_datagram_locks_no_client_out;
use self::keep_alives::a_flood_of_keep_alives_costs_little;
use self::objects::objects_of_others_do_not_slow_opening;
use self::slots::idle_connections_of_one_address_leave_slots_to_others;
use crate::Case;
use crate::target::{Target, limits};
use crate::wire::{Raw, bytes};

pub(crate) const CASES: &[Case] = crate::cases! {
    attacks:
        large_requests_leave_others_their_turn
        a_handler_that_panics_over_udp
        a_forged_first_datagram_locks_no_client_out
        a_flood_of_keep_alives_costs_little
        objects_of_others_do_not_slow_opening
        idle_connections_of_one_address_leave_slots_to_others
        a_fifo_among_the_files
};

/// Two clients that send requests of 14 MiB in sequence; between a small call and its reply the server executes a few of them
/// at most.
fn large_requests_leave_others_their_turn(target: &mut Target) {
    let large = bytes(FunctionId::SERVICE_START, vec![Value::Bstr(vec![0x30a2; 7 << 20])]);
    let (carried_out, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    let server = target.tcp;
    thread::scope(|scope| {
        let attack = || {
            let mut raw = Raw::connect(server);
            let mut writer = Raw::new(raw.stream().try_clone().unwrap());
            scope.spawn({
                let (large, stopped) = (&large, &stopped);
                move || {
                    while !stopped.load(Ordering::Relaxed) {
                        writer.send(large);
                    }
                    writer.finish();
                }
            });
            while raw.next_reply().is_some() {
                carried_out.fetch_add(1, Ordering::Relaxed);
            }
        };
        let attackers = [scope.spawn(attack), scope.spawn(attack)];
        let mut counts = Vec::new();
        for _ in 0..20 {
            let before = carried_out.load(Ordering::Relaxed);
            target.open();
            counts.push(carried_out.load(Ordering::Relaxed) - before);
        }
        stopped.store(true, Ordering::Relaxed);
        for attacker in attackers {
            attacker.join().unwrap();
        }
        // a count includes the time until this thread runs again
        let few = counts.iter().filter(|count| **count <= 4).count();
        assert!(few >= 15, "{counts:?} large requests between a small one and its reply");
    });
}

/// One call fails; its client and others are served, over UDP and over TCP.
fn a_handler_that_panics_over_udp(_: &mut Target) {
    let mut panicking = Hooked::new(Application::default());
    panicking.set(|request| {
        if request.function == FunctionId::CONTROLLER_EXECUTE && request.text(1).eq_ignore_ascii_case("panic") {
            // without the hook, which would print a backtrace, and take the memory for it
            std::panic::resume_unwind(Box::new("the handler was told to panic"));
        }
        None
    });
    let served = Served::of(panicking, limits());
    let (mut one, mut other) = (Raw::datagrams(served.udp), Raw::datagrams(served.udp));
    let (first, second) = (one.begin(), other.begin());
    for _ in 0..3 {
        let panic = vec![Value::I4(first), Value::text("panic"), Value::Empty];
        assert_eq!(one.ask(FunctionId::CONTROLLER_EXECUTE, panic).code, HResult::E_UNEXPECTED.0);
        for (peer, handle) in [(&mut one, first), (&mut other, second)] {
            assert_eq!(peer.ask(FunctionId::CONTROLLER_GET_NAME, vec![Value::I4(handle)]).code, 0);
        }
        Raw::connect(served.tcp).begin();
    }
    one.end();
    other.end();
}
