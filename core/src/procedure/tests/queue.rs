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
    /// When it is at rest after a halt.
    braked: u64,
    /// Braking time in ms.
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
        if let Some(target) = self.queue.first().copied() {
            if (target - self.position).abs() <= 0.05 {
                self.reached.push(target);
            }
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

/// A motion to an angle. If it is `known`, the target says where it ends.
fn to(angle: f64, known: bool) -> (MotionStart<VariantBuf<64>, &'static str>, Target) {
    let target = Target::joints(Joints::new([angle, 0.0, 90.0, 0.0, 45.0]), 8);
    let motion = MotionStart::Move {
        interpolation: 1,
        pose: VariantBuf::new(format!("J({angle})").as_str()).unwrap(),
        option: "NEXT",
    };
    (motion, if known { target } else { Target::UNKNOWN })
}

fn begin(
    queue: MotionQueue,
    motion: (MotionStart<VariantBuf<64>, &'static str>, Target),
) -> impl Procedure<Output = MotionQueue, Error = StepError> {
    run_queue(HANDLES, queue, Some(motion), Until::Begun)
}

fn wait(queue: MotionQueue) -> impl Procedure<Output = MotionQueue, Error = StepError> {
    run_queue(HANDLES, queue, None::<(MotionStart<VariantBuf<64>, &str>, Target)>, Until::Ended)
}

/// Runs motions to these angles; the robot is halted before a call, and the program pauses before each motion.
fn drive(robot: &mut Robot, angles: &[f64], pause: Duration, halt_before: Option<usize>, known: bool) -> Motion {
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
        let run = run_from(now, begin(queue, to(*angle, known)), |_, call, now| carry(robot, call, now));
        (queue, now) = (run.result.unwrap(), run.now.saturating_add(pause));
    }
    let run = run_from(now, wait(queue), |_, call, now| carry(robot, call, now));
    run.result.unwrap().ended().unwrap_or(Motion::TimedOut)
}

#[test]
fn motions_follow_each_other_and_the_last_one_arrives() {
    for known in [true, false] {
        let mut robot = Robot::new(0, false);
        assert_eq!(drive(&mut robot, &[10.0, 20.0, 5.0, 10.0], Duration::ZERO, None, known), Motion::Arrived);
        assert_eq!((robot.position, robot.reached.as_slice()), (10.0, [10.0, 20.0, 5.0, 10.0].as_slice()));
        // each was sent while the previous motion was running, so the robot never rested: 10 + 10 + 15 + 5 degrees
        let last = robot.calls.iter().rposition(|call| call.contains("Robot_Move")).unwrap();
        assert!(robot.calls[..last].iter().all(|call| !call.contains("Halt")));
        assert!((400..450).contains(&robot.at), "{} ms", robot.at);
    }
}

#[test]
fn motions_without_a_time_limit_follow_each_other() {
    let mut robot = Robot::new(0, false);
    let queue = MotionQueue::new(MotionConfig::within(Duration::MAX));
    let first = run_from(Instant::ZERO, begin(queue, to(10.0, true)), |_, call, now| robot.answer(call, now));
    let begun = first.result.unwrap();
    assert!(!begun.is_new());
    let ended = run_from(first.now, wait(begun), |_, call, now| robot.answer(call, now));
    assert_eq!((ended.result.unwrap().ended(), robot.position), (Some(Motion::Arrived), 10.0));
}

#[test]
fn a_program_that_is_late_starts_the_next_motion_from_rest() {
    for known in [true, false] {
        let mut robot = Robot::new(0, false);
        assert_eq!(drive(&mut robot, &[10.0, 20.0], Duration::from_millis(400), None, known), Motion::Arrived);
        assert_eq!(robot.reached, [10.0, 20.0]);
    }
}

/// The robot is halted between any two calls. It counts as arrived only at the end of the last motion, and as halted only
/// elsewhere; nothing is sent after the halt was seen.
#[test]
fn no_halt_between_any_two_calls_is_taken_for_arrival() {
    let pauses = [Duration::ZERO, Duration::from_millis(70), Duration::from_millis(300)];
    for (angles, pause, brake, keeps, known) in [[10.0, 20.0, 5.0], [1.0, 1.5, 0.5]].iter().flat_map(|angles| {
        pauses.iter().flat_map(move |pause| {
            [0, 1, 60].into_iter().flat_map(move |brake| {
                let cases = [(false, false), (false, true), (true, false), (true, true)];
                cases.map(move |(keeps, known)| (angles, *pause, brake, keeps, known))
            })
        })
    }) {
        let mut undisturbed = Robot::new(brake, keeps);
        let ended = drive(&mut undisturbed, angles, pause, None, known);
        let is_seen = known || angles[0] > 5.0;
        assert!(ended == Motion::Arrived || (ended == Motion::Unknown && !is_seen), "{ended:?} {angles:?} {pause:?}");
        for halt in 0..undisturbed.calls.len() {
            let mut robot = Robot::new(brake, keeps);
            let ended = drive(&mut robot, angles, pause, Some(halt), known);
            let case = format!(
                "{ended:?}, halt before call {halt}, brake {brake} ms, {pause:?}, keeps {keeps}, known {known}: {:?} at {}",
                robot.reached, robot.position
            );
            assert!(robot.queue.is_empty(), "it moves on: {case}");
            let is_there = (robot.position - angles[2]).abs() <= 0.05;
            // the last poll of one motion and the acceptance of the next motion
            let handed_over = robot.calls[halt..].iter().take(4).any(|call| call.contains("Robot_Move"));
            match ended {
                Motion::Arrived => {
                    assert!(is_there && ((handed_over && brake < 60) || robot.reached == angles), "{case}")
                }
                // it may be halted there by chance, during an earlier motion
                Motion::Halted => assert!(!is_there || robot.reached.len() < 2, "{case}"),
                Motion::Unknown => assert!(!known || !is_seen, "{case}"),
                _ => panic!("{case}"),
            }
        }
    }
}

#[test]
fn a_motion_of_no_length_has_arrived() {
    // the second motion ends where the first does
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[10.0, 10.0], Duration::ZERO, None, true), Motion::Arrived);
    assert!(!robot.calls.iter().any(|call| call == HALT));
    // the first ends where the robot rests
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[0.0, 10.0], Duration::ZERO, None, true), Motion::Arrived);
    assert_eq!(robot.calls.iter().filter(|call| call.contains("Robot_Move")).count(), 2);
    // one that cannot be compared, and was never seen, is not carried out for certain
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[0.0, 10.0], Duration::ZERO, None, false), Motion::Halted);
    assert_eq!(robot.calls.iter().filter(|call| call.contains("Robot_Move")).count(), 1);
    assert_eq!(robot.calls.last().unwrap(), HALT);
    // without a motion there is nothing to wait for
    let run = run(wait(MotionQueue::new(MotionConfig::within(Duration::ZERO))), |_, call, _| panic!("{call}"));
    assert_eq!(run.result.unwrap().ended(), None);
}

/// A round that ends where it begins, of motions that are shorter than the polls.
#[test]
fn a_short_round_has_arrived_only_if_the_robot_was_seen_elsewhere() {
    let mut robot = Robot::new(0, false);
    assert_eq!(drive(&mut robot, &[3.0, 0.0], Duration::ZERO, None, true), Motion::Arrived);
    assert_eq!(robot.reached, [3.0, 0.0]);
    // the motions are accepted, and the robot never moves
    let mut queue = MotionQueue::new(MotionConfig::within(Duration::from_secs(10)));
    let mut now = Instant::ZERO;
    let answer = |call: &str| match call {
        _ if call.contains("SysState") => Answer::value(&0),
        _ if call.contains("Jnt") => Answer::value(&[0.0, 0.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]),
        _ => Answer::Empty,
    };
    for angle in [3.0, 0.0] {
        let run = run_from(now, begin(queue, to(angle, true)), |_, call, _| answer(call));
        (queue, now) = (run.result.unwrap(), run.now);
    }
    assert_eq!(queue.ended(), Some(Motion::Halted));
}

#[test]
fn a_place_on_the_way_is_not_the_end_of_a_sequence() {
    // two polls find the robot where the last motion ends, and it continues from there
    let places = [1.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.5];
    let mut polls = 0;
    let mut answer = |call: &str| {
        let at = |angle: f64| Answer::value(&[angle, 0.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0]);
        match call {
            _ if call.contains("SysState") => {
                polls += 1;
                Answer::value(&if polls <= places.len() { MOVING } else { 0 })
            }
            _ if call.contains("DestJnt") => at(if polls < 5 { 3.0 } else { 0.0 }),
            _ if call.contains("CurJnt") => {
                at(if polls == 0 { 0.0 } else { places.get(polls - 1).copied().unwrap_or(0.0) })
            }
            _ => Answer::Empty,
        }
    };
    let (mut queue, mut now) = (MotionQueue::new(MotionConfig::within(Duration::from_secs(10))), Instant::ZERO);
    for angle in [3.0, 0.0] {
        let run = run_from(now, begin(queue, to(angle, true)), |_, call, _| answer(call));
        (queue, now) = (run.result.unwrap(), run.now);
    }
    let run = run_from(now, wait(queue), |_, call, _| answer(call));
    assert_eq!(run.result.unwrap().ended(), Some(Motion::Arrived));
    assert!(polls > places.len() + 1, "it arrived at poll {polls}");
}

#[test]
fn a_busy_robot_is_asked_again_and_another_refusal_halts_it() {
    let mut refused = 0;
    let mut robot = Robot::new(0, false);
    let mut queue = MotionQueue::new(MotionConfig::within(Duration::from_secs(10)));
    let mut now = Instant::ZERO;
    for angle in [10.0, 20.0] {
        let run = run_from(now, begin(queue, to(angle, true)), |_, call, now| {
            if call.contains("J(20)") && refused < 5 {
                refused += 1;
                return Answer::Refused(HResult::E_ROBOTISBUSY);
            }
            robot.answer(call, now)
        });
        (queue, now) = (run.result.unwrap(), run.now);
    }
    assert_eq!((refused, queue.ended()), (5, None));
    let run = run_from(now, begin(queue, to(5.0, true)), |_, call, now| {
        if call.contains("J(5)") { Answer::Refused(HResult::E_INVALIDARG) } else { robot.answer(call, now) }
    });
    let error = run.result.err().unwrap();
    assert_eq!(error.cause, StepCause::Refused(HResult::E_INVALIDARG));
    assert_eq!(run.calls.last().unwrap(), HALT);
}

#[test]
fn a_robot_that_stays_busy_at_rest_is_halted_at_the_time_limit() {
    let mut robot = Robot::new(0, false);
    let queue = MotionQueue::new(MotionConfig::within(Duration::from_millis(250)));
    let first = run_from(Instant::ZERO, begin(queue, to(10.0, true)), |_, call, now| robot.answer(call, now));
    let second = run_from(first.now, begin(first.result.unwrap(), to(20.0, true)), |_, call, now| {
        if call.contains("J(20)") { Answer::Refused(HResult::E_ROBOTISBUSY) } else { robot.answer(call, now) }
    });
    assert_eq!(second.result.unwrap().ended(), Some(Motion::TimedOut));
    assert_eq!(second.calls.last().unwrap(), HALT);
    assert!((250..270).contains(&(second.now.as_micros() / 1000)), "{:?}", second.now);
}

#[test]
fn one_time_limit_covers_all_motions() {
    let mut robot = Robot::new(0, false);
    let queue = MotionQueue::new(MotionConfig::within(Duration::from_millis(250)));
    let first = run_from(Instant::ZERO, begin(queue, to(20.0, true)), |_, c, now| robot.answer(c, now));
    let second = begin(first.result.unwrap(), to(40.0, true));
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
    let queue = MotionQueue::new(MotionConfig::within(Duration::from_secs(10)));
    let first = run_from(Instant::ZERO, begin(queue, to(10.0, true)), |_, call, now| robot.answer(call, now));
    let last = run_queue(HANDLES, first.result.unwrap(), Some(to(20.0, true)), Until::Ended);
    let last = run_from(first.now, last, |_, call, now| robot.answer(call, now));
    assert_eq!(last.result.unwrap().ended(), Some(Motion::Arrived));
    assert_eq!(robot.reached, [10.0, 20.0]);
}
