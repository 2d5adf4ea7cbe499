//! A robot of the page: the thread that reads it, and what it has read.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread;
use std::time::{Duration, Instant};

use bcap_capture::trace::{Level, Packets, shown};
use bcap_live::calls::{Failure as _, needs_reconnect};
use bcap_live::jog::Grip;
use bcap_live::link::{Access, Error, Link};
use bcap_live::model::{Model, Update};
use bcap_live::reader::{self, Reader, Rounds};
use bcap_live::recovery::Recovery;
use bcap_live::tape::Tape;
use bcap_live::variables::{get_one, is_virtual};
use bcap_std::{Examination, ObjectPath};
use tokio::sync::oneshot;

use crate::control::{Client, Control};
use crate::halt::Halter;
use crate::job::Job;

/// The time from one reading to the next.
const INTERVAL: Duration = Duration::from_millis(200);

/// The joints that the arm was commanded to.
pub(crate) const TARGET: &str = "robot/@DEST_ANGLE";

/// How often the state is examined, and a lost connection is tried again.
const SLOW: Duration = Duration::from_secs(1);

/// The longest time that an order waits. An older one is refused: the user may have turned to something else.
const LONGEST_WAIT: Duration = Duration::from_secs(2);

/// A robot of the page.
pub(crate) struct Robot {
    pub(crate) name: String,
    pub(crate) address: String,
    pub(crate) control: Control,
    pub(crate) halter: Halter,
    pub(crate) access: Access,
    /// The last hold of the robot for a jog.
    grip: Mutex<Option<Arc<Grip>>>,
    /// The last recovery.
    recovery: Mutex<Option<Arc<Recovery>>>,
    /// The last work on backups.
    backup: Mutex<Option<Arc<Job>>>,
    live: Mutex<Live>,
    orders: Sender<Order>,
}

/// The values that were read.
#[derive(Debug, Default)]
pub(crate) struct Live {
    pub(crate) model: Model,
    /// The state of the robot; `None` if it is unknown.
    pub(crate) examination: Option<Examination>,
    /// Why the state is unknown.
    pub(crate) unknown: Option<String>,
    /// Whether the controller says that it is a virtual one; `None` until it was asked.
    pub(crate) is_virtual: Option<bool>,
    /// `@TYPE_NAME` of the robot, if the controller has it.
    pub(crate) type_name: Option<String>,
    /// The variables of each page.
    pub(crate) names: BTreeMap<Client, Vec<String>>,
    /// The pages that show the arm.
    pub(crate) arms: HashSet<Client>,
    /// The last packets.
    pub(crate) tape: Tape,
}

/// Carries out an order, or answers why there is no session. Fails when the session is lost.
type Work = dyn FnOnce(Result<&mut Link, &'static str>) -> Result<(), Error> + Send;

/// An order of a user.
struct Order {
    since: Instant,
    work: Box<Work>,
}

impl Robot {
    /// Starts the threads of a robot. They end when it is dropped.
    pub(crate) fn start(name: String, access: Access) -> std::io::Result<Arc<Self>> {
        let (orders, receiver) = channel();
        let halter = Halter::start(access.clone())?;
        let address = access.address.to_string();
        let robot = Arc::new(Self {
            name,
            address,
            control: Control::default(),
            halter,
            access: access.clone(),
            grip: Mutex::default(),
            recovery: Mutex::default(),
            backup: Mutex::default(),
            live: Mutex::new(Live::default()),
            orders,
        });
        let thread = Thread { robot: Arc::downgrade(&robot), access, orders: receiver, began: Instant::now() };
        thread::Builder::new().name("robot".into()).spawn(move || thread.run())?;
        Ok(robot)
    }

    pub(crate) fn live(&self) -> MutexGuard<'_, Live> {
        // a panic of another thread leaves values that were read
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the last hold of the robot for a jog.
    pub(crate) fn grip(&self) -> MutexGuard<'_, Option<Arc<Grip>>> {
        self.grip.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the last work on backups.
    pub(crate) fn backup(&self) -> MutexGuard<'_, Option<Arc<Job>>> {
        self.backup.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the last recovery.
    pub(crate) fn recovery(&self) -> MutexGuard<'_, Option<Arc<Recovery>>> {
        self.recovery.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends a jog and a recovery, if there is one.
    pub(crate) fn end_motion(&self, why: &str) {
        if let Some(recovery) = &*self.recovery() {
            recovery.end(why);
        }
        if let Some(grip) = &*self.grip() {
            grip.end(why);
        }
    }

    /// Carries out an order over the session. The error is for the user.
    pub(crate) async fn order<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Link) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, String> {
        let (sender, reply) = oneshot::channel();
        let work = move |link: Result<&mut Link, &'static str>| {
            let (answer, lost) = match link.map(work) {
                Err(why) => (Err(why.to_owned()), Ok(())),
                Ok(Ok(value)) => (Ok(value), Ok(())),
                Ok(Err(error)) => {
                    let text = if error.is_lost() {
                        format!("it is unknown whether it was done: {error}")
                    } else {
                        error.to_string()
                    };
                    (Err(text), if needs_reconnect(&error) { Err(error) } else { Ok(()) })
                }
            };
            // a page that is closed needs no answer
            let _ = sender.send(answer);
            lost
        };
        let ended = "the thread of this robot has ended; start bcap web again";
        self.orders.send(Order { since: Instant::now(), work: Box::new(work) }).map_err(|_| ended)?;
        reply.await.map_err(|_| ended)?
    }
}

/// The thread of a robot.
struct Thread {
    robot: Weak<Robot>,
    access: Access,
    orders: Receiver<Order>,
    began: Instant,
}

impl Thread {
    /// Reads until the robot is dropped. A lost connection is tried again.
    fn run(mut self) {
        loop {
            let ended = self.read_until_lost();
            let Some(robot) = self.robot.upgrade() else { return };
            let Err(error) = ended else { continue };
            let mut live = robot.live();
            live.model.apply(Update::Lost(error.to_string()));
            live.examination = None;
            drop(live);
            drop(robot);
            let until = Instant::now() + SLOW;
            while let Some(order) = self.wait(until) {
                match order {
                    Some(order) => {
                        drop((order.work)(Err("there is no connection to the controller; nothing was done")))
                    }
                    None => return,
                }
            }
        }
    }

    /// Waits for an order until a moment; the inner `None` is the end.
    fn wait(&self, until: Instant) -> Option<Option<Order>> {
        match self.orders.recv_timeout(until.saturating_duration_since(Instant::now())) {
            Ok(order) => Some(Some(order)),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => Some(None),
        }
    }

    /// Reads until the robot is dropped, or a recording starts, which must have the beginning of the session. Fails when the
    /// connection is lost.
    fn read_until_lost(&mut self) -> Result<(), Error> {
        let (mut packets, robot) = (Packets::new(), self.robot.clone());
        let (began, recordings) = (self.began, self.access.tap.count());
        packets.watch_bytes(move |role, wire, bytes| {
            let Some(robot) = robot.upgrade() else { return };
            let text = shown(role, wire, bytes, Level::Values);
            let mut live = robot.live();
            live.tape.push(role, bytes);
            live.model.now = began.elapsed();
            live.model.apply(Update::Packet(role, text));
        });
        let Some(robot) = self.robot.upgrade() else { return Ok(()) };
        robot.live().tape.opens();
        drop(robot);
        let mut link = Link::connect(&self.access, &packets)?;
        let found = is_virtual(&mut link)?;
        let type_name = match get_one(&mut link, &ObjectPath::variable("robot/@TYPE_NAME")?) {
            Ok(name) => name.as_variant().as_bstr().map(|name| name.to_string()),
            Err(error) if needs_reconnect(&error) => return Err(error),
            Err(_) => None,
        };
        let mut reader = Reader::start(&mut link, &[])?;
        let Some(robot) = self.robot.upgrade() else { return Ok(()) };
        let mut live = robot.live();
        (live.is_virtual, live.type_name) = (Some(found), type_name);
        live.tape.connected(link.ends());
        drop(live);
        robot.halter.prepare();
        drop(robot);
        let (mut next, mut slow) = (Instant::now(), Instant::now());
        while self.access.tap.count() == recordings {
            let Some(robot) = self.robot.upgrade() else { return Ok(()) };
            let names = robot.wanted();
            reader.select::<Link>(&names)?;
            robot.live().model.apply(Update::Connected(names));
            if Instant::now() >= slow {
                slow = Instant::now() + SLOW;
                self.examine(&mut link, &robot)?;
            }
            let mut round = Round { robot: &robot, orders: &self.orders, began };
            reader::round(&mut reader, &mut link, &mut round)?;
            drop(robot);
            next = (next + INTERVAL).max(Instant::now());
            while let Some(order) = self.wait(next) {
                match order {
                    Some(order) => carry_out(order, &mut link)?,
                    None => return Ok(()),
                }
            }
        }
        Ok(())
    }

    fn examine(&self, link: &mut Link, robot: &Robot) -> Result<(), Error> {
        let examined = match link.examine() {
            Err(error) if needs_reconnect(&error) => return Err(error),
            examined => examined,
        };
        let mut live = robot.live();
        live.unknown = examined.as_ref().err().map(ToString::to_string);
        live.examination = examined.ok();
        Ok(())
    }
}

impl Robot {
    /// Returns the variables that a page shows, in the order of their names.
    fn wanted(&self) -> Vec<String> {
        let live = self.live();
        let mut names: BTreeSet<&str> = live.names.values().flatten().map(String::as_str).collect();
        if !live.arms.is_empty() {
            names.insert(TARGET);
        }
        names.into_iter().map(str::to_owned).collect()
    }
}

/// A round of readings.
struct Round<'a> {
    robot: &'a Robot,
    orders: &'a Receiver<Order>,
    began: Instant,
}

impl Rounds<Link> for Round<'_> {
    fn tell(&mut self, update: Update) {
        let mut live = self.robot.live();
        live.model.now = self.began.elapsed();
        live.model.apply(update);
    }

    fn poll(&mut self, link: &mut Link) -> Result<(), Error> {
        self.orders.try_iter().try_for_each(|order| carry_out(order, link))
    }
}

/// Carries out an order, unless it has waited too long.
fn carry_out(order: Order, link: &mut Link) -> Result<(), Error> {
    if order.since.elapsed() > LONGEST_WAIT {
        return (order.work)(Err("the controller was busy for too long; nothing was done"));
    }
    (order.work)(Ok(link))
}
