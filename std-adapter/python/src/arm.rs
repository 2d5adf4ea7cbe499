//! An arm that is taken, and its motions.

use std::pin::Pin;
use std::sync::Arc;

use bcap_std::{Destination, Error, Interpolation, Joints, Motion, Move, Pass, Plane, Position, Transform, asynch};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use tokio::sync::{Mutex, watch};

use crate::call::Call;
use crate::error::{self, Failure, seconds, unknown};
use crate::runtime::Home;
use crate::slave::{Stream, StreamConfig};

/// The arm of a robot, which this session has taken. Dropping it halts the robot, and gives the arm back.
#[pyclass(frozen)]
pub(crate) struct Arm {
    pub(crate) home: Arc<Home>,
    /// `None` after it was given back.
    arm: Arc<Mutex<Option<asynch::Arm>>>,
    given: watch::Sender<Giving>,
}

/// The progress of giving the arm back, which ends the calls of other threads.
#[derive(Clone, Copy, PartialEq)]
enum Giving {
    NotBegun,
    Begun,
    /// Whether it succeeded.
    Ended(bool),
}

/// The future of a function of the arm.
type Working<'a, T> = Pin<Box<dyn Future<Output = Result<T, Error>> + Send + 'a>>;

impl Arm {
    pub(crate) fn new(home: Arc<Home>, arm: asynch::Arm) -> Self {
        Self { home, arm: Arc::new(Mutex::new(Some(arm))), given: watch::Sender::new(Giving::NotBegun) }
    }

    /// Runs a function of the arm until the arm is given back, and then waits for the end of that.
    pub(crate) fn run<T, W>(&self, work: W) -> impl Future<Output = Result<T, Failure>> + Send + 'static + use<T, W>
    where
        T: Send + 'static,
        W: for<'a> FnOnce(&'a mut asynch::Arm) -> Working<'a, T> + Send + 'static,
    {
        let (arm, mut given) = (Arc::clone(&self.arm), self.given.subscribe());
        async move {
            let is_begun = |giving: &Giving| *giving != Giving::NotBegun;
            let mut taken = tokio::select! {
                biased;
                _ = given.wait_for(is_begun) => return Err(Failure::ArmGiven),
                taken = arm.lock() => taken,
            };
            // a call that waited may get the lock before it is woken by the change
            if is_begun(&given.borrow()) {
                return Err(Failure::ArmGiven);
            }
            let Some(held) = &mut *taken else { return Err(Failure::ArmGiven) };
            tokio::select! {
                biased;
                ended = work(held) => return Ok(ended?),
                _ = given.wait_for(is_begun) => {}
            }
            // the work was dropped, so its session halts the robot
            drop(taken);
            let ended = given.wait_for(|giving| matches!(giving, Giving::Ended(_))).await;
            Err(Failure::ArmGivenMeanwhile { succeeded: ended.is_ok_and(|ended| *ended == Giving::Ended(true)) })
        }
    }
}

/// Notifies the calls of other threads how the arm was given back, even if that is cancelled.
struct Giver {
    given: watch::Sender<Giving>,
    succeeded: bool,
}

impl Drop for Giver {
    fn drop(&mut self) {
        let succeeded = self.succeeded;
        self.given.send_modify(|giving| *giving = Giving::Ended(succeeded || *giving == Giving::Ended(true)));
    }
}

#[pymethods]
impl Arm {
    fn motor(&self, on: bool) -> Call {
        Call::fallible(
            &self.home,
            self.run(move |arm| Box::pin(async move { if on { arm.motor_on().await } else { arm.motor_off().await } })),
        )
    }

    fn set_speed(&self, percent: f64) -> Call {
        Call::fallible(&self.home, self.run(move |arm| Box::pin(arm.set_speed(percent))))
    }

    fn select_tool(&self, number: u8) -> Call {
        Call::fallible(&self.home, self.run(move |arm| Box::pin(arm.select_tool(number))))
    }

    fn select_work(&self, number: u8) -> Call {
        Call::fallible(&self.home, self.run(move |arm| Box::pin(arm.select_work(number))))
    }

    /// Makes motions without a stop between them, and waits for the end of the last motion.
    fn motions(&self, motions: Vec<Step<'_>>, timeout: f64) -> PyResult<Call> {
        let limit = seconds(timeout)?;
        let mut motions = motions.into_iter().map(Step::motion).collect::<PyResult<Vec<_>>>()?.into_iter();
        let first = motions.next().ok_or_else(|| PyValueError::new_err("a motion needs a destination"))?;
        Ok(Call::fallible(
            &self.home,
            self.run(move |arm| {
                Box::pin(async move {
                    let mut moving = arm.start(&first, limit).await?;
                    for motion in motions {
                        moving = moving.then(&motion).await?;
                    }
                    moving.wait().await.map(Ended)
                })
            }),
        ))
    }

    /// Begins a stream of Slave Mode.
    fn stream(&self, config: StreamConfig) -> PyResult<Call> {
        Stream::begin(&self.home, config, |format, limits, trajectory| {
            self.run(move |arm| Box::pin(arm.stream(format, limits, trajectory)))
        })
    }

    /// Halts a motion, and gives the arm back.
    fn give(&self) -> Call {
        let (arm, given) = (Arc::clone(&self.arm), self.given.clone());
        Call::new(&self.home, async move {
            given.send_if_modified(|giving| {
                let begins = *giving == Giving::NotBegun;
                if begins {
                    *giving = Giving::Begun;
                }
                begins
            });
            let mut giver = Giver { given, succeeded: false };
            let mut taken = arm.lock().await;
            if let Some(arm) = taken.take() {
                arm.give().await?;
                giver.succeeded = true;
            }
            Ok(())
        })
    }
}

/// The end of a motion: nothing if the robot has arrived, otherwise an exception.
struct Ended(Motion);

impl<'py> IntoPyObject<'py> for Ended {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = PyErr;

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        match self.0 {
            Motion::Arrived => Ok(py.None().into_bound(py)),
            other => Err(error::not_arrived(py, other)),
        }
    }
}

/// A motion as a dictionary.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Step<'py> {
    way: String,
    destination: Option<Bound<'py, PyAny>>,
    via: Option<Bound<'py, PyAny>>,
    axes: Vec<(u8, f64)>,
    /// The length of an approach or a departure in mm, or the angle of a rotation in degrees.
    amount: f64,
    plane: String,
    centre: [f64; 3],
    passing: Passing,
    speed: Option<f64>,
    acceleration: Option<f64>,
    deceleration: Option<f64>,
}

impl Step<'_> {
    fn motion(self) -> PyResult<Move> {
        let Self { way, destination, via, axes, amount, plane, centre, passing, speed, acceleration, deceleration } =
            self;
        let destination = destination.as_ref().map(place).transpose()?;
        let to = || destination.ok_or_else(|| PyValueError::new_err("a motion needs a destination"));
        let via = via.as_ref().map(place).transpose()?;
        let (interpolation, way) = match way.split_once(' ') {
            Some((way, "line")) => (Interpolation::Line, way),
            Some((way, _)) => (Interpolation::Joint, way),
            None => (Interpolation::Joint, &*way),
        };
        let mut motion = match (way, via) {
            ("move", Some(via)) => Move::circle(via, to()?),
            ("move", None) if interpolation == Interpolation::Line => Move::line(to()?),
            ("move", None) => Move::joint(to()?),
            ("approach", _) => Move::approach(interpolation, to()?, amount),
            ("depart", _) => Move::depart(interpolation, amount),
            ("drive-by", _) => Move::drive_by(axes),
            ("drive-to", _) => Move::drive_to(axes),
            ("rotate", _) => Move::rotate(plane_of(&plane)?, amount as f32, centre),
            _ => return Err(unknown("motion", way, "move, approach, depart, drive-by, drive-to, rotate")),
        };
        motion = motion.pass(passing.pass()?);
        if let Some(percent) = speed {
            motion = motion.speed_percent(percent);
        }
        if let Some(percent) = acceleration {
            motion = motion.acceleration_percent(percent);
        }
        if let Some(percent) = deceleration {
            motion = motion.deceleration_percent(percent);
        }
        Ok(motion)
    }
}

fn plane_of(name: &str) -> PyResult<Plane> {
    match name {
        "xy" => Ok(Plane::Xy),
        "yz" => Ok(Plane::Yz),
        "zx" => Ok(Plane::Zx),
        _ => Err(unknown("plane", name, "xy, yz, zx")),
    }
}

/// The accuracy at the end of a motion: a word, or a distance in mm.
#[derive(FromPyObject)]
enum Passing {
    Distance(u16),
    Word(String),
}

impl Passing {
    fn pass(&self) -> PyResult<Pass> {
        match self {
            Self::Distance(mm) => Ok(Pass::Within(*mm)),
            Self::Word(word) => match &**word {
                "exact" => Ok(Pass::Exact),
                "commanded" => Ok(Pass::Commanded),
                "near" => Ok(Pass::Near),
                _ => Err(unknown("passing", word, "exact, commanded, near, and a distance in mm")),
            },
        }
    }
}

/// Returns a destination: text, or a sequence with a letter as its attribute `kind`.
fn place(object: &Bound<'_, PyAny>) -> PyResult<Destination> {
    if let Ok(text) = object.extract::<String>() {
        return Ok(text.into());
    }
    let kind = object.getattr("kind").and_then(|kind| kind.extract::<String>());
    let kind =
        kind.map_err(|_| PyTypeError::new_err("a destination is P(...), J(...), T(...), or text such as \"P1\""))?;
    let numbers: Vec<f64> = object.extract()?;
    let figure = |number: &f64| *number as i32;
    Ok(match (&*kind, &*numbers) {
        ("P", [x, y, z, rx, ry, rz, fig @ ..]) if fig.len() <= 1 => {
            let position = Position::new([*x, *y, *z], [*rx, *ry, *rz]);
            fig.first().map_or(position, |fig| position.figure(figure(fig))).into()
        }
        ("T", [x, y, z, ox, oy, oz, ax, ay, az, fig @ ..]) if fig.len() <= 1 => {
            let transform = Transform::new([*x, *y, *z], [*ox, *oy, *oz], [*ax, *ay, *az]);
            fig.first().map_or(transform, |fig| transform.figure(figure(fig))).into()
        }
        ("J", [_, ..]) if numbers.len() <= 8 => {
            let degrees = std::array::from_fn(|axis| numbers.get(axis).copied().unwrap_or(0.0));
            Joints { degrees }.into()
        }
        _ => return Err(PyValueError::new_err(format!("{kind} does not have {} numbers", numbers.len()))),
    })
}
