//! The lock, the clock and the addresses of a gateway's driver.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Mutex, PoisonError};

use bcap_core::time::Instant;
use bcap_gateway::driver::{self, Client, Lock, Platform};

use super::report::Log;
use crate::clock::now;
use crate::server::is_same_host;

/// A gateway that the tasks of a driver share.
pub(super) type SharedGateway = driver::SharedGateway<'static, Tokio>;

/// The platform of tokio's tasks.
#[derive(Debug)]
pub(super) struct Tokio;

/// A mutex whose value survives a panic under the lock: a panic of the log leaves the gateway consistent.
#[derive(Debug)]
pub(super) struct SurvivingMutex<T>(Mutex<T>);

impl<T> Lock<T> for SurvivingMutex<T> {
    fn new(value: T) -> Self {
        Self(Mutex::new(value))
    }

    fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> Option<R> {
        Some(work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

impl Platform for Tokio {
    type Address = SocketAddr;
    type Cause = io::Error;
    type Failure = io::ErrorKind;
    type Clients = Vec<Client<SocketAddr>>;
    type Log = Log;
    type Lock<T> = SurvivingMutex<T>;

    fn now() -> Instant {
        now()
    }

    fn clients(capacity: usize) -> Self::Clients {
        (0..capacity).map(|_| Client::default()).collect()
    }

    /// A listener for both versions reports a client over IPv4 as `::ffff:10.0.0.5`.
    fn ipv4(client: SocketAddr) -> Option<Ipv4Addr> {
        match client.ip().to_canonical() {
            IpAddr::V4(address) => Some(address),
            IpAddr::V6(_) => None,
        }
    }

    fn is_same_host(client: SocketAddr, other: SocketAddr) -> bool {
        is_same_host(client.ip(), other.ip())
    }
}
