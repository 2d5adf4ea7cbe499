//! A server on real sockets, in its own thread, with a small application or any other handler.

use std::collections::{BTreeSet, HashMap};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bcap_core::bcap::server::{Handler, Request};
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::error::EncodeError;
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::rac;
use bcap_core::time::Instant;
use bcap_core::variant::VariantBuf;
use bcap_std::server::{Limits, Server};
use tokio::runtime::Handle;

use bcap_testkit::network::answer_to;

use crate::background::Background;

/// A controller with variables of any name and some commands.
///
/// | command | effect                                                                                      |
/// |---------|---------------------------------------------------------------------------------------------|
/// | `sleep` | waits for this number of milliseconds                                                       |
/// | `echo`  | returns its parameter                                                                       |
/// | `open`  | returns the number of open handles                                                          |
/// | `token` | counts the call of this token, waits for these milliseconds and returns the token           |
///
/// It behaves the same without sockets.
#[derive(Debug, Default)]
pub struct Application {
    values: HashMap<String, VariantBuf<1024>>,
    names: HashMap<i32, String>,
    next_handle: i32,
    until: HashMap<PeerId, Instant>,
    /// Peers that have started the service.
    started: BTreeSet<PeerId>,
    /// Number of polls of a sleeping call.
    pub asked_again: u64,
    /// Number of executions of each token.
    pub executed: HashMap<i32, u32>,
    /// Connected peers that have made a call.
    pub peers: BTreeSet<PeerId>,
    /// Open handles.
    pub open: Vec<(Object, i32)>,
}

impl Application {
    fn execute(
        &mut self,
        peer: PeerId,
        request: &Request<'_>,
        reply: &mut ReplyValue<'_>,
        now: Instant,
    ) -> Result<Outcome, EncodeError> {
        let command = request.text(1);
        if command.eq_ignore_ascii_case("sleep") {
            return Ok(self.sleep(peer, request.int(2), now));
        }
        if command.eq_ignore_ascii_case("token") {
            let [token, millis] = request.value(2).as_array().and_then(|a| a.items()?.to_array()).unwrap_or_default();
            // a call that waits is executed once
            if !self.until.contains_key(&peer) {
                *self.executed.entry(token).or_default() += 1;
            }
            reply.set(&answer_to(token))?;
            return Ok(if millis > 0 { self.sleep(peer, millis, now) } else { HResult::S_OK.into() });
        }
        if command.eq_ignore_ascii_case("echo") {
            reply.set(&request.value(2))?;
        } else if command.eq_ignore_ascii_case("open") {
            reply.set(&i32::try_from(self.open.len()).unwrap_or(i32::MAX))?;
        } else {
            return Ok(HResult::E_NOTIMPL.into());
        }
        Ok(HResult::S_OK.into())
    }

    fn sleep(&mut self, peer: PeerId, millis: i32, now: Instant) -> Outcome {
        let length = Duration::from_millis(u64::try_from(millis).unwrap_or(0));
        self.asked_again += u64::from(self.until.contains_key(&peer));
        let until = *self.until.entry(peer).or_insert_with(|| now + length);
        if now < until {
            return Outcome::Wait(until);
        }
        self.until.remove(&peer);
        HResult::S_OK.into()
    }
}

impl Handler for Application {
    fn call(&mut self, peer: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, now: Instant) -> Outcome {
        let function = request.function;
        self.peers.insert(peer);
        let set = match function {
            _ if function.opens().is_some() => {
                let object = function.opens().unwrap_or(Object::Service);
                let handle = if object == Object::Service { 0 } else { self.next_handle + 1 };
                self.next_handle = self.next_handle.max(handle);
                // a service can be started more than once, and is stopped once
                if !self.started.contains(&peer) || object != Object::Service {
                    self.open.push((object, handle));
                }
                if object == Object::Service {
                    self.started.insert(peer);
                }
                self.names.insert(handle, request.text(1).to_string());
                if object == Object::Service { Ok(()) } else { reply.set(&handle) }
            }
            _ if function.releases().is_some() => {
                let released = (function.releases().unwrap_or(Object::Service), request.handle());
                // all services have the same handle, so one that is not this peer's must stay
                let is_there = released.0 != Object::Service || self.started.remove(&peer);
                if let Some(at) = self.open.iter().position(|open| is_there && *open == released) {
                    self.open.remove(at);
                    self.names.remove(&released.1);
                }
                Ok(())
            }
            FunctionId::VARIABLE_PUT_VALUE => {
                let name = self.names.get(&request.handle()).cloned().unwrap_or_default();
                VariantBuf::new(&request.value(1)).map(|value| drop(self.values.insert(name, value)))
            }
            FunctionId::VARIABLE_GET_VALUE => {
                let value = self.names.get(&request.handle()).and_then(|name| self.values.get(name));
                value.map_or(Ok(()), |value| reply.set(value))
            }
            FunctionId::CONTROLLER_GET_NAME => reply.set(&7_i32),
            FunctionId::CONTROLLER_EXECUTE => {
                return self.execute(peer, request, reply, now).unwrap_or(HResult::E_TOO_MUCH_DATA.into());
            }
            _ => return HResult::E_NOTIMPL.into(),
        };
        set.map_or(HResult::E_TOO_MUCH_DATA, |()| HResult::S_OK).into()
    }

    fn abandoned(&mut self, peer: PeerId, _: Instant) {
        self.until.remove(&peer);
    }

    fn left(&mut self, peer: PeerId, _: Instant) {
        self.peers.remove(&peer);
    }
}

impl rac::server::Handler for Application {
    fn call(&mut self, peer: PeerId, request: &rac::Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        self.peers.insert(peer);
        let variable = request.variable();
        let name = format!("{}{}", variable.kind.name(), variable.index);
        let set = match request.value() {
            Some(value) => VariantBuf::new(&value).map(|value| drop(self.values.insert(name, value))),
            None => self.values.get(&name).map_or(Ok(()), |value| reply.set(value)),
        };
        set.map_or(HResult::E_TOO_MUCH_DATA, |()| HResult::S_OK).into()
    }

    fn left(&mut self, peer: PeerId, _: Instant) {
        self.peers.remove(&peer);
    }
}

/// A server that runs until this is dropped.
#[derive(Debug)]
pub struct Served<H = Application> {
    /// Where it takes b-CAP over TCP.
    pub tcp: SocketAddr,
    /// Where it takes b-CAP over UDP.
    pub udp: SocketAddr,
    /// Where it takes RAC.
    pub rac: SocketAddr,
    application: Arc<Mutex<H>>,
    runtime: Handle,
    background: Background,
}

impl Served {
    /// Starts a server of the small application on free ports of the loopback.
    #[must_use]
    pub fn start(limits: Limits) -> Self {
        Self::of(Application::default(), limits)
    }

    /// Waits until all peers are disconnected and all handles released, then stops the server.
    ///
    /// # Panics
    ///
    /// When that takes longer than half a minute.
    pub fn stop_empty(self) {
        let until = std::time::Instant::now() + Duration::from_secs(30);
        let left = || {
            let application = self.application();
            (application.open.len(), application.peers.len())
        };
        while left() != (0, 0) && std::time::Instant::now() < until {
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!(left(), (0, 0), "leaked handles and peers");
    }

    /// Stops the server and waits for its end; returns the application.
    #[must_use]
    pub fn stop(mut self) -> Application {
        self.background.end();
        std::mem::take(&mut *self.application())
    }
}

impl<H: Handler + rac::server::Handler + Send + 'static> Served<H> {
    /// Starts a server of any handler on free ports of the loopback.
    ///
    /// # Panics
    ///
    /// When the machine has no socket for it.
    #[must_use]
    pub fn of(handler: H, limits: Limits) -> Self {
        let application = Arc::new(Mutex::new(handler));
        let shared = Arc::clone(&application);
        let (background, (addresses, runtime)) = Background::start(async move |stopped| {
            let server = Server::with_shared(shared).limits(limits);
            let server = server.bcap_tcp("127.0.0.1:0").await.expect("a port for TCP");
            let server = server.bcap_udp("127.0.0.1:0").await.expect("a port for UDP");
            let server = server.rac_tcp("127.0.0.1:0").await.expect("a port for RAC");
            let addresses = server.addresses();
            let run = async {
                server.run(async { _ = stopped.await }).await.expect("the listeners last");
            };
            ((addresses, Handle::current()), run)
        });
        let (tcp, udp, rac) = (addresses.bcap_tcp[0], addresses.bcap_udp[0], addresses.rac_tcp[0]);
        Self { tcp, udp, rac, application, runtime, background }
    }
}

impl<H> Served<H> {
    /// Returns how many tasks the server has: some for its sockets, and one for each connection.
    #[must_use]
    pub fn tasks(&self) -> usize {
        self.runtime.metrics().num_alive_tasks()
    }

    /// Calls a function with the application; the server waits during the call.
    pub fn application(&self) -> MutexGuard<'_, H> {
        self.application.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
