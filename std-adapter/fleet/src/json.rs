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
//! | `bcap/GROUP/NAME/values`    | a list of such objects, each with `"name":"VARIABLE"`, of the points with `joined` | no |
//! | `bcap/GROUP/NAME/command`   | a command to this node, see [`command`](crate::command)          |          |
//! | `bcap/GROUP/NAME/answer`    | its answer                                                       | no       |
//!
//! `T` is in milliseconds since 1970. `N` is different for each reading of a node, and increases.

use std::collections::VecDeque;
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

/// The topic of the readings that share a message.
const VALUES: &str = "values";

/// The maximum number of readings of one message, and the bytes after which another message begins.
const JOINED: usize = 100;
const JOINED_BYTES: usize = 32 * 1024;

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
        for reading in outbox.cells.iter().flat_map(|cell| cell.latest.iter().flatten()) {
            publish(outbox.config, outbox.messages, reading, true);
        }
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
                publish(outbox.config, outbox.messages, &unknown(state, point, id), false);
            }
        }
    }

    fn reading(&mut self, outbox: &mut Outbox<'_>, reading: Reading) -> Option<Reading> {
        outbox.cells[reading.cell].latest[reading.point] = Some(reading.clone());
        add(outbox, reading);
        None
    }

    fn joins(&self, outbox: &Outbox<'_>, reading: &Reading) -> bool {
        let points = &outbox.config.controllers[reading.cell].points;
        let last = outbox.messages.back().filter(|last| last.entries < JOINED && last.payload.len() < JOINED_BYTES);
        last.and_then(|last| last.readings.last())
            .is_some_and(|last| last.cell == reading.cell && points[last.point].joined && points[reading.point].joined)
    }

    fn historical(&mut self, outbox: &mut Outbox<'_>, reading: Reading, _: bool) {
        add(outbox, reading);
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

/// Returns the id of a message that is not a command, for its answer; empty if the message has no id.
fn id(payload: &[u8]) -> String {
    #[derive(Deserialize)]
    struct WithId {
        id: String,
    }
    serde_json::from_slice(payload).map_or_else(|_| String::new(), |WithId { id }| id)
}

#[derive(Serialize)]
struct Shown<'a> {
    /// The variable, in a list.
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<&'a str>,
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
/// several processes, `instance` names the process, and `bd_seq` lets the next process continue its numbers.
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

/// Returns the reading that says that a point of a disconnected controller is unknown.
const fn unknown(state: &State, point: usize, id: u64) -> Reading {
    let (cell, time) = (state.cell, state.time);
    Reading { cell, point, time, id, value: None, quality: Quality::Bad, historical: false }
}

/// Adds a reading, which is sent again if the broker does not acknowledge it.
fn add(outbox: &mut Outbox<'_>, reading: Reading) {
    if let Some(message) = publish(outbox.config, outbox.messages, &reading, false) {
        message.readings.push(reading);
    }
}

/// Adds a reading to the messages: to the last message if both are in the list of the same controller. Returns its message.
fn publish<'m>(
    config: &Config,
    messages: &'m mut VecDeque<Message>,
    reading: &Reading,
    repeated: bool,
) -> Option<&'m mut Message> {
    let cell = &config.controllers[reading.cell];
    let point = &cell.points[reading.point];
    let Reading { quality, time, id, .. } = *reading;
    let historical = reading.historical && !repeated;
    let name = point.joined.then_some(point.name.as_str());
    let shown = Shown { name, value: reading.value.as_ref(), quality, time, id, historical, repeated };
    if point.joined {
        join(messages, topic(config, &cell.name, VALUES), &shown);
    } else {
        // an old value must not replace a newer one
        let message = retained(topic(config, &cell.name, &point.name), &shown);
        messages.push_back(Message { retain: !historical, ..message });
    }
    messages.back_mut()
}

/// Adds a reading to the list at the end of the messages, or begins a list. It is not retained: it has the values that changed.
fn join(messages: &mut VecDeque<Message>, topic: String, shown: &Shown<'_>) {
    let last = messages.back_mut().filter(|last| last.topic == topic && last.payload.len() < JOINED_BYTES);
    match last.filter(|last| last.entries < JOINED) {
        Some(last) => {
            last.entries += 1;
            // the end of the list
            last.payload.pop();
            last.payload.push(b',');
            last.payload.extend(json(shown));
            last.payload.push(b']');
        }
        None => messages.push_back(Message { retain: false, ..retained(topic, &[shown]) }),
    }
}

fn retained(topic: String, shown: &impl Serialize) -> Message {
    Message { topic, payload: json(shown), qos: QoS::AtLeastOnce, retain: true, entries: 1, readings: Vec::new() }
}

fn json(shown: &impl Serialize) -> Vec<u8> {
    // numbers, texts and lists of them are always JSON
    serde_json::to_vec(shown).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicU64;

    use super::*;
    use crate::encoder::CellCache;

    #[test]
    fn a_list_has_at_most_100_readings() {
        let config = "group = \"g\"\nnode = \"n\"\n[broker]\nhost = \"h\"\n[[controller]]\nname = \"a\"\n\
            address = \"tcp:h\"\n[[controller.publish]]\nnames = [\"I1-150\"]\njoined = true\n";
        let (config, next_id) = (Config::parse(config).unwrap(), AtomicU64::new(0));
        let lengths = |messages: &VecDeque<Message>| -> Vec<usize> {
            let list = |message: &Message| serde_json::from_slice::<Vec<serde_json::Value>>(&message.payload).unwrap();
            messages.iter().map(|message| list(message).len()).collect()
        };
        let (mut cells, mut messages) = ([CellCache::new(150)], VecDeque::new());
        let mut outbox = Outbox { config: &config, cells: &mut cells, messages: &mut messages, next_id: &next_id };
        for point in 0..150 {
            let (value, quality) = (Some(Value::Integer(5)), Quality::Good);
            let reading = Reading { cell: 0, point, time: 5, id: 1, value, quality, historical: false };
            Json.reading(&mut outbox, reading);
        }
        assert_eq!(lengths(outbox.messages), [100, 50]);
        outbox.messages.clear();
        // repeated ones are not sent again after a loss
        Json.repeat(&mut outbox);
        assert_eq!(lengths(outbox.messages), [100, 50]);
    }
}
