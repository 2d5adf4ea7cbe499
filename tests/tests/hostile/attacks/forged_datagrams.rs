//! Datagrams with the address of another client.

use bcap_core::bcap::FunctionId;
use bcap_testkit::frame::TestFrame;
use bcap_testkit::value::Value;

use crate::target::Target;
use crate::wire::{Raw, request};

/// An ordinary call from an address without a session, then Service_Start with a lower serial from the same address: a
/// forged datagram, or a server that was restarted below its client.
pub(super) fn a_forged_first_datagram_locks_no_client_out(target: &mut Target) {
    for serial in [57, 2, 1023, 1025, 0xffff] {
        let mut peer = Raw::datagrams(target.udp);
        let forged = request(FunctionId::VARIABLE_GET_VALUE, vec![Value::I4(1)]);
        peer.send(&TestFrame { serial, reserved: serial, ..forged }.to_wire(false));
        assert_eq!(peer.reply().serial, serial);
        // the first serial of a client is 1
        peer.serial = 0;
        let handle = peer.begin();
        assert_eq!(peer.ask(FunctionId::CONTROLLER_GET_NAME, vec![Value::I4(handle)]).code, 0);
        peer.end();
    }
}
