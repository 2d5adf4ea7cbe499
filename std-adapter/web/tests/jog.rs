//! Tests that try to break the rules of a jog, without a browser.

use std::net::Shutdown;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use bcap_sim::Profile;
use bcap_sim::pace::Paced;
use bcap_std::blocking::Controller;
use bcap_std::{Move, Settings};
use serde_json::json;
use tokio_tungstenite::tungstenite::stream::MaybeTlsStream;

use crate::support::{LIMIT, Page, Relay, Sim, Web, serve_paced, until};

/// The lost heartbeats of the test.
const LOST: usize = 1000;

/// The heartbeats stop at random moments: while the arm is taken, while the motor switches on, during a step, between two
/// steps.
#[test]
fn a_thousand_lost_heartbeats_leave_the_robot_at_rest_and_the_arm_free() {
    // each has a page; an idle machine with few robots shows the program's times, not the machine's
    let robots: usize = std::env::var("ROBOTS").map_or(10, |robots| robots.parse().unwrap());
    let lost = LOST / robots;
    let sims: Vec<Sim> = (0..robots).map(|_| Sim::quick()).collect();
    let names: Vec<String> = (0..robots).map(|n| format!("robot{n}")).collect();
    let robots: Vec<_> = names.iter().zip(&sims).map(|(name, sim)| (name.as_str(), sim.address())).collect();
    let web = Web::moving(&robots);
    let (times, moved) = (Mutex::new(Vec::new()), Mutex::new(0));
    thread::scope(|scope| {
        for (robot, sim) in sims.iter().enumerate() {
            let (web, times, moved) = (&web, &times, &moved);
            scope.spawn(move || {
                let mut random = fastrand::Rng::with_seed(robot as u64);
                let mut page = web.page();
                page.until("tiles", |tiles| tiles[robot]["state"] == "ready, motor off");
                page.order("take", json!({ "robot": robot, "name": "Anna" })).unwrap();
                for _ in 0..lost {
                    let ended = lose(&mut page, sim, robot, &mut random);
                    *moved.lock().unwrap() += usize::from(ended.moved);
                    times.lock().unwrap().push(ended.time);
                }
            });
        }
    });
    let (mut times, moved) = (times.into_inner().unwrap(), moved.into_inner().unwrap());
    times.sort();
    let [first, middle, most, last] = [0, 500, 990, 999].map(|n| times[n * times.len() / 1000]);
    let late = times.iter().filter(|time| **time > Duration::from_millis(300)).count();
    println!(
        "{} lost heartbeats, rest after the last one: min {first:?}, p50 {middle:?}, p99 {most:?}, max {last:?}; {late} above 300 ms; \
         {moved} lost during a motion; each arm is free",
        times.len()
    );
    let count = robots.len() * lost;
    assert_eq!(times.len(), count);
    assert!(moved > 100, "{moved} robots moved");
    // 300 ms of an idle machine; a busy one runs the threads of ten robots late
    assert!(last < Duration::from_secs(10), "{last:?}");
    // the watch writes it after the end of the jog
    let lapses = || web.lines().iter().filter(|line| line.contains(LAPSED)).count();
    until("each has a line of the audit", || lapses() == count);
}

/// A lost heartbeat: the time from the last heartbeat to rest, and whether the robot moved then.
struct Lost {
    time: Duration,
    moved: bool,
}

/// Begins a jog, holds a button, and loses the heartbeat.
fn lose(page: &mut Page, sim: &Sim, robot: usize, random: &mut fastrand::Rng) -> Lost {
    sim.lock().clear_errors(bcap_std::now());
    let end = Instant::now() + LIMIT;
    while let Err(why) = page.order("grip", json!({ "robot": robot, "name": format!("robot{robot}") })) {
        assert!(why.contains("has not ended") && Instant::now() < end, "{why}");
        // a page may send 20 orders a second
        thread::sleep(Duration::from_millis(100));
    }
    let time = Duration::from_millis(random.u64(0..300));
    // a busy machine may need this time for the arm: every other heartbeat is lost after a press
    let (mut until, waits) = (Instant::now() + time, random.bool());
    let (axis, by) = ([("J1", 5.0), ("J4", -5.0), ("Z", 2.0)][random.usize(0..3)], random.bool());
    let press = json!({ "robot": robot, "axis": axis.0, "by": if by { axis.1 } else { -axis.1 }, "percent": 10.0 });
    let (mut is_pressed, mut has_ended, mut next) = (false, false, Instant::now());
    while Instant::now() < until || (waits && !is_pressed && !has_ended) {
        // it is refused until the motor is on
        if !is_pressed && Instant::now() >= next {
            let pressed = page.order("press", press.clone());
            next = Instant::now() + Duration::from_millis(100);
            is_pressed = pressed.is_ok();
            has_ended = pressed.is_err_and(|why| why.starts_with("the jog has ended"));
            if waits && is_pressed {
                until = Instant::now() + time;
            }
        }
        // it also answers pulses
        page.receive().unwrap();
    }
    let (last, mut time, mut moved) = (Instant::now(), Duration::ZERO, false);
    loop {
        let mut sim = sim.lock();
        sim.advance(bcap_std::now());
        if sim.is_moving() {
            (time, moved) = (last.elapsed(), true);
        } else if sim.arm_owner().is_none() && last.elapsed() > Duration::from_millis(200) {
            return Lost { time, moved };
        }
        drop(sim);
        assert!(last.elapsed() < LIMIT, "the robot moves, or the arm is not free");
        thread::sleep(Duration::from_millis(2));
    }
}

/// A page that jogs the robot of a virtual controller.
struct Jogging {
    sim: Sim,
    web: Web,
    page: Page,
}

impl Jogging {
    fn begin() -> Option<Self> {
        let sim = Sim::start();
        let web = Web::moving(&[("press", sim.address())]);
        let page = ready(&web)?;
        Some(Self { sim, web, page })
    }

    /// Holds a button until the robot moves; `None` if the heartbeat was lost before.
    fn press(&mut self) -> Option<()> {
        self.hold("J1", 5.0, 10.0)
    }

    fn hold(&mut self, axis: &str, by: f64, percent: f64) -> Option<()> {
        let press = json!({ "robot": 0, "axis": axis, "by": by, "percent": percent });
        self.page.order("press", press).ok()?;
        let end = Instant::now() + LIMIT;
        while !self.sim.lock().is_moving() {
            assert!(Instant::now() < end, "the robot moves");
            if self.page.receive()?["v"]["phase"] == "off" {
                return None;
            }
        }
        Some(())
    }

    /// Waits until the robot has been at rest for 300 ms while the page answers pulses; `None` when the page is closed. A busy
    /// machine may begin the last step late.
    #[track_caller]
    fn rests(&mut self) -> Option<()> {
        let end = Instant::now() + LIMIT;
        loop {
            let rests = self.sim.lock().axes();
            watch(&mut self.page, Duration::from_millis(300))?;
            if self.sim.lock().axes() == rests {
                return Some(());
            }
            assert!(Instant::now() < end, "nothing moves without a button");
        }
    }

    /// Waits until the robot rests and the arm is free, and returns the end of the last line of the audit.
    #[track_caller]
    fn ended(&self) -> String {
        self.sim.until("the robot rests, and the arm is free", |sim| !sim.is_moving() && sim.arm_owner().is_none());
        assert!(!self.sim.lock().motor_is_on(), "the motor that was switched on is off");
        let mut last = String::new();
        until("the jog has its line of the audit", || {
            last = self.web.lines().into_iter().find(|line| line.contains("the jog ends: ")).unwrap_or_default();
            !last.is_empty()
        });
        last.split_once("the jog ends: ").unwrap().1.to_owned()
    }
}

/// Answers pulses for a time; `None` when the page is closed.
fn watch(page: &mut Page, time: Duration) -> Option<()> {
    let until = Instant::now() + time;
    while Instant::now() < until {
        page.receive()?;
    }
    Some(())
}

/// A busy machine can lose a heartbeat: such an attempt is repeated.
#[track_caller]
fn retried(attempt: impl Fn() -> Option<()>) {
    assert!((0..20).any(|_| attempt().is_some()), "each attempt has lost its heartbeat");
}

/// Asserts that a jog ends for a reason; `None` if it has lost its heartbeat before.
#[track_caller]
fn assert_end(jogging: &Jogging, why: &str) -> Option<()> {
    let ended = jogging.ended();
    if ended == format!("{LAPSED}; {DONE}") {
        return None;
    }
    assert_eq!(ended, format!("{why}; {DONE}"));
    Some(())
}

/// Begins a jog, and waits until it is ready; `None` if the heartbeat was lost before.
fn ready(web: &Web) -> Option<Page> {
    let mut page = web.page();
    page.until_state("ready, motor off");
    page.order("show", json!({ "robot": 0, "screen": "jog" })).unwrap();
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    page.order("grip", json!({ "robot": 0, "name": "press" })).unwrap();
    let jog = page.until("jog", |jog| jog["phase"] == "ready" || jog["ends"].is_string());
    (jog["phase"] == "ready").then_some(page)
}

const DONE: &str = "the robot rests, and the arm is free: done";

/// The reason with which a jog may also end on a busy machine.
const LAPSED: &str = "the heartbeat of the page was lost";

/// The reason of an end, and what ends a jog.
type End<'a> = (&'a str, &'a dyn Fn(&mut Jogging));

#[test]
fn each_end_halts_the_robot_and_frees_the_arm() {
    let ends: [End<'_>; 7] = [
        ("too many orders", &|jogging| {
            for _ in 0..60 {
                jogging.page.send("calls", json!({ "robot": 0 }));
            }
        }),
        ("the tab was hidden", &|jogging| {
            drop(jogging.page.order("endjog", json!({ "robot": 0, "why": "the tab was hidden" })));
        }),
        ("a second button was pressed", &|jogging| {
            let second = json!({ "robot": 0, "axis": "J2", "by": 1.0, "percent": 1.0 });
            assert!(jogging.page.order("press", second).is_err());
        }),
        ("the screen was left", &|jogging| {
            jogging.page.order("show", json!({ "robot": 0, "screen": "cell" })).unwrap();
        }),
        ("the control was released", &|jogging| {
            jogging.page.order("release", json!({ "robot": 0 })).unwrap();
        }),
        // HALT waits for the end of the step for 2 s, which a busy machine may need
        ("HALT was pressed", &|jogging| {
            until("the robot is halted", || jogging.web.halt_while_receiving(&mut jogging.page, 0)["ok"] == true);
        }),
        ("the page is closed", &|jogging| {
            let MaybeTlsStream::Plain(stream) = jogging.page.socket.get_ref() else { unreachable!() };
            stream.shutdown(Shutdown::Both).unwrap();
        }),
    ];
    for (why, end) in ends {
        retried(|| {
            let mut jogging = Jogging::begin()?;
            jogging.press()?;
            end(&mut jogging);
            assert_end(&jogging, why)
        });
    }
}

#[test]
fn a_lifted_button_ends_its_step_and_keeps_the_arm() {
    retried(|| {
        let mut jogging = Jogging::begin()?;
        let before = jogging.sim.lock().point().position[2];
        jogging.hold("Z", -0.5, 10.0)?;
        let Jogging { sim, page, .. } = &mut jogging;
        // two steps and more
        let end = Instant::now() + LIMIT;
        while sim.lock().point().position[2] > before - 1.2 {
            assert!(Instant::now() < end, "the robot moves by steps");
            if page.receive()?["v"]["phase"] == "off" {
                return None;
            }
        }
        let steps = page.order("lift", json!({ "robot": 0 })).ok()?;
        assert!(steps.as_u64().unwrap() >= 2, "{steps}");
        jogging.rests()?;
        let Jogging { sim, page, .. } = &mut jogging;
        let errors = sim.lock().errors().count();
        let owner = sim.lock().arm_owner();
        let motor = sim.lock().motor_is_on();
        page.order("endjog", json!({ "robot": 0, "why": "the user ended it" })).ok()?;
        assert_end(&jogging, "the user ended it")?;
        assert_eq!(errors, 0, "a step that ends leaves no error");
        assert!(owner.is_some() && motor, "the arm was kept after the lift");
        Some(())
    });
}

/// The page missed that the button was lifted, or its lift order was lost: its heartbeats continue without the press.
#[test]
fn a_heartbeat_without_the_press_lifts_the_button() {
    retried(|| {
        let mut jogging = Jogging::begin()?;
        jogging.hold("J1", 0.5, 10.0)?;
        jogging.page.held = 0;
        jogging.rests()?;
        jogging.page.order("endjog", json!({ "robot": 0, "why": "the user ended it" })).ok()?;
        assert_end(&jogging, "the user ended it")
    });
}

#[test]
fn a_jog_needs_the_right_the_control_the_name_and_a_short_slow_step() {
    let sim = Sim::start();
    let grip = json!({ "robot": 0, "name": "press" });
    let press = |axis: &str, by: f64, percent: f64| json!({ "robot": 0, "axis": axis, "by": by, "percent": percent });
    let writing = Web::start(&[("press", sim.address())], true);
    let mut page = writing.page();
    page.until_state("ready, motor off");
    page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    let refused = page.order("grip", grip.clone()).unwrap_err();
    assert_eq!(refused, "this server moves nothing; start it with --allow-motion");
    assert_eq!(page.order("press", press("J1", 1.0, 1.0)).unwrap_err(), refused);
    let web = Web::moving(&[("press", sim.address())]);
    let (mut anna, mut bob) = (web.page(), web.page());
    anna.until_state("ready, motor off");
    assert_eq!(anna.order("grip", grip.clone()).unwrap_err(), "take the control first");
    anna.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
    assert_eq!(bob.order("grip", grip).unwrap_err(), "Anna has the control; ask for its release");
    let wrong = anna.order("grip", json!({ "robot": 0, "name": "welder" })).unwrap_err();
    assert_eq!(wrong, "welder is not the name of this robot; nothing was done");
    assert_eq!(anna.order("press", press("J1", 1.0, 1.0)).unwrap_err(), "the jog has ended; begin it again");
    assert_eq!(sim.lock().arm_owner(), None);
    let begun = || {
        let web = Web::moving(&[("press", sim.address())]);
        ready(&web).map(|page| (web, page))
    };
    let (web, mut anna) = (0..20).find_map(|_| begun()).unwrap();
    for (axis, by, percent, why) in [
        ("J1", 5.1, 1.0, "5.1: a step is at most 5 mm or degrees, and not 0"),
        ("J1", 0.0, 1.0, "0: a step is at most"),
        ("Z", 1.0, 11.0, "11 %: the speed is above 0 and at most 10 %"),
        ("J9", 1.0, 1.0, "J9: write J1 to J8"),
        ("'; DROP", 1.0, 1.0, "'; DROP: write J1 to J8"),
    ] {
        let refused = anna.order("press", press(axis, by, percent)).unwrap_err();
        assert!(refused.starts_with(why), "{refused}");
    }
    assert!(web.page().order("press", press("J1", 1.0, 1.0)).is_err());
    assert!(!sim.lock().is_moving());
}

#[test]
fn a_step_out_of_range_is_not_made() {
    let sim = Sim::start();
    // J5 ends at 120 degrees
    let mut cell = Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let _ = arm.move_to(&Move::joint("J(0,45,90,0,118,0)").speed_percent(100.0), LIMIT).unwrap();
    arm.give().unwrap();
    let before = sim.lock().axes();
    retried(|| {
        let web = Web::moving(&[("press", sim.address())]);
        let mut page = ready(&web)?;
        page.order("press", json!({ "robot": 0, "axis": "J5", "by": 5.0, "percent": 10.0 })).ok()?;
        let ended = page.until("jog", |jog| jog["outcome"] != json!(null));
        if ended["ends"] == LAPSED {
            return None;
        }
        assert_eq!(ended["ends"], "J5 +5: J5 would leave its range; nothing was moved");
        assert_eq!(ended["outcome"], "the robot rests, and the arm is free");
        Some(())
    });
    let sim = sim.lock();
    assert_eq!((sim.axes(), sim.errors().count(), sim.arm_owner()), (before, 0, None));
}

/// The request is for 10 %, which would be above the limit.
#[test]
fn the_tool_is_slower_than_250_mm_per_second() {
    retried(|| {
        let mut jogging = Jogging::begin()?;
        jogging.press()?;
        let (mut last, mut fastest) = (None, 0.0_f64);
        let until = Instant::now() + Duration::from_millis(800);
        while Instant::now() < until {
            jogging.page.receive()?;
            let mut sim = jogging.sim.lock();
            // not before the lock, for which it may wait while another thread advances the controller
            let now = bcap_std::now();
            sim.advance(now);
            let to = sim.point().position;
            if let Some((since, from)) = last.replace((now, to)) {
                let way = to.iter().zip(from).take(3).map(|(to, from)| (to - from).powi(2)).sum::<f64>().sqrt();
                // both of the virtual controller's clock
                fastest = fastest.max(way / now.saturating_since(since).as_secs_f64());
            }
        }
        assert!(fastest <= 250.0, "{fastest} mm/s");
        let _ = jogging.page.order("endjog", json!({ "robot": 0, "why": "it was seen" }));
        assert_end(&jogging, "it was seen")?;
        assert!(fastest > 10.0, "{fastest} mm/s");
        println!("the fastest: {fastest:.0} mm/s");
        Some(())
    });
}

/// Heartbeats for old pulses do not count: a slow network must not hide a lost one.
#[test]
fn heartbeats_that_were_held_up_do_not_count() {
    let mut jogging = (0..20).find_map(|_| Jogging::begin()).unwrap();
    // whether the robot moves already does not matter
    let _ = jogging.press();
    jogging.page.beats = false;
    let mut first = None;
    let end = Instant::now() + LIMIT;
    while jogging.web.lines().iter().all(|line| !line.contains("the jog ends: ")) {
        let message = jogging.page.receive().unwrap();
        if message["t"] == "pulse" {
            let number = *first.get_or_insert(message["n"].as_u64().unwrap());
            jogging.page.beat(number);
            jogging.page.beat(number + 1_000_000);
        }
        assert!(Instant::now() < end, "the jog ends");
    }
    assert_eq!(jogging.ended(), format!("{LAPSED}; {DONE}"));
}

/// The connection of the jog hangs while the robot makes a step of 13 s, and then the page loses its heartbeat, or its user lifts
/// the button: the connection of HALT halts the robot.
#[test]
fn a_jog_whose_connection_hangs_is_halted_over_another_one() {
    for is_lifted in [false, true] {
        halt_a_jog_that_hangs(is_lifted);
    }
}

fn halt_a_jog_that_hangs(is_lifted: bool) {
    retried(|| {
        let sim = Sim::start();
        let relay = Relay::start(sim.address());
        let web = Web::moving(&[("press", relay.address)]);
        let page = ready(&web)?;
        let mut jogging = Jogging { sim, web, page };
        jogging.hold("J1", 5.0, 0.1)?;
        // after the reading and the halting connection
        relay.freeze(2);
        let Jogging { sim, web, page } = &mut jogging;
        page.beats = is_lifted;
        if is_lifted {
            page.order("lift", json!({ "robot": 0 })).ok()?;
        }
        let end = Instant::now() + LIMIT;
        let line = "press: Anna: the jog did not halt in time: HALT: done";
        while web.lines().iter().all(|known| known != line) {
            page.receive()?;
            // the heartbeat was lost, and the step ended, before the connection hung
            if web.lines().iter().any(|line| line.contains("the jog ends: ")) {
                return None;
            }
            assert!(Instant::now() < end, "{:?}", web.lines());
        }
        assert!(!sim.lock().is_moving());
        relay.freeze(usize::MAX);
        page.order("endjog", json!({ "robot": 0, "why": "it was seen" })).ok()?;
        until("the jog ends", || web.ended_jogs() > 0);
        // a busy machine may also lose the heartbeat
        let is_lapsed = web.lines().iter().any(|line| line.contains(LAPSED));
        (is_lapsed != is_lifted).then_some(())
    });
}

/// The controller ends during a step: the outcome claims only what was observed. The next jog works when the controller is
/// back.
#[test]
fn a_jog_of_an_rc9_frees_the_arm_after_a_lost_connection() {
    retried(|| {
        let sim = Sim::quick_of(Profile::Rc9);
        let relay = Relay::start(sim.address());
        // the provider is not given: the one of an RC8 is refused
        let web = Web::moving(&[("press", relay.address)]);
        let mut page = ready(&web)?;
        // after the reading and the halting connection
        relay.cut(2);
        page.order("endjog", json!({ "robot": 0, "why": "it was seen" })).ok()?;
        // the server connects again once, which a busy machine may delay beyond the time for that
        let end = Instant::now() + Duration::from_secs(10);
        while sim.lock().motor_is_on() || sim.lock().arm_owner().is_some() {
            if Instant::now() > end {
                println!("not freed: {:?}", web.lines());
                return None;
            }
            thread::sleep(Duration::from_millis(5));
        }
        Some(())
    });
}

#[test]
fn a_controller_that_starts_again_during_a_jog_is_not_called_at_rest() {
    retried(|| {
        let mut jogging = Jogging::begin()?;
        jogging.press()?;
        let Jogging { sim, web, mut page } = jogging;
        let address = sim.address();
        drop(sim);
        let ended = page.until("jog", |jog| jog["outcome"] != json!(null));
        if ended["failed"] == false {
            // the heartbeat was lost, and the step ended, before the controller did
            return None;
        }
        let outcome = ended["outcome"].as_str().unwrap();
        assert!(outcome.starts_with("IT IS UNKNOWN whether the robot rests and the arm is free: "), "{outcome}");
        until("the outcome has its line of the audit", || web.lines().iter().any(|line| line.ends_with(outcome)));
        let sim = Sim::at(address);
        page.until_state("ready, motor off");
        page.order("grip", json!({ "robot": 0, "name": "press" })).unwrap();
        let end = Instant::now() + LIMIT;
        while sim.lock().arm_owner().is_none() {
            assert!(Instant::now() < end, "the arm is taken");
            if page.receive()?["v"]["phase"] == "off" {
                return None;
            }
        }
        page.order("endjog", json!({ "robot": 0, "why": "it was seen" })).unwrap();
        sim.until("the arm is free", |sim| sim.arm_owner().is_none());
        Some(())
    });
}

/// The controller may have carried out TakeArm: the connection or the reply is lost, or the controller abandons the call.
#[test]
fn an_arm_that_was_perhaps_taken_is_not_called_free() {
    for (commands, then) in [
        (&["TakeArm"][..], "\"disconnect\""),
        (&["TakeArm"], "\"drop\""),
        (&["TakeArm", "GiveArm"], "{ refuse = \"E_TIMEOUT\" }"),
    ] {
        let fault = |of: &&str| format!("[[fault]]\nwhen = {{ every = 1, of = \"{of}\" }}\nthen = {then}\n");
        let scenario: String = commands.iter().map(fault).collect();
        retried(|| {
            let mut controller = bcap_sim::Controller::new(bcap_sim::Config::new(bcap_sim::Profile::Rc8));
            controller.play(bcap_sim::Scenario::parse(&scenario).unwrap());
            let server = serve_paced(&Arc::new(Mutex::new(Paced::new(controller))));
            let web = Web::moving(&[("press", server.value)]);
            let mut page = web.page();
            page.until_state("ready, motor off");
            page.order("show", json!({ "robot": 0, "screen": "jog" })).unwrap();
            page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
            page.order("grip", json!({ "robot": 0, "name": "press" })).unwrap();
            let ended = page.until("jog", |jog| jog["outcome"] != json!(null));
            let outcome = ended["outcome"].as_str().unwrap();
            if ended["ends"] == LAPSED && outcome == "nothing was moved, and the arm was not taken" {
                // before TakeArm
                return None;
            }
            let unknown = "IT IS UNKNOWN whether the robot rests and the arm is free: ";
            assert!(outcome.starts_with(unknown) && ended["failed"] == true, "{then}: {ended}");
            Some(())
        });
    }
}

#[test]
fn a_stream_of_another_client_is_not_ended_by_a_jog() {
    let sim = Sim::start();
    let mut cell = Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    arm.robot().execute::<()>("slvChangeMode", 0x202).unwrap();
    retried(|| {
        let web = Web::moving(&[("press", sim.address())]);
        let mut page = web.page();
        page.until_state("streaming");
        page.order("show", json!({ "robot": 0, "screen": "jog" })).unwrap();
        page.order("take", json!({ "robot": 0, "name": "Anna" })).unwrap();
        // each end has the number of its jog, because the second may look like the first
        let mut ended = json!(null);
        for number in [1, 2] {
            assert_eq!(page.order("grip", json!({ "robot": 0, "name": "press" })), Ok(json!(number)));
            ended = page.until("jog", |jog| jog["jog"] == number && jog["outcome"] != json!(null));
        }
        assert_eq!(ended["outcome"], "nothing was moved, and the arm was not taken");
        assert_eq!(sim.lock().slave_mode(), 0x202);
        if ended["ends"] == LAPSED {
            return None;
        }
        assert_eq!(ended["ends"], "another client streams in Slave Mode; TakeArm would end the stream");
        Some(())
    });
}
