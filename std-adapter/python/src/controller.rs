//! A controller, its stopper, and the changes of its variables.

use std::sync::Arc;

use bcap_sim::memory::Network;
use bcap_std::blocking::Halted;
use bcap_std::core::hresult::HResult;
use bcap_std::core::variant::OwnedVariant;
use bcap_std::{Error, Joints, Options, Position, RecoveryConfig, Settings, TaskStart, TaskStatus};
use bcap_std::{TaskStop, asynch};
use pyo3::prelude::*;
use tokio::sync::Mutex;

use crate::arm::Arm;
use crate::call::Call;
use crate::error::{self, Failure, seconds, unknown};
use crate::runtime::Home;
use crate::sim::{Sim, find_model};
use crate::value::{Value, equals, from_python};

/// A session with a controller.
#[pyclass(frozen)]
pub(crate) struct Controller {
    home: Arc<Home>,
    cell: asynch::Controller,
    /// A second session of the virtual controller in memory, which has no address.
    network: Option<Network>,
    settings: Settings,
}

/// Connects to a controller at an address, or to a virtual one in memory. `driven` says that the threads that make its calls run it.
#[pyfunction]
pub(crate) fn connect(
    address: String,
    model: &str,
    robot: Option<String>,
    timeout: f64,
    sim: Option<&Bound<'_, Sim>>,
    driven: bool,
) -> PyResult<Call> {
    let (_, _, model) = find_model(model)?;
    let mut settings = Settings::new(model).options(Options::default().connect_timeout(seconds(timeout)?));
    settings.robot = robot;
    let network = sim.and_then(|sim| sim.get().network()).cloned();
    let home = if driven { Home::driven()? } else { Home::shared()? };
    Ok(Call::new(&Arc::clone(&home), async move {
        let cell = match &network {
            Some(network) => asynch::Controller::over(network.connect(), &settings).await?,
            None => asynch::Controller::connect(&address, &settings).await?,
        };
        Ok(Controller { home, cell, network, settings })
    }))
}

/// Returns number, name, meaning and remedy of a code.
fn described(code: HResult) -> (u32, Option<&'static str>, Option<&'static str>, Option<String>) {
    (code.to_u32(), code.name(), code.meaning(), code.hint().map(|hint| hint.to_string()))
}

impl Controller {
    /// Makes a call with the robot.
    fn with_robot<T, F>(&self, work: impl FnOnce(asynch::Robot) -> F + Send + 'static) -> Call
    where
        T: for<'py> IntoPyObject<'py> + Send + 'static,
        F: Future<Output = Result<T, Error>> + Send + 'static,
    {
        let cell = self.cell.clone();
        Call::new(&self.home, async move { work(cell.robot().await?).await })
    }
}

#[pymethods]
impl Controller {
    fn read(&self, name: String) -> Call {
        let cell = self.cell.clone();
        Call::new(&self.home, async move { cell.read::<OwnedVariant>(&name).await.map(Value) })
    }

    /// Reads several variables in one turn.
    fn read_all(&self, names: Vec<String>) -> Call {
        let cell = self.cell.clone();
        Call::new(&self.home, async move {
            let names: Vec<_> = names.iter().map(String::as_str).collect();
            let mut values = Vec::with_capacity(names.len());
            for (_, value) in cell.read_each(&names).await? {
                values.push(Value(value?));
            }
            Ok(values)
        })
    }

    fn write(&self, name: String, value: &Bound<'_, PyAny>) -> PyResult<Call> {
        let (cell, value) = (self.cell.clone(), from_python(value)?);
        Ok(Call::new(&self.home, async move { cell.write(&name, value).await }))
    }

    /// Reads a variable until it has a value.
    fn wait_for(&self, name: String, value: &Bound<'_, PyAny>, timeout: f64) -> PyResult<Call> {
        let (cell, wanted, limit) = (self.cell.clone(), from_python(value)?, seconds(timeout)?);
        Ok(Call::fallible(&self.home, async move {
            let mut refused = None;
            let compare = |value: &OwnedVariant| match equals(value.as_variant(), wanted.as_variant()) {
                Ok(is_equal) => is_equal,
                Err(reason) => {
                    refused = Some(reason);
                    true
                }
            };
            let value = cell.read_until(&name, compare, limit).await?;
            match refused {
                Some(reason) => Err(Failure::Argument(format!("{name} cannot have the wanted value: {reason}"))),
                None => Ok(Value(value)),
            }
        }))
    }

    fn watch(&self, names: Vec<String>, interval: f64) -> PyResult<Watch> {
        let names: Vec<_> = names.iter().map(String::as_str).collect();
        let interval = seconds(interval)?;
        // it starts a task
        let _context = self.home.handle()?.enter();
        let changes = self.cell.subscribe(&names, interval);
        Ok(Watch { home: Arc::clone(&self.home), changes: Arc::new(Mutex::new(changes)) })
    }

    fn execute(&self, command: String, parameter: &Bound<'_, PyAny>) -> PyResult<Call> {
        let (cell, parameter) = (self.cell.clone(), from_python(parameter)?);
        Ok(Call::new(&self.home, async move { cell.execute::<OwnedVariant>(&command, parameter).await.map(Value) }))
    }

    fn execute_robot(&self, command: String, parameter: &Bound<'_, PyAny>) -> PyResult<Call> {
        let parameter = from_python(parameter)?;
        Ok(self.with_robot(|robot| async move { robot.execute::<OwnedVariant>(&command, parameter).await.map(Value) }))
    }

    fn joints(&self) -> Call {
        self.with_robot(|robot| async move { robot.joints().await.map(|Joints { degrees }| degrees.to_vec()) })
    }

    fn position(&self) -> Call {
        self.with_robot(|robot| async move { robot.position().await.map(|at: Position| at.to_array().to_vec()) })
    }

    /// Returns the codes of the current errors, and what a person must do first.
    fn examine(&self) -> Call {
        self.with_robot(|robot| async move {
            let state = robot.examine().await?;
            let errors: Vec<_> = state.errors().iter().copied().map(described).collect();
            Ok((errors, state.obstacles().map(|obstacle| obstacle.to_string()).collect::<Vec<_>>()))
        })
    }

    fn take_arm(&self) -> Call {
        let home = Arc::clone(&self.home);
        self.with_robot(|robot| async move { robot.take_arm().await.map(|arm| Arm::new(home, arm)) })
    }

    fn recover(&self, alone: bool, speed: Option<f64>) -> Call {
        let (home, config) = (Arc::clone(&self.home), RecoveryConfig { is_alone: alone, speed, agreed: None });
        self.with_robot(move |robot| async move { robot.recover(config).await.map(|arm| Arm::new(home, arm)) })
    }

    fn prepare(&self) -> Call {
        let home = Arc::clone(&self.home);
        self.with_robot(|robot| async move { robot.prepare().await.map(|arm| Arm::new(home, arm)) })
    }

    /// Opens a second session, which runs on a separate thread, so that other calls do not delay it.
    fn stopper(&self) -> PyResult<Call> {
        let home = Home::shared()?;
        let (cell, network, settings) = (self.cell.clone(), self.network.clone(), self.settings.clone());
        Ok(Call::new(&Arc::clone(&home), async move {
            let stopper = match network {
                Some(network) => asynch::Stopper::over(network.connect(), &settings).await?,
                None => cell.stopper().await?,
            };
            Ok(Stopper { home, stopper })
        }))
    }

    fn read_file(&self, name: &str) -> Call {
        let file = self.cell.file(name);
        Call::new(&self.home, async move { file.read::<OwnedVariant>().await.map(Value) })
    }

    fn write_file(&self, name: &str, content: &Bound<'_, PyAny>) -> PyResult<Call> {
        let (file, content) = (self.cell.file(name), from_python(content)?);
        Ok(Call::new(&self.home, async move { file.write(content).await }))
    }

    fn start_task(&self, name: String, mode: &str) -> PyResult<Call> {
        let mode = match mode {
            "once" => TaskStart::OneCycle,
            "continuous" => TaskStart::Continuous,
            "step" => TaskStart::OneStep,
            _ => return Err(unknown("mode", mode, "once, continuous, step")),
        };
        let cell = self.cell.clone();
        Ok(Call::new(&self.home, async move { cell.task(&name).await?.start(mode).await }))
    }

    fn stop_task(&self, name: String, mode: &str) -> PyResult<Call> {
        let mode = match mode {
            "default" => TaskStop::Default,
            "now" => TaskStop::Now,
            "step" => TaskStop::AfterStep,
            "cycle" => TaskStop::AfterCycle,
            "initialize" => TaskStop::Initialize,
            _ => return Err(unknown("mode", mode, "default, now, step, cycle, initialize")),
        };
        let cell = self.cell.clone();
        Ok(Call::new(&self.home, async move { cell.task(&name).await?.stop(mode).await }))
    }

    fn task_status(&self, name: String) -> Call {
        let cell = self.cell.clone();
        Call::new(&self.home, async move {
            Ok(match cell.task(&name).await?.status().await? {
                TaskStatus::None => "none",
                TaskStatus::Suspended => "suspended",
                TaskStatus::Ready => "ready",
                TaskStatus::Running => "running",
                TaskStatus::StoppedAtStep => "stopped at a step",
                _ => "unknown",
            })
        })
    }

    fn close(&self) -> Call {
        let cell = self.cell.clone();
        Call::new(&self.home, async move {
            match cell.close().await {
                // it was closed before
                Err(Error::Closed) => Ok(()),
                closed => closed,
            }
        })
    }
}

/// Halts the robot from any thread, over a separate connection.
#[pyclass(frozen)]
pub(crate) struct Stopper {
    home: Arc<Home>,
    stopper: asynch::Stopper,
}

#[pymethods]
impl Stopper {
    fn halt(&self) -> Call {
        let stopper = self.stopper.clone();
        Call::new(&self.home, async move {
            Ok(match stopper.halt().await? {
                Halted::Halted => "halted",
                Halted::NothingMoved => "nothing moved",
                Halted::TasksStopped(_) => "tasks stopped",
                _ => "at rest",
            })
        })
    }
}

/// The changes of variables.
#[pyclass(frozen)]
pub(crate) struct Watch {
    home: Arc<Home>,
    changes: Arc<Mutex<asynch::Subscription>>,
}

#[pymethods]
impl Watch {
    /// Returns the next change: its name, and its value or its exception; None at the end.
    fn next(&self) -> Call {
        let changes = Arc::clone(&self.changes);
        Call::new(&self.home, async move { Ok(changes.lock().await.next().await.map(Change)) })
    }
}

struct Change(asynch::Reading);

impl<'py> IntoPyObject<'py> for Change {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = PyErr;

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let asynch::Reading { name, value, .. } = self.0;
        let (value, failure) = match value {
            Ok(value) => (Some(Value(value)), None),
            Err(failure) => (None, Some(error::raise(py, &failure))),
        };
        Ok((&*name, value, failure).into_pyobject(py)?.into_any())
    }
}
