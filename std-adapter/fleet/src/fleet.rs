//! A fleet: the scans, the publisher and the server of metrics.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bcap_std::asynch::Controller;
use bcap_std::{Model, Settings};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::broker::Connector;
use crate::config::{Cell, Config};
use crate::error::Error;
use crate::event::Event;
use crate::http;
use crate::metrics::Metrics;
use crate::publisher::Publisher;
use crate::queue::Queue;
use crate::reading::now_ms;
use crate::scan::{Scan, Shared};
use crate::status::Monitor;
use crate::store::Store;
use crate::stream::StreamCheck;

/// Many controllers and one broker.
pub struct Fleet {
    shared: Arc<Shared>,
    publisher: Publisher,
    controllers: Vec<Controller>,
    listener: Option<TcpListener>,
}

impl Fleet {
    /// Reads secrets and certificates, opens the buffer, listens for metrics, and begins to connect to the controllers.
    /// `report` is called for each [`Event`]; it must return immediately.
    ///
    /// # Errors
    ///
    /// An [`Error`]. A disconnected broker or controller is not an error.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future closes everything.
    pub async fn start(config: Config, report: impl Fn(&Event) + Send + Sync + 'static) -> Result<Self, Error> {
        let connector = Connector::new(&config)?;
        let store = match &config.buffer {
            None => None,
            Some(buffer) => {
                let failed = |source| Error::Buffer { path: buffer.directory.clone(), source };
                Some(Store::open(buffer, &config).map_err(failed)?)
            }
        };
        let listener = match config.metrics_address() {
            None => None,
            Some(address) => {
                let listener = TcpListener::bind(address).await;
                Some(listener.map_err(|source| Error::Listen { address, source })?)
            }
        };
        let controllers = config.controllers.iter().map(spawn).collect::<Result<Vec<_>, _>>()?;
        let metrics = Arc::new(Metrics::new(config.controllers.len()));
        metrics.active.store(config.standby.is_none(), Ordering::Relaxed);
        let shared = Arc::new(Shared {
            queue: Queue::new(Arc::clone(&metrics)),
            metrics,
            reads: watch::Sender::new(config.standby.is_none()),
            report: Box::new(report),
            // at most 1000 readings a millisecond
            next_id: AtomicU64::new(now_ms().saturating_mul(1000)),
            config,
        });
        let publisher = Publisher::new(Arc::clone(&shared), controllers.clone(), connector, store);
        Ok(Self { shared, publisher, controllers, listener })
    }

    /// Returns where metrics are served.
    #[must_use]
    pub fn metrics_address(&self) -> Option<SocketAddr> {
        self.listener.as_ref().and_then(|listener| listener.local_addr().ok())
    }

    /// Returns what reads the status while the fleet runs.
    #[must_use]
    pub fn monitor(&self) -> Monitor {
        Monitor { shared: Arc::clone(&self.shared) }
    }

    /// Runs until `end` is ready. Then it closes the sessions with the controllers, sends the messages that the broker
    /// takes within two seconds, and writes the rest to the buffer.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future closes all connections. Readings in memory are lost then.
    pub async fn run(self, end: impl Future<Output = ()>) {
        let Self { shared, publisher, controllers, listener } = self;
        let mut tasks = JoinSet::new();
        if let Some(listener) = listener {
            tasks.spawn(http::serve(listener, Arc::clone(&shared)));
        }
        for (cell, controller) in controllers.iter().enumerate() {
            let (shared, controller) = (Arc::clone(&shared), controller.clone());
            tasks.spawn(Scan { shared, cell, controller, stream: StreamCheck::default() }.run());
        }
        let closing = async {
            end.await;
            let mut closing = JoinSet::new();
            for controller in controllers {
                closing.spawn(controller.close());
            }
            // a controller that does not answer must not delay the end
            let _ = tokio::time::timeout(CLOSE, closing.join_all()).await;
        };
        publisher.run(closing).await;
        // a fleet that starts after this one may listen on the same port, so the server must have ended
        tasks.shutdown().await;
    }
}

/// Maximum time for the end of all sessions.
const CLOSE: std::time::Duration = std::time::Duration::from_secs(2);

/// Begins to connect to a controller.
fn spawn(cell: &Cell) -> Result<Controller, Error> {
    Controller::spawn(&cell.address, &settings(cell))
        .map_err(|error| Error::Config(format!("the controller {}: {error}", cell.name)))
}

/// Returns how to connect to a controller.
pub(crate) fn settings(cell: &Cell) -> Settings {
    Settings::new(Model::from(cell.model))
}
