//! The objects of a controller for tokio: each function is dropped after a number of turns of the runtime, so that the task is
//! dropped by its caller before, during and after each of its calls. Then the same controller must serve an ordinary call, and
//! no arm may be taken, no robot moving and no object open without an owner.

use std::collections::BTreeMap;
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant;
use bcap_sim::{Config, Controller as Simulated, Profile};
use bcap_std::asynch::{Arm, Controller, Stopper};
use bcap_std::{Joints, Motion, Move, RecoveryConfig, Settings, TaskStart, TaskStop};
use bcap_tests::served::Served;
use bcap_tests::simulated::simulated;
use tokio::task::yield_now;

/// The numbers of turns after which a future is dropped.
const TURNS: [usize; 14] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 40, 80, 160, 320, 640];
const LIMIT: Duration = Duration::from_secs(30);

/// Drops a future after `turns` turns of the runtime; returns its output if it ended before.
async fn dropped_after<T>(turns: usize, future: impl Future<Output = T>) -> Option<T> {
    let mut future = pin!(future);
    for _ in 0..turns {
        if let Poll::Ready(output) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return Some(output);
        }
        yield_now().await;
    }
    None
}

/// The virtual controller, a session with it, and where the counts go.
struct Rig {
    sim: Served<Simulated>,
    cell: Controller,
    address: String,
    points: BTreeMap<&'static str, usize>,
}

impl Rig {
    async fn new() -> Self {
        let sim = simulated();
        let address = sim.address();
        let cell = Controller::connect(&address, &Settings::rc8()).await.unwrap();
        Self { sim, cell, address, points: BTreeMap::new() }
    }

    /// Drops the futures of `make` and checks the controller after each.
    async fn sweep<T>(&mut self, name: &'static str, make: impl AsyncFn(Controller) -> T) {
        for turns in TURNS {
            let ended = dropped_after(turns, make(self.cell.clone())).await.is_some();
            self.check(name, turns).await;
            if ended {
                break;
            }
            *self.points.entry(name).or_default() += 1;
        }
    }

    /// Sends an ordinary call, and waits until the robot rests without an owner.
    async fn check(&self, name: &str, turns: usize) {
        let number = i32::try_from(turns).unwrap();
        self.cell.write("I9", number).await.unwrap_or_else(|error| panic!("{name} after {turns} turns: {error}"));
        assert_eq!(self.cell.read::<i32>("I9").await.unwrap(), number, "{name} after {turns} turns");
        for _ in 0..10_000 {
            {
                let mut sim = self.sim.application();
                sim.advance(bcap_std::now());
                if sim.arm_owner().is_none() && !sim.is_moving() && !sim.motor_is_on() {
                    // a motion that the drop has halted is an error of the controller, which its user clears
                    let errors: Vec<_> = sim.errors().map(|error| error.code).collect();
                    let is_halted = |code: &HResult| *code == HResult::E_MOTION_STOPPED;
                    assert!(errors.iter().all(is_halted), "{name} after {turns} turns: {errors:?}");
                    sim.clear_errors(bcap_std::now());
                    return;
                }
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        panic!("{name} after {turns} turns: the robot is not at rest, or somebody has its arm");
    }
}

async fn arm(cell: &Controller) -> Arm {
    cell.robot().await.unwrap().take_arm().await.unwrap()
}

/// Drops all functions; returns at how many points each was dropped.
pub(crate) fn all() -> BTreeMap<&'static str, usize> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut rig = Rig::new().await;
        calls(&mut rig).await;
        arms(&mut rig).await;
        sessions(&mut rig).await;
        std::mem::take(&mut rig.points)
    })
}

async fn calls(rig: &mut Rig) {
    rig.sweep("Controller::read", async |cell| cell.read::<i32>("I1").await.unwrap()).await;
    rig.sweep("Controller::read_all", async |cell| cell.read_all(["I2", "P1"]).await.unwrap()).await;
    rig.sweep("Controller::read_each", async |cell| cell.read_each(&["I2", "P1"]).await.unwrap().len()).await;
    rig.sweep("Controller::write", async |cell| cell.write("I3", 1).await.unwrap()).await;
    rig.sweep("Controller::execute", async |cell| cell.execute::<i32>("SysState", ()).await.unwrap()).await;
    rig.sweep("Controller::call", async |cell| {
        cell.call(call::controller_get_name(cell.handle().await.unwrap())).await.unwrap();
    })
    .await;
    rig.sweep("Controller::handle", async |cell| cell.handle().await.unwrap()).await;
    rig.sweep("Controller::robot", async |cell| drop(cell.robot().await.unwrap())).await;
    rig.sweep("Robot::read", async |cell| {
        cell.robot().await.unwrap().read::<bool>("@SERVO_ON").await.unwrap();
    })
    .await;
    rig.sweep("Robot::joints", async |cell| cell.robot().await.unwrap().joints().await.unwrap()).await;
    rig.sweep("Robot::position", async |cell| cell.robot().await.unwrap().position().await.unwrap()).await;
    rig.sweep("Robot::execute", async |cell| {
        drop(cell.robot().await.unwrap().execute::<OwnedVariant>("CurJnt", ()).await.unwrap());
    })
    .await;
    rig.sweep("Controller::task", async |cell| drop(cell.task("Pro1").await.unwrap())).await;
    rig.sweep("Task::start", async |cell| {
        let task = cell.task("Pro1").await.unwrap();
        // a dropped start may have been executed
        task.stop(TaskStop::Now).await.unwrap();
        task.start(TaskStart::OneCycle).await.unwrap();
    })
    .await;
    rig.sweep("Task::stop", async |cell| cell.task("Pro1").await.unwrap().stop(TaskStop::Now).await.unwrap()).await;
    rig.sweep("Task::status", async |cell| cell.task("Pro1").await.unwrap().status().await.unwrap()).await;
    // there is no such file
    rig.sweep("File::read", async |cell| cell.file("none.txt").read::<String>().await.unwrap_err()).await;
    rig.sweep("File::write", async |cell| cell.file("none.txt").write("text").await.unwrap_err()).await;
    let interval = Duration::from_millis(1);
    rig.sweep("Subscription::next", async |cell| {
        cell.subscribe(&["I1"], interval).next().await.unwrap().value.unwrap();
    })
    .await;
    rig.sweep("Controller::read_until", async |cell| cell.read_until("I2", |_: &i32| true, interval).await.unwrap())
        .await;
    rig.sweep("States::next", async |cell| {
        let mut states = cell.states();
        states.next().await.unwrap();
        // there is no second state
        states.next().await
    })
    .await;
}

async fn arms(rig: &mut Rig) {
    rig.sweep("Robot::take_arm", async |cell| drop(arm(&cell).await)).await;
    let alone = RecoveryConfig { is_alone: true, ..RecoveryConfig::default() };
    rig.sweep("Robot::examine", async |cell| {
        cell.robot().await.unwrap().examine().await.unwrap();
    })
    .await;
    rig.sweep("Robot::recover", async |cell| drop(cell.robot().await.unwrap().recover(alone).await.unwrap())).await;
    rig.sweep("Robot::prepare", async |cell| drop(cell.robot().await.unwrap().prepare().await.unwrap())).await;
    rig.sweep("Arm::motor_on", async |cell| arm(&cell).await.motor_on().await.unwrap()).await;
    rig.sweep("Arm::motor_off", async |cell| {
        let mut arm = arm(&cell).await;
        arm.motor_on().await.unwrap();
        arm.motor_off().await.unwrap();
    })
    .await;
    rig.sweep("Arm::set_speed", async |cell| arm(&cell).await.set_speed(50.0).await.unwrap()).await;
    rig.sweep("Arm::select_tool", async |cell| arm(&cell).await.select_tool(1).await.unwrap()).await;
    rig.sweep("Arm::select_work", async |cell| arm(&cell).await.select_work(0).await.unwrap()).await;
    rig.sweep("Arm::give", async |cell| arm(&cell).await.give().await.unwrap()).await;
    rig.sweep("Arm::move_to", async |cell| {
        let mut arm = arm(&cell).await;
        arm.motor_on().await.unwrap();
        let there = arm.robot().joints().await.unwrap().degrees[0];
        let motion = Move::joint(Joints::new([there + 5.0, 45.0, 90.0, 0.0, 45.0, 0.0]));
        assert_eq!(arm.move_to(&motion, LIMIT).await.unwrap(), Motion::Arrived);
    })
    .await;
    moving(rig).await;
}

async fn moving(rig: &mut Rig) {
    let by = |arm: &Arm, degrees: f64| {
        let robot = arm.robot().clone();
        async move {
            let there = robot.joints().await.unwrap().degrees[0];
            Move::joint(Joints::new([there + degrees, 45.0, 90.0, 0.0, 45.0, 0.0]))
        }
    };
    rig.sweep("Arm::start", async |cell| {
        let mut arm = arm(&cell).await;
        arm.motor_on().await.unwrap();
        let motion = by(&arm, 5.0).await;
        arm.start(&motion, LIMIT).await.unwrap().halt().await.map(drop).unwrap();
    })
    .await;
    rig.sweep("Moving::then", async |cell| {
        let mut arm = arm(&cell).await;
        arm.motor_on().await.unwrap();
        let (out, back) = (by(&arm, 5.0).await, by(&arm, 0.0).await);
        let moving = arm.start(&out, LIMIT).await.unwrap().then(&back).await.unwrap();
        // on a loaded machine so short a motion may not be seen to begin, and is halted
        assert!(matches!(moving.wait().await.unwrap(), Motion::Arrived | Motion::Halted));
    })
    .await;
}

async fn sessions(rig: &mut Rig) {
    let address = rig.address.clone();
    rig.sweep("Controller::connect", async |_| {
        Controller::connect(&address, &Settings::rc8()).await.unwrap().close().await.unwrap();
    })
    .await;
    rig.sweep("Controller::over", async |_| {
        let network = bcap_sim::memory::Network::new(Config::new(Profile::Rc8));
        drop(Stopper::over(network.connect(), &Settings::rc8()).await.unwrap());
        let cell = Controller::over(network.connect(), &Settings::rc8()).await.unwrap();
        cell.read::<i32>("I1").await.unwrap();
    })
    .await;
    rig.sweep("Controller::connected", async |_| {
        Controller::spawn(&address, &Settings::rc8()).unwrap().connected().await.unwrap();
    })
    .await;
    rig.sweep("Stopper::halt", async |cell| cell.stopper().await.unwrap().halt().await.unwrap()).await;
    rig.sweep("Controller::close", async |_| {
        let other = Controller::connect(&address, &Settings::rc8()).await.unwrap();
        other.close().await.unwrap();
    })
    .await;
}
