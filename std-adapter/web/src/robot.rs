//! A robot of the page: the thread that reads it, and the values that were read.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

use bcap_capture::trace::{Level, Packets, shown};
use bcap_live::calls::{Failure as _, needs_reconnect, unless_refused};
use bcap_live::jog::{Grip, Phase};
use bcap_live::link::{Access, Error, Link};
use bcap_live::model::{Model, Update};
use bcap_live::reader::{self, Reader, Rounds};
use bcap_live::recovery::Recovery;
use bcap_live::tape::Tape;
use bcap_live::variables::{get_one, is_virtual};
use bcap_std::{Examination, ObjectPath};
use tokio::sync::oneshot;

use crate::audit::Audit;
use crate::control::{Client, Control};
use crate::halt::{AT_REST, Halter, Outcome};
use crate::job::{Job, Kind};
use crate::text::safe;
use crate::threads::lock;

/// The time from one reading to the next.
const INTERVAL: Duration = Duration::from_millis(200);

/// The joints that the arm was commanded to.
pub(crate) const TARGET: &str = "robot/@DEST_ANGLE";

/// Interval at which the state is read, and a lost connection is tried again.
const SLOW: Duration = Duration::from_secs(1);

/// Maximum time that an order waits. An older order is refused, because the user may no longer pay attention to it.
pub(crate) const LONGEST_WAIT: Duration = Duration::from_secs(2);

/// States older than this are shown as unknown.
const OLD: Duration = Duration::from_secs(3);

/// The pause before a robot is halted again, because a call that began before the halt is still running.
pub(crate) const AGAIN: Duration = Duration::from_millis(100);

/// Number of halts of a robot at the end of a page.
pub(crate) const HALTS: u32 = 3;

/// Maximum time that HALT waits for the end of such a call.
const LONGEST_HALT: Duration = Duration::from_secs(2);

/// A robot of the page.
pub(crate) struct Robot {
    pub(crate) name: String,
    pub(crate) control: Control,
    pub(crate) halter: Halter,
    pub(crate) access: Access,
    /// The last hold of the robot for a jog.
    pub(crate) grip: Mutex<Option<Arc<Grip>>>,
    /// The number of jogs that were begun.
    pub(crate) jogs: AtomicU64,
    /// The last recovery.
    pub(crate) recovery: Mutex<Option<Arc<Recovery>>>,
    /// The last work on backups.
    pub(crate) backup: Mutex<Option<Arc<Job>>>,
    /// The number of halts, and of releases of the control.
    revoked: Arc<AtomicU64>,
    /// The number of running calls that can move the robot.
    acting: Arc<AtomicUsize>,
    live: Arc<Mutex<Live>>,
    /// Its drop ends the thread that reads.
    orders: Sender<QueuedOrder>,
}

/// The values that were read.
#[derive(Default)]
pub(crate) struct Live {
    pub(crate) model: Model,
    /// The state of the robot, or why it is unknown; `None` while it is being read.
    pub(crate) examination: Option<Result<Examination, String>>,
    /// When it was read.
    pub(crate) examined: Option<Instant>,
    /// Whether the controller reports that it is virtual; `None` until it was read.
    pub(crate) is_virtual: Option<bool>,
    /// `@TYPE_NAME` of the robot, if the controller has it.
    pub(crate) type_name: Option<String>,
    /// The variables that each page has selected. They are also read on other screens, for plots and recordings.
    pub(crate) names: BTreeMap<Client, Vec<String>>,
    /// The pages that show the arm.
    pub(crate) arms: HashSet<Client>,
    /// The last packets.
    pub(crate) tape: Tape,
    /// When their session was opened, as the model counts time.
    pub(crate) opened: Duration,
}

/// An order of a user. Without a session it answers that it was not carried out. Fails when the session is lost.
type QueuedOrder = Box<dyn FnOnce(Option<&mut Link>) -> Result<(), Error> + Send>;

impl Robot {
    /// Starts the threads of a robot. They end when it is dropped.
    pub(crate) fn start(name: String, access: Access) -> std::io::Result<Arc<Self>> {
        let (orders, queue) = channel();
        let (live, halter, began) = (Arc::<Mutex<Live>>::default(), Halter::start(access.clone())?, Instant::now());
        let thread = Thread { live: Arc::clone(&live), halter: halter.clone(), access: access.clone(), queue, began };
        thread::Builder::new().name("robot".into()).spawn(move || thread.run())?;
        let (control, grip, jogs, recovery, backup, revoked, acting) = Default::default();
        let robot = Self { name, control, halter, access, grip, jogs, recovery, backup, revoked, acting, live, orders };
        Ok(Arc::new(robot))
    }

    pub(crate) fn live(&self) -> MutexGuard<'_, Live> {
        lock(&self.live)
    }

    /// Fails unless the question to the user had the name of this robot.
    pub(crate) fn check_name(&self, name: &str) -> Result<(), String> {
        let is_named = safe(&self.name) == name;
        is_named.then_some(()).ok_or_else(|| format!("{name} is not the name of this robot; nothing was done"))
    }

    /// Ends a jog and a recovery, if there is one.
    pub(crate) fn end_motion(&self, why: &str) {
        if let Some(recovery) = &*lock(&self.recovery) {
            recovery.end(why);
        }
        if let Some(grip) = &*lock(&self.grip) {
            grip.end(why);
        }
    }

    /// Halts the robot for a user who has pressed HALT, revokes the orders that have not begun, and ends a jog, a recovery and a
    /// restore. A call that began earlier may reach the controller after the halt, so the robot is halted again until such calls
    /// have ended.
    pub(crate) async fn halt(&self) -> Outcome {
        self.revoke();
        self.end_motion("HALT was pressed");
        if let Some(job) = lock(&self.backup).as_ref().filter(|job| job.work.kind == Kind::Restore) {
            job.end("HALT was pressed");
        }
        let (until, mut acts) = (Instant::now() + LONGEST_HALT, self.acts());
        let mut outcome = self.halter.halt().await;
        while acts && outcome.is_ok() {
            if Instant::now() > until {
                return outcome.and_then(|text| {
                    Err(format!(
                        "{text}; but a call that was made before HALT has not ended, and may still move the robot: use the emergency stop"
                    ))
                });
            }
            tokio::time::sleep(AGAIN).await;
            acts = self.acts();
            let again = self.halter.halt().await;
            outcome = outcome.and_then(|first| again.map(|text| if first == AT_REST { text } else { first }));
        }
        outcome
    }

    /// Halts the robot repeatedly while a call runs: a call that is just being sent may arrive after the first halt. `why` is
    /// for the audit log.
    pub(crate) fn halt_while(&self, audit: &Audit, why: &str, moves: impl Fn() -> bool) {
        for _ in 0..HALTS {
            if !moves() {
                break;
            }
            let outcome = self.halter.halt_now();
            let what = format!("HALT, because {why}, {}", outcome.as_deref().unwrap_or("failed"));
            audit.write("a page", &self.name, &what, &outcome);
            thread::sleep(AGAIN);
        }
    }

    /// Ends the work on backups for the user of a page, between two calls.
    pub(crate) fn end_work(&self, client: Client) -> Result<(), String> {
        if let Some(job) = &*lock(&self.backup) {
            if job.client != client && job.work.kind == Kind::Restore {
                return Err("another page restores; it ends that, or releases the control".into());
            }
            job.end("the user ended it");
        }
        Ok(())
    }

    /// Returns whether something that a page has begun may still move the robot.
    fn acts(&self) -> bool {
        self.acting.load(Ordering::SeqCst) > 0
            || lock(&self.grip).as_ref().is_some_and(|grip| grip.phase() == Phase::Moving)
            || lock(&self.recovery).as_ref().is_some_and(|recovery| recovery.moves())
    }

    /// Revokes the pending orders that change something: HALT was pressed, or the control was released.
    pub(crate) fn revoke(&self) {
        self.revoked.fetch_add(1, Ordering::SeqCst);
    }

    /// Returns the revocation count.
    pub(crate) fn revoked(&self) -> u64 {
        self.revoked.load(Ordering::SeqCst)
    }

    /// Fails if it was revoked after the count was `since`.
    pub(crate) fn check_since(&self, since: u64) -> Result<(), String> {
        self.permit_since(since).check().map_err(|error| reason(&error))
    }

    /// Returns the permit of an order that a user confirmed at the revocation count `since`.
    pub(crate) fn permit_since(&self, since: u64) -> Permit {
        let (revoked, acting) = (Arc::clone(&self.revoked), Arc::clone(&self.acting));
        Permit { since, revoked, acting, moves: false }
    }

    /// Carries out an order over the session. The error is for the user.
    pub(crate) async fn order<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Link) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, String> {
        let (sender, reply) = oneshot::channel();
        let since = Instant::now();
        let order = move |link: Option<&mut Link>| {
            let refused = |why: &str| Err(Error::Skipped(format!("{why}; nothing was done")));
            let done = match link {
                None => refused("there is no connection to the controller"),
                Some(_) if since.elapsed() > LONGEST_WAIT => refused("the controller was busy for too long"),
                Some(link) => work(link),
            };
            let (answer, lost) = match done {
                Ok(value) => (Ok(value), Ok(())),
                Err(error) => (Err(reason(&error)), if needs_reconnect(&error) { Err(error) } else { Ok(()) }),
            };
            // a page that is closed needs no answer
            let _ = sender.send(answer);
            lost
        };
        // without a receiver the order is dropped, and its reply with it
        let _ = self.orders.send(Box::new(order));
        reply.await.map_err(|_| "the thread of this robot has ended; start bcap web again")?
    }
}

/// The permit of an order to change something, which a halt and a release revoke. It is kept until the order is done.
pub(crate) struct Permit {
    revoked: Arc<AtomicU64>,
    since: u64,
    acting: Arc<AtomicUsize>,
    /// Whether it counts as a call that can move the robot.
    moves: bool,
}

impl Permit {
    /// Fails if it is revoked.
    pub(crate) fn check(&self) -> Result<(), Error> {
        let why = "HALT was pressed, or the control was released, before it began; nothing was done";
        (self.revoked.load(Ordering::SeqCst) == self.since).then_some(()).ok_or_else(|| Error::Skipped(why.into()))
    }

    /// Same as [`check`](Self::check), for a call that can move the robot: a halt waits for its end.
    pub(crate) fn check_move(&mut self) -> Result<(), Error> {
        // before the check, so that a halt after the check sees this call
        if !std::mem::replace(&mut self.moves, true) {
            self.acting.fetch_add(1, Ordering::SeqCst);
        }
        self.check()
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        if self.moves {
            self.acting.fetch_sub(1, Ordering::SeqCst);
        }
    }
}

/// Returns why an order of a user failed.
pub(crate) fn reason(error: &Error) -> String {
    if error.is_lost() { format!("it is unknown whether it was done: {error}") } else { error.to_string() }
}

impl Live {
    /// Returns whether the state is too old to be shown as the current one.
    pub(crate) fn is_old(&self) -> bool {
        self.examined.is_none_or(|at| at.elapsed() > OLD)
    }

    /// Returns the variables that the pages show, in the order of their names.
    fn wanted(&self) -> Vec<String> {
        let mut names: BTreeSet<&str> = self.names.values().flatten().map(String::as_str).collect();
        if !self.arms.is_empty() {
            names.insert(TARGET);
        }
        names.into_iter().map(str::to_owned).collect()
    }
}

/// The thread of a robot.
struct Thread {
    live: Arc<Mutex<Live>>,
    halter: Halter,
    access: Access,
    queue: Receiver<QueuedOrder>,
    began: Instant,
}

impl Thread {
    /// Reads until the robot is dropped. A lost connection is tried again.
    fn run(mut self) {
        loop {
            let goes_on = match self.read_until_lost() {
                Err(error) => {
                    self.tell(Update::Lost(error.to_string()));
                    lock(&self.live).examination = None;
                    self.carry_out_until(Instant::now() + SLOW, None)
                }
                goes_on => goes_on,
            };
            if matches!(goes_on, Ok(false)) {
                return;
            }
        }
    }

    /// Carries out orders until a moment. Returns `false` if the robot was dropped; fails when the session is lost.
    fn carry_out_until(&self, until: Instant, mut link: Option<&mut Link>) -> Result<bool, Error> {
        loop {
            match self.queue.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(order) => order(link.as_deref_mut())?,
                Err(RecvTimeoutError::Timeout) => return Ok(true),
                Err(RecvTimeoutError::Disconnected) => return Ok(false),
            }
        }
    }

    /// Reads until the robot is dropped, and returns `false`, or until a recording starts, which must have the beginning of the
    /// session. Fails when the connection is lost.
    fn read_until_lost(&mut self) -> Result<bool, Error> {
        let (mut packets, recordings) = (Packets::new(), self.access.tap.count());
        let (live, began) = (Arc::clone(&self.live), self.began);
        packets.watch_bytes(move |role, wire, bytes| {
            let text = shown(role, wire, bytes, Level::Values);
            let mut live = lock(&live);
            live.tape.push(role, bytes);
            live.model.now = began.elapsed();
            live.model.apply(Update::Packet(role, text));
        });
        lock(&self.live).tape.opens();
        let opened = began.elapsed();
        let mut link = Link::connect(&self.access, &packets)?;
        let found = is_virtual(&mut link)?;
        let type_name = unless_refused(get_one(&mut link, &ObjectPath::variable("robot/@TYPE_NAME")?))?;
        let mut reader = Reader::start(&mut link, &[])?;
        let mut live = lock(&self.live);
        live.is_virtual = Some(found);
        live.type_name = type_name.and_then(|name| name.as_variant().as_bstr().map(|name| name.to_string()));
        live.tape.connected(link.ends());
        live.opened = opened;
        drop(live);
        self.halter.prepare();
        let (mut next, mut slow) = (Instant::now(), Instant::now());
        while self.access.tap.count() == recordings {
            let names = lock(&self.live).wanted();
            reader.select::<Link>(&names)?;
            self.tell(Update::Connected(names));
            if Instant::now() >= slow {
                slow = Instant::now() + SLOW;
                self.examine(&mut link)?;
            }
            reader::round(&mut reader, &mut link, self)?;
            next = (next + INTERVAL).max(Instant::now());
            if !self.carry_out_until(next, Some(&mut link))? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn examine(&self, link: &mut Link) -> Result<(), Error> {
        let examined = match link.examine() {
            Err(error) if needs_reconnect(&error) => return Err(error),
            examined => examined,
        };
        let mut live = lock(&self.live);
        live.examination = Some(examined.map_err(|error| error.to_string()));
        live.examined = Some(Instant::now());
        Ok(())
    }
}

impl Rounds<Link> for Thread {
    fn tell(&mut self, update: Update) {
        let mut live = lock(&self.live);
        live.model.now = self.began.elapsed();
        live.model.apply(update);
    }

    fn poll(&mut self, link: &mut Link) -> Result<(), Error> {
        self.queue.try_iter().try_for_each(|order| order(Some(link)))
    }
}
