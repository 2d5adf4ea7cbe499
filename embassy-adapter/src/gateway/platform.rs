//! The lock, the clock and the addresses of a gateway's driver.

use core::cell::RefCell;
use core::marker::PhantomData;
use core::net::{Ipv4Addr, SocketAddrV4};

use bcap_core::time::Instant;
use bcap_gateway::driver::{self, Client, Lock, Platform};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::report::Log;
use crate::clock::now;
use crate::error::NetError;

/// A gateway that several tasks share; `SESSIONS` is at least the number of its client slots.
///
/// `M` is embassy's mutex: `NoopRawMutex` for one executor, `CriticalSectionRawMutex` for several.
pub type SharedGateway<'m, M, const SESSIONS: usize> = driver::SharedGateway<'m, Embassy<M, SESSIONS>>;

/// The platform of embassy's tasks, with memory for `SESSIONS` clients.
#[derive(Debug)]
pub struct Embassy<M, const SESSIONS: usize>(PhantomData<M>);

/// A value behind embassy's mutex.
pub struct CellLock<M: RawMutex, T>(Mutex<M, RefCell<T>>);

impl<M: RawMutex, T> Lock<T> for CellLock<M, T> {
    fn new(value: T) -> Self {
        Self(Mutex::new(RefCell::new(value)))
    }

    fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        self.0.lock(|value| value.try_borrow_mut().ok().map(|mut value| work(&mut value)))
    }
}

impl<M: RawMutex, T> core::fmt::Debug for CellLock<M, T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("CellLock").finish_non_exhaustive()
    }
}

impl<M: RawMutex, const SESSIONS: usize> Platform for Embassy<M, SESSIONS> {
    type Address = Option<SocketAddrV4>;
    type Cause = NetError;
    type Failure = ();
    type Clients = [Client<Option<SocketAddrV4>>; SESSIONS];
    type Log = Log;
    type Lock<T> = CellLock<M, T>;

    fn now() -> Instant {
        now()
    }

    fn clients(_: usize) -> Self::Clients {
        const { assert!(SESSIONS > 0) };
        core::array::from_fn(|_| Client::default())
    }

    fn ipv4(client: Option<SocketAddrV4>) -> Option<Ipv4Addr> {
        client.map(|client| *client.ip())
    }

    fn is_same_host(client: Option<SocketAddrV4>, other: Option<SocketAddrV4>) -> bool {
        Self::ipv4(client) == Self::ipv4(other)
    }
}
