//! Serial framing.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use bcap_core::bcap::FunctionId as F;
use bcap_core::hresult::HResult;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::wire::{Link, Received};
use bcap_tests::serial::SerialServer;

use super::session::{Session, controller};

#[test]
fn a_frame_has_the_crc_of_the_vendors_libraries() {
    let line = SerialServer::start(Arc::new(Mutex::new(controller())));
    let mut session = Session::start_after(65_530, Link::Serial, line.address);
    let stop = b"\x01\x12\0\0\0\x01\0\x01\0\x02\0\0\0\0\0\x89\x3a\x04";
    assert_eq!(TestFrame { serial: 1, reserved: 1, code: 2, args: vec![] }.to_wire(true), stop);
    session.wire.send(stop).unwrap();
    assert_eq!(session.reply(1).0, HResult::S_OK);
}

#[test]
fn noise_and_wrong_crcs_are_passed_over() {
    let line = SerialServer::start(Arc::new(Mutex::new(controller())));
    let mut session = Session::start(Link::Serial, line.address);
    let args = [session.controller.clone()];
    let serial = session.next_serial();
    let frame = TestFrame { serial, reserved: serial, code: F::CONTROLLER_GET_NAME.0, args: args.to_vec() };
    let mut damaged = frame.to_wire(true);
    damaged[9] ^= 0x10;
    for noise in [&damaged[..], &[0xff; 40], &[0, 4, 4], &[2, 3]] {
        session.wire.send(noise).unwrap();
        assert_eq!(session.wire.receive(Duration::from_millis(100)), Received::Silence, "{noise:02x?}");
        session.ok(F::CONTROLLER_GET_NAME, &args);
    }
    session.stop();
}
