//! The virtual controller, in this process.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::thread;

use bcap_sim::memory::Network;
use bcap_sim::{Config, Controller, Profile, Scenario};
use bcap_std::Model;
use bcap_std::server::Server;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tokio::sync::oneshot;

use crate::error::unknown;
use crate::runtime::lock;

/// A virtual controller on a port of this machine, or in memory with a clock that never waits.
#[pyclass(frozen)]
pub(crate) struct Sim {
    world: World,
    address: Option<String>,
    model: &'static str,
}

enum World {
    Served(Arc<Mutex<Controller>>, Mutex<Option<Serving>>),
    Virtual(Network),
}

/// The thread that serves a controller. It has a separate runtime, so that it outlasts the sessions of this process.
struct Serving {
    stop: oneshot::Sender<()>,
    thread: thread::JoinHandle<()>,
}

/// The models by name: the virtual controller, and the settings of a session.
const MODELS: [(&str, Profile, Model); 5] = [
    ("rc8", Profile::Rc8, Model::Rc8),
    ("rc8a", Profile::Rc8a, Model::Rc8),
    ("rc9", Profile::Rc9, Model::Rc9),
    ("cobotta", Profile::Cobotta, Model::Cobotta),
    ("cobotta-pro", Profile::CobottaPro, Model::Rc9),
];

/// Returns a model by its name.
pub(crate) fn find_model(name: &str) -> PyResult<(&'static str, Profile, Model)> {
    let known = || unknown("model", name, &MODELS.map(|(name, ..)| name).join(", "));
    MODELS.into_iter().find(|(model, ..)| *model == name).ok_or_else(known)
}

impl Sim {
    /// Returns the network of a controller in memory.
    pub(crate) const fn network(&self) -> Option<&Network> {
        match &self.world {
            World::Virtual(network) => Some(network),
            World::Served(..) => None,
        }
    }

    /// Runs a function with the controller.
    fn with<T: Send>(&self, py: Python<'_>, run: impl FnOnce(&mut Controller) -> T + Send) -> T {
        py.detach(|| match &self.world {
            World::Served(controller, _) => run(&mut lock(controller)),
            World::Virtual(network) => run(&mut network.controller()),
        })
    }
}

#[pymethods]
impl Sim {
    #[new]
    fn new(
        py: Python<'_>,
        model: &str,
        port: u16,
        scenario: Option<&str>,
        files: Option<PathBuf>,
        in_memory: bool,
    ) -> PyResult<Self> {
        let (model, profile, _) = find_model(model)?;
        let config = Config { files, ..Config::new(profile) };
        let scenario = scenario.map(|text| {
            let parsed = Scenario::parse(text).and_then(|scenario| scenario.check(&config).map(|()| scenario));
            parsed.map_err(|error| PyValueError::new_err(format!("invalid scenario: {error}")))
        });
        let scenario = scenario.transpose()?;
        if in_memory {
            let network = Network::new(config);
            scenario.into_iter().for_each(|scenario| network.controller().play(scenario));
            return Ok(Self { world: World::Virtual(network), address: None, model });
        }
        let mut controller = Controller::new(config);
        scenario.into_iter().for_each(|scenario| controller.play(scenario));
        let controller = Arc::new(Mutex::new(controller));
        let (port, serving) = py.detach(|| serve(Arc::clone(&controller), port))?;
        let world = World::Served(controller, Mutex::new(Some(serving)));
        Ok(Self { world, address: Some(format!("tcp:127.0.0.1:{port}")), model })
    }

    /// The address, or None in memory.
    #[getter]
    fn address(&self) -> Option<&str> {
        self.address.as_deref()
    }

    #[getter]
    const fn model(&self) -> &str {
        self.model
    }

    #[getter]
    fn moving(&self, py: Python<'_>) -> bool {
        self.with(py, |controller| controller.is_moving())
    }

    #[getter]
    fn motor_on(&self, py: Python<'_>) -> bool {
        self.with(py, |controller| controller.motor_is_on())
    }

    #[getter]
    fn arm_taken(&self, py: Python<'_>) -> bool {
        self.with(py, |controller| controller.arm_owner().is_some())
    }

    #[getter]
    fn slave_mode(&self, py: Python<'_>) -> i32 {
        self.with(py, |controller| controller.slave_mode())
    }

    #[getter]
    fn joints(&self, py: Python<'_>) -> Vec<f64> {
        self.with(py, |controller| controller.axes()).to_vec()
    }

    /// Presses or releases the emergency stop.
    fn emergency_stop(&self, py: Python<'_>, pressed: bool) {
        let now = self.network().map_or_else(bcap_std::now, Network::now);
        self.with(py, |controller| controller.emergency_stop(pressed, now));
    }

    /// Ends the server.
    fn close(&self, py: Python<'_>) {
        if let World::Served(_, serving) = &self.world
            && let Some(Serving { stop, thread }) = lock(serving).take()
        {
            let _ = stop.send(());
            // its panic was printed
            let _ = py.detach(|| thread.join());
        }
    }
}

/// Serves a controller on a thread, and returns its port.
fn serve(controller: Arc<Mutex<Controller>>, port: u16) -> PyResult<(u16, Serving)> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let server = Server::with_shared(controller).on_connect(Controller::connected);
    let server = runtime.block_on(server.bcap_tcp(("127.0.0.1", port)))?;
    let port = server.addresses().bcap_tcp.first().map_or(port, std::net::SocketAddr::port);
    let server = runtime.block_on(server.bcap_udp(("127.0.0.1", port)))?;
    let (stop, stopped) = oneshot::channel::<()>();
    let thread = thread::Builder::new().name("bcap-sim".to_owned()).spawn(move || {
        let ended = runtime.block_on(server.run(async {
            let _ = stopped.await;
        }));
        // a listening socket has failed: its clients detect that
        let _ = ended;
    })?;
    Ok((port, Serving { stop, thread }))
}
