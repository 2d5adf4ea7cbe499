//! Moves readings to the broker and commands from it. One task owns the connection, the buffer on disk and the encoder.
//!
//! While there is a connection, new readings go first, and buffered readings when there are no new ones. At most
//! [`WINDOW`] messages wait for the broker. After a loss, readings that it has not acknowledged go to the buffer.

mod confirm;
mod host;
mod role;

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bcap_std::asynch::Controller;
use rumqttc::{ConnectReturnCode, Event as Mqtt, Outgoing, Packet, Publish, QoS};
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{Instant, sleep_until, timeout};

use self::confirm::Unconfirmed;
use crate::broker::{Broker, Link, LinkEvent, WINDOW};
use crate::command::{Answer, Command, Commands, canonical, execute};
use crate::config::{Config, Format};
use crate::event::{CommandResult, Event};
use crate::json;
use crate::message::Message;
use crate::queue::{Item, State};
use crate::reading::{Reading, now_ms};
use crate::scan::Shared;
use crate::sparkplug::{self, HostWrite, Sparkplug};
use crate::standby::Standby;
use crate::store::Store;

/// The delays between two attempts to connect.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));

/// The longest time for the last messages.
const CLOSE: Duration = Duration::from_secs(2);

/// The most readings in memory without a buffer on disk.
const MEMORY: usize = 20_000;

/// New readings beyond this go to the buffer although there is a connection.
const BACKLOG: usize = 10_000;

/// The most messages that wait for the window before answers are left out: commands must not fill the memory.
const WAITING: usize = 1000;

/// The most commands that run at the same time, and those of one controller: a slow one must not occupy all.
const RUNNING: (usize, usize) = (64, 16);

/// How long a connection must last before the backoff begins anew: a broker may accept and close at once.
const STABLE: Duration = Duration::from_secs(2);

/// The most bytes of a text of a command in an answer or event.
const LONGEST_TEXT: usize = 256;

/// Moves readings to the broker and commands from it.
pub(crate) struct Publisher {
    shared: Arc<Shared>,
    controllers: Vec<Controller>,
    broker: Broker,
    /// `None` if this is the only process of the node.
    standby: Option<Standby>,
    /// When the primary host came online, as it says, in milliseconds since 1970; 0 if it is offline or unknown.
    host_since: u64,
    /// Whether another process was seen as the active one since this process was.
    stands_by: bool,
    /// `None` for JSON.
    sparkplug: Option<Sparkplug>,
    /// `None` without a buffer on disk, or after it has failed.
    store: Option<Store>,
    commands: Commands,
    running: JoinSet<Finished>,
    cells: Vec<Cell>,
    /// Readings to send as historical.
    history: VecDeque<Reading>,
    /// Readings that the broker must acknowledge before the store's loaded file can be deleted.
    loaded: usize,
    link: Option<Connection>,
    retry: Instant,
    backoff: Duration,
    /// Whether all values must be sent again: newer ones than the retained ones went to the buffer, or a host has asked.
    stale: bool,
}

/// The known state of a controller.
struct Cell {
    state: Option<State>,
    latest: Vec<Option<Reading>>,
    /// The number of commands that run.
    running: usize,
}

impl Cell {
    fn is_connected(&self) -> bool {
        self.state.as_ref().is_some_and(|state| state.down.is_none())
    }
}

/// A command that has ended.
struct Finished {
    cell: usize,
    topic: String,
    command: Command,
    result: CommandResult,
    reason: Option<String>,
}

/// A message passed to the link, until the broker confirms it.
struct Sent {
    at: Instant,
    readings: Vec<Reading>,
}

/// A connection and its messages.
struct Connection {
    link: Link,
    /// Whether the broker has accepted it.
    is_up: bool,
    began: Instant,
    /// Messages to give to the link.
    out: VecDeque<Message>,
    /// Messages that the link has not sent.
    sent: VecDeque<Sent>,
    /// Messages that the broker has not acknowledged, by packet.
    waiting: HashMap<u16, Sent>,
    /// Messages without acknowledgements.
    unconfirmed: Unconfirmed,
}

impl Connection {
    fn room(&self) -> usize {
        usize::from(WINDOW).min(self.unconfirmed.room()).saturating_sub(self.in_flight() + self.out.len())
    }

    fn in_flight(&self) -> usize {
        self.sent.len() + self.waiting.len()
    }

    /// Returns whether the broker has all messages.
    fn is_idle(&self) -> bool {
        self.out.is_empty() && self.in_flight() == 0 && self.unconfirmed.is_empty()
    }

    /// Gives messages to the link.
    fn flush(&mut self) {
        while self.in_flight() < usize::from(WINDOW) {
            let Some(message) = self.out.pop_front() else { break };
            self.send(message);
        }
        self.unconfirmed.ask(|| self.link.client.try_unsubscribe(confirm::TOPIC).is_ok());
    }

    fn send(&mut self, message: Message) {
        let Message { topic, payload, qos, retain, readings } = message;
        // the channel of the link has room for more than the window; after a loss the event follows
        let _ = self.link.client.try_publish(topic, qos, retain, payload);
        self.sent.push_back(Sent { at: Instant::now(), readings });
    }

    /// Returns the readings that may not have arrived, the oldest first.
    fn into_readings(mut self) -> Vec<Reading> {
        let sent = std::mem::take(&mut self.sent);
        let waiting = std::mem::take(&mut self.waiting);
        let unconfirmed = std::mem::take(&mut self.unconfirmed).into_readings();
        let out = std::mem::take(&mut self.out).into_iter().map(|message| message.readings);
        let sent = waiting.into_values().chain(sent).map(|sent| sent.readings);
        let mut readings: Vec<_> = sent.chain(out).flatten().chain(unconfirmed).collect();
        readings.sort_by_key(|reading| reading.id);
        readings
    }
}

impl Publisher {
    pub(crate) fn new(shared: Arc<Shared>, controllers: Vec<Controller>, broker: Broker, store: Option<Store>) -> Self {
        let config = &shared.config;
        let cells = config.controllers.iter().map(|cell| Cell {
            state: None,
            latest: vec![None; cell.points.len()],
            running: 0,
        });
        Self {
            cells: cells.collect(),
            commands: Commands::new(config.commands.clone(), now_ms()),
            standby: config.standby.as_ref().map(|standby| Standby::new(standby.after())),
            host_since: 0,
            stands_by: false,
            sparkplug: (config.format == Format::Sparkplug).then(|| Sparkplug::new(config)),
            controllers,
            broker,
            store,
            running: JoinSet::new(),
            history: VecDeque::new(),
            loaded: 0,
            link: None,
            retry: Instant::now(),
            backoff: BACKOFF.0,
            stale: false,
            shared,
        }
    }

    /// Runs until `end` is ready.
    pub(crate) async fn run(mut self, end: impl Future<Output = ()>) {
        tokio::pin!(end);
        let shared = Arc::clone(&self.shared);
        loop {
            if self.link.is_none() && self.retry <= Instant::now() {
                self.connect();
            }
            self.step().await;
            let wake = self.standby.as_ref().and_then(Standby::wake);
            tokio::select! {
                event = next(&mut self.link) => self.handle(event).await,
                () = shared.queue.added() => {}
                () = sleep_until(self.retry), if self.link.is_none() => {}
                () = at(wake) => self.tick().await,
                Some(Ok(finished)) = self.running.join_next() => self.end(finished),
                () = &mut end => break,
            }
        }
        self.close().await;
    }

    fn config(&self) -> &Config {
        &self.shared.config
    }

    fn is_up(&self) -> bool {
        self.link.as_ref().is_some_and(|connection| connection.is_up)
    }

    /// Moves all messages that can be moved without waiting for the broker.
    async fn step(&mut self) {
        if !self.is_active() {
            self.drain().await;
        }
        if !self.sends_history() {
            return;
        }
        if self.shared.queue.len() > BACKLOG {
            self.stale = true;
            self.drain().await;
        }
        loop {
            self.pump();
            if !self.history.is_empty() || self.loaded > 0 || !self.load().await {
                return;
            }
        }
    }

    /// Moves all new readings to the buffer.
    async fn drain(&mut self) {
        let mut readings = Vec::new();
        while let Some(item) = self.shared.queue.pop() {
            match item {
                Item::State(state) => {
                    readings.extend(self.set_state(&state));
                    if self.is_active() {
                        self.send_state(&state);
                    }
                }
                Item::Reading(mut reading) => {
                    // also the latest one: it is in the buffer
                    reading.historical = true;
                    self.cells[reading.cell].latest[reading.point] = Some(reading.clone());
                    readings.push(reading);
                }
            }
        }
        if !readings.is_empty() {
            self.keep(readings).await;
        }
    }

    /// Puts messages into the window.
    fn pump(&mut self) {
        let shared = Arc::clone(&self.shared);
        let is_active = self.is_active();
        while self.link.as_ref().is_some_and(|connection| connection.room() > 0) {
            if let Some(item) = is_active.then(|| shared.queue.pop()).flatten() {
                match item {
                    Item::State(state) => {
                        let unborn = self.set_state(&state);
                        self.send_later(unborn);
                        self.send_state(&state);
                    }
                    Item::Reading(reading) => self.send(reading),
                }
            } else if is_active && std::mem::take(&mut self.stale) {
                self.repeat();
            } else if let Some(reading) = self.history.pop_front() {
                self.send_history(reading);
            } else {
                break;
            }
        }
        if let Some(connection) = &mut self.link {
            connection.flush();
        }
    }

    fn push(&mut self, message: Message) {
        if let Some(connection) = &mut self.link {
            connection.out.push_back(message);
        }
    }

    /// Sets the state of a controller; returns the readings that waited for its birth.
    fn set_state(&mut self, state: &State) -> Vec<Reading> {
        // a birth waits for the first readings of the session
        let unborn = self.take_unborn(state.cell);
        let cell = &mut self.cells[state.cell];
        if self.sparkplug.is_some() {
            cell.latest.fill(None);
        }
        cell.state = Some(state.clone());
        unborn
    }

    /// Sends readings as historical when there is nothing new.
    fn send_later(&mut self, readings: Vec<Reading>) {
        // the store's loaded file stays until these have arrived as well
        self.loaded += readings.len();
        self.history.extend(readings);
    }

    /// Takes the readings of a session that ends before the birth of its device, as historical ones. Historical
    /// readings are in the buffer.
    fn take_unborn(&mut self, cell: usize) -> Vec<Reading> {
        if self.sparkplug.as_ref().is_none_or(|sparkplug| sparkplug.is_born(cell)) {
            return Vec::new();
        }
        let latest = self.cells[cell].latest.iter_mut().filter_map(Option::take);
        latest.filter(|reading| !reading.historical).map(|reading| Reading { historical: true, ..reading }).collect()
    }

    fn send_state(&mut self, state: &State) {
        let shared = Arc::clone(&self.shared);
        let Some(sparkplug) = &mut self.sparkplug else {
            self.push(json::state(&shared.config, state));
            if state.down.is_some() {
                self.send_unknown(state);
            }
            return;
        };
        if let Some(message) = sparkplug.device_death(&shared.config, state.cell) {
            self.push(message);
        }
    }

    /// Sends that the points of a disconnected controller which this process has not read are unknown. The broker may have
    /// good values of an earlier process.
    fn send_unknown(&mut self, state: &State) {
        let shared = Arc::clone(&self.shared);
        for point in 0..self.cells[state.cell].latest.len() {
            if self.cells[state.cell].latest[point].is_none() {
                let id = shared.next_id.fetch_add(1, Ordering::Relaxed);
                self.push(json::unknown(&shared.config, state, point, id));
            }
        }
    }

    /// Sends a new reading.
    fn send(&mut self, reading: Reading) {
        let shared = Arc::clone(&self.shared);
        let config = &shared.config;
        let cell = reading.cell;
        let before = self.cells[cell].latest[reading.point].replace(reading.clone());
        let Some(sparkplug) = &mut self.sparkplug else {
            return self.push(json::reading(config, reading));
        };
        if !self.cells[cell].is_connected() {
            // the death of the device has said that all values are unknown
            self.cells[cell].latest[reading.point] = None;
        } else if !sparkplug.is_born(cell) {
            // the birth carries the latest reading only
            if let Some(before) = before.filter(|before| !before.historical) {
                self.send_later(vec![Reading { historical: true, ..before }]);
            }
            self.birth(cell);
        } else if sparkplug.has_type(config, &reading) {
            let last = self.link.as_mut().and_then(|connection| connection.out.back_mut());
            if !last.is_some_and(|message| sparkplug.join(config, message, &reading)) {
                let message = sparkplug.data(config, reading);
                self.push(message);
            }
        } else {
            let birth = sparkplug.device_birth(config, cell, &self.cells[cell].latest);
            self.push(birth);
        }
    }

    fn send_history(&mut self, reading: Reading) {
        let shared = Arc::clone(&self.shared);
        let config = &shared.config;
        let Some(sparkplug) = &mut self.sparkplug else {
            return self.push(json::reading(config, reading));
        };
        let cell = reading.cell;
        let mut messages = Vec::new();
        if !sparkplug.is_born(cell) {
            // aliases are unknown before a birth; its unread values are null
            messages.push(sparkplug.device_birth(config, cell, &self.cells[cell].latest));
        }
        let last = self.link.as_mut().and_then(|connection| connection.out.back_mut());
        if !last.is_some_and(|message| messages.is_empty() && sparkplug.join(config, message, &reading)) {
            messages.push(sparkplug.data(config, reading));
        }
        let has_more = self.history.front().is_some_and(|next| next.cell == cell);
        if !self.cells[cell].is_connected() && !has_more {
            // the birth was for its history only
            messages.extend(sparkplug.device_death(config, cell));
        }
        messages.into_iter().for_each(|message| self.push(message));
    }

    /// Sends the birth of a device when each of its points was read.
    fn birth(&mut self, cell: usize) {
        let shared = Arc::clone(&self.shared);
        let latest = &self.cells[cell].latest;
        let is_up = self.cells[cell].is_connected();
        if let Some(sparkplug) = &mut self.sparkplug
            && is_up
            && latest.iter().all(Option::is_some)
        {
            let birth = sparkplug.device_birth(&shared.config, cell, latest);
            self.push(birth);
        }
    }

    /// Sends the state that a host needs after a new connection, or when it asks.
    fn introduce(&mut self) {
        let shared = Arc::clone(&self.shared);
        let config = &shared.config;
        if let Some(sparkplug) = &mut self.sparkplug {
            let birth = sparkplug.birth(config);
            self.push(birth);
            (0..self.cells.len()).for_each(|cell| self.birth(cell));
            return;
        }
        self.push(self.node_state(true));
        let states: Vec<_> = self.cells.iter().filter_map(|cell| cell.state.clone()).collect();
        states.iter().for_each(|state| self.send_state(state));
        self.repeat();
    }

    /// Sends the latest readings again, so that the retained ones are the newest. Sparkplug has births for this.
    fn repeat(&mut self) {
        if self.sparkplug.is_some() {
            return self.introduce();
        }
        let readings = self.cells.iter().flat_map(|cell| cell.latest.iter().flatten());
        let messages: Vec<_> = readings.map(|reading| json::repeated(self.config(), reading)).collect();
        messages.into_iter().for_each(|message| self.push(message));
    }

    fn connect(&mut self) {
        let shared = Arc::clone(&self.shared);
        let link = match (&self.standby, &mut self.sparkplug) {
            (Some(standby), _) if !standby.is_active() => self.broker.watch(standby.instance()),
            (_, Some(sparkplug)) => self.broker.connect(Some(sparkplug.will(&shared.config))),
            (_, None) => self.broker.connect(Some(self.node_state(false))),
        };
        let (out, sent, waiting, unconfirmed) = Default::default();
        self.link = Some(Connection { link, is_up: false, began: Instant::now(), out, sent, waiting, unconfirmed });
    }

    async fn handle(&mut self, event: Option<LinkEvent>) {
        match event {
            Some(Ok(Mqtt::Incoming(Packet::ConnAck(ack)))) if ack.code == ConnectReturnCode::Success => {
                self.accepted().await;
            }
            Some(Ok(Mqtt::Incoming(Packet::Publish(publish)))) => {
                if !self.saw_host(&publish).await {
                    self.receive(&publish);
                }
            }
            Some(Ok(Mqtt::Outgoing(Outgoing::Disconnect))) => self.lose("the primary host is offline".into()).await,
            Some(Ok(Mqtt::Incoming(Packet::PubAck(ack)))) => {
                let sent = self.link.as_mut().and_then(|connection| connection.waiting.remove(&ack.pkid));
                if let Some(Sent { at, readings }) = sent {
                    self.prove(at);
                    self.arrived(readings).await;
                }
            }
            Some(Ok(Mqtt::Incoming(Packet::SubAck(ack)))) => self.subscribed(&ack.return_codes).await,
            Some(Ok(Mqtt::Outgoing(Outgoing::Publish(packet)))) => {
                let Some(connection) = &mut self.link else { return };
                let Some(sent) = connection.sent.pop_front() else { return };
                if packet == 0 {
                    connection.unconfirmed.push(sent.readings);
                } else {
                    connection.waiting.insert(packet, sent);
                }
            }
            Some(Ok(Mqtt::Outgoing(Outgoing::Unsubscribe(_)))) => {
                if let Some(connection) = &mut self.link {
                    connection.unconfirmed.asked();
                }
            }
            Some(Ok(Mqtt::Incoming(Packet::UnsubAck(_)))) => {
                let confirmed = self.link.as_mut().map(|connection| connection.unconfirmed.confirmed());
                self.arrived(confirmed.unwrap_or_default()).await;
            }
            Some(Ok(_)) => {}
            Some(Err(reason)) => self.lose(reason).await,
            None => self.lose("the connection has ended".into()).await,
        }
    }

    async fn accepted(&mut self) {
        let metrics = &self.shared.metrics;
        metrics.broker_connections.fetch_add(1, Ordering::Relaxed);
        // a takeover replaces one connection by another
        if !metrics.broker_up.swap(true, Ordering::Relaxed) {
            (self.shared.report)(&Event::BrokerUp {});
        }
        if self.is_watcher() {
            return self.watch();
        }
        self.drain().await;
        self.activate();
        if !self.waits_for_host() {
            self.begin().await;
        }
    }

    /// Begins to publish and to receive commands.
    async fn begin(&mut self) {
        // readings from before are historical
        self.drain().await;
        self.stale = false;
        let topics = self.topics();
        if let Some(connection) = &mut self.link {
            (connection.is_up, connection.began) = (true, Instant::now());
            for topic in topics {
                let _ = connection.link.client.try_subscribe(topic, QoS::AtLeastOnce);
            }
        }
        self.introduce();
    }

    /// Returns the topics of commands.
    fn topics(&self) -> Vec<String> {
        let config = self.config();
        let mut topics = Vec::new();
        if self.sparkplug.is_some() {
            topics.push(sparkplug::topic(config, "NCMD", None));
            if self.commands.are_on() {
                topics.push(sparkplug::topic(config, "DCMD", None) + "/+");
            }
        } else if self.commands.are_on() {
            topics.push(format!("bcap/{}/+/command", config.group));
        }
        topics
    }

    /// Counts readings that the broker has.
    async fn arrived(&mut self, readings: Vec<Reading>) {
        self.shared.metrics.published.fetch_add(readings.len() as u64, Ordering::Relaxed);
        let loaded = readings.iter().filter(|reading| reading.historical).count().min(self.loaded);
        if loaded > 0 {
            self.loaded -= loaded;
            if self.loaded == 0 {
                self.with_store(|store| {
                    store.acknowledge();
                    Ok(())
                })
                .await;
            }
        }
    }

    async fn lose(&mut self, reason: String) {
        self.shared.metrics.broker_up.store(false, Ordering::Relaxed);
        (self.shared.report)(&Event::BrokerDown { reason });
        if let Some(standby) = &mut self.standby {
            standby.lost();
        }
        if self.link.as_ref().is_some_and(|connection| connection.age() >= STABLE) {
            self.backoff = BACKOFF.0;
        }
        self.retry = Instant::now() + self.backoff;
        self.backoff = (self.backoff * 2).min(BACKOFF.1);
        self.recover().await;
    }

    /// Ends the connection, and keeps readings that may not have arrived.
    async fn recover(&mut self) {
        let Some(connection) = self.link.take() else { return };
        let mut readings = connection.into_readings();
        // loaded readings go back as well, so that the file can be deleted
        readings.extend(self.history.drain(..));
        readings.iter_mut().for_each(|reading| reading.historical = true);
        readings.sort_by_key(|reading| reading.id);
        let had_loaded = std::mem::take(&mut self.loaded) > 0;
        if !readings.is_empty() {
            self.keep(readings).await;
        }
        if had_loaded {
            self.with_store(|store| {
                store.acknowledge();
                Ok(())
            })
            .await;
        }
    }

    /// Puts readings into the buffer.
    async fn keep(&mut self, readings: Vec<Reading>) {
        if self.store.is_some() {
            let count = readings.len() as u64;
            let kept = self.with_store(move |store| store.append(&readings, now_ms())).await;
            if kept.is_none() {
                self.shared.metrics.dropped.fetch_add(count, Ordering::Relaxed);
            }
            return;
        }
        self.history.extend(readings);
        let excess = self.history.len().saturating_sub(MEMORY);
        self.history.drain(..excess);
        self.shared.metrics.dropped.fetch_add(excess as u64, Ordering::Relaxed);
    }

    /// Loads the oldest readings of the store; returns whether there are any.
    async fn load(&mut self) -> bool {
        if self.store.as_ref().is_none_or(|store| store.stored() == 0) {
            return false;
        }
        let readings = self.with_store(|store| store.load(now_ms())).await.unwrap_or_default();
        self.loaded = readings.len();
        self.history.extend(readings);
        self.loaded > 0
    }

    /// Runs a blocking function of the store on another thread. A store that fails is given up.
    async fn with_store<T: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut Store) -> std::io::Result<T> + Send + 'static,
    ) -> Option<T> {
        let mut store = self.store.take()?;
        let done = spawn_blocking(move || {
            let result = work(&mut store);
            let counts = (store.take_dropped(), store.stored(), store.stored_bytes());
            (store, result, counts)
        });
        let (store, result, (dropped, stored, bytes)) = done.await.ok()?;
        let metrics = &self.shared.metrics;
        metrics.dropped.fetch_add(dropped, Ordering::Relaxed);
        metrics.stored.store(stored, Ordering::Relaxed);
        metrics.stored_bytes.store(bytes, Ordering::Relaxed);
        match result {
            Ok(value) => {
                self.store = Some(store);
                Some(value)
            }
            Err(error) => {
                (self.shared.report)(&Event::BufferFailed { reason: error.to_string() });
                None
            }
        }
    }

    fn receive(&mut self, publish: &Publish) {
        if self.is_watcher() {
            return self.saw(publish);
        }
        let shared = Arc::clone(&self.shared);
        let config = &shared.config;
        let mut levels = publish.topic.split('/');
        if let Some(sparkplug) = &mut self.sparkplug {
            let cell = levels.nth(4).and_then(|name| config.controllers.iter().position(|cell| cell.name == name));
            let is_node = publish.topic == sparkplug::topic(config, "NCMD", None);
            if !is_node && cell.is_none() {
                return;
            }
            match sparkplug.command(config, cell.filter(|_| !is_node), &publish.payload) {
                // not at once: a host that asks again and again must not fill the memory
                Ok(command) if is_node && command.rebirth => self.stale = true,
                Ok(command) => {
                    for HostWrite { name, value, time } in command.writes {
                        let expires = time.saturating_add(self.commands.longest());
                        let id = format!("{time}/{}", canonical(&name));
                        let command = Command { id, name, value, expires, origin: None };
                        self.order(cell.unwrap_or(0), publish, command);
                    }
                }
                Err(reason) => self.unreadable(cell, publish, reason),
            }
            return;
        }
        let name = levels.nth(2).unwrap_or_default();
        // another node of the group may have this controller
        let Some(cell) = config.controllers.iter().position(|cell| cell.name == name) else { return };
        match serde_json::from_slice(&publish.payload) {
            Ok(command) => self.order(cell, publish, command),
            Err(error) => self.unreadable(Some(cell), publish, format!("it is not a command: {error}")),
        }
    }

    /// Executes a command, or refuses it.
    fn order(&mut self, cell: usize, publish: &Publish, command: Command) {
        self.shared.metrics.commands.fetch_add(1, Ordering::Relaxed);
        let checked = if publish.retain {
            Err("it is retained, and may be old".into())
        } else if self.running.len() >= RUNNING.0 {
            Err(format!("{} commands are running", RUNNING.0))
        } else if self.cells[cell].running >= RUNNING.1 {
            Err(format!("{} commands of this controller are running", RUNNING.1))
        } else {
            // the times first: a later proof refers to these times, and the deadline is not after the expiry
            let (at, now) = (Instant::now(), now_ms());
            if self.is_proven() {
                self.commands.check(cell, &command, at, now)
            } else {
                Err("another process of this node may be active by now; send a new one".into())
            }
        };
        let topic = publish.topic.clone();
        match checked {
            Ok(job) => {
                let controller = self.controllers[cell].clone();
                self.cells[cell].running += 1;
                self.running.spawn(async move {
                    let (result, reason) = execute(controller, job).await;
                    Finished { cell, topic, command, result, reason }
                });
            }
            Err(reason) => {
                self.finish(Finished { cell, topic, command, result: CommandResult::Refused, reason: Some(reason) });
            }
        }
    }

    /// Ends a command that ran.
    fn end(&mut self, finished: Finished) {
        self.cells[finished.cell].running -= 1;
        self.finish(finished);
    }

    fn unreadable(&mut self, cell: Option<usize>, publish: &Publish, reason: String) {
        let Some(cell) = cell else { return };
        self.shared.metrics.commands.fetch_add(1, Ordering::Relaxed);
        let command = Command { id: String::new(), name: String::new(), value: ().into(), expires: 0, origin: None };
        let (topic, result) = (publish.topic.clone(), CommandResult::Refused);
        self.finish(Finished { cell, topic, command, result, reason: Some(reason) });
    }

    /// Writes the outcome of a command to the audit log, and answers it.
    fn finish(&mut self, finished: Finished) {
        let Finished { cell, topic, command, result, reason } = finished;
        let shared = Arc::clone(&self.shared);
        if result == CommandResult::Refused {
            shared.metrics.refused.fetch_add(1, Ordering::Relaxed);
        }
        let (id, reason) = (cut(command.id), reason.map(cut));
        let answer = json::answer(&shared.config, cell, &Answer { id: &id, result, reason: reason.as_deref() });
        (shared.report)(&Event::Command {
            controller: shared.config.controllers[cell].name.clone(),
            topic,
            id,
            origin: command.origin.map(cut),
            name: cut(command.name),
            value: cut(command.value.to_string()),
            result,
            reason,
        });
        // Sparkplug has no answers; a host sees the new value
        let has_room = self.link.as_ref().is_some_and(|connection| connection.out.len() < WAITING);
        if self.sparkplug.is_none() && self.is_active() && has_room {
            self.push(answer);
        }
    }

    /// Announces the end, and keeps readings that may not have arrived.
    async fn close(mut self) {
        let ended = async {
            while let Some(finished) = self.running.join_next().await {
                finished.into_iter().for_each(|finished| self.end(finished));
            }
        };
        // the controllers are closed, so commands end at once
        let _ = timeout(CLOSE, ended).await;
        if self.is_up() {
            self.step().await;
            let shared = Arc::clone(&self.shared);
            if self.is_active() {
                let death = self.sparkplug.as_ref().map(|sparkplug| sparkplug.death(&shared.config));
                death.into_iter().for_each(|death| self.push(death));
                if self.sparkplug.is_none() || self.standby.is_some() {
                    self.push(self.node_state(false));
                }
            }
            let last = async {
                while self.link.as_ref().is_some_and(|link| !link.is_idle()) {
                    if let Some(connection) = &mut self.link {
                        connection.flush();
                    }
                    let event = next(&mut self.link).await;
                    self.handle(event).await;
                }
                if let Some(connection) = &mut self.link {
                    let _ = connection.link.client.try_disconnect();
                    while connection.link.events.recv().await.is_some_and(|event| event.is_ok()) {}
                }
            };
            let _ = timeout(CLOSE, last).await;
        }
        self.recover().await;
        self.drain().await;
        let unborn: Vec<_> = (0..self.cells.len()).flat_map(|cell| self.take_unborn(cell)).collect();
        if !unborn.is_empty() {
            self.keep(unborn).await;
        }
        if !self.history.is_empty() {
            let readings = self.history.len() as u64;
            self.shared.metrics.dropped.fetch_add(readings, Ordering::Relaxed);
            (self.shared.report)(&Event::Unsent { readings });
        }
    }
}

/// Shortens a text of a command: a sender must not fill the log.
fn cut(mut text: String) -> String {
    if text.len() > LONGEST_TEXT {
        text.truncate(text.floor_char_boundary(LONGEST_TEXT));
        text.push('…');
    }
    text
}

/// Waits until a time, or forever.
async fn at(time: Option<Instant>) {
    match time {
        Some(time) => sleep_until(time).await,
        None => std::future::pending().await,
    }
}

/// Waits for the next event of a connection. Cancel-safe.
async fn next(link: &mut Option<Connection>) -> Option<LinkEvent> {
    match link {
        Some(connection) => connection.link.events.recv().await,
        None => std::future::pending().await,
    }
}
