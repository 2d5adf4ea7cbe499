//! Moves readings to the broker and commands from it. One task owns the connection, the backlog and the encoder.
//!
//! ```text
//!  scans ─► queue ─┬────────────► encoder ─► connection ─► broker
//!                  └─► backlog ──────┘           │
//!                         ▲── not acknowledged ──┘
//! ```
//!
//! While there is a connection, new readings go first, and the backlog when there are no new ones. At most
//! [`WINDOW`](crate::broker::WINDOW) messages wait for the broker. After a loss, readings that it has not acknowledged go to the
//! backlog.

mod backlog;
mod confirm;
mod connection;
mod host;
mod orders;
mod role;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use bcap_service::throttle::Throttle;
use bcap_std::asynch::Controller;
use rumqttc::{ConnectReturnCode, Event as Mqtt, Outgoing, Packet};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout, timeout_at};

use self::backlog::Backlog;
use self::connection::{Connection, Phase, next};
use crate::broker::{Connector, LinkEvent};
use crate::command::{CommandCheck, Finished};
use crate::config::{Config, Format};
use crate::encoder::{CellCache, Encoder, Outbox};
use crate::event::Event;
use crate::json::Json;
use crate::message::Message;
use crate::queue::{Item, State};
use crate::reading::{Reading, now_ms};
use crate::scan::Shared;
use crate::sparkplug::Sparkplug;
use crate::standby::Failover;
use crate::store::Store;

/// The delays between two attempts to connect.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(10));

/// Maximum time for the last messages.
const CLOSE: Duration = Duration::from_secs(2);

/// New readings beyond this go to the buffer although there is a connection.
const BACKLOG: usize = 10_000;

/// Minimum time that a connection must last before the backoff is reset: a broker may accept and immediately close.
const STABLE: Duration = Duration::from_secs(2);

/// Minimum time between two rounds of all values.
const REPEAT: Duration = Duration::from_secs(1);

/// Sustained rate of events for refused commands of a controller, per second.
const REFUSALS: u32 = 10;

/// Moves readings to the broker and commands from it.
pub(crate) struct Publisher {
    shared: Arc<Shared>,
    controllers: Vec<Controller>,
    connector: Connector,
    /// `None` if this is the only process of the node.
    standby: Option<Failover>,
    /// The latest time in a state of the primary host, in milliseconds since 1970; 0 if it is unknown.
    host_since: u64,
    /// Whether another process was seen as the active one since this process was.
    stands_by: bool,
    encoder: Box<dyn Encoder>,
    cells: Vec<CellCache>,
    backlog: Backlog,
    commands: CommandCheck,
    running: JoinSet<Finished>,
    /// Whether running commands are abandoned, and new commands are refused.
    gives_up: watch::Sender<bool>,
    /// The number of commands of each controller that run.
    running_of: Vec<usize>,
    link: Option<Connection>,
    retry: Instant,
    backoff: Duration,
    /// Whether all values must be sent again: values newer than the retained ones went to the buffer, or a host has requested
    /// it.
    stale: bool,
    /// When all values may be sent again, so that many requests of hosts are one.
    repeat_at: Instant,
    /// Limits the events of refused commands, by controller.
    refusals: Throttle<usize>,
}

impl Publisher {
    pub(crate) fn new(
        shared: Arc<Shared>,
        controllers: Vec<Controller>,
        connector: Connector,
        store: Option<Store>,
    ) -> Self {
        let config = &shared.config;
        let encoder: Box<dyn Encoder> = match config.format {
            Format::Json => Box::new(Json),
            Format::Sparkplug => Box::new(Sparkplug::new(config)),
        };
        Self {
            cells: config.controllers.iter().map(|cell| CellCache::new(cell.points.len())).collect(),
            backlog: Backlog::new(Arc::clone(&shared), store),
            commands: CommandCheck::new(config.commands.clone(), encoder.lead(), now_ms()),
            encoder,
            running_of: vec![0; config.controllers.len()],
            standby: config.standby.as_ref().map(|standby| Failover::new(standby.after())),
            host_since: 0,
            stands_by: false,
            controllers,
            connector,
            running: JoinSet::new(),
            gives_up: watch::Sender::new(false),
            link: None,
            retry: Instant::now(),
            backoff: BACKOFF.0,
            stale: false,
            repeat_at: Instant::now(),
            refusals: Throttle::new(REFUSALS),
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
            let suppressed = self.refusals.take_expired(bcap_std::now());
            self.report_suppressed(suppressed);
            let repeat = Some(self.repeat_at).filter(|at| self.stale && *at > Instant::now());
            let wake = self.standby.as_ref().and_then(Failover::wake);
            tokio::select! {
                event = next(&mut self.link) => self.handle(event).await,
                () = shared.queue.added() => {}
                () = sleep_until(self.retry), if self.link.is_none() => {}
                () = at(wake) => self.tick().await,
                () = at(repeat) => {}
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
        self.link.as_ref().is_some_and(Connection::is_up)
    }

    /// Moves all messages that can be moved without waiting for the broker.
    async fn step(&mut self) {
        if !self.is_active() {
            self.drain().await;
        }
        if !self.sends_backlog() {
            return;
        }
        if self.shared.queue.len() > BACKLOG {
            self.stale = true;
            self.drain().await;
        }
        loop {
            self.pump();
            if !self.backlog.load().await {
                return;
            }
        }
    }

    /// Moves all new readings to the backlog.
    async fn drain(&mut self) {
        let mut readings = Vec::new();
        while let Some(item) = self.shared.queue.pop() {
            match item {
                Item::State(state) => {
                    readings.extend(self.set_state(&state));
                    if self.is_active() {
                        self.encode(|encoder, outbox| encoder.state(outbox, &state));
                    }
                }
                Item::Reading(mut reading) => {
                    // even the latest reading: it is in the backlog
                    reading.historical = true;
                    self.cells[reading.cell].latest[reading.point] = Some(reading.clone());
                    readings.push(reading);
                }
            }
        }
        self.backlog.keep(readings).await;
    }

    /// Puts messages into the window.
    fn pump(&mut self) {
        let shared = Arc::clone(&self.shared);
        let is_active = self.is_active();
        while self.link.as_ref().is_some_and(|connection| connection.room() > 0) {
            let repeats = is_active && self.stale && self.repeat_at <= Instant::now();
            // data after a request for births must not be sent before them
            if repeats && self.encoder.has_births() {
                self.repeat();
            } else if let Some(item) = is_active.then(|| shared.queue.pop()).flatten() {
                match item {
                    Item::State(state) => {
                        let unsent = self.set_state(&state);
                        self.backlog.push(unsent);
                        self.encode(|encoder, outbox| encoder.state(outbox, &state));
                    }
                    Item::Reading(reading) => {
                        let replaced = self.encode(|encoder, outbox| encoder.reading(outbox, reading));
                        self.backlog.push(replaced.map(|replaced| Reading { historical: true, ..replaced }));
                    }
                }
            } else if repeats {
                self.repeat();
            } else if let Some((reading, has_more)) = self.backlog.pop() {
                self.encode(|encoder, outbox| encoder.historical(outbox, reading, has_more));
            } else {
                break;
            }
        }
        // otherwise the messages of a scan would be small when the broker is slow
        while is_active && self.pump_joined() {}
        if let Some(connection) = &mut self.link {
            connection.flush();
        }
    }

    /// Puts the next reading into the last message of a window without room, if it has the same list.
    fn pump_joined(&mut self) -> bool {
        let shared = Arc::clone(&self.shared);
        let joined = self.encode(|encoder, outbox| {
            let reading = shared.queue.pop_reading(|reading| encoder.joins(outbox, reading))?;
            Some(encoder.reading(outbox, reading))
        });
        self.backlog.push(joined.iter().flatten().map(|replaced| Reading { historical: true, ..replaced.clone() }));
        joined.is_some()
    }

    /// Sends all values again.
    fn repeat(&mut self) {
        (self.stale, self.repeat_at) = (false, Instant::now() + REPEAT);
        self.encode(|encoder, outbox| encoder.repeat(outbox));
    }

    fn push(&mut self, message: Message) {
        if let Some(connection) = &mut self.link {
            connection.out.push_back(message);
        }
    }

    /// Adds messages of the encoder to the connection, if there is one.
    fn encode<T: Default>(&mut self, work: impl FnOnce(&mut dyn Encoder, &mut Outbox<'_>) -> T) -> T {
        let Some(connection) = &mut self.link else { return T::default() };
        let Shared { config, next_id, .. } = &*self.shared;
        let mut outbox = Outbox { config, next_id, cells: &mut self.cells, messages: &mut connection.out };
        work(&mut *self.encoder, &mut outbox)
    }

    /// Sets the state of a controller; returns the readings of its last session that were not sent.
    fn set_state(&mut self, state: &State) -> Vec<Reading> {
        let cell = &mut self.cells[state.cell];
        cell.state = Some(state.clone());
        self.encoder.take_unsent(state.cell, cell)
    }

    /// Takes the readings of all controllers that were not sent.
    fn take_unsent(&mut self) -> Vec<Reading> {
        let cells = self.cells.iter_mut().enumerate();
        cells.flat_map(|(index, cell)| self.encoder.take_unsent(index, cell)).collect()
    }

    fn connect(&mut self) {
        let link = match &self.standby {
            Some(standby) if !standby.is_active() => self.connector.watch(standby.instance()),
            _ => {
                let will = self.encoder.will(&self.shared.config);
                self.connector.connect(Some(will.unwrap_or_else(|| self.node_state(false))))
            }
        };
        self.link = Some(Connection::new(link, &self.shared.config));
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
                let sent = self.link.as_mut().and_then(|connection| connection.acknowledged(ack.pkid));
                if let Some((at, readings)) = sent {
                    self.prove(at);
                    self.backlog.arrived(&readings).await;
                }
            }
            Some(Ok(Mqtt::Incoming(Packet::SubAck(ack)))) => self.subscribed(&ack.return_codes).await,
            Some(Ok(Mqtt::Outgoing(Outgoing::Publish(packet)))) => {
                if let Some(connection) = &mut self.link {
                    connection.written(packet);
                }
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
        if self.shows_state() {
            self.push(self.node_state(true));
        }
        if self.waits_for_host() {
            self.start_reading();
        } else {
            self.begin().await;
        }
    }

    /// Begins to receive commands, and then to publish.
    async fn begin(&mut self) {
        let topics = self.encoder.topics(&self.shared.config, self.commands.are_on());
        if let Some(connection) = &mut self.link {
            connection.phase = Phase::Subscribing;
            connection.subscribe(topics);
        }
        self.rise().await;
    }

    /// Begins to publish if the broker has answered all subscriptions.
    async fn rise(&mut self) {
        let is_ready = |link: &Connection| link.phase == Phase::Subscribing && link.subscribing == 0;
        if !self.link.as_ref().is_some_and(is_ready) {
            return;
        }
        // readings from before are historical
        self.drain().await;
        self.start_reading();
        (self.stale, self.repeat_at) = (false, Instant::now() + REPEAT);
        if let Some(connection) = &mut self.link {
            connection.rise();
        }
        self.encode(|encoder, outbox| encoder.introduce(outbox));
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
        if let Some(connection) = self.link.take() {
            self.backlog.restore(connection.into_readings()).await;
        }
    }

    /// Announces the end, and keeps readings that may not have arrived.
    async fn close(mut self) {
        // the controllers are closed, so commands end immediately, unless a controller does not answer
        if timeout(CLOSE, self.join()).await.is_err() {
            self.gives_up.send_replace(true);
            self.join().await;
        }
        // commands that arrive from now on are refused
        self.gives_up.send_replace(true);
        if self.is_up() {
            self.step().await;
            if self.is_active() {
                if self.standby.is_none() && !self.encoder.has_births() {
                    self.invalidate();
                }
                let death = self.encoder.death(&self.shared.config);
                death.into_iter().for_each(|death| self.push(death));
                if self.shows_state() {
                    self.push(self.node_state(false));
                }
            }
            self.send_last(Instant::now() + CLOSE).await;
        }
        self.recover().await;
        self.drain().await;
        let unsent = self.take_unsent();
        self.backlog.keep(unsent).await;
        let suppressed = self.refusals.take();
        self.report_suppressed(suppressed);
        self.backlog.close();
    }

    /// Publishes that all controllers are disconnected and their values unknown: the next fleet may not have them. In a format
    /// with births the death of the node says that.
    fn invalidate(&mut self) {
        let time = now_ms();
        for cell in 0..self.cells.len() {
            let state = State { cell, down: Some("the node has ended".into()), time };
            let unsent = self.set_state(&state);
            self.backlog.push(unsent);
            // so that the encoder publishes each point as unknown
            self.cells[cell].latest.fill(None);
            self.encode(|encoder, outbox| encoder.state(outbox, &state));
        }
    }

    /// Waits until no command runs.
    async fn join(&mut self) {
        while let Some(finished) = self.running.join_next().await {
            finished.into_iter().for_each(|finished| self.end(finished));
        }
    }

    /// Sends the messages of the connection, and closes it. Only the wait for the broker ends with the time: an event is handled
    /// whole, because it may write to the buffer.
    async fn send_last(&mut self, until: Instant) {
        while let Some(connection) = self.link.as_mut().filter(|link| !link.is_idle()) {
            connection.flush();
            let Ok(event) = timeout_at(until, next(&mut self.link)).await else { return };
            self.handle(event).await;
        }
        if let Some(connection) = &mut self.link {
            let _ = connection.link.client.try_disconnect();
            while let Ok(Some(Ok(event))) = timeout_at(until, next(&mut self.link)).await {
                // a command is refused and reported, although its answer is not sent
                if let Mqtt::Incoming(Packet::Publish(publish)) = event
                    && !self.is_watcher()
                {
                    self.receive(&publish);
                }
            }
        }
    }
}

/// Waits until a time, or forever.
async fn at(time: Option<Instant>) {
    match time {
        Some(time) => sleep_until(time).await,
        None => std::future::pending().await,
    }
}
