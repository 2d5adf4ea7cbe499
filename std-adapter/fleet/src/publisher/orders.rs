//! Commands from the broker: they run side by side, and each one is reported and answered.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use bcap_service::throttle::Suppressed;
use rumqttc::Publish;
use tokio::time::Instant;

use super::Publisher;
use crate::command::{Answer, Command, Finished, execute, refused};
use crate::encoder::Decoded;
use crate::event::{CommandResult, Event};
use crate::reading::now_ms;

/// The maximum number of answers that wait for the window before further ones are left out: commands must not fill the memory.
const WAITING: usize = 1000;

/// The maximum number of commands that run at the same time, in total and for one controller: a slow controller must not occupy
/// all slots.
const RUNNING: (usize, usize) = (64, 16);

/// The maximum size of a text of a command in an answer or event in bytes.
const LONGEST_TEXT: usize = 256;

impl Publisher {
    /// Handles a message of a host, or, as a watcher, of the active process.
    pub(super) fn receive(&mut self, publish: &Publish) {
        if self.is_watcher() {
            return self.saw(publish);
        }
        let longest = self.commands.longest();
        match self.encoder.decode(&self.shared.config, &topic(publish), &publish.payload, longest) {
            Decoded::Nothing => {}
            // not immediately: a host that repeats the request must not fill the memory
            Decoded::Repeat => self.stale = true,
            Decoded::Commands(cell, commands) => {
                commands.into_iter().for_each(|command| self.order(cell, publish, command));
            }
            Decoded::Invalid(cell, id, reason) => self.refuse_invalid(cell, publish, id, reason),
        }
    }

    /// Executes a command, or refuses it.
    fn order(&mut self, cell: usize, publish: &Publish, command: Command) {
        self.shared.metrics.commands.fetch_add(1, Ordering::Relaxed);
        let checked = if let Err(copy) = self.commands.check_copy(cell, &command.id, now_ms()) {
            Err(copy)
        } else if publish.retain {
            Err(refused("it is retained, and may be old".into()))
        } else if *self.gives_up.borrow() {
            Err(refused("this process ends".into()))
        } else if self.running.len() >= RUNNING.0 {
            Err(refused(format!("{} commands are running", RUNNING.0)))
        } else if self.running_of[cell] >= RUNNING.1 {
            Err(refused(format!("{} commands of this controller are running", RUNNING.1)))
        } else {
            // the times first: a later proof refers to these times, and the deadline is not after the expiry
            let (at, now) = (Instant::now(), now_ms());
            if self.is_proven() {
                self.commands.check(cell, &command, at, now)
            } else {
                let reason = "another process of this node may be active by now, and execute it; send a new one";
                Err((CommandResult::Unknown, reason.into()))
            }
        };
        let topic = topic(publish);
        match checked {
            Ok(job) => {
                let controller = self.controllers[cell].clone();
                let mut gives_up = self.gives_up.subscribe();
                self.running_of[cell] += 1;
                self.running.spawn(async move {
                    let (result, reason) = tokio::select! {
                        biased;
                        outcome = execute(controller, job) => outcome,
                        _ = gives_up.wait_for(|gives_up| *gives_up) => {
                            (CommandResult::Unknown, Some("this process ended before the controller answered".into()))
                        }
                    };
                    Finished { cell, topic, command, result, reason }
                });
            }
            Err((result, reason)) => {
                self.finish(Finished { cell, topic, command, result, reason: Some(reason) }, false)
            }
        }
    }

    /// Ends a command that ran.
    pub(super) fn end(&mut self, finished: Finished) {
        self.running_of[finished.cell] -= 1;
        let was_sent = finished.result != CommandResult::Refused;
        self.finish(finished, was_sent);
    }

    fn refuse_invalid(&mut self, cell: usize, publish: &Publish, id: String, reason: String) {
        self.shared.metrics.commands.fetch_add(1, Ordering::Relaxed);
        let command = Command { id, name: String::new(), value: ().into(), expires: 0, origin: None };
        let (topic, result) = (topic(publish), CommandResult::Refused);
        self.finish(Finished { cell, topic, command, result, reason: Some(reason) }, false);
    }

    /// Writes the outcome of a command to the audit log, and answers it.
    fn finish(&mut self, finished: Finished, was_sent: bool) {
        let Finished { cell, topic, command, result, reason } = finished;
        let shared = Arc::clone(&self.shared);
        if !was_sent {
            shared.metrics.refused.fetch_add(1, Ordering::Relaxed);
        }
        let (id, reason) = (cut(command.id), reason.map(cut));
        let answer = Answer { id: &id, result, reason: reason.as_deref() };
        let answer = self.encoder.answer(&shared.config, cell, &answer);
        // a command that was sent may have changed the robot, so it is always reported
        if was_sent || self.refusals.admits(cell, bcap_std::now()) {
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
        }
        let is_active = self.is_active();
        if let Some(connection) = self.link.as_mut().filter(|link| is_active && link.urgent.len() < WAITING) {
            connection.urgent.extend(answer);
        }
    }

    /// Reports how many events were left out.
    pub(super) fn report_suppressed(&self, suppressed: Vec<Suppressed<usize>>) {
        for Suppressed { source, lines } in suppressed {
            let controller = source.map_or_else(String::new, |cell| self.config().controllers[cell].name.clone());
            (self.shared.report)(&Event::Suppressed { controller, events: lines });
        }
    }
}

/// Returns the topic of a message.
fn topic(publish: &Publish) -> String {
    String::from_utf8_lossy(&publish.topic).into_owned()
}

/// Shortens a text of a command: a sender must not fill the log.
fn cut(mut text: String) -> String {
    if text.len() > LONGEST_TEXT {
        text.truncate(text.floor_char_boundary(LONGEST_TEXT));
        text.push('…');
    }
    text
}
