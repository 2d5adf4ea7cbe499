//! The audit log: one JSON object a line for each request of a client, and for each change of the robot's session.
//!
//! | `event`                            | further fields                                             |
//! |------------------------------------|------------------------------------------------------------|
//! | `connected` `disconnected`         | `client`                                                   |
//! | `denied`                           | `client`, `reason`: its address, or no slot is free        |
//! | `served` `failed`                  | `client` `line` `result` `name` `us`: the time it took     |
//! | `refused`                          | `client` `line` `result` `name` `reason`                   |
//! | `robot_up`                         | `robot`                                                    |
//! | `robot_down`                       | `robot` `reason` `retry_ms`                                |
//! | `suppressed`                       | `client` `lines`: number of lines over the rate of this address |
//! | `dropped`                          | `lines`: number of lines that could not be written in time |
//! | `end`                              | `served` `failed` `refused` `sessions` and the times in us |
//!
//! Every object has `time`, in UTC. A successful PUT is always written. All other lines of one IP address are limited by a
//! token bucket; `suppressed` gives the number of lines that exceeded it, at most every 10 s and at the end. Characters that
//! act on a terminal are escaped, because clients choose the text of their lines.

use std::io::{self, Write};
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::time::Duration;

use bcap_capture::times::Times;
use bcap_core::hresult::HResult;
use bcap_core::rac::Verb;
use bcap_gateway::{Counters, Event, RobotError, Tally};
use bcap_std::gateway::{Denial, Report};
use bcap_std::now;
use serde::Serialize;

use crate::events::{self, Log, Writer};
use crate::rotate::Rotating;
use crate::throttle::{Suppressed, Throttle};

/// The content of a line.
#[derive(Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Record {
    Connected { client: String },
    Disconnected { client: String },
    Denied { client: String, reason: &'static str },
    Served(Answer),
    Failed(Answer),
    Refused(Answer),
    RobotUp { robot: String },
    RobotDown { robot: String, reason: String, retry_ms: u64 },
    Suppressed { client: String, lines: u64 },
    End(Totals),
}

/// A line of a client, and its answer.
#[derive(Debug, Serialize)]
struct Answer {
    client: String,
    line: String,
    result: i32,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    us: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

impl Answer {
    /// Describes a line by its received bytes.
    fn new(client: String, line: &[u8], result: HResult) -> Self {
        let line = String::from_utf8_lossy(line).into_owned();
        Self { client, line, result: result.0, name: result.name(), us: None, reason: None }
    }

    fn took(self, time: Duration) -> Self {
        Self { us: Some(micros(time)), ..self }
    }

    fn because(self, reason: String) -> Self {
        Self { reason: Some(reason), ..self }
    }
}

/// The totals at the end.
#[derive(Debug, Serialize)]
struct Totals {
    served: Total,
    failed: Total,
    refused: u32,
    sessions: u32,
}

#[derive(Debug, Serialize)]
struct Total {
    count: u32,
    mean_us: u64,
    p50_us: u64,
    p99_us: u64,
    max_us: u64,
}

impl Total {
    fn new(tally: &Tally, times: &Times) -> Self {
        Self {
            count: tally.count(),
            mean_us: micros(tally.mean()),
            p50_us: times.quantile(500),
            p99_us: times.quantile(990),
            max_us: times.max(),
        }
    }
}

/// Returns the reason why a client was not served.
const fn denial(reason: Denial) -> &'static str {
    match reason {
        Denial::Address => "the rules do not allow this address to connect",
        Denial::Full => "no slot is free",
        _ => "it was not served",
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

/// The limits of an audit log.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Lines a second of one IP address; 0 writes all.
    pub rate: u32,
    /// The maximum size of a file in bytes; 0 for any size.
    pub size: u64,
    /// The number of old files to keep.
    pub keep: u32,
}

/// An audit log.
#[derive(Debug)]
pub struct Audit {
    /// The robot's address.
    robot: String,
    log: Log,
    /// The times of all answers, including answers that are not logged.
    served: Times,
    failed: Times,
    throttle: Throttle<IpAddr>,
    writer: Writer,
}

impl Audit {
    /// Opens the log: `-` is the standard output, a file is appended to.
    ///
    /// # Errors
    ///
    /// When the file cannot be opened, or the thread that writes cannot be started.
    pub fn open(path: &Path, robot: String, bounds: Bounds) -> io::Result<Self> {
        let output: Box<dyn Write + Send> = if path == Path::new("-") {
            Box::new(io::stdout())
        } else {
            let file = Rotating::open(path, bounds.size, bounds.keep);
            let failed =
                |error: io::Error| io::Error::new(error.kind(), format!("cannot write to {}: {error}", path.display()));
            Box::new(file.map_err(failed)?)
        };
        let (log, writer) = events::open(output)?;
        let throttle = Throttle::new(bounds.rate);
        Ok(Self { robot, log, served: Times::new(), failed: Times::new(), throttle, writer })
    }

    /// Writes a report of the gateway, unless its client has exceeded its rate.
    pub fn log(&mut self, report: &Report<'_>) {
        match *report {
            Report::Connected { client } => self.log_client(client, |client| Record::Connected { client }),
            Report::Denied { client, reason } => {
                let reason = denial(reason);
                self.log_client(client, |client| Record::Denied { client, reason });
            }
            Report::Disconnected { client, .. } => self.log_client(client, |client| Record::Disconnected { client }),
            Report::Answered { client, line, event } => self.log_answer(client, line, event),
            Report::Robot { event, cause } => self.log_robot(event, cause),
            _ => {}
        }
        self.report_suppressed();
    }

    fn log_client(&mut self, client: SocketAddr, record: impl FnOnce(String) -> Record) {
        if self.throttle.admits(client.ip().to_canonical(), now()) {
            self.log.write(&record(client.to_string()));
        }
    }

    fn log_answer(&mut self, client: SocketAddr, line: &[u8], event: Event) {
        match event {
            Event::Served { time, .. } => self.served.record(micros(time)),
            Event::Failed { time, .. } => self.failed.record(micros(time)),
            _ => {}
        }
        let answer = |client, result| Answer::new(client, line, result);
        match event {
            // a write has changed the robot, so it is always logged
            Event::Served { request, result, time, .. } if request.verb == Verb::Put => {
                self.log.write(&Record::Served(answer(client.to_string(), result).took(time)));
            }
            Event::Served { result, time, .. } => {
                self.log_client(client, |client| Record::Served(answer(client, result).took(time)));
            }
            Event::Failed { result, time, .. } => {
                self.log_client(client, |client| Record::Failed(answer(client, result).took(time)));
            }
            Event::Refused { refusal, .. } => self.log_client(client, |client| {
                Record::Refused(answer(client, refusal.hresult()).because(refusal.to_string()))
            }),
            // it is not about a line
            _ => {}
        }
    }

    fn log_robot(&mut self, event: Event, cause: Option<&io::Error>) {
        let robot = self.robot.clone();
        match event {
            Event::RobotUp => self.log.write(&Record::RobotUp { robot }),
            Event::RobotDown { error, pause } => {
                let reason = match (error, cause) {
                    (RobotError::Closed, Some(cause)) => cause.to_string(),
                    (error, _) => error.to_string(),
                };
                let retry_ms = u64::try_from(pause.as_millis()).unwrap_or(u64::MAX);
                self.log.write(&Record::RobotDown { robot, reason, retry_ms });
            }
            // it is not about the robot
            _ => {}
        }
    }

    /// Writes the counts of suppressed lines whose interval has ended.
    pub fn report_suppressed(&mut self) {
        let counts = self.throttle.take_expired(now());
        self.write_suppressed(counts);
    }

    fn write_suppressed(&mut self, suppressed: Vec<Suppressed<IpAddr>>) {
        for Suppressed { source: client, lines } in suppressed {
            let client = client.map_or_else(|| "others".to_owned(), |client| client.to_string());
            self.log.write(&Record::Suppressed { client, lines });
        }
    }

    /// Writes the totals and waits for the writer.
    pub fn close(mut self, counters: &Counters) {
        let suppressed = self.throttle.take();
        self.write_suppressed(suppressed);
        let totals = Totals {
            served: Total::new(&counters.served, &self.served),
            failed: Total::new(&counters.failed, &self.failed),
            refused: counters.refused,
            sessions: counters.connected,
        };
        self.log.write(&Record::End(totals));
        drop(self.log);
        self.writer.finish();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_client_request_and_result() {
        let answer = Answer::new("10.0.0.2:40000".into(), b"GET:RC8:1:I:\xff", HResult::E_ACCESSDENIED);
        let record = Record::Refused(answer.because("not today".into()));
        let expected = "{\"event\":\"refused\",\"client\":\"10.0.0.2:40000\",\"line\":\"GET:RC8:1:I:\u{fffd}\",\
                        \"result\":-2147024891,\"name\":\"E_ACCESSDENIED\",\"reason\":\"not today\"}";
        assert_eq!(serde_json::to_string(&record).unwrap(), expected);
    }
}
