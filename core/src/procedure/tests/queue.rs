//! Queues of motions against robots that are halted at every possible time.

use super::*;

const HANDLES: Handles = Handles { controller: ControllerHandle(7), robot: RobotHandle(9) };
const HALT: &str = "Robot_Halt(9, \"\")";
const MOVING: i32 = 0b11 << 20;
/// The speed of the robot, in degrees per ms.
const SPEED: f64 = 0.1;

/// A robot of one joint with a queue.
struct Robot {
    queue: Vec<f64>,
    /// The position, and when it was there.
    position: f64,
    at: u64,
    /// When it has come to rest after a halt.
    braked: u64,
    /// How long it brakes, in ms.
    brake: u64,
    /// Whether DestJnt is the last destination after a halt, and not where the robot rests.
    keeps_destination: bool,
    destination: f64,
    /// The motions that ended at their destination.
    reached: Vec<f64>,
    calls: Vec<String>,
}

impl Robot {
    fn new(brake: u64, keeps_destination: bool) -> Self {
        Self {
            queue: Vec::new(),
            position: 0.0,
            at: 0,
            braked: 0,
            brake,
            keeps_destination,
            destination: 0.0,
            reached: Vec::new(),
            calls: Vec::new(),
        }
    }

    fn advance(&mut self, now: u64) {
        while let (true, Some(target)) = (self.at < now, self.queue.first().copied()) {
            let way = target - self.position;
            let left = (now - self.at) as f64 * SPEED;
            if way.abs() > left {
                self.position += left * way.signum();
                break;
            }
            self.at += (way.abs() / SPEED).ceil() as u64;
            self.position = target;
            self.reached.push(self.queue.remove(0));
        }
        self.at = now;
        self.destination = match self.queue.first() {
            Some(target) => *target,
            None if self.keeps_destination => self.destination,
            None => self.position,
        };
    }

    fn halt(&mut self, now: u64) {
        self.advance(now);
        if !self.queue.is_empty() {
            self.queue.clear();
            self.braked = now + self.brake;
        }
    }

    fn answer(&mut self, call: &str, now: Instant) -> Answer {
        let now = now.as_micros() / 1000;
        self.advance(now);
        self.calls.push(call.into());
        let at = |angle: f64| Answer::value(&[angle, 0.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]);
        match call {
            HALT => self.halt(now),
            _ if call.contains("SysState") => {
                let moves = !self.queue.is_empty() || now < self.braked;
                return Answer::value(&if moves { MOVING } else { 0 });
            }
            _ if call.contains("DestJnt") => return at(self.destination),
            _ if call.contains("CurJnt") => return at(self.position),
            _ if now < self.braked => return Answer::Refused(HResult::E_ROBOTISBUSY),
            _ => {
                let target = call.strip_prefix("Robot_Move(9, 1, \"J(").and_then(|rest| rest.split(')').next());
                self.queue.push(target.and_then(|target| target.parse().ok()).unwrap());
            }
        }
        Answer::Empty
    }
}

fn begin(
    queue: MotionQueue,
    motion: MotionStart<&str, &str>,
) -> impl Procedure<Output = MotionQueue, Error = StepError> {
    run_queue(HANDLES, queue, Some(motion), Until::Begun)
}

fn wait(queue: MotionQueue) -> impl Procedure<Output = MotionQueue, Error = StepError> {
    run_queue(HANDLES, queue, None::<MotionStart<&str, &str>>, Until::Ended)
}

/// Runs motions to these angles; the robot is halted before a call, and the program pauses before each motion.
fn drive(robot: &mut Robot, angles: &[f64], pause: Duration, halt_before: Option<usize>) -> Motion {
    let mut queue = MotionQueue::new(MotionConfig::within(Duration::from_secs(10)));
    let (mut now, mut calls) = (Instant::ZERO, 0);
    let mut carry = |robot: &mut Robot, call: &str, now: Instant| {
        if halt_before == Some(calls) {
            // between the call before and this one
            robot.halt(now.as_micros() / 1000);
        }
        calls += 1;
        robot.answer(call, now)
    };
    for angle in angles {
        let pose = format!("J({angle})");
        let motion = MotionStart::Move { interpolation: 1, pose: pose.as_str(), option: "NEXT" };
        let run = run_from(now, begin(queue, motion), |_, call, now| carry(robot, call, now));
        (queue, now) = (run.result.unwrap(), run.now.saturating_add(pause));
    }
    let run = run_from(now, wait(queue), |_, call, now| carry(robot, call, now));
    run.result.unwrap().ended().unwrap_or(Motion::TimedOut)
}

#[test]
fn motions_follow_each_other_and_the_last_one_arrives() {
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[10.0, 20.0, 5.0, 10.0], Duration::ZERO, None), Motion::Arrived);
    assert_eq!((robot.position, robot.reached.as_slice()), (10.0, [10.0, 20.0, 5.0, 10.0].as_slice()));
    // each was sent while the one before was under way, so the robot never rested: 10 + 10 + 15 + 5 degrees
    let last = robot.calls.iter().rposition(|call| call.contains("Robot_Move")).unwrap();
    assert!(robot.calls[..last].iter().all(|call| !call.contains("Halt")));
    assert!((400..450).contains(&robot.at), "{} ms", robot.at);
}

#[test]
fn a_program_that_is_late_starts_the_next_motion_from_rest() {
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[10.0, 20.0], Duration::from_millis(400), None), Motion::Arrived);
    assert_eq!(robot.reached, [10.0, 20.0]);
}

/// The robot is halted between any two calls: it never counts as arrived, and nothing is sent after the halt was seen.
#[test]
fn no_halt_between_any_two_calls_is_taken_for_arrival() {
    let angles = [10.0, 20.0, 5.0];
    let pauses = [Duration::ZERO, Duration::from_millis(70), Duration::from_millis(300)];
    for (pause, brake, keeps) in pauses.iter().flat_map(|pause| {
        [0, 1, 60].into_iter().flat_map(move |brake| [false, true].map(|keeps| (*pause, brake, keeps)))
    }) {
        let mut undisturbed = Robot::new(brake, keeps);
        assert_eq!(drive(&mut undisturbed, &angles, pause, None), Motion::Arrived);
        for halt in 0..undisturbed.calls.len() {
            let mut robot = Robot::new(brake, keeps);
            let ended = drive(&mut robot, &angles, pause, Some(halt));
            let case = format!("halt before call {halt}, brake {brake} ms, {pause:?}, {keeps}: {:?}", robot.reached);
            match ended {
                Motion::Arrived => assert_eq!((robot.reached.as_slice(), robot.position), (&angles[..], 5.0), "{case}"),
                Motion::Halted => assert!(robot.queue.is_empty(), "it moves on: {case}"),
                other => panic!("{other:?}, {case}"),
            }
        }
    }
}

#[test]
fn a_motion_that_is_never_seen_to_begin_is_halted() {
    // the second motion ends where the first does
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[10.0, 10.0], Duration::ZERO, None), Motion::Halted);
    assert_eq!(robot.calls.last().unwrap(), HALT);
    // the first ends where the robot rests
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[0.0, 10.0], Duration::ZERO, None), Motion::Halted);
    assert_eq!(robot.calls.iter().filter(|call| call.contains("Robot_Move")).count(), 1);
    // without a motion there is nothing to wait for
    let run = run(wait(MotionQueue::new(MotionConfig::within(Duration::ZERO))), |_, call, _| panic!("{call}"));
    assert_eq!(run.result.unwrap().ended(), None);
}

#[test]
fn a_busy_robot_is_asked_again_and_another_refusal_halts_it() {
    let mut refused = 0;
    let mut robot = Robot::new(0, false);
    let mut queue = MotionQueue::new(MotionConfig::within(Duration::from_secs(10)));
    let (mut now, motion) = (Instant::ZERO, |pose| MotionStart::Move { interpolation: 1, pose, option: "NEXT" });
    for pose in ["J(10)", "J(20)"] {
        let run = run_from(now, begin(queue, motion(pose)), |_, call, now| {
            if call.contains("J(20)") && refused < 5 {
                refused += 1;
                return Answer::Refused(HResult::E_ROBOTISBUSY);
            }
            robot.answer(call, now)
        });
        (queue, now) = (run.result.unwrap(), run.now);
    }
    assert_eq!((refused, queue.ended()), (5, None));
    let run = run_from(now, begin(queue, motion("J(5)")), |_, call, now| {
        if call.contains("J(5)") { Answer::Refused(HResult::E_INVALIDARG) } else { robot.answer(call, now) }
    });
    let error = run.result.err().unwrap();
    assert_eq!(error.cause, StepCause::Refused(HResult::E_INVALIDARG));
    assert_eq!(run.calls.last().unwrap(), HALT);
}

#[test]
fn the_time_limit_is_that_of_all_motions() {
    let mut robot = Robot::new(0, false);
    let queue = MotionQueue::new(MotionConfig::within(Duration::from_millis(250)));
    let motion = |pose| MotionStart::Move { interpolation: 1, pose, option: "NEXT" };
    let first = run_from(Instant::ZERO, begin(queue, motion("J(20)")), |_, c, now| robot.answer(c, now));
    let second = begin(first.result.unwrap(), motion("J(40)"));
    let second = run_from(first.now, second, |_, call, now| robot.answer(call, now));
    let queue = second.result.unwrap();
    assert_eq!(queue.ended(), None);
    let ended = run_from(second.now, wait(queue), |_, call, now| robot.answer(call, now));
    assert_eq!(ended.result.unwrap().ended(), Some(Motion::TimedOut));
    assert_eq!(ended.calls.last().unwrap(), HALT);
    assert!((250..260).contains(&(ended.now.as_micros() / 1000)), "{:?}", ended.now);
}

#[test]
fn the_last_motion_may_be_added_and_waited_for_at_once() {
    let mut robot = Robot::new(0, false);
    let motion = |pose| MotionStart::Move { interpolation: 1, pose, option: "NEXT" };
    let queue = MotionQueue::new(MotionConfig::within(Duration::from_secs(10)));
    let first = run_from(Instant::ZERO, begin(queue, motion("J(10)")), |_, call, now| robot.answer(call, now));
    let last = run_queue(HANDLES, first.result.unwrap(), Some(motion("J(20)")), Until::Ended);
    let last = run_from(first.now, last, |_, call, now| robot.answer(call, now));
    assert_eq!(last.result.unwrap().ended(), Some(Motion::Arrived));
    assert_eq!(robot.reached, [10.0, 20.0]);
}
