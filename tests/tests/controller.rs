//! `Controller` and its objects against the virtual controller, over real sockets: their results, and the state in
//! which they leave the controller.

use std::net::TcpListener;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bcap_core::bcap::{FunctionId, call};
use bcap_core::hresult::HResult;
use bcap_core::procedure::Motion;
use bcap_core::variant::OwnedVariant;
use bcap_sim::codes::{EMERGENCY_STOP, WRONG_ARGUMENT};
use bcap_sim::memory::Network;
use bcap_sim::{Config, Controller as Simulated, Profile, Scenario};
use bcap_std::blocking::{Arm, Controller, Halted, Stopper};
use bcap_std::server::Limits;
use bcap_std::{
    Error, Interpolation, Joints, Move, Pass, Plane, Position, Settings, StoppedTasks, TaskStart, TaskStatus, TaskStop,
};
use bcap_testkit::network::Random;
use bcap_tests::served::Served;
use bcap_tests::simulated::{Outcomes, simulated, to, turn};

const LIMIT: Duration = Duration::from_secs(30);

/// Takes the arm and switches the motor on.
fn ready(cell: &mut Controller) -> Arm<'_> {
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    arm
}

/// A motion of 20 s, so that it is running at the next line.
fn far() -> Move {
    to(150.0).speed_percent(2.0)
}

fn connect(sim: &Served<Simulated>) -> Controller {
    Controller::connect(&sim.address(), &Settings::rc8()).unwrap()
}

#[test]
fn variables_are_read_and_written_over_both_transports() {
    let sim = simulated();
    for address in [sim.address(), format!("udp:{}", sim.udp)] {
        let mut cell = Controller::connect(&address, &Settings::rc8().robot("Arm0")).unwrap();
        cell.write("I1", 41).unwrap();
        assert_eq!(cell.read::<i32>("I1").unwrap(), 41);
        let position = Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5);
        cell.write("P1", position).unwrap();
        assert_eq!(cell.read::<Position>("P1").unwrap(), position);
        let [count, position] = cell.read_all(["I1", "P1"]).unwrap();
        assert_eq!((count.convert(), position.convert::<Vec<f32>>().unwrap().len()), (Ok(41), 7));
        assert!(!cell.robot().unwrap().read::<bool>("@SERVO_ON").unwrap());
        // I1, P1, the robot and its variable, each opened once
        assert_eq!(sim.application().open_objects(), 5, "with the controller");
        cell.close().unwrap();
        sim.assert_left();
    }
}

#[test]
fn a_path_names_a_variable_of_an_object_everywhere() {
    let sim = simulated();
    let mut cell = Controller::connect(&sim.address(), &Settings::rc8().robot("Arm0")).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    let mut all = arm.controller();
    // the path opens no second handle of the robot that has the arm
    let names = ["robot/@SERVO_ON", "robot:Arm0/@SERVO_ON", "task:Pro1/@STATUS", "controller/I1"];
    assert!(!all.read::<bool>(names[0]).unwrap());
    let [motor, again, status, count] = all.read_all(names).unwrap();
    assert_eq!((motor.convert(), again.convert(), count.convert()), (Ok(false), Ok(false), Ok(0)));
    // the controller, the robot and its variable, the task and its variable, I1
    assert_eq!(sim.application().open_objects(), 6);
    assert_eq!(all.scan(&names).unwrap().read(arm.controller()).unwrap()[2], status);
    assert_eq!(sim.application().open_objects(), 6);
    for (name, reason) in [
        ("task/@STATUS", "task: the name is missing; write task:NAME"),
        ("robot/task:Pro1/@STATUS", "robot/task:Pro1: a robot has no task"),
    ] {
        let error = arm.controller().read::<i32>(name).unwrap_err();
        assert!(matches!(error, Error::Path(_)), "{error}");
        assert_eq!(error.to_string(), reason);
    }
    // not a path: the controller is queried for this name
    let unknown = arm.controller().read::<i32>("a/b").unwrap_err();
    assert!(unknown.to_string().starts_with("Controller_GetVariable of a/b: "), "{unknown}");
    arm.controller().write("robot/@SERVO_ON", true).unwrap();
    assert!(sim.application().motor_is_on());
    drop(arm);
    assert!(!sim.application().motor_is_on(), "it was switched on here");
    cell.close().unwrap();
    sim.assert_left();
}

#[test]
fn variables_are_read_and_written_while_the_arm_is_taken_and_moves() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let scan = cell.scan(&["I1"]).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.controller().write("I1", 5).unwrap();
    assert_eq!(scan.read(arm.controller()).unwrap()[0].convert(), Ok(5));
    arm.motor_on().unwrap();
    let mut moving = arm.start(&to(40.0), LIMIT).unwrap();
    moving.controller().write("I1", 6).unwrap();
    assert_eq!(moving.wait().unwrap(), Motion::Arrived);
    assert_eq!(arm.controller().read::<i32>("I1").unwrap(), 6);
    assert_eq!(arm.controller().task("Pro1").unwrap().status().unwrap(), TaskStatus::Ready);
    drop(arm);
    assert_eq!(scan.read(&mut cell).unwrap()[0].convert(), Ok(6));
    drop(cell);
    sim.assert_left();
}

#[test]
fn values_are_waited_for_and_calls_have_time_limits() {
    let sim = simulated();
    let mut cell = connect(&sim);
    cell.write("I1", 3).unwrap();
    assert_eq!(cell.read_until("I1", |value: &i32| *value == 3, LIMIT).unwrap(), 3);
    let missed = cell.read_until("I1", |value: &i32| *value == 4, Duration::from_millis(25)).unwrap_err();
    assert_eq!(missed.to_string(), "I1 did not meet the condition within 25ms; its last value was I4(3)");
    let names = cell.call(call::controller_get_robot_names(cell.handle(), "")).unwrap();
    assert_eq!(names.convert::<Vec<String>>().unwrap(), ["Arm0"]);
    // an object that a call opens is released with the session
    let variable = cell.call(call::controller_get_variable(cell.handle(), "I1", "")).unwrap();
    assert_eq!(cell.call(call::variable_get_value(variable)).unwrap().convert(), Ok(3));
    let long = "x".repeat(3000);
    cell.call(call::variable_put_value(variable, long.as_str())).unwrap_err();
    let each = cell.read_each(&["I1", "I99999"]).unwrap();
    let [(first, count), (second, missing)] = each.as_slice() else { panic!("{each:?}") };
    assert_eq!(count.as_ref().unwrap().convert(), Ok(3));
    assert!(missing.is_err() && first <= second);

    let slow = "[[fault]]\nwhen = { every = 1, of = \"Variable_GetValue\" }\nthen = { delay_ms = 2000 }\n";
    sim.application().play(Scenario::parse(slow).unwrap());
    let late = cell.within(Duration::from_millis(20)).read::<i32>("I1").unwrap_err();
    assert!(matches!(late, Error::NoReply { .. }) && !late.is_lost(), "{late:?}");
    assert_eq!(cell.read::<i32>("I1").unwrap(), 3);
    let mut robot = cell.robot().unwrap();
    let late = robot.within(Duration::from_millis(20)).read::<bool>("@SERVO_ON").unwrap_err();
    assert!(matches!(late, Error::NoReply { .. }) && !late.is_lost(), "{late:?}");
    let mut arm = robot.take_arm().unwrap();
    let late = arm.robot().within(Duration::from_millis(20)).read::<bool>("@SERVO_ON").unwrap_err();
    assert!(matches!(late, Error::NoReply { .. }) && !late.is_lost(), "{late:?}");
    assert!(!arm.robot().read::<bool>("@SERVO_ON").unwrap());
    drop(arm);
    drop(cell);
    sim.assert_left();
}

#[test]
fn a_stopper_connects_without_a_controller() {
    let sim = simulated();
    let stopper = Stopper::connect(&sim.address(), &Settings::rc8()).unwrap();
    assert_eq!(stopper.halt().unwrap(), Halted::NothingMoved);
    assert!(matches!(Stopper::connect("robot", &Settings::rc8()), Err(Error::Address(_))));
}

/// The tool stays where it is when only the figure changes, so the position of a halted robot does not show a difference.
#[test]
fn the_same_place_with_another_figure_is_not_the_end_of_a_motion() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let stopper = cell.stopper().unwrap();
    let mut arm = ready(&mut cell);
    let home = Move::joint(Joints::new([0.0, 45.0, 90.0, 0.0, 45.0, 0.0]));
    for _ in 0..5 {
        assert_eq!(arm.move_to(&home, LIMIT).unwrap(), Motion::Arrived);
        let here = arm.robot().position().unwrap();
        assert_eq!(here.figure, 5);
        let turned = Move::joint(here.figure(1)).speed_percent(1.0);
        let moving = arm.start(&turned, LIMIT).unwrap();
        assert_eq!(stopper.halt().unwrap(), Halted::Halted);
        let ended = moving.wait().unwrap();
        assert!(matches!(ended, Motion::Unknown | Motion::Halted), "{ended:?}");
        assert_eq!(arm.robot().position().unwrap().figure, 5);
        sim.clear();
    }
    let here = arm.robot().position().unwrap();
    assert_eq!(arm.move_to(&Move::joint(here.figure(1)), LIMIT).unwrap(), Motion::Arrived);
    assert_eq!(arm.robot().position().unwrap().figure, 1);
}

#[test]
fn positions_and_vectors_are_no_joints() {
    let sim = simulated();
    let mut cell = connect(&sim);
    cell.write("P1", Position::new([400.0, 0.0, 300.0], [180.0, 0.0, 180.0]).figure(5)).unwrap();
    cell.write("J1", Joints::new([1.0, 2.0, 3.0])).unwrap();
    assert_eq!(cell.read::<Joints>("J1").unwrap(), Joints::new([1.0, 2.0, 3.0]));
    let here = cell.robot().unwrap().joints().unwrap();
    assert_eq!(cell.read::<Joints>("robot/@CURRENT_ANGLE").unwrap(), here);
    for name in ["P1", "V1", "T1", "I1", "robot/@CURRENT_POSITION"] {
        assert!(matches!(cell.read::<Joints>(name), Err(Error::Value { .. })), "{name}");
    }
    let position = cell.robot().unwrap().execute::<Joints>("CurPos", ()).unwrap_err();
    assert_eq!(
        position.to_string(),
        "the value of CurPos: expected an array of 8 elements, found VT_ARRAY|VT_R8 of 7 elements"
    );
}

#[test]
fn an_error_names_function_object_and_reason() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let refused = cell.read::<i32>("NoSuchVariable").unwrap_err();
    assert_eq!(
        refused.to_string(),
        "Controller_GetVariable of NoSuchVariable: the controller refused: 0x80000204 (E_CAO_OBJECT_NOTFOUND): There is no \
         such object. Hint: check the name against what the matching Get...Names function lists"
    );
    assert!(refused.code().is_some() && !refused.is_lost());
    assert!(cell.read::<i32>("P1").unwrap_err().to_string().starts_with("the value of P1: "));
    let mut other = connect(&sim);
    let arm = cell.robot().unwrap().take_arm().unwrap();
    let taken = other.robot().unwrap().take_arm().unwrap_err();
    assert_eq!(taken.code(), Some(HResult::E_ARM_NOT_TAKEN));
    drop(arm);
    let wrong = Controller::connect("robot", &Settings::rc8()).unwrap_err();
    assert!(matches!(wrong, Error::Address(_)), "{wrong}");
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let refused = Controller::connect(&format!("tcp:{free}"), &Settings::rc8()).unwrap_err();
    assert!(matches!(refused, Error::Connect(_)), "{refused}");
}

#[test]
fn a_motion_arrives_and_the_drop_leaves_nothing() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = ready(&mut cell);
    arm.set_speed(100.0).unwrap();
    assert_eq!(arm.move_to(&to(3.0), LIMIT).unwrap(), Motion::Arrived);
    assert!((arm.robot().joints().unwrap().degrees[0] - 3.0).abs() < 0.05);
    let line = arm.robot().position().unwrap();
    let [x, y, z] = line.xyz_mm;
    let lower = Position { xyz_mm: [x, y, z - 20.0], ..line };
    assert_eq!(arm.move_to(&Move::line(lower), LIMIT).unwrap(), Motion::Arrived);
    assert!((arm.robot().position().unwrap().xyz_mm[2] - (z - 20.0)).abs() < 0.1);
    arm.move_to(&Move::joint("J(3, 45, 90, 0, 45, 0)"), LIMIT).map(drop).unwrap();
    assert!(sim.application().motor_is_on() && sim.application().arm_owner().is_some());
    drop(arm);
    assert!(!sim.application().motor_is_on() && sim.application().arm_owner().is_none());
    drop(cell);
    sim.assert_left();
}

#[test]
fn an_arm_that_is_kept_or_taken_by_a_call_is_given_back_with_the_session() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = cell.arm().unwrap();
    arm.motor_on().unwrap();
    arm.keep();
    assert!(cell.has_arm() && sim.application().arm_owner().is_some() && sim.application().motor_is_on());
    cell.arm().unwrap().give().unwrap();
    assert!(!cell.has_arm() && sim.application().arm_owner().is_none() && !sim.application().motor_is_on());

    let robot = cell.open(&"robot".parse().unwrap()).unwrap();
    let execute = |cell: &mut Controller, command: &str, parameter: &[i32]| {
        let arguments = [OwnedVariant::new(&robot), OwnedVariant::new(command), OwnedVariant::new(parameter)];
        cell.call_any(command, FunctionId::ROBOT_EXECUTE, &arguments.map(Result::unwrap)).map(drop)
    };
    execute(&mut cell, "TakeArm", &[0, 1]).unwrap();
    execute(&mut cell, "Motor", &[1, 0]).unwrap();
    assert!(cell.has_arm());
    let motion = Move::joint("J(-90, 45, 90, 0, 45, 0)").speed_percent(1.0);
    let mut arm = cell.arm().unwrap();
    assert_eq!(arm.move_to(&motion, Duration::from_millis(1)).unwrap(), Motion::TimedOut);
    arm.keep();
    drop(cell);
    sim.assert_left();
    assert!(sim.application().arm_owner().is_none() && !sim.application().motor_is_on());
}

#[test]
fn a_scan_works_with_its_own_controller_only() {
    let sim = simulated();
    let (mut cell, mut other) = (connect(&sim), connect(&sim));
    cell.write("I1", 4).unwrap();
    let scan = cell.scan(&["I1", "P1", "IO128"]).unwrap();
    let open = sim.application().open_objects();
    for count in 5..8 {
        cell.write("I1", count).unwrap();
        let values = scan.read(&mut cell).unwrap();
        let [number, position, door] = values.as_slice() else { panic!("{values:?}") };
        assert_eq!((number.convert(), door.convert()), (Ok(count), Ok(false)));
        assert_eq!(position.convert::<Vec<f32>>().unwrap().len(), 7);
    }
    assert_eq!(sim.application().open_objects(), open, "a scan opens nothing");
    assert!(matches!(scan.read(&mut other), Err(Error::OtherSession)));
    assert!(cell.scan(&["I1", "NoSuchVariable"]).unwrap_err().to_string().contains("NoSuchVariable"));
}

#[test]
fn tasks_and_files_are_objects() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut task = cell.task("Pro1").unwrap();
    assert_eq!(task.status().unwrap(), TaskStatus::Ready);
    task.start(TaskStart::Continuous).unwrap();
    assert_eq!(task.status().unwrap(), TaskStatus::Running);
    task.stop(TaskStop::Now).unwrap();
    assert_ne!(task.status().unwrap(), TaskStatus::Running);
    assert!(cell.task("NoSuchTask").unwrap_err().to_string().contains("NoSuchTask"));
    let missing = cell.file("missing.txt").read::<String>().unwrap_err();
    assert!(missing.to_string().contains("missing.txt"), "{missing}");
    cell.close().unwrap();
    assert_eq!(sim.application().open_objects(), 0);
}

#[test]
fn tool_and_work_are_selected() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.select_tool(3).unwrap();
    arm.select_work(2).unwrap();
    let robot = arm.robot();
    assert_eq!(robot.read::<i32>("@CURRENT_TOOL").unwrap(), 3);
    assert_eq!(robot.read::<i32>("@CURRENT_WORK").unwrap(), 2);
    assert!(arm.select_tool(200).unwrap_err().to_string().contains("Tool200"));
}

#[test]
fn axes_are_driven_and_the_pass_is_sent() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = ready(&mut cell);
    assert_eq!(
        arm.move_to(&Move::drive_to([(1, 4.0), (2, 44.0)]).speed_percent(50.0), LIMIT).unwrap(),
        Motion::Arrived
    );
    assert_eq!(arm.move_to(&Move::drive_by([(1, -3.0)]), LIMIT).unwrap(), Motion::Arrived);
    let degrees = arm.robot().joints().unwrap().degrees;
    assert!((degrees[0] - 1.0).abs() < 0.05 && (degrees[1] - 44.0).abs() < 0.05, "{degrees:?}");
    for pass in [Pass::Exact, Pass::Commanded, Pass::Near, Pass::Within(10)] {
        assert_eq!(arm.move_to(&to(2.0).pass(pass), LIMIT).unwrap(), Motion::Arrived);
        assert_eq!(arm.move_to(&Move::joint("J(0, 45, 90, 0, 45, 0)").pass(pass), LIMIT).unwrap(), Motion::Arrived);
    }
    let refused = arm.move_to(&Move::drive_by([(9, 1.0)]), LIMIT).unwrap_err();
    assert_eq!(refused.code(), Some(WRONG_ARGUMENT));
}

#[test]
fn arcs_rotations_approach_and_depart_end_where_they_should() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = ready(&mut cell);
    let from = arm.robot().position().unwrap();
    let [x, y, z] = from.xyz_mm;
    let at = |dx: f64, dy: f64, dz: f64| Position { xyz_mm: [x + dx, y + dy, z + dz], ..from };
    let mut ends_at = |motion: &Move, [wx, wy, wz]: [f64; 3]| {
        assert_eq!(arm.move_to(motion, LIMIT).unwrap(), Motion::Arrived, "{motion:?}");
        let end = arm.robot().position().unwrap();
        let there = end.xyz_mm;
        let off = [there[0] - wx, there[1] - wy, there[2] - wz].map(f64::abs).into_iter().fold(0.0, f64::max);
        assert!(off < 0.2, "{motion:?} ended at {there:?}");
        end
    };
    ends_at(&Move::circle(at(-20.0, 20.0, 0.0), at(-40.0, 0.0, 0.0)), [x - 40.0, y, z]);
    // half a circle about the middle leads back, and the tool turns with it
    let turned = ends_at(&Move::rotate(Plane::Xy, 180.0, [x - 20.0, y, z]), [x, y, z]);
    let degrees = (turned.rotation_degrees[2] - from.rotation_degrees[2]).abs();
    assert!((degrees - 180.0).abs() < 0.05, "RZ turned by {degrees} degrees");
    // the tool points down: it approaches from above, and departs upwards
    ends_at(&Move::joint(at(0.0, 0.0, -30.0)), [x, y, z - 30.0]);
    ends_at(&Move::depart(Interpolation::Line, 10.0), [x, y, z - 20.0]);
    ends_at(&Move::approach(Interpolation::Joint, at(0.0, 0.0, -30.0), 20.0), [x, y, z - 10.0]);
}

#[test]
fn a_panic_of_the_user_leaves_nothing() {
    let sim = simulated();
    let panicked = catch_unwind(AssertUnwindSafe(|| {
        let mut cell = connect(&sim);
        let mut arm = cell.robot().unwrap().take_arm().unwrap();
        arm.motor_on().unwrap();
        panic!("in user code");
    }));
    assert!(panicked.is_err());
    sim.assert_left();
}

#[test]
fn a_motor_that_was_on_before_stays_on() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut first = cell.robot().unwrap().take_arm().unwrap();
    first.motor_on().unwrap();
    first.robot().execute::<()>("GiveArm", ()).unwrap();
    std::mem::forget(first);
    connect(&sim).robot().unwrap().take_arm().unwrap().give().unwrap();
    assert!(sim.application().motor_is_on() && sim.application().arm_owner().is_none());
}

#[test]
fn an_error_of_the_controller_is_the_end_of_a_motion() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = ready(&mut cell);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            sim.until(Simulated::is_moving);
            sim.application().emergency_stop(true, bcap_std::now());
        });
        assert_eq!(arm.move_to(&far(), LIMIT).unwrap(), Motion::Failed(EMERGENCY_STOP));
    });
}

/// A task that moves the arm to and fro without a pause.
const MOVER: &str = "[controller]\nmotor = true
    [[task]]\nname = 'Mover'\nstart = 2\nsteps = [
        { move = 'J(60, 45, 90, 0, 45, 0)' },
        { move = 'J(-60, 45, 90, 0, 45, 0)' },
    ]\n";

/// Creates a controller that refuses Robot_Halt while its task moves the arm.
fn moved_by_a_task(faults: &str) -> Served<Simulated> {
    of_model(Profile::Rc8, faults)
}

fn of_model(model: Profile, faults: &str) -> Served<Simulated> {
    let mut sim = Simulated::new(Config::new(model));
    sim.play(Scenario::parse(&format!("{MOVER}{faults}")).unwrap());
    Served::of(sim, Limits::default())
}

/// The controller does not support KillAll.
const NO_KILL_ALL: &str = "[[fault]]\nwhen = { every = 1, of = 'KillAll' }\nthen = { refuse = 'E_INVALID_CMD_NAME' }\n";
/// It accepts KillAll, but its tasks continue.
const IDLE_KILL_ALL: &str = "[[fault]]\nwhen = { every = 1, of = 'KillAll' }\nthen = { refuse = 'S_OK' }\n";
/// It does not list its tasks either.
const NO_LIST: &str =
    "[[fault]]\nwhen = { every = 1, of = 'Controller_GetTaskNames' }\nthen = { refuse = 'E_NOTIMPL' }\n";

#[test]
fn a_stopper_stops_the_task_that_moves_the_robot() {
    let models = [
        (Profile::Rc8, Settings::rc8()),
        (Profile::Rc9, Settings::rc9()),
        (Profile::Cobotta, Settings::cobotta()),
        (Profile::CobottaPro, Settings::rc9()),
    ];
    let answers =
        [("", StoppedTasks::All), (NO_KILL_ALL, StoppedTasks::Single(1)), (IDLE_KILL_ALL, StoppedTasks::Single(1))];
    for ((model, settings), (faults, tasks)) in models.iter().flat_map(|model| answers.map(|answer| (model, answer))) {
        let sim = of_model(*model, faults);
        let mut cell = Controller::connect(&sim.address(), settings).unwrap();
        sim.until(Simulated::is_moving);
        assert_eq!(cell.stopper().unwrap().halt().unwrap(), Halted::TasksStopped(tasks));
        assert!(!sim.application().is_moving());
        assert_eq!(sim.application().task("Mover").unwrap().0, bcap_sim::TaskStatus::Ready);
        assert_eq!(cell.robot().unwrap().halt().unwrap(), Halted::NothingMoved);
    }
    // the drop of an arm halts its own motions only
    let sim = moved_by_a_task("");
    let mut cell = connect(&sim);
    sim.until(Simulated::is_moving);
    let taken = cell.robot().unwrap().take_arm().map(drop);
    assert_eq!(taken.unwrap_err().code(), Some(HResult::E_ARM_NOT_TAKEN));
    assert!(sim.application().task("Mover").unwrap().0 == bcap_sim::TaskStatus::Running);
}

#[test]
fn a_robot_that_moves_on_is_no_success_of_a_halt() {
    let sim = moved_by_a_task(&format!("{NO_KILL_ALL}{NO_LIST}"));
    let stopper = connect(&sim).stopper().unwrap();
    sim.until(Simulated::is_moving);
    let error = stopper.halt().unwrap_err();
    let Error::NotHalted(halt) = &error else { panic!("{error}") };
    assert_eq!((halt.rests, halt.tasks), (false, None));
    assert_eq!(error.code(), Some(HResult::from_u32(0x8350_0079)));
    assert!(error.to_string().starts_with("the robot STILL MOVES; Robot_Halt was refused: 0x83500079"), "{error}");
    assert!(error.to_string().ends_with("; use the emergency stop"), "{error}");
}

#[test]
fn a_stopper_halts_a_motion_that_another_thread_waits_for() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let stopper = cell.stopper().unwrap();
    assert_eq!(stopper.halt().unwrap(), Halted::NothingMoved);
    let mut arm = ready(&mut cell);
    std::thread::scope(|scope| {
        let button = stopper.clone();
        let pressed = scope.spawn(|| {
            let button = button;
            sim.until(Simulated::is_moving);
            button.halt().unwrap()
        });
        assert_eq!(arm.move_to(&far(), LIMIT).unwrap(), Motion::Halted);
        assert_eq!(pressed.join().unwrap(), Halted::Halted);
    });
    assert!(arm.robot().joints().unwrap().degrees[0] < 150.0);
    drop(arm);
    drop((cell, stopper));
    sim.assert_left();
}

#[test]
fn a_motion_is_halted_at_its_time_limit() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = ready(&mut cell);
    let slow = to(150.0).speed_percent(1.0);
    assert_eq!(arm.move_to(&slow, Duration::from_millis(100)).unwrap(), Motion::TimedOut);
    assert!(!sim.application().is_moving());
}

/// A halt at a random time: the outcome that the waiting code gets agrees with the position of the robot.
#[test]
fn no_halted_motion_is_reported_as_arrived() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let stopper = cell.stopper().unwrap();
    let mut arm = ready(&mut cell);
    let (mut random, mut outcomes) = (Random(7), Outcomes::default());
    for trial in 0..Outcomes::trials() {
        let degrees = if trial % 2 == 0 { 10.0 } else { 0.0 };
        let delay = Duration::from_micros(random.below(200_000));
        let ended = AtomicBool::new(false);
        let motion = std::thread::scope(|scope| {
            scope.spawn(|| {
                sim.until(|sim| sim.is_moving() || ended.load(Ordering::Relaxed));
                std::thread::sleep(delay);
                stopper.halt().unwrap()
            });
            let motion = arm.move_to(&to(degrees), LIMIT).unwrap();
            ended.store(true, Ordering::Relaxed);
            motion
        });
        outcomes.count(&sim, Some(motion), [degrees, 0.0]);
    }
    outcomes.assert_stopped();
}

#[test]
fn a_lost_connection_is_told_and_the_drop_does_not_wait() {
    let sim = simulated();
    let mut cell = connect(&sim);
    cell.write("I1", 1).unwrap();
    drop(sim);
    let lost = cell.read::<i32>("I1").unwrap_err();
    assert!(lost.is_lost(), "{lost}");
    assert!(lost.to_string().starts_with("not connected: "), "{lost}");
    cell.close().unwrap();
}

#[test]
fn in_memory_a_motion_of_many_seconds_takes_no_time_and_can_be_halted() {
    let network = Network::new(Config::new(Profile::Rc8));
    let mut cell = Controller::over(network.connect(), &Settings::rc8()).unwrap();
    assert!(matches!(cell.stopper(), Err(Error::NoAddress)));
    let stopper = Stopper::over(network.connect(), &Settings::rc8()).unwrap();
    assert_eq!(stopper.halt().unwrap(), Halted::NothingMoved);
    let mut arm = ready(&mut cell);
    let begun = network.now();
    assert_eq!(arm.move_to(&to(80.0).speed_percent(1.0), LIMIT * 10).unwrap(), Motion::Arrived);
    let seconds = network.now().saturating_since(begun).as_secs();
    assert!(seconds > 20, "{seconds} s");
    assert!((network.controller().joints()[0] - 80.0).abs() < 0.05);
    drop(arm);
    drop((cell, stopper));
    let controller = network.controller();
    assert_eq!((controller.arm_owner(), controller.motor_is_on(), controller.open_objects()), (None, false, 0));
}

#[test]
fn motions_follow_each_other_without_a_stop() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = ready(&mut cell);
    let both_turn = AtomicBool::new(false);
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !ended.load(Ordering::Relaxed) {
                sim.application().advance(bcap_std::now());
                let joints = sim.application().joints();
                both_turn.fetch_or(joints[0] < 59.0 && joints[5] > 1.0, Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        // both motions last seconds, and so does the time in which one brakes and the other begins
        let slow = |motion: Move| motion.speed_percent(5.0).acceleration_percent(0.5).deceleration_percent(0.5);
        let mut moving = arm.start(&slow(to(60.0)).pass(Pass::Near), LIMIT).unwrap();
        assert!(sim.application().is_moving());
        assert!(moving.robot().joints().unwrap().degrees[0] < 60.0);
        moving = moving.then(&slow(turn(60.0, 60.0)).pass(Pass::Near)).unwrap();
        assert_eq!(moving.then(&turn(60.0, 0.0)).unwrap().wait().unwrap(), Motion::Arrived);
        ended.store(true, Ordering::Relaxed);
    });
    assert!(both_turn.load(Ordering::Relaxed), "the second motion begins before the first has ended");
    let joints = arm.robot().joints().unwrap().degrees;
    assert!((joints[0] - 60.0).abs() < 0.05 && joints[5].abs() < 0.05, "{joints:?}");
    // late: the robot rests, and the next motion starts from there
    let moving = arm.start(&to(-30.0), LIMIT).unwrap();
    sim.until(|sim| !sim.is_moving());
    assert_eq!(moving.then(&to(60.0)).unwrap().wait().unwrap(), Motion::Arrived);
    assert!((sim.application().joints()[0] - 60.0).abs() < 0.05);
}

#[test]
fn motions_that_are_dropped_halt_the_robot() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let mut arm = ready(&mut cell);
    drop(arm.start(&far(), LIMIT).unwrap());
    assert!(!sim.application().is_moving() && sim.application().joints()[0] < 149.0);
    // the halted motion is an error
    assert_eq!(arm.start(&far(), LIMIT).unwrap_err().code(), Some(HResult::E_ERROR_PRESENT));
    sim.clear();
    assert_eq!(arm.start(&far(), LIMIT).unwrap().halt().unwrap(), Halted::Halted);
    assert!(!sim.application().is_moving());
    sim.clear();
    // an error of a later motion halts those before it
    let moving = arm.start(&far(), LIMIT).unwrap();
    let refused = moving.then(&Move::joint("P(")).unwrap_err();
    assert!(refused.code().is_some() && !sim.application().is_moving(), "{refused}");
    sim.clear();
    // a leaked motion is halted before the next, which is refused because of that
    let below = sim.application().joints()[0] - 5.0;
    std::mem::forget(arm.start(&far(), LIMIT).unwrap());
    assert!(arm.move_to(&to(below), LIMIT).is_err());
    sim.clear();
    assert_eq!(arm.move_to(&to(below), LIMIT).unwrap(), Motion::Arrived);
    std::mem::forget(arm.start(&far(), LIMIT).unwrap());
    drop(arm);
    assert!(!sim.application().is_moving());
    drop(cell);
    sim.assert_left();
}

#[test]
fn a_halt_between_motions_is_not_taken_for_arrival() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let stopper = cell.stopper().unwrap();
    let mut arm = ready(&mut cell);
    // while the program does something else: the next motion is not sent
    let moving = arm.start(&far(), LIMIT).unwrap();
    assert_eq!(stopper.halt().unwrap(), Halted::Halted);
    let rest = sim.application().joints()[0];
    let moving = moving.then(&to(0.0)).unwrap().then(&to(100.0)).unwrap();
    assert_eq!(moving.wait().unwrap(), Motion::Halted);
    assert!((sim.application().joints()[0] - rest).abs() < 0.001);
    sim.clear();
    // of two motions, the second one waits in the controller
    let moving = arm.start(&to(rest + 50.0).speed_percent(2.0), LIMIT).unwrap();
    let motion = std::thread::scope(|scope| {
        scope.spawn(|| {
            while sim.application().joints()[0] < rest + 20.0 {
                sim.application().advance(bcap_std::now());
                std::thread::sleep(Duration::from_millis(1));
            }
            stopper.halt().unwrap()
        });
        moving.then(&to(rest)).unwrap().wait().unwrap()
    });
    let end = sim.application().joints()[0];
    assert_eq!(motion, Motion::Halted);
    assert!(end > rest + 15.0 && end < rest + 49.0, "{end} from {rest}");
    sim.clear();
    // an emergency stop is the end of the queue as well
    let moving = arm.start(&to(rest).speed_percent(1.0), LIMIT).unwrap();
    sim.application().emergency_stop(true, bcap_std::now());
    assert_eq!(moving.then(&to(rest + 50.0)).unwrap().wait().unwrap(), Motion::Failed(EMERGENCY_STOP));
}

/// A halt at a random time during three motions: the outcome that the waiting code gets agrees with the position of the
/// robot.
#[test]
fn no_halted_queue_is_reported_as_arrived() {
    let sim = simulated();
    let mut cell = connect(&sim);
    let stopper = cell.stopper().unwrap();
    let mut arm = ready(&mut cell);
    let (mut random, mut outcomes) = (Random(23), Outcomes::default());
    for trial in 0..Outcomes::trials() {
        let pass = [Pass::Exact, Pass::Near, Pass::Within(5)][random.below(3) as usize];
        let (degrees, other) = if trial % 2 == 0 { (12.0, 20.0) } else { (0.0, 0.0) };
        let delay = Duration::from_micros(random.below(500_000));
        let pause = Duration::from_micros(random.below(150_000) * u64::from(trial % 4 == 0));
        let motion = std::thread::scope(|scope| {
            let stopper = stopper.clone();
            scope.spawn(move || {
                std::thread::sleep(delay);
                stopper.halt().unwrap()
            });
            let moving = arm.start(&turn(5.0 + other, degrees).pass(pass), LIMIT).unwrap();
            std::thread::sleep(pause);
            let queued = moving.then(&turn(40.0 - other, degrees + 1.0).pass(pass));
            let queued = queued.and_then(|moving| moving.then(&turn(degrees, other)));
            match queued {
                Ok(moving) => moving.wait().unwrap(),
                // the halt arrived before the last motion was queued
                Err(Error::Refused { code: HResult::E_ERROR_PRESENT, .. }) => Motion::Halted,
                Err(error) => panic!("trial {trial}: {error}"),
            }
        });
        sim.until(|sim| !sim.is_moving());
        outcomes.count(&sim, Some(motion), [degrees, other]);
    }
    outcomes.assert_stopped();
}

#[test]
fn a_kept_motion_goes_on_and_belongs_to_its_session() {
    let network = Network::new(Config::new(Profile::Rc8));
    let mut cell = Controller::over(network.connect(), &Settings::rc8()).unwrap();
    let mut other = Controller::over(network.connect(), &Settings::rc8()).unwrap();
    let mut arm = ready(&mut cell);
    let kept = arm.start(&to(30.0), LIMIT).unwrap().keep();
    arm.keep();
    assert_eq!(cell.resume(kept).unwrap().wait().unwrap(), Motion::Arrived);
    let mut arm = cell.arm().unwrap();
    let kept = arm.start(&to(0.0), LIMIT).unwrap().keep();
    arm.keep();
    assert!(matches!(other.resume(kept), Err(Error::OtherSession)));
    // the end of the session halts it
    drop(cell);
    assert!(!other.robot().unwrap().read::<bool>("@SERVO_ON").unwrap());
}
