//! `bcap-fleet CONFIG --screen`: the controllers, the buffer, the broker and the last events, live in the terminal.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bcap_fleet::{ControllerStatus, Event, Monitor, Status};
use bcap_terminal::screen::{KeyCode, Line, Panel, Part, Screen};

/// The lines of a list that are kept.
const KEPT: usize = 200;

/// The controllers that a page key moves.
const PAGE: usize = 10;

/// The time over which readings a second are counted.
const PERIOD: Duration = Duration::from_secs(1);

const KEYS: &str = "q quit  up, down, page up, page down: other controllers";

/// The events of a fleet that its screen shows.
#[derive(Clone, Default)]
pub(crate) struct ShownEvents(Arc<Mutex<Lists>>);

#[derive(Default)]
struct Lists {
    /// Why there is no session, by controller.
    down: BTreeMap<String, String>,
    /// Why there is no connection to the broker.
    broker: Option<String>,
    commands: VecDeque<String>,
    log: VecDeque<String>,
}

impl ShownEvents {
    /// Adds an event with its time.
    pub(crate) fn add(&self, time: &str, event: &Event) {
        let mut lists = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // the day is known, and the milliseconds do not matter
        let time = time.get(11..19).unwrap_or(time);
        let text = match event {
            Event::BrokerUp {} => {
                lists.broker = None;
                "the broker is connected".to_owned()
            }
            Event::BrokerDown { reason } => {
                lists.broker = Some(reason.clone());
                format!("the broker is disconnected: {reason}")
            }
            Event::RobotUp { controller } => {
                lists.down.remove(controller);
                format!("{controller} is connected")
            }
            Event::RobotDown { controller, reason } => {
                lists.down.insert(controller.clone(), reason.clone());
                format!("{controller} is disconnected: {reason}")
            }
            Event::CommandsDenied {} => "the broker refuses the subscription of commands".to_owned(),
            Event::RobotError { controller, code, meaning, .. } => {
                format!("{controller} has the error {code} {}", meaning.unwrap_or_default())
            }
            Event::Skipped { controller, variable, reason } => format!("{controller} {variable} {reason}"),
            Event::Command { controller, name, value, result, reason, .. } => {
                let reason = reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
                let result = format!("{result:?}").to_lowercase();
                push(&mut lists.commands, format!("{time} {controller} {name} = {value} {result}{reason}"));
                return;
            }
            Event::BufferFailed { reason } => format!("the buffer has failed: {reason}"),
            Event::BufferWorks {} => "the buffer takes readings again".to_owned(),
            Event::Suppressed { controller, events } => format!("{controller}: {events} more refused commands"),
            Event::Unsent { readings } => format!("{readings} readings were not sent"),
            Event::Active { .. } => "this process is active".to_owned(),
            Event::Standby { active: Some(active) } => format!("this process is the standby of {active}"),
            Event::Standby { active: None } => "this process is the standby".to_owned(),
            Event::PrimaryHost { online: true } => "the primary host is online".to_owned(),
            Event::PrimaryHost { online: false } => "the primary host is offline".to_owned(),
            other => format!("{other:?}"),
        };
        push(&mut lists.log, format!("{time} {text}"));
    }
}

fn push(lines: &mut VecDeque<String>, line: String) {
    if lines.len() >= KEPT {
        lines.pop_front();
    }
    lines.push_back(line);
}

/// The contents of the screen, and the selected controller.
pub(crate) struct Shown {
    monitor: Monitor,
    events: ShownEvents,
    metrics: Option<String>,
    /// The controller around which the list is shown.
    selected: usize,
    /// When readings were counted last, their count, and how many a second there were before.
    rate: (Instant, u64, f64),
}

impl Shown {
    pub(crate) fn new(monitor: Monitor, events: ShownEvents, metrics: Option<String>) -> Self {
        Self { monitor, events, metrics, selected: 0, rate: (Instant::now(), 0, 0.0) }
    }

    /// Handles keys, and returns the content to draw.
    pub(crate) fn screen(&mut self, keys: &[KeyCode]) -> Screen {
        let status = self.monitor.status();
        let last = status.controllers.len().saturating_sub(1);
        for key in keys {
            self.selected = match key {
                KeyCode::Up => self.selected.saturating_sub(1),
                KeyCode::Down => self.selected + 1,
                KeyCode::PageUp => self.selected.saturating_sub(PAGE),
                KeyCode::PageDown => self.selected + PAGE,
                _ => self.selected,
            }
            .min(last);
        }
        let (since, count, _) = self.rate;
        if since.elapsed() >= PERIOD {
            let rate = (status.published.saturating_sub(count)) as f64 / since.elapsed().as_secs_f64();
            self.rate = (Instant::now(), status.published, rate);
        }
        self.draw(&status)
    }

    fn draw(&self, status: &Status) -> Screen {
        let lists = self.events.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = status.controllers.len();
        let up = status.controllers.iter().filter(|controller| controller.up).count();
        let broker = if status.broker_up { "broker connected" } else { "BROKER DISCONNECTED" };
        let controllers = status.controllers.iter().map(controller).collect();
        let errors = lists.broker.iter().map(|reason| format!("broker: {reason}"));
        let errors = errors.chain(lists.down.iter().map(|(name, reason)| format!("{name}: {reason}")));
        let errors: Vec<_> = errors.map(Line::alarm).collect();
        let none = errors.is_empty().then(|| Line::new("all are connected"));
        let lines = |lines: &VecDeque<String>| lines.iter().map(Line::new).collect();
        Screen {
            title: "bcap-fleet".into(),
            state: format!("{up} of {count} controllers connected, {broker}"),
            alarm: up < count || !status.broker_up,
            values: Panel::new("controller, scan, readings, errors", controllers).showing(Part::Around(self.selected)),
            robot: Panel::new("broker", self.broker(status)),
            tasks: Panel::new("buffer", buffer(status)),
            errors: Panel::new("disconnected", errors.into_iter().chain(none).collect()).showing(Part::Wrapped),
            messages: Panel::new("commands", lines(&lists.commands)).showing(Part::Last),
            log: Panel::new("events", lines(&lists.log)).showing(Part::Last),
            notice: Line::new(
                self.metrics.as_ref().map(|at| format!("metrics: http://{at}/metrics")).unwrap_or_default(),
            ),
            keys: KEYS.into(),
            overlay: None,
        }
    }

    fn broker(&self, status: &Status) -> Vec<Line> {
        vec![
            Line::new(format!("host         {}", status.broker)),
            Line::new(format!("connections  {}", status.broker_connections)),
            Line::new(format!("readings     {}, {:.0}/s", status.published, self.rate.2)),
            Line::new(format!("commands     {}, {} refused", status.commands, status.refused)),
        ]
    }
}

fn controller(controller: &ControllerStatus) -> Line {
    let ControllerStatus { name, up, scan, readings, errors, .. } = controller;
    if !up {
        return Line::alarm(format!("{name:8} disconnected {readings:>9} {errors:>4}"));
    }
    let scan = format!("{:.1} ms", scan.as_secs_f64() * 1000.0);
    Line::new(format!("{name:8} {scan:>12} {readings:>9} {errors:>4}"))
}

fn buffer(status: &Status) -> Vec<Line> {
    let dropped = format!("dropped      {}", status.dropped);
    let (queued, stored, kib) = (status.queued, status.stored, status.stored_bytes.div_ceil(1024));
    // two lines, which is all that a terminal of 80 by 24 has for them
    vec![
        Line::new(format!("in memory    {queued}, on disk {stored} ({kib} KiB)")),
        if status.dropped > 0 { Line::alarm(dropped) } else { Line::new(dropped) },
    ]
}
