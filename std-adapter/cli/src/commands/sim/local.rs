//! A virtual controller inside this process.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::thread::{self, JoinHandle};

use bcap_sim::{Controller, Model};
use tokio::sync::oneshot;

use crate::commands::sim;
use crate::failure::Failure;
use crate::listen::{Listening, runtime};

/// The virtual controller in a thread of this process, on free ports of the loopback.
pub(crate) struct LocalController {
    pub(crate) listening: Listening,
    stop: oneshot::Sender<()>,
    thread: JoinHandle<io::Result<()>>,
}

impl LocalController {
    pub(crate) fn start(model: Model) -> Result<Self, Failure> {
        let free = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let wanted = Listening { bcap: free, udp: free, rac: Some(free) };
        let runtime = runtime()?;
        let (server, listening) = runtime.block_on(sim::listen(Controller::new(sim::config(model)), &wanted))?;
        let (stop, stopped) = oneshot::channel();
        let thread = thread::Builder::new().name("controller".into()).spawn(move || {
            // a dropped sender also stops the server
            runtime.block_on(server.run(async { stopped.await.unwrap_or(()) }))
        })?;
        Ok(Self { listening, stop, thread })
    }

    pub(crate) fn stop(self) -> Result<(), Failure> {
        // if the controller has ended already, its result says why
        let _ = self.stop.send(());
        match self.thread.join() {
            Ok(result) => Ok(result?),
            Err(_) => Err(Failure::Connection {
                message: "the virtual controller has panicked".into(),
                hint: "this is a bug in the virtual controller; please report it".into(),
            }),
        }
    }
}
