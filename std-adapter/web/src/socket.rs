//! The WebSocket of a page: its orders, and the sections that it shows.

use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use bcap_capture::value::selection::Selection;
use bcap_live::variables::{expand, shown};
use bcap_live::write::{Write, check};
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::time::{Instant, MissedTickBehavior, interval, interval_at, timeout};

use crate::app::App;
use crate::control::Client;
use crate::guard::Bucket;
use crate::robot::Robot;
use crate::view;

/// How often a page gets what has changed.
const TICK: Duration = Duration::from_millis(200);

/// How often a page gets a message even if nothing has changed: without one it shows that its values are old.
const ALIVE: Duration = Duration::from_secs(1);

/// The longest time for a message to a page. A page that does not take it is closed.
const SEND: Duration = Duration::from_secs(10);

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
}

/// An order of a page.
#[derive(Debug, Deserialize)]
#[serde(tag = "do", rename_all = "lowercase", deny_unknown_fields)]
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
    /// Writes the value that was checked last.
    Write { robot: usize, name: String },
    /// Clears the errors.
    Clear { robot: usize },
}

/// A page.
pub(crate) struct Page {
    app: Arc<App>,
    client: Client,
    robot: usize,
    screen: Screen,
    /// The text of each section that was sent last.
    sent: HashMap<&'static str, String>,
    /// How many packets the page has.
    packets: u64,
    /// The value that was checked last, and the robot that it is for.
    checked: Option<(usize, Box<Write>)>,
}

impl Drop for Page {
    /// The loss of a page frees what it holds.
    fn drop(&mut self) {
        for robot in &self.app.robots {
            robot.live().names.remove(&self.client);
            if let Some(name) = robot.control.name_of(self.client) {
                robot.control.release(self.client);
                self.app.audit.write::<()>(&name, &robot.name, "the page is closed, the control is free", &Ok(()));
            }
        }
    }
}

/// Serves a page until it is closed.
pub(crate) async fn serve(app: Arc<App>, client: Client, mut socket: WebSocket) {
    let mut page =
        Page { app, client, robot: 0, screen: Screen::Cell, sent: HashMap::new(), packets: 0, checked: None };
    let hello = json!({ "t": "hello", "write": page.app.allow_write, "version": env!("CARGO_PKG_VERSION") });
    if send(&mut socket, hello.to_string()).await.is_none() {
        return;
    }
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut alive = interval(ALIVE);
    let mut bucket = Bucket::new();
    loop {
        tokio::select! {
            _ = ticks.tick() => {
                for text in page.changed() {
                    if send(&mut socket, text).await.is_none() {
                        return;
                    }
                }
            }
            _ = alive.tick() => if send(&mut socket, tick()).await.is_none() {
                return;
            },
            message = socket.recv() => {
                let text = match message {
                    Some(Ok(Message::Text(text))) => text,
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => continue,
                    _ => return,
                };
                if answer(&mut page, &mut socket, &text, bucket.take()).await.is_none() {
                    return;
                }
            }
        }
    }
}

/// Carries out an order if the page has not given too many, and sends the answer.
async fn answer(page: &mut Page, socket: &mut WebSocket, text: &str, is_allowed: bool) -> Option<()> {
    if !is_allowed {
        // the number of the order is not read
        return send(socket, json!({ "t": "answer", "error": "too many orders; wait a moment" }).to_string()).await;
    }
    let mut order = pin!(page.order(text));
    let mut alive = interval_at(Instant::now() + ALIVE, ALIVE);
    let answer = loop {
        tokio::select! {
            answer = &mut order => break answer,
            // a controller may need seconds
            _ = alive.tick() => send(socket, tick()).await?,
        }
    };
    send(socket, answer.to_string()).await
}

fn tick() -> String {
    json!({ "t": "tick" }).to_string()
}

async fn send(socket: &mut WebSocket, text: String) -> Option<()> {
    timeout(SEND, socket.send(Message::Text(text.into()))).await.ok()?.ok()
}

impl Page {
    /// Returns the messages with the sections that have changed.
    fn changed(&mut self) -> Vec<String> {
        let tiles =
            self.app.robots.iter().enumerate().map(|(number, robot)| view::tile(number, robot, self.client)).collect();
        let mut sections = vec![("tiles", Value::Array(tiles))];
        if let Some(robot) = self.app.robots.get(self.robot) {
            match self.screen {
                Screen::Cell => {}
                Screen::Variables => sections.push(("variables", view::variables(self.client, robot))),
                Screen::Alarms => sections.push(("alarms", view::alarms(robot))),
                Screen::Arm => sections.push(("arm", view::arm(robot))),
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
        let parsed = serde_json::from_str::<Value>(text).ok().and_then(|mut order| {
            let number = order.as_object_mut()?.remove("id")?.as_u64()?;
            Some((number, serde_json::from_value::<Order>(order).ok()?))
        });
        let Some((number, order)) = parsed else { return json!({ "t": "answer", "error": "this is not an order" }) };
        match self.carry_out(order).await {
            Ok(value) => json!({ "t": "answer", "id": number, "ok": value }),
            Err(why) => json!({ "t": "answer", "id": number, "error": view::safe(&why) }),
        }
    }

    async fn carry_out(&mut self, order: Order) -> Result<Value, String> {
        match order {
            Order::Show { robot, screen } => {
                self.robot(robot)?;
                (self.robot, self.screen, self.packets) = (robot, screen, 0);
                self.sent.clear();
                Ok(Value::Null)
            }
            Order::Select { robot, names } => self.select(robot, names).await,
            Order::Take { robot, name } => {
                self.writes()?;
                let taken = self.robot(robot)?.control.take(self.client, &name);
                self.app.audit.write(&view::safe(&name), &self.robot(robot)?.name, "takes the control", &taken);
                taken.map(|()| Value::Null)
            }
            Order::Release { robot } => {
                let robot = self.robot(robot)?;
                if let Some(name) = robot.control.name_of(self.client) {
                    robot.control.release(self.client);
                    self.app.audit.write::<()>(&name, &robot.name, "releases the control", &Ok(()));
                }
                Ok(Value::Null)
            }
            Order::Check { robot, name, text } => {
                self.holder(robot)?;
                let write = self.robot(robot)?.order(move |link| check(link, &name, &text)).await?;
                let answer = json!({
                    "name": view::safe(&write.path.to_string()),
                    "old": view::safe(&shown(&write.before)),
                    "new": view::safe(&shown(&write.value)),
                });
                self.checked = Some((robot, Box::new(write)));
                Ok(answer)
            }
            Order::Write { robot, name } => self.write(robot, &name).await,
            Order::Clear { robot } => {
                let (who, robot) = (self.holder(robot)?, self.robot(robot)?);
                let cleared = robot.order(bcap_live::errors::clear).await;
                self.app.audit.write(&who, &robot.name, "clears the errors", &cleared);
                cleared.map(|()| Value::Null)
            }
        }
    }

    fn robot(&self, number: usize) -> Result<Arc<Robot>, String> {
        self.app.robots.get(number).cloned().ok_or_else(|| "there is no such robot".into())
    }

    /// Refuses orders that change something unless the server was started for them.
    fn writes(&self) -> Result<(), String> {
        if self.app.allow_write {
            return Ok(());
        }
        Err("this server is read-only; start it with --allow-write".into())
    }

    /// Returns the name of this page's user, who has the control of a robot.
    fn holder(&self, robot: usize) -> Result<String, String> {
        self.writes()?;
        let control = &self.robot(robot)?.control;
        control.name_of(self.client).ok_or_else(|| match control.holder() {
            Some(name) => format!("{name} has the control; ask for its release"),
            None => "take the control first".into(),
        })
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
        let (who, robot) = (self.holder(number)?, self.robot(number)?);
        let is_for = |(robot, write): &(usize, Box<Write>)| *robot == number && write.path.to_string() == name;
        let (_, write) = self.checked.take_if(|checked| is_for(checked)).ok_or("check the value first")?;
        let what = format!("writes {name}: {} -> {}", shown(&write.before), shown(&write.value));
        let written = robot.order(move |link| write.perform_unless_changed(link)).await;
        self.app.audit.write(&who, &robot.name, &what, &written);
        written.map(|()| Value::Null)
    }
}
