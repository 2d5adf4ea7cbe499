//! The platform that a driver runs on: lock, clock, addresses, errors.

use core::fmt::Debug;
use core::net::Ipv4Addr;

use bcap_core::time::Instant;

use super::client::Client;
use super::report::Report;

/// A value that several tasks share.
pub trait Lock<T> {
    /// Wraps a value.
    fn new(value: T) -> Self;

    /// Calls `work` with the value. Returns `None` when it is in use, which happens only when the log of a gateway uses the
    /// gateway.
    fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R>;
}

/// The lock, the clock and the types of a platform.
pub trait Platform: Sized {
    /// The address of a client, for rules and reports.
    type Address: Copy + Debug;
    /// The error of the link to the robot, for reports.
    type Cause;
    /// The error of the link to a client, for reports.
    type Failure: Copy;
    /// The memory for the clients of a gateway.
    type Clients: AsMut<[Client<Self::Address>]>;
    /// Receives the reports. It is called while the gateway is locked, so it must be short and must not use the gateway.
    type Log: for<'a, 'b> FnMut(&'a Report<'b, Self::Address, Self::Cause, Self::Failure>);
    /// The lock of the gateway.
    type Lock<T>: Lock<T>;

    /// Returns the current time.
    fn now() -> Instant;

    /// Allocates memory for up to `capacity` clients.
    fn clients(capacity: usize) -> Self::Clients;

    /// Returns the IPv4 address of a client, which determines the rules that apply to it; `None` if it has none.
    fn ipv4(client: Self::Address) -> Option<Ipv4Addr>;

    /// Returns whether two clients are on one host.
    fn is_same_host(client: Self::Address, other: Self::Address) -> bool;
}
