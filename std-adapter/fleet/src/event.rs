//! The events that a fleet reports to its user: changes of connections, and every command.

use serde::Serialize;

/// An event. It is serialised with the tag `event`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Event {
    /// The broker accepted the connection.
    BrokerUp {},
    /// The connection to the broker failed or was lost.
    BrokerDown {
        /// Why.
        reason: String,
    },
    /// This process of a node with `[standby]` is the active one now: it reads and publishes.
    Active {
        /// The name of this process in the state of the node.
        instance: String,
    },
    /// Another process of the node is active; this one waits to take over.
    Standby {
        /// The name of the active process, if it has one.
        #[serde(skip_serializing_if = "Option::is_none")]
        active: Option<String>,
    },
    /// The primary host of Sparkplug came online, so this node publishes, or it went offline.
    PrimaryHost {
        /// Whether it is online.
        online: bool,
    },
    /// The broker refuses the subscription of commands, so no commands arrive. Values are published.
    CommandsDenied {},
    /// A session with a controller was opened.
    RobotUp {
        /// The controller.
        controller: String,
    },
    /// There is no session with a controller.
    RobotDown {
        /// The controller.
        controller: String,
        /// Why.
        reason: String,
    },
    /// A controller has a new latest error. Only a controller whose `error` is published has these events.
    RobotError {
        /// The controller.
        controller: String,
        /// The code, as `0x83204071`.
        code: String,
        /// Its meaning.
        #[serde(skip_serializing_if = "Option::is_none")]
        meaning: Option<&'static str>,
        /// Its remedy.
        #[serde(skip_serializing_if = "Option::is_none")]
        remedy: Option<String>,
    },
    /// A variable is not read while a stream of Slave Mode runs, because reading it may end the stream.
    Skipped {
        /// The controller.
        controller: String,
        /// The variable.
        variable: String,
        /// Which call was skipped, and why.
        reason: String,
    },
    /// The buffer on disk failed; new readings wait in memory, and readings that do not fit are dropped and counted.
    BufferFailed {
        /// Why.
        reason: String,
    },
    /// The buffer on disk accepts readings again.
    BufferWorks {},
    /// Events of commands of a controller exceeded the rate, and were not reported.
    Suppressed {
        /// The controller.
        controller: String,
        /// The number of events.
        events: u64,
    },
    /// The end of the process lost readings that were in memory, because there is no buffer on disk, or it has failed.
    Unsent {
        /// The number of readings.
        readings: u64,
    },
    /// A command arrived from the broker, and was executed or not.
    Command {
        /// The controller.
        controller: String,
        /// The topic of the command.
        topic: String,
        /// The correlation id.
        id: String,
        /// The sender, as claimed in the command; the broker does not report it.
        #[serde(skip_serializing_if = "Option::is_none")]
        origin: Option<String>,
        /// The variable.
        name: String,
        /// The value, as JSON.
        value: String,
        /// The outcome.
        result: CommandResult,
        /// Why it was not executed.
        #[serde(skip_serializing_if = "Option::is_none")]
        reason: Option<String>,
    },
}

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum CommandResult {
    /// The controller wrote the value.
    Done,
    /// The command was not sent to the controller.
    Refused,
    /// The controller refused the value, or there was no connection; the value was not written.
    Failed,
    /// The controller did not answer in time, or another process may have sent the command; the value may have been written.
    Unknown,
    /// A copy of a command that was accepted: it was not sent again, and this is not the result of the first copy.
    Repeated,
}
