//! Plain JSON: one topic for each variable, for people and programs without a library.
//!
//! | topic                       | payload                                                          | retained |
//! |-----------------------------|------------------------------------------------------------------|----------|
//! | `bcap/GROUP/NODE/state`     | `{"state":"online","time":T}`; `offline` by will                 | yes      |
//! | the same                    | with `[standby]` also `"instance"` and, for Sparkplug, `"bdSeq"`  | yes      |
//! | `bcap/GROUP/NAME/state`     | `{"state":"connected","time":T}`; `disconnected` with `reason`   | yes      |
//! | `bcap/GROUP/NAME/VARIABLE`  | `{"value":5,"quality":"good","time":T,"id":N}`                   | yes      |
//! | the same                    | the same with `"historical":true`: the broker was disconnected   | no       |
//! | the same                    | the same with `"repeated":true`: sent before, for a broker that has lost it | yes |
//! | `bcap/GROUP/NAME/command`   | a command to this node, see [`command`](crate::command)          |          |
//! | `bcap/GROUP/NAME/answer`    | its answer                                                       | no       |
//!
//! `T` is in milliseconds since 1970. `N` is different for each reading of a node, and increases.

use std::sync::atomic::Ordering;

use rumqttc::QoS;
use serde::{Deserialize, Serialize};

use crate::command::Answer;
use crate::config::Config;
use crate::encoder::{Decoded, Encoder, Outbox};
use crate::message::Message;
use crate::queue::State;
use crate::reading::{Quality, Reading, Value};
use crate::shorten::LARGEST;

/// The encoder. It has no state: each message is complete.
pub(crate) struct Json;

impl Encoder for Json {
    fn has_births(&self) -> bool {
        false
    }

    fn topics(&self, config: &Config, are_on: bool) -> Vec<String> {
        are_on.then(|| topic(config, "+", "command")).into_iter().collect()
    }

    fn introduce(&mut self, outbox: &mut Outbox<'_>) {
        let states: Vec<_> = outbox.cells.iter().filter_map(|cell| cell.state.clone()).collect();
        states.iter().for_each(|state| self.state(outbox, state));
        self.repeat(outbox);
    }

    /// The retained values become the newest.
    fn repeat(&mut self, outbox: &mut Outbox<'_>) {
        let readings = outbox.cells.iter().flat_map(|cell| cell.latest.iter().flatten());
        outbox.messages.extend(readings.map(|reading| repeated(outbox.config, reading)));
    }

    /// The points of a disconnected controller that this process has not read are unknown. The broker may have good values of an
    /// earlier process.
    fn state(&mut self, outbox: &mut Outbox<'_>, state: &State) {
        outbox.push(self::state(outbox.config, state));
        if state.down.is_none() {
            return;
        }
        for (point, latest) in outbox.cells[state.cell].latest.iter().enumerate() {
            if latest.is_none() {
                let id = outbox.next_id.fetch_add(1, Ordering::Relaxed);
                outbox.messages.push_back(unknown(outbox.config, state, point, id));
            }
        }
    }

    fn reading(&mut self, outbox: &mut Outbox<'_>, reading: Reading) -> Option<Reading> {
        outbox.cells[reading.cell].latest[reading.point] = Some(reading.clone());
        outbox.push(self::reading(outbox.config, reading));
        None
    }

    fn historical(&mut self, outbox: &mut Outbox<'_>, reading: Reading, _: bool) {
        outbox.push(self::reading(outbox.config, reading));
    }

    fn decode(&self, config: &Config, topic: &str, payload: &[u8], _: u64) -> Decoded {
        let name = topic.split('/').nth(2).unwrap_or_default();
        // another node of the group may have this controller
        let Some(cell) = config.controllers.iter().position(|cell| cell.name == name) else { return Decoded::Nothing };
        if payload.is_empty() {
            return Decoded::Invalid(cell, String::new(), format!("it is empty, or has more than {LARGEST} bytes"));
        }
        match serde_json::from_slice(payload) {
            Ok(command) => Decoded::Commands(cell, vec![command]),
            Err(error) => Decoded::Invalid(cell, id(payload), format!("it is not a command: {error}")),
        }
    }

    fn answer(&self, config: &Config, cell: usize, answer: &Answer<'_>) -> Option<Message> {
        let topic = topic(config, &config.controllers[cell].name, "answer");
        Some(Message { retain: false, ..retained(topic, answer) })
    }
}

/// Returns the id of a message that is not a command, for its answer; empty if it has none.
fn id(payload: &[u8]) -> String {
    #[derive(Deserialize)]
    struct WithId {
        id: String,
    }
    serde_json::from_slice(payload).map_or_else(|_| String::new(), |WithId { id }| id)
}

#[derive(Serialize)]
struct Shown<'a> {
    /// `null` if unknown, or a number that JSON does not have.
    value: Option<&'a Value>,
    quality: Quality,
    time: u64,
    id: u64,
    #[serde(skip_serializing_if = "is_false")]
    historical: bool,
    #[serde(skip_serializing_if = "is_false")]
    repeated: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
const fn is_false(flag: &bool) -> bool {
    !*flag
}

#[derive(Serialize)]
struct StateShown<'a> {
    state: &'a str,
    time: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    instance: Option<&'a str>,
    #[serde(rename = "bdSeq", skip_serializing_if = "Option::is_none")]
    bd_seq: Option<u8>,
}

/// Returns the topic of something of a controller, or of the node.
pub(crate) fn topic(config: &Config, name: &str, leaf: &str) -> String {
    format!("bcap/{}/{name}/{leaf}", config.group)
}

/// Returns the message that the broker sends when this node is gone, or that this node sends when it starts or ends. With
/// several processes, `instance` says which one is meant, and `bd_seq` lets the next one continue its numbers.
pub(crate) fn node(config: &Config, online: bool, time: u64, instance: Option<&str>, bd_seq: Option<u8>) -> Message {
    let state = if online { "online" } else { "offline" };
    let shown = StateShown { state, time, reason: None, instance, bd_seq };
    retained(topic(config, &config.node, "state"), &shown)
}

/// Returns the message for a change of a controller's state.
fn state(config: &Config, state: &State) -> Message {
    let reason = state.down.as_deref();
    let word = if reason.is_some() { "disconnected" } else { "connected" };
    let shown = StateShown { state: word, time: state.time, reason, instance: None, bd_seq: None };
    retained(topic(config, &config.controllers[state.cell].name, "state"), &shown)
}

/// Returns the message for a reading.
fn reading(config: &Config, reading: Reading) -> Message {
    // an old value must not replace a newer one
    let retain = !reading.historical;
    let message = shown(config, &reading, false);
    Message { readings: vec![reading], retain, ..message }
}

/// Returns the message that repeats the latest reading of a point.
fn repeated(config: &Config, reading: &Reading) -> Message {
    shown(config, reading, true)
}

/// Returns the message that says that a point of a disconnected controller is unknown.
fn unknown(config: &Config, state: &State, point: usize, id: u64) -> Message {
    let (cell, time) = (state.cell, state.time);
    shown(config, &Reading { cell, point, time, id, value: None, quality: Quality::Bad, historical: false }, false)
}

fn shown(config: &Config, reading: &Reading, repeated: bool) -> Message {
    let cell = &config.controllers[reading.cell];
    let Reading { quality, time, id, .. } = *reading;
    let historical = reading.historical && !repeated;
    let shown = Shown { value: reading.value.as_ref(), quality, time, id, historical, repeated };
    retained(topic(config, &cell.name, &cell.points[reading.point].name), &shown)
}

fn retained(topic: String, shown: &impl Serialize) -> Message {
    // numbers, texts and lists of them are always JSON
    let payload = serde_json::to_vec(shown).unwrap_or_default();
    Message { topic, payload, qos: QoS::AtLeastOnce, retain: true, readings: Vec::new() }
}
