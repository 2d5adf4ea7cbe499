//! The async functions of bcap-core and bcap-std, and how each is covered.

use bcap_tests::async_functions::Coverage::{self, Exempt, Swept, Through};

const DECLARED: Coverage = Exempt("a declaration; its implementations are covered");
const OF_A_TASK: Coverage = Through("server/mod.rs: Server::run");

/// The functions of bcap-core.
pub(crate) const CORE: &[(&str, Coverage)] = &[
    ("io/asynch.rs: Connection::call", Swept("call")),
    ("io/asynch.rs: Connection::call_with", Swept("call_with")),
    ("io/asynch.rs: Connection::exchange", Through("io/asynch.rs: Connection::call_with")),
    ("io/asynch.rs: Connection::perform", Through("io/asynch.rs: Connection::run")),
    ("io/asynch.rs: Connection::run", Swept("run")),
    ("io/asynch.rs: Connection::run_beside", Swept("run_beside")),
    ("io/asynch.rs: RacConnection::get", Swept("get")),
    ("io/asynch.rs: RacConnection::put", Swept("put")),
    ("io/asynch.rs: RacConnection::request", Through("io/asynch.rs: RacConnection::get")),
    ("io/asynch.rs: Timed::receive", Swept("Timed::receive")),
    ("io/asynch.rs: Timed::send", Swept("Timed::send")),
    ("io/asynch.rs: Timed::sleep_until", Swept("Timed::sleep_until")),
    ("io/asynch.rs: Timer::sleep_until", DECLARED),
    ("io/asynch.rs: Transport::receive", DECLARED),
    ("io/asynch.rs: Transport::send", DECLARED),
    ("io/asynch.rs: Transport::sleep_until", DECLARED),
    ("io/asynch.rs: clear", Through("io/asynch.rs: Connection::call")),
    ("io/asynch.rs: first", Through("io/asynch.rs: Timed::receive")),
    ("io/asynch.rs: run", Through("io/asynch.rs: Connection::run")),
    ("io/asynch.rs: wait", Through("io/asynch.rs: Connection::call_with")),
];

/// The functions of bcap-std.
pub(crate) const STD: &[(&str, Coverage)] = &[
    ("asynch.rs: TcpTransport::receive", Swept("TcpTransport::receive")),
    ("asynch.rs: TcpTransport::send", Swept("TcpTransport::send")),
    ("asynch.rs: TcpTransport::sleep_until", Swept("TcpTransport::sleep_until")),
    ("asynch.rs: UdpTransport::receive", Swept("UdpTransport::receive")),
    ("asynch.rs: UdpTransport::send", Swept("UdpTransport::send")),
    ("asynch.rs: UdpTransport::sleep_until", Swept("UdpTransport::sleep_until")),
    ("asynch.rs: addresses", Through("asynch.rs: connect_tcp")),
    ("asynch.rs: connect_rac", Swept("connect_rac")),
    ("asynch.rs: connect_stream", Through("asynch.rs: connect_tcp")),
    ("asynch.rs: connect_tcp", Swept("connect_tcp")),
    ("asynch.rs: connect_udp", Swept("connect_udp")),
    ("asynch.rs: within", Through("asynch.rs: TcpTransport::receive")),
    ("server/admission.rs: Activity::evicted", OF_A_TASK),
    ("server/mod.rs: Server::bcap_tcp", Swept("bcap_tcp")),
    ("server/mod.rs: Server::bcap_udp", Swept("bcap_udp")),
    ("server/mod.rs: Server::rac_tcp", Swept("rac_tcp")),
    ("server/mod.rs: Server::run", Swept("Server::run")),
    ("server/rac.rs: listen", OF_A_TASK),
    ("server/rac.rs: refuse", OF_A_TASK),
    ("server/shared.rs: Changes::next", OF_A_TASK),
    ("server/shared.rs: Shared::change_after", Through("server/shared.rs: Changes::next")),
    ("server/stream.rs: Connection::end_turn", OF_A_TASK),
    ("server/stream.rs: Connection::run", OF_A_TASK),
    ("server/stream.rs: Connection::run_elsewhere", OF_A_TASK),
    ("server/stream.rs: Connection::send", OF_A_TASK),
    ("server/stream.rs: Connection::wait", OF_A_TASK),
    ("server/stream.rs: closed", OF_A_TASK),
    ("server/stream.rs: serve", OF_A_TASK),
    ("server/stream.rs: within", OF_A_TASK),
    ("server/tcp.rs: Served::ended", OF_A_TASK),
    ("server/tcp.rs: accept", OF_A_TASK),
    ("server/tcp.rs: listen", OF_A_TASK),
    ("server/tcp.rs: refuse", OF_A_TASK),
    ("server/udp.rs: Peers::datagram", OF_A_TASK),
    ("server/udp.rs: Peers::run", OF_A_TASK),
    ("server/udp.rs: Peers::run_all", OF_A_TASK),
    ("server/udp.rs: Peers::welcome", OF_A_TASK),
    ("server/udp.rs: serve", OF_A_TASK),
];
