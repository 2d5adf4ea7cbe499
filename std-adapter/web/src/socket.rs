//! The WebSocket of a page: its orders, and the sections that it shows.

use std::collections::HashMap;
use std::pin::pin;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::extract::ws::WebSocket;
use bcap_capture::value::selection::Selection;
use bcap_live::jog::Grip;
use bcap_live::recovery::Recovery;
use bcap_live::request::Request;
use bcap_live::variables::{expand, shown};
use bcap_live::write::{Write, check, check_position};
use bcap_sim::pace::Paced;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tokio::time::{Instant, MissedTickBehavior, interval, interval_at};

use crate::app::App;
use crate::backup;
use crate::control::{Client, cleaned};
use crate::job::Work;
use crate::jog;
use crate::line::Line;
use crate::panel;
use crate::raw::{self, Desk};
use crate::recover;
use crate::robot::Robot;
use crate::secret::Bucket;
use crate::tasks;
use crate::text::safe;
use crate::threads::lock;
use crate::view;

/// How often a page gets what has changed.
const TICK: Duration = Duration::from_millis(200);

/// How often a page gets a message even if nothing has changed: without one it shows that its values are old.
const ALIVE: Duration = Duration::from_secs(1);

/// The most variables of a page.
const VARIABLES: usize = 1000;

/// The screens of a page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Screen {
    #[default]
    Cell,
    Variables,
    Alarms,
    Arm,
    Plots,
    Packets,
    Jog,
    Tasks,
    Raw,
    Panel,
    Backup,
    Session,
}

/// An order of a page.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
enum Order {
    /// Shows a screen of a robot.
    Show { robot: usize, screen: Screen },
    /// Selects the variables of a robot.
    Select { robot: usize, names: Vec<String> },
    /// Takes the control of a robot.
    Take { robot: usize, name: String },
    /// Releases the control of a robot.
    Release { robot: usize },
    /// Checks a value for a variable.
    Check { robot: usize, name: String, text: String },
    /// Checks the position of the resting robot for a variable of type P.
    Teach { robot: usize, name: String },
    /// Writes the value that was checked last.
    Write { robot: usize, name: String },
    /// Clears the errors.
    Clear { robot: usize },
    /// Begins a jog of the robot with this name, for which the user has agreed.
    Grip { robot: usize, name: String },
    /// A button is held: the robot moves by steps.
    Press { robot: usize, axis: String, by: f64, percent: f64 },
    /// The button is lifted.
    Lift { robot: usize },
    /// Ends the jog.
    Drop { robot: usize, why: String },
    /// Begins a recovery of the robot with this name, and plans its steps.
    Recover { robot: usize, name: String },
    /// Makes the next step of the recovery.
    Step { robot: usize, step: String },
    /// Ends the recovery.
    Stop { robot: usize },
    /// Reads the logs of the controller.
    Log { robot: usize },
    /// Starts or stops a task.
    Task { robot: usize, name: String, what: tasks::What },
    /// Reads the line of a task.
    Line { robot: usize, name: String },
    /// Lists a folder of the controller.
    Files { robot: usize, folder: String },
    /// Reads a file of the controller.
    View { robot: usize, path: String },
    /// Returns the function table.
    Functions {},
    /// Makes a call of a robot with this name.
    Call { robot: usize, name: String, function: String, arguments: Vec<String> },
    /// Makes the call of a packet in hexadecimal.
    Bytes { robot: usize, name: String, packet: String },
    /// Returns the packets of a call.
    Packet { robot: usize, serial: u16 },
    /// Returns the calls by function and object.
    Calls { robot: usize },
    /// Lists the backups of this server.
    Backups {},
    /// Begins a dump, a comparison, or the plan of a restore.
    Work { robot: usize, work: Work },
    /// Ends it.
    Unwork { robot: usize },
    /// Restores the backup that was planned, on the robot with this name.
    Restore { robot: usize, name: String, folder: String },
    /// Starts or ends the recordings.
    Record { starts: bool },
    /// Lists the recordings of this server.
    Recordings {},
    /// Plays a scenario on the virtual controller.
    Play { robot: usize, text: String },
    /// Changes the time factor of the virtual controller.
    Pace { robot: usize, factor: f64 },
}

/// A page.
pub(crate) struct Page {
    pub(crate) app: Arc<App>,
    client: Client,
    robot: usize,
    screen: Screen,
    /// The text of each section that was sent last.
    sent: HashMap<&'static str, String>,
    /// How many packets the page has.
    packets: u64,
    /// The value that was checked last, and the robot that it is for.
    checked: Option<(usize, Box<Write>)>,
    /// The jog of this page, and its robot.
    grip: Option<(usize, Arc<Grip>)>,
    /// The recovery of this page, and its robot.
    recovery: Option<(usize, Arc<Recovery>)>,
    /// The session for the calls of the user.
    pub(crate) desk: Option<Arc<Desk>>,
}

impl Drop for Page {
    /// The loss of a page frees what it holds.
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
    let mut page = Page {
        app,
        client,
        robot: 0,
        screen: Screen::Cell,
        sent: HashMap::new(),
        packets: 0,
        checked: None,
        grip: None,
        recovery: None,
        desk: None,
    };
    // the page is dropped first, so that its loss ends a jog at once
    let mut line = Line::new(socket);
    let _ = serve_page(&mut page, &mut line, hello.to_string()).await;
}

async fn serve_page(page: &mut Page, line: &mut Line, hello: String) -> Option<()> {
    line.send(hello).await?;
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut alive = interval(ALIVE);
    // 40 orders at once, and 20 each second
    let mut bucket = Bucket::new(40, Duration::from_millis(50));
    loop {
        line.grip = page.grip.as_ref().map(|(_, grip)| Arc::clone(grip));
        line.watch(page.screen == Screen::Raw && page.mover(page.robot).is_ok());
        tokio::select! {
            _ = ticks.tick() => {
                for text in page.changed() {
                    line.send(text).await?;
                }
            }
            _ = alive.tick() => line.alive().await?,
            text = line.order() => answer(page, line, &text?, bucket.take()).await?,
        }
    }
}

/// Carries out an order if the page has not given too many, and sends the answer.
async fn answer(page: &mut Page, line: &mut Line, text: &str, is_allowed: bool) -> Option<()> {
    if !is_allowed {
        // the number of the order is not read
        return line.send(json!({ "t": "answer", "error": "too many orders; wait a moment" }).to_string()).await;
    }
    let mut order = pin!(page.order(text));
    let mut alive = interval_at(Instant::now() + ALIVE, ALIVE);
    let answer = loop {
        tokio::select! {
            answer = &mut order => break answer,
            // a controller may need seconds
            _ = alive.tick() => line.alive().await?,
            ended = line.hold() => ended?,
        }
    };
    line.send(answer.to_string()).await
}

impl Page {
    /// Returns the messages with the sections that have changed.
    fn changed(&mut self) -> Vec<String> {
        let tiles =
            self.app.robots.iter().enumerate().map(|(number, robot)| view::tile(number, robot, self.client)).collect();
        let mut sections = vec![("tiles", Value::Array(tiles))];
        sections.extend(self.app.config.replay.as_ref().map(|replay| ("replay", replay.section())));
        if let Some(robot) = self.app.robots.get(self.robot) {
            match self.screen {
                Screen::Cell | Screen::Raw => {}
                Screen::Variables => sections.push(("variables", view::variables(self.client, robot))),
                Screen::Alarms => sections.push(("alarms", view::alarms(robot, recover::section(robot)))),
                Screen::Arm => sections.push(("arm", view::arm(robot))),
                Screen::Tasks => sections.push(("tasks", tasks::section(robot))),
                Screen::Jog => sections.push(("jog", view::jog(robot))),
                Screen::Backup => sections.push(("backup", backup::section(robot, self.client))),
                Screen::Session => sections.push(("session", view::session(&self.app))),
                Screen::Panel => {
                    sections.extend(self.app.config.panel.as_deref().map(|found| ("panel", panel::section(found))))
                }
                Screen::Plots => sections.push(("plots", view::variables(self.client, robot))),
                Screen::Packets => {
                    let (packets, total) = view::packets(robot, self.packets);
                    if total != self.packets {
                        self.packets = total;
                        sections.push(("packets", packets));
                    }
                }
            }
        }
        let mut messages = Vec::new();
        for (name, content) in sections {
            let text = json!({ "t": name, "robot": self.robot, "v": content }).to_string();
            if self.sent.get(name) != Some(&text) {
                messages.push(text.clone());
                self.sent.insert(name, text);
            }
        }
        messages
    }

    /// Carries out an order, and returns the answer.
    async fn order(&mut self, text: &str) -> Value {
        let parsed = serde_json::from_str::<Map<_, _>>(text).ok().and_then(|mut order| {
            let number = order.remove("id")?.as_u64()?;
            let Value::String(what) = order.remove("do")? else { return None };
            // an internally tagged enum needs 250 KB of code
            let order = Map::from_iter([(what, Value::Object(order))]);
            Some((number, Order::deserialize(Value::Object(order)).ok()?))
        });
        let Some((number, order)) = parsed else { return json!({ "t": "answer", "error": "this is not an order" }) };
        match self.carry_out(order).await {
            Ok(value) => json!({ "t": "answer", "id": number, "ok": value }),
            Err(why) => json!({ "t": "answer", "id": number, "error": safe(&why) }),
        }
    }

    async fn carry_out(&mut self, order: Order) -> Result<Value, String> {
        match order {
            Order::Show { robot, screen } => self.show(robot, screen),
            Order::Select { robot, names } => self.select(robot, names).await,
            Order::Take { robot, name } => self.take(robot, &name),
            Order::Release { robot } => self.release(robot),
            Order::Check { robot, name, text } => {
                self.writer(robot)?;
                let write = self.robot(robot)?.order(move |link| check(link, &name, &text)).await?;
                Ok(self.checked(robot, write))
            }
            Order::Teach { robot, name } => {
                self.writer(robot)?;
                let write = self.robot(robot)?.order(move |link| check_position(link, &name)).await?;
                Ok(self.checked(robot, write))
            }
            Order::Write { robot, name } => self.write(robot, &name).await,
            Order::Clear { robot } => {
                let (who, robot) = (self.writer(robot)?, self.robot(robot)?);
                let cleared = robot.order(bcap_live::errors::clear).await;
                self.app.audit.write(&who, &robot.name, "clears the errors", &cleared);
                cleared.map(|()| Value::Null)
            }
            Order::Grip { robot, name } => self.take_grip(robot, &name),
            Order::Press { robot, axis, by, percent } => {
                self.mover(robot)?;
                let press = jog::press(&*self.robot(robot)?, &axis, by, percent)?;
                self.grip(robot)?.press(press).map(|()| Value::Null)
            }
            Order::Lift { robot } => self.lift(robot),
            Order::Recover { robot, name } => self.begin_recovery(robot, &name),
            Order::Step { robot, step } => self.agree(robot, &step),
            Order::Stop { robot } => {
                self.recovery(robot)?.end("the user ended it");
                Ok(Value::Null)
            }
            Order::Log { robot } => self.robot(robot)?.order(recover::log).await,
            Order::Task { robot, name, what } => self.task(robot, name, what).await,
            Order::Line { robot, name } => {
                Ok(json!(self.robot(robot)?.order(move |link| link.task_line(&name)).await?))
            }
            Order::Files { robot, folder } => self.robot(robot)?.order(move |link| tasks::list(link, &folder)).await,
            Order::View { robot, path } => self.robot(robot)?.order(move |link| tasks::text(link, &path)).await,
            Order::Functions {} => Ok(raw::functions()),
            Order::Call { robot, name, function, arguments } => {
                self.call(robot, &name, Request::parse(&function, &arguments)?).await
            }
            Order::Bytes { robot, name, packet } => self.call(robot, &name, Request::decode(&packet)?).await,
            Order::Packet { robot, serial } => Ok(view::packet(&*self.robot(robot)?, serial)),
            Order::Calls { robot } => Ok(view::calls(&*self.robot(robot)?)),
            Order::Backups {} => backup::list(&self.app),
            Order::Work { robot, work } => self.work(robot, work),
            Order::Unwork { robot } => self.end_work(robot),
            Order::Restore { robot, name, folder } => self.restore(robot, &name, folder),
            Order::Record { starts } => self.record(starts).await,
            Order::Recordings {} => self.recordings().await,
            Order::Play { robot, text } => {
                let what = format!("plays the scenario: {}", text.trim());
                self.on_panel(robot, &what, |found| panel::play(found, &text))
            }
            Order::Pace { robot, factor } => {
                self.on_panel(robot, &format!("sets the time factor to {factor}"), |found| panel::pace(found, factor))
            }
            Order::Drop { robot, why } => {
                self.grip(robot)?.end(&safe(&why));
                Ok(Value::Null)
            }
        }
    }

    fn show(&mut self, number: usize, screen: Screen) -> Result<Value, String> {
        let robot = self.robot(number)?;
        self.end_motion("the screen was left");
        for robot in &self.app.robots {
            robot.live().arms.remove(&self.client);
        }
        if screen == Screen::Arm {
            robot.live().arms.insert(self.client);
        }
        (self.robot, self.screen, self.packets) = (number, screen, 0);
        self.sent.clear();
        Ok(Value::Null)
    }

    /// Keeps a value that was checked, and shows it with the old one.
    fn checked(&mut self, robot: usize, write: Write) -> Value {
        let [name, old, new] =
            [write.path.to_string(), shown(&write.before), shown(&write.value)].map(|text| safe(&text));
        self.checked = Some((robot, Box::new(write)));
        json!({ "name": name, "old": old, "new": new })
    }

    /// Takes the control of a robot.
    fn take(&self, robot: usize, name: &str) -> Result<Value, String> {
        if !self.app.config.allow_motion {
            self.writes()?;
        }
        let taken = self.robot(robot)?.control.take(self.client, name);
        self.app.audit.write(&cleaned(name), &self.robot(robot)?.name, "takes the control", &taken);
        taken.map(|()| Value::Null)
    }

    /// Releases the control of a robot, and ends what this page moves.
    fn release(&mut self, robot: usize) -> Result<Value, String> {
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
            self.app.audit.write::<()>(&name, &robot.name, what, &Ok(()));
        }
    }

    /// Starts or stops a task. A start may move the robot.
    async fn task(&self, robot: usize, name: String, what: tasks::What) -> Result<Value, String> {
        let who = if what.is_start() { self.mover(robot)? } else { self.holder(robot)? };
        let robot = self.robot(robot)?;
        let doing = format!("{what} {}", safe(&name));
        let done = robot.order(move |link| what.perform(link, &name)).await;
        self.app.audit.write(&who, &robot.name, &doing, &done);
        done.map(|()| Value::Null)
    }

    /// Changes the virtual controller. Its user needs the control, as for a real one.
    fn on_panel(
        &self,
        robot: usize,
        what: &str,
        change: impl FnOnce(&Mutex<Paced>) -> Result<(), String>,
    ) -> Result<Value, String> {
        let panel =
            self.app.config.panel.as_deref().ok_or("this server has no virtual controller; start `bcap sim --web`")?;
        let who = self.holder(robot)?;
        let changed = change(panel);
        self.app.audit.write(&who, &self.robot(robot)?.name, what, &changed);
        changed.map(|()| Value::Null)
    }

    /// Ends a press of a button.
    fn lift(&self, robot: usize) -> Result<Value, String> {
        let steps = self.grip(robot)?.lift();
        let (who, what) = (self.mover(robot)?, format!("jogged by {steps} steps"));
        self.app.audit.write::<()>(&who, &self.robot(robot)?.name, &what, &Ok(()));
        Ok(json!(steps))
    }

    /// Makes the next step of the recovery.
    fn agree(&self, robot: usize, step: &str) -> Result<Value, String> {
        let who = self.mover(robot)?;
        let agreed = self.recovery(robot)?.agree(step);
        self.app.audit.write(&who, &self.robot(robot)?.name, &format!("agrees to {}", safe(step)), &agreed);
        agreed.map(|()| Value::Null)
    }

    /// Begins a recovery.
    fn begin_recovery(&mut self, number: usize, name: &str) -> Result<Value, String> {
        let (who, robot) = (self.mover(number)?, self.named(number, name)?);
        self.end_motion("a recovery begins");
        self.recovery = Some((number, recover::start(&self.app, &robot, who)?));
        Ok(Value::Null)
    }

    /// Returns the recovery of this page.
    fn recovery(&self, number: usize) -> Result<&Recovery, String> {
        let recovery = self.recovery.as_ref().filter(|(robot, _)| *robot == number).map(|(_, found)| &**found);
        recovery.ok_or_else(|| "there is no recovery of this page; begin one".into())
    }

    /// Returns the number of this page.
    pub(crate) const fn client(&self) -> Client {
        self.client
    }

    /// Ends what this page moves.
    fn end_motion(&mut self, why: &str) {
        self.end_jog(why);
        if let Some((_, recovery)) = self.recovery.take() {
            recovery.end(why);
        }
        if let Some(desk) = self.desk.take() {
            desk.end(&self.app);
        }
    }

    /// Begins a jog.
    fn take_grip(&mut self, number: usize, name: &str) -> Result<Value, String> {
        let (who, robot) = (self.mover(number)?, self.named(number, name)?);
        self.end_motion("a jog begins");
        self.grip = Some((number, jog::start(&self.app, &robot, who)?));
        Ok(Value::Null)
    }

    /// Returns the jog of this page.
    fn grip(&self, number: usize) -> Result<&Grip, String> {
        let grip = self.grip.as_ref().filter(|(robot, _)| *robot == number).map(|(_, grip)| &**grip);
        grip.ok_or_else(|| "the jog has ended; begin it again".into())
    }

    fn end_jog(&mut self, why: &str) {
        if let Some((_, grip)) = self.grip.take() {
            grip.end(why);
        }
    }

    pub(crate) fn robot(&self, number: usize) -> Result<Arc<Robot>, String> {
        self.app.robots.get(number).cloned().ok_or_else(|| "there is no such robot".into())
    }

    /// Returns a robot whose name was in the question to the user.
    pub(crate) fn named(&self, number: usize, name: &str) -> Result<Arc<Robot>, String> {
        let robot = self.robot(number)?;
        robot.check_name(name)?;
        Ok(robot)
    }

    /// Refuses orders that change something unless the server was started for them.
    fn writes(&self) -> Result<(), String> {
        if self.app.config.allow_write {
            return Ok(());
        }
        Err("this server is read-only; start it with --allow-write".into())
    }

    /// Returns the name of this page's user, who has the control of a robot, and may write.
    pub(crate) fn writer(&self, robot: usize) -> Result<String, String> {
        self.writes()?;
        self.holder(robot)
    }

    /// Returns the name of this page's user, who has the control of a robot, and may move it.
    pub(crate) fn mover(&self, robot: usize) -> Result<String, String> {
        if !self.app.config.allow_motion {
            return Err("this server moves nothing; start it with --allow-motion".into());
        }
        self.holder(robot)
    }

    /// Returns the name of this page's user, who has the control of a robot.
    fn holder(&self, robot: usize) -> Result<String, String> {
        self.robot(robot)?.control.user(self.client)
    }

    async fn select(&mut self, robot: usize, names: Vec<String>) -> Result<Value, String> {
        let robot = self.robot(robot)?;
        let selections = Selection::parse_each(&names).map_err(|error| error.to_string())?;
        let names = robot.order(move |link| expand(link, &selections)).await?;
        if names.len() > VARIABLES {
            return Err(format!("{} variables; a page shows at most {VARIABLES}", names.len()));
        }
        for name in &names {
            bcap_std::ObjectPath::variable(name).map_err(|error| error.to_string())?;
        }
        let count = names.len();
        robot.live().names.insert(self.client, names);
        Ok(json!(count))
    }

    /// Writes the value that was checked, if the variable still has the value that the user has seen.
    async fn write(&mut self, number: usize, name: &str) -> Result<Value, String> {
        let (who, robot) = (self.writer(number)?, self.robot(number)?);
        let is_for = |(robot, write): &(usize, Box<Write>)| *robot == number && write.path.to_string() == name;
        let (_, write) = self.checked.take_if(|checked| is_for(checked)).ok_or("check the value first")?;
        let what = format!("writes {name}: {} -> {}", shown(&write.before), shown(&write.value));
        let written = robot.order(move |link| write.perform_unless_changed(link)).await;
        self.app.audit.write(&who, &robot.name, &what, &written);
        written.map(|()| Value::Null)
    }
}
