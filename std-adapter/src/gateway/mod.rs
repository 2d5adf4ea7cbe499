//! The gateway of the core over tokio: PLCs that speak RAC on one side, a robot that speaks b-CAP on the other.
//!
//! ```text
//!  PLC ─► TCP listener ─► a task ─┐
//!  PLC ─► TCP listener ─► a task ─┼─► the gateway ◄─► a task ◄─► the robot, over TCP or UDP
//!                                 │
//!                                 └─► Report: every answer; robot and PLCs connect and disconnect
//! ```
//!
//! A [`Driver`] runs the [driver of `bcap-gateway`](bcap_gateway::driver) over sockets. [`Config`](bcap_gateway::Config) sets
//! how the robot is reached, what PLCs may do, and the time limit of a request. [`Limits`] bounds the resources for PLCs: a new
//! connection gets the slot of the connection that has been idle longest when slots are short. A PLC that sends without a pause
//! does not delay other PLCs: tasks yield after each read and write, and the gateway serves requests in turn.
//!
//! With [`Driver::modbus`], PLCs that do not speak RAC use Modbus TCP.
//!
//! # Examples
//!
//! ```no_run
//! use bcap_gateway::{Allow, Config, Gateway, Memory, Rules};
//! use bcap_core::rac::{self, VariableKind};
//! use bcap_std::gateway::{Driver, Report};
//! use tokio::net::TcpListener;
//!
//! # async fn example(ctrl_c: impl Future<Output = ()>) -> std::io::Result<()> {
//! let put = Box::leak(Box::new([Allow::range(VariableKind::I, 0, 99)]));
//! let config = Config { rules: Rules { put, ..Rules::READ_ONLY }, ..Config::RC8 };
//! // 64 PLCs; the memory lives as long as the process
//! let gateway = Gateway::new(config, Box::leak(Box::new(Memory::<64, 256>::new())));
//!
//! let log = |report: &Report<'_>| println!("{report:?}");
//! let listener = TcpListener::bind(("0.0.0.0", rac::PORT)).await?;
//! let counters = Driver::new(gateway, ("192.168.0.1", 5007), log).run(listener, ctrl_c).await;
//! println!("{} requests served", counters.served.count());
//! # Ok(())
//! # }
//! ```

mod clients;
mod platform;
mod report;
mod robot;
mod traffic;

use std::sync::Arc;
use std::time::Duration;

use bcap_core::bcap::Link;
use bcap_gateway::driver;
use bcap_gateway::modbus::Entry;
use bcap_gateway::{Counters, Gateway};
use tokio::net::TcpListener;
use tokio::sync::watch;

use self::clients::Plant;
use self::platform::SharedGateway;
use self::robot::{HostPort, RobotSocket};
use self::traffic::TrafficTap;
use crate::connect::{DATAGRAM_ROOM, Options, random_serial};

pub use self::report::{Ended, Report};
pub use self::traffic::{Moved, Traffic};
pub use bcap_gateway::driver::{Denial, Limits};

/// Drives a gateway over the sockets of this machine.
#[derive(Debug)]
pub struct Driver {
    shared: Arc<SharedGateway>,
    robot: HostPort,
    options: Options,
    tap: TrafficTap,
    limits: Limits,
    modbus: Option<(TcpListener, &'static [Entry])>,
}

impl Driver {
    /// Creates a driver for a robot at a host and a port. The link of the gateway's configuration selects TCP or UDP; a host
    /// name is looked up for each connection.
    ///
    /// `log` gets every report. It is called while the gateway is locked, so it must be short.
    #[must_use]
    pub fn new(
        mut gateway: Gateway<'static>,
        (host, port): (impl Into<String>, u16),
        log: impl FnMut(&Report<'_>) + Send + 'static,
    ) -> Self {
        if gateway.config().client.link == Link::Datagram {
            gateway.set_next_serial(random_serial());
        }
        let shared = Arc::new(SharedGateway::new(gateway, Box::new(log)));
        Self {
            shared,
            robot: (host.into(), port),
            options: Options::default(),
            tap: TrafficTap::default(),
            limits: Limits::default(),
            modbus: None,
        }
    }

    /// Changes the limits for PLCs. The operating system probes a PLC after a minute of silence in any case.
    #[must_use]
    pub fn limits(self, limits: Limits) -> Self {
        Self { limits, ..self }
    }

    /// Serves Modbus TCP on another listener, for PLCs that do not speak RAC: a request becomes a line for each of its variables.
    /// The same slots, rules and limits apply.
    #[must_use]
    pub fn modbus(self, listener: TcpListener, map: &'static [Entry]) -> Self {
        Self { modbus: Some((listener, map)), ..self }
    }

    /// Shows all bytes of PLCs and of the robot to a function, such as a recording. No task moves bytes while it is called, so it
    /// must be short.
    #[must_use]
    pub fn tap(self, tap: impl FnMut(&Traffic<'_>) + Send + 'static) -> Self {
        Self { tap: TrafficTap::new(tap), ..self }
    }

    /// Sets the time limit for connecting to the robot over TCP, for each address of its name; 3 s by default.
    #[must_use]
    pub fn connect_timeout(mut self, timeout: Duration) -> Self {
        self.options.connect_timeout = timeout;
        self
    }

    /// Serves the PLCs that connect to `listener` until `shutdown` is ready, and returns the counts.
    ///
    /// Then it accepts no more connections and lines. A running request still gets its answer within the gateway's
    /// `request_timeout`, and the connection to the robot is closed last.
    ///
    /// # Cancel safety
    ///
    /// When the future is dropped all connections are closed immediately; a running request may have been carried out.
    pub async fn run(self, listener: TcpListener, shutdown: impl Future<Output = ()>) -> Counters {
        let Self { shared, robot, options, tap, limits, modbus } = self;
        let (stop, stopped) = watch::channel(());
        let plant = Plant { shared: Arc::clone(&shared), tap: tap.clone(), limits, stopped };
        let clients = async {
            let modbus = async {
                if let Some((listener, map)) = modbus {
                    clients::listen(listener, Some(map), plant.clone()).await;
                }
            };
            let stop = async {
                shutdown.await;
                shared.stop();
                // every listener sees that the sender is dropped
                drop(stop);
            };
            tokio::join!(clients::listen(listener, None, plant.clone()), modbus, stop)
        };
        let kind = shared.view(|gateway| gateway.config().client.link).unwrap_or(Link::Stream);
        let mut link = RobotSocket { robot, kind, options, tap, socket: None };
        let mut frame = vec![0; DATAGRAM_ROOM];
        tokio::select! {
            ((), (), ()) = clients => {}
            never = driver::run_robot(&mut link, &mut frame, &shared) => never,
        }
        shared.view(|gateway| *gateway.counters()).unwrap_or_default()
    }
}
