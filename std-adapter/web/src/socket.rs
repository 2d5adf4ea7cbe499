//! The WebSocket of a page: its orders, and the sections that it shows.

use std::pin::pin;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::extract::ws::WebSocket;
use bcap_capture::value::selection::{Selection, names_within};
use bcap_live::link::{Error, Link};
use bcap_live::request::Request;
use bcap_live::variables::{count, is_system_variable, shown};
use bcap_live::write::{Write, check, check_position};
use bcap_sim::pace::Paced;
use serde::Serialize;
use serde_json::{Map, Value, json};
use tokio::time::{Interval, MissedTickBehavior, interval};

use crate::app::App;
use crate::channel::{Channel, Received};
use crate::control::{Client, cleaned};
use crate::motions::{self, SharedMotions};
use crate::order::{Order, Screen};
use crate::robot::Robot;
use crate::secret::Bucket;
use crate::text::safe;
use crate::threads::lock;
use crate::{panel, raw, view};

/// Interval at which a page gets changes.
const TICK: Duration = Duration::from_millis(200);

/// Interval at which a page gets a message even without changes. Without these messages it shows that its values are old.
const ALIVE: Duration = Duration::from_secs(1);

/// The maximum number of variables of a page.
const VARIABLES: usize = 1000;

/// The answer to an order, or why it was not carried out.
pub(crate) type Answer = Result<Value, String>;

/// A page.
pub(crate) struct Page {
    pub(crate) app: Arc<App>,
    pub(crate) client: Client,
    shown: Mutex<Shown>,
    checked: Mutex<LastCheck>,
    pub(crate) motions: SharedMotions,
}

/// The last check of a value.
#[derive(Default)]
struct LastCheck {
    /// Its number. The user agrees to this check, not to a later one.
    number: u64,
    /// The robot and the value, until it is written.
    value: Option<(usize, Box<Write>)>,
}

/// The screen of a page, and the messages that the page has.
#[derive(Default)]
struct Shown {
    robot: usize,
    screen: Screen,
    /// The last message of each section.
    sent: Vec<String>,
    /// The number of packets that the page has.
    packets: u64,
}

impl Drop for Page {
    /// The loss of a page ends its motions, and frees the control that it holds.
    fn drop(&mut self) {
        self.end_motion("the page is closed");
        for robot in &self.app.robots {
            robot.live().names.remove(&self.client);
            robot.live().arms.remove(&self.client);
            self.free(robot, "the page is closed", "the page is closed, the control is free");
        }
    }
}

/// Serves a page until it is closed.
pub(crate) async fn serve(app: Arc<App>, client: Client, socket: WebSocket) {
    let labels: Map<_, _> = app.config.labels.iter().map(|(name, label)| (safe(name), safe(label).into())).collect();
    let hello = json!({ "t": "hello", "labels": labels, "write": app.config.allow_write, "motion": app.config.allow_motion, "panel": app.config.panel.is_some(), "version": env!("CARGO_PKG_VERSION") });
    let (shown, checked) = Default::default();
    let motions = SharedMotions::default();
    let mut channel = Channel::new(socket, Arc::clone(&app), client, Arc::clone(&motions));
    // dropped before the channel, so that the loss of the page ends a jog immediately
    let page = Page { app, client, shown, checked, motions };
    let _ = serve_page(&page, &mut channel, hello.to_string()).await;
}

/// The times at which a page gets messages.
struct Clock {
    ticks: Interval,
    alive: Interval,
}

async fn serve_page(page: &Page, channel: &mut Channel, hello: String) -> Option<()> {
    channel.send(hello).await?;
    let mut clock = Clock { ticks: interval(TICK), alive: interval(ALIVE) };
    for interval in [&mut clock.ticks, &mut clock.alive] {
        interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
    }
    // a burst of 40 orders, and 20 per second
    let mut bucket = Bucket::new(40, Duration::from_millis(50));
    loop {
        channel.watch(page.is_watched());
        tokio::select! {
            _ = clock.ticks.tick() => page.update(channel).await?,
            _ = clock.alive.tick() => channel.alive().await?,
            order = channel.order() => answer(page, channel, &mut clock, order?, bucket.take()).await?,
        }
    }
}

/// Carries out an order if the page has not given too many, and sends the answer.
async fn answer(
    page: &Page,
    channel: &mut Channel,
    clock: &mut Clock,
    received: Received,
    is_allowed: bool,
) -> Option<()> {
    let (late, id) = (channel.why_late(&received), received.order.as_ref().map(|(id, _)| *id));
    let refused = |why: &str| json!({ "t": "answer", "id": id, "error": safe(why) }).to_string();
    if !is_allowed {
        // the refused order may have been the end of a motion
        page.end_motion("too many orders");
        return channel.send(refused("too many orders; wait a moment")).await;
    }
    let Some((_, order)) = received.order else { return channel.send(refused("this is not an order")).await };
    if let Some(why) = late.filter(|_| order.changes()) {
        return channel.send(refused(why)).await;
    }
    let mut order = pin!(page.carry_out(order));
    let done = loop {
        tokio::select! {
            done = &mut order => break done,
            // a controller may need seconds
            _ = clock.ticks.tick() => page.update(channel).await?,
            _ = clock.alive.tick() => channel.alive().await?,
            ended = channel.hold() => ended?,
        }
    };
    let answer = |value| json!({ "t": "answer", "id": id, "ok": value }).to_string();
    channel.send(done.map_or_else(|why| refused(&why), answer)).await
}

impl Page {
    /// Sends the sections that have changed.
    async fn update(&self, channel: &mut Channel) -> Option<()> {
        for text in self.changed() {
            channel.send(text).await?;
        }
        Some(())
    }

    /// Returns the messages with the sections that have changed.
    fn changed(&self) -> Vec<String> {
        let tiles: Value =
            self.app.robots.iter().enumerate().map(|(number, robot)| view::tile(number, robot, self.client)).collect();
        let replay = self.app.config.replay.as_ref().map(|replay| (json!("replay"), replay.section()));
        let shown = &mut *lock(&self.shown);
        let section = self.section(shown).map(|section| (json!(shown.screen), section));
        let sections = [(json!("tiles"), tiles)].into_iter().chain(replay).chain(section);
        let message = |(name, content)| json!({ "t": name, "robot": shown.robot, "v": content }).to_string();
        let messages: Vec<_> = sections.map(message).collect();
        let changed = messages.iter().filter(|text| !shown.sent.contains(text)).cloned().collect();
        shown.sent = messages;
        changed
    }

    /// Returns the section of the screen; `None` if the screen has no content.
    fn section(&self, shown: &mut Shown) -> Option<Value> {
        let robot = self.app.robots.get(shown.robot)?;
        Some(match shown.screen {
            Screen::Cell | Screen::Raw => return None,
            Screen::Variables | Screen::Plots => view::variables(self.client, robot),
            Screen::Alarms => view::alarms(robot),
            Screen::Arm => view::arm(robot),
            Screen::Tasks => view::tasks(robot),
            Screen::Jog => view::jog(robot),
            Screen::Backup => json!(lock(&robot.backup).as_ref().map(|job| job.section(self.client))),
            Screen::Session => view::session(&self.app),
            Screen::Panel => panel::section(self.app.config.panel.as_deref()?),
            Screen::Packets => view::packets(robot, &mut shown.packets)?,
        })
    }

    /// Carries out an order.
    async fn carry_out(&self, order: Order) -> Answer {
        match order {
            Order::Show { robot, screen } => self.show(robot, screen),
            Order::Select { robot, names } => self.select(robot, names).await,
            Order::Take { robot, name } => self.take(robot, &name),
            Order::Release { robot } => self.release(robot),
            Order::Check { robot, name, text } => self.check(robot, move |link| check(link, &name, &text)).await,
            Order::Teach { robot, name } => self.check(robot, move |link| check_position(link, &name)).await,
            Order::Write { robot, check, revoked } => self.write(robot, check, revoked).await,
            Order::Clear { robot, revoked } => {
                let (who, robot) = self.writer(robot)?;
                self.change(who, &robot, revoked, "clears the errors".into(), bcap_live::errors::clear).await
            }
            Order::Grip { robot, name, revoked } => self.take_grip(robot, &name, revoked),
            Order::Press { robot, axis, by, percent, press } => self.press(robot, &axis, by, percent, press),
            Order::Lift { robot } => self.lift(robot),
            Order::Recover { robot, name, revoked } => self.begin_recovery(robot, &name, revoked),
            Order::Step { robot, step, revoked } => self.agree(robot, &step, revoked),
            Order::EndRecovery { robot } => self.stop(robot),
            Order::Log { robot } => self.log(robot).await,
            Order::Task { robot, of, name, what, revoked } => self.task(robot, &of, name, what, revoked).await,
            Order::Line { robot, name } => self.line(robot, name).await,
            Order::Files { robot, folder } => self.files(robot, folder).await,
            Order::View { robot, path } => self.view(robot, path).await,
            Order::Functions {} => Ok(raw::functions()),
            Order::Call { agreed, function, arguments } => {
                self.call(agreed, Request::parse(&function, &arguments)?).await
            }
            Order::Bytes { agreed, packet } => self.call(agreed, Request::decode(&packet)?).await,
            Order::Packet { robot, serial, at } => Ok(view::packet(&*self.robot(robot)?, serial, at)),
            Order::Calls { robot } => Ok(view::calls(&*self.robot(robot)?)),
            Order::Backups {} => self.backups().await,
            Order::Work { robot, work } => self.work(robot, work),
            Order::EndWork { robot } => self.end_work(robot),
            Order::Restore { robot, name, folder, revoked } => self.restore(robot, &name, folder, revoked),
            Order::Record { starts } => self.record(starts).await,
            Order::Recordings {} => self.recordings().await,
            Order::Play { robot, text } => {
                let what = format!("plays the scenario: {}", text.trim());
                self.on_panel(robot, &what, |found| panel::play(found, &text))
            }
            Order::Pace { robot, factor } => {
                self.on_panel(robot, &format!("sets the time factor to {factor}"), |found| panel::pace(found, factor))
            }
            Order::EndJog { robot, why } => self.drop_grip(robot, &why),
        }
    }

    fn show(&self, number: usize, screen: Screen) -> Answer {
        let robot = self.robot(number)?;
        self.end_motion("the screen was left");
        for robot in &self.app.robots {
            robot.live().arms.remove(&self.client);
        }
        if screen == Screen::Arm {
            robot.live().arms.insert(self.client);
        }
        *lock(&self.shown) = Shown { robot: number, screen, ..Shown::default() };
        Ok(Value::Null)
    }

    /// Keeps a value that is checked, and shows it with the old one.
    async fn check(
        &self,
        number: usize,
        check: impl FnOnce(&mut Link) -> Result<Write, Error> + Send + 'static,
    ) -> Answer {
        let (_, robot) = self.writer(number)?;
        let write = robot.order(check).await?;
        if is_system_variable(&write.path) {
            return Err("a system variable may switch the motor or start a program: write it on the screen Raw calls, whose session \
                        ends with the screen"
                .into());
        }
        let [before, value] = [&write.before, &write.value].map(shown);
        let (old, new) = (safe(&before), safe(&value));
        let checked = &mut *lock(&self.checked);
        checked.number += 1;
        // otherwise an undo would write another text
        let (name, exact) = (safe(&write.path), old == before);
        let answer = json!({ "check": checked.number, "name": name, "old": old, "new": new, "exact": exact });
        checked.value = Some((number, Box::new(write)));
        Ok(answer)
    }

    /// Returns the value of a check, once; `None` if it is not the last check, or of another robot.
    fn take_checked(&self, robot: usize, check: u64) -> Option<Box<Write>> {
        let checked = &mut *lock(&self.checked);
        let is_last = checked.number == check;
        checked.value.take_if(|(of, _)| is_last && *of == robot).map(|(_, write)| write)
    }

    /// Takes the control of a robot.
    fn take(&self, robot: usize, name: &str) -> Answer {
        if !self.app.config.allow_motion {
            self.writes()?;
        }
        let robot = self.robot(robot)?;
        let who = Some(cleaned(name)).filter(|name| !name.is_empty()).unwrap_or_else(|| "a page".into());
        self.audited(&who, &robot, "takes the control", robot.control.take(self.client, name))
    }

    /// Releases the control of a robot, and ends what this page moves.
    fn release(&self, robot: usize) -> Answer {
        let robot = self.robot(robot)?;
        if robot.control.user(self.client).is_ok() {
            self.end_motion("the control was released");
            self.free(&robot, "the control was released", "releases the control");
        }
        Ok(Value::Null)
    }

    /// Ends a restore of this page, and frees the control that it has.
    fn free(&self, robot: &Robot, why: &str, what: &str) {
        if let Some(job) = &*lock(&robot.backup)
            && job.is_restore_of(self.client)
        {
            job.end(why);
        }
        if let Some(name) = robot.control.release(self.client) {
            robot.revoke();
            self.app.audit.write::<()>(&name, &robot.name, what, &Ok(()));
        }
    }

    /// Changes the virtual controller. Its user needs the control, as for a real one.
    fn on_panel(&self, robot: usize, what: &str, change: impl FnOnce(&Mutex<Paced>) -> Result<(), String>) -> Answer {
        let panel =
            self.app.config.panel.as_deref().ok_or("this server has no virtual controller; start `bcap sim --web`")?;
        let (who, robot) = self.holder(robot)?;
        self.audited(&who, &robot, what, change(panel))
    }

    /// Ends what this page moves.
    pub(crate) fn end_motion(&self, why: &str) {
        motions::end(&self.motions, &self.app, why);
    }

    /// Returns whether this page shows a screen of a robot.
    pub(crate) fn shows(&self, screen: Screen, robot: usize) -> bool {
        let shown = lock(&self.shown);
        shown.screen == screen && shown.robot == robot
    }

    /// Returns whether this page must send heartbeats without a jog: it may make calls that move a robot.
    fn is_watched(&self) -> bool {
        let robot = lock(&self.shown).robot;
        self.shows(Screen::Raw, robot) && self.mover(robot).is_ok()
    }

    pub(crate) fn robot(&self, number: usize) -> Result<Arc<Robot>, String> {
        self.app.robots.get(number).cloned().ok_or_else(|| "there is no such robot".into())
    }

    /// Refuses orders that change something unless the server was started for them.
    fn writes(&self) -> Result<(), String> {
        if self.app.config.allow_write {
            return Ok(());
        }
        Err("this server is read-only; start it with --allow-write".into())
    }

    /// Returns the name of this page's user and the robot, if the user has the control of the robot and may write.
    pub(crate) fn writer(&self, robot: usize) -> Result<(String, Arc<Robot>), String> {
        self.writes()?;
        self.holder(robot)
    }

    /// Returns the name of this page's user and the robot, if the user has the control of the robot and may move it.
    pub(crate) fn mover(&self, robot: usize) -> Result<(String, Arc<Robot>), String> {
        if !self.app.config.allow_motion {
            return Err("this server moves nothing; start it with --allow-motion".into());
        }
        self.holder(robot)
    }

    /// Returns the name of this page's user and the robot, if the user has the control of the robot.
    pub(crate) fn holder(&self, robot: usize) -> Result<(String, Arc<Robot>), String> {
        let robot = self.robot(robot)?;
        Ok((robot.control.user(self.client)?, robot))
    }

    /// Writes the line of the audit for an action at a robot, and returns its outcome as the answer.
    pub(crate) fn audited<T: Serialize>(
        &self,
        who: &str,
        robot: &Robot,
        what: &str,
        outcome: Result<T, String>,
    ) -> Answer {
        self.app.audit.write(who, &robot.name, what, &outcome);
        outcome.map(|answer| json!(answer))
    }

    /// Carries out an order that changes something and that the user confirmed at the revocation count `revoked`. HALT, and the
    /// release of the control, revoke it until it begins.
    pub(crate) async fn change<T: Serialize + Send + 'static>(
        &self,
        who: String,
        robot: &Arc<Robot>,
        revoked: u64,
        what: String,
        work: impl FnOnce(&mut Link) -> Result<T, Error> + Send + 'static,
    ) -> Answer {
        let permit = robot.permit_since(revoked);
        self.recorded(who, robot, what, move |link| permit.check().and_then(|()| work(link))).await
    }

    /// Carries out an order, and writes it to the audit log, even if the page is closed in the meantime.
    pub(crate) async fn recorded<T: Serialize + Send + 'static>(
        &self,
        who: String,
        robot: &Arc<Robot>,
        what: String,
        work: impl FnOnce(&mut Link) -> Result<T, Error> + Send + 'static,
    ) -> Answer {
        let (app, robot) = (Arc::clone(&self.app), Arc::clone(robot));
        let task = self.app.work.spawn(async move {
            let outcome = robot.order(work).await;
            app.audit.write(&who, &robot.name, &what, &outcome);
            outcome.map(|answer| json!(answer))
        });
        task.await.unwrap_or_else(|_| Err("the order panicked; it is unknown whether it was done".into()))
    }

    async fn select(&self, robot: usize, names: Vec<String>) -> Answer {
        let robot = self.robot(robot)?;
        let selections = Selection::parse_each(&names).map_err(|error| error.to_string())?;
        let names = robot.order(move |link| names_within(&selections, VARIABLES, |kind| count(link, kind))).await?;
        let names = names.map_err(|count| format!("{count} variables; a page shows at most {VARIABLES}"))?;
        for name in &names {
            bcap_std::ObjectPath::variable(name).map_err(|error| error.to_string())?;
        }
        let count = names.len();
        robot.live().names.insert(self.client, names);
        Ok(json!(count))
    }

    /// Writes the value of a check, if the variable still has the value that the user saw.
    async fn write(&self, number: usize, check: u64, revoked: u64) -> Answer {
        let (who, robot) = self.writer(number)?;
        let write = self
            .take_checked(number, check)
            .ok_or("this value is not the one that was checked last; check it again")?;
        let what = format!("writes {}: {} -> {}", write.path, shown(&write.before), shown(&write.value));
        self.change(who, &robot, revoked, what, move |link| write.perform_unless_changed(link)).await
    }
}
