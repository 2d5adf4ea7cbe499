//! The configuration: a file in TOML. docs/fleet.md describes it.

use std::collections::HashSet;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use bcap_gateway::AllowBuf;
use bcap_std::{Address, Model};
use serde::Deserialize;

use crate::error::Error;
use crate::point::{Point, Publish, points};

/// The configuration of a fleet.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    pub(crate) group: String,
    pub(crate) node: String,
    #[serde(default)]
    pub(crate) format: Format,
    /// The id of the Sparkplug host. While it is offline, nothing is published.
    pub(crate) primary_host: Option<String>,
    pub(crate) broker: Broker,
    pub(crate) buffer: Option<Buffer>,
    pub(crate) metrics: Option<MetricsEndpoint>,
    pub(crate) standby: Option<Standby>,
    #[serde(default)]
    pub(crate) commands: Commands,
    #[serde(rename = "controller")]
    pub(crate) controllers: Vec<Cell>,
}

/// The form in which the broker gets readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Format {
    #[default]
    Json,
    Sparkplug,
}

/// How to connect to the broker.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Broker {
    pub(crate) host: String,
    pub(crate) port: Option<u16>,
    pub(crate) client_id: Option<String>,
    #[serde(default = "keep_alive")]
    pub(crate) keep_alive_seconds: u16,
    pub(crate) user: Option<String>,
    pub(crate) password_file: Option<PathBuf>,
    pub(crate) password_env: Option<String>,
    pub(crate) tls: Option<Tls>,
}

/// Certificates in PEM.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(not(feature = "tls"), allow(dead_code, reason = "only encrypted connections use them"))]
pub(crate) struct Tls {
    /// The authorities that sign the broker's certificate; by default the authorities of the operating system.
    pub(crate) ca: Option<PathBuf>,
    pub(crate) certificate: Option<PathBuf>,
    pub(crate) key: Option<PathBuf>,
}

/// The buffer on disk while the broker is disconnected.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Buffer {
    pub(crate) directory: PathBuf,
    #[serde(default = "buffer_mib")]
    pub(crate) mib: u32,
    #[serde(default = "buffer_hours")]
    pub(crate) hours: u32,
}

/// Where metrics are served.
#[derive(Clone, Debug, Deserialize)]
// its name in errors
#[serde(deny_unknown_fields, expecting = "struct Metrics")]
pub(crate) struct MetricsEndpoint {
    #[serde(default = "loopback")]
    pub(crate) address: IpAddr,
    pub(crate) port: u16,
}

/// The division of work between several processes of a node.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Standby {
    /// The time without a message of the active process after which another process takes over.
    #[serde(default = "after_ms")]
    after_ms: u64,
}

impl Standby {
    pub(crate) const fn after(&self) -> Duration {
        Duration::from_millis(self.after_ms)
    }
}

/// The permissions of commands from the broker.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Commands {
    #[serde(default)]
    pub(crate) allow: Vec<Rule>,
    /// The commands a second for each controller.
    #[serde(default = "per_second")]
    pub(crate) per_second: u32,
    /// Maximum time between the arrival of a command and its expiry.
    #[serde(default = "longest_seconds")]
    pub(crate) longest_seconds: u32,
}

impl Default for Commands {
    fn default() -> Self {
        Self { allow: Vec::new(), per_second: per_second(), longest_seconds: longest_seconds() }
    }
}

/// A rule in the grammar of the gateway.
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct Rule(pub(crate) AllowBuf);

impl TryFrom<String> for Rule {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        AllowBuf::parse(&text).map(Self).map_err(|error| format!("the rule {text:?}: {error}"))
    }
}

/// A controller.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Cell {
    pub(crate) name: String,
    pub(crate) address: String,
    #[serde(default)]
    pub(crate) model: ModelName,
    #[serde(default)]
    publish: Vec<Publish>,
    /// The published items.
    #[serde(skip)]
    pub(crate) points: Vec<Point>,
}

/// A model, as `bcap --model` names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum ModelName {
    #[default]
    Rc8,
    Rc9,
    Cobotta,
}

impl From<ModelName> for Model {
    fn from(name: ModelName) -> Self {
        match name {
            ModelName::Rc8 => Self::Rc8,
            ModelName::Rc9 => Self::Rc9,
            ModelName::Cobotta => Self::Cobotta,
        }
    }
}

const fn keep_alive() -> u16 {
    15
}

const fn buffer_mib() -> u32 {
    64
}

const fn buffer_hours() -> u32 {
    72
}

const fn loopback() -> IpAddr {
    IpAddr::V4(Ipv4Addr::LOCALHOST)
}

const fn after_ms() -> u64 {
    2000
}

const fn per_second() -> u32 {
    10
}

const fn longest_seconds() -> u32 {
    10
}

impl Config {
    /// Reads and checks a file.
    ///
    /// # Errors
    ///
    /// [`Error::Read`]; [`Error::Config`] with the place of the fault.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Self::parse(&text).map_err(|error| Error::Config(format!("{}: {error}", path.display())))
    }

    /// Parses and checks the text of a file.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] with the place of the fault.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let mut config: Self = toml::from_str(text).map_err(|error| Error::Config(describe(text, &error)))?;
        config.check().map_err(Error::Config)?;
        Ok(config)
    }

    /// Returns the number of controllers.
    #[must_use]
    pub fn controllers(&self) -> usize {
        self.controllers.len()
    }

    fn check(&mut self) -> Result<(), String> {
        name("group", &self.group)?;
        name("node", &self.node)?;
        if let Some(host) = &self.primary_host {
            name("primary_host", host)?;
            if self.format != Format::Sparkplug {
                return Err("primary_host needs format = \"sparkplug\"".into());
            }
        }
        self.broker.check()?;
        if let Some(Standby { after_ms }) = self.standby {
            if !(200..=60_000).contains(&after_ms) {
                return Err(format!("[standby]: after_ms {after_ms}: expected 200 to 60000"));
            }
            if self.broker.client_id.is_some() {
                return Err(
                    "[standby]: remove client_id from [broker]; all processes of a node need the same one".into()
                );
            }
        }
        if self.commands.longest_seconds == 0 {
            return Err("[commands]: longest_seconds must be 1 or more".into());
        }
        if self.controllers.is_empty() {
            return Err("there is no [[controller]]".into());
        }
        let mut names = HashSet::from([self.node.clone()]);
        for (number, cell) in (1..).zip(&mut self.controllers) {
            let place = |error| format!("[[controller]] number {number}, {error}");
            if self.format == Format::Sparkplug && cell.publish.iter().any(Publish::is_joined) {
                return Err(place(format!(
                    "{}: joined needs format = \"json\"; Sparkplug joins readings anyway",
                    cell.name
                )));
            }
            if !names.insert(cell.name.clone()) {
                return Err(place(format!("name {:?}: another controller or the node has this name", cell.name)));
            }
            cell.check().map_err(place)?;
        }
        Ok(())
    }

    /// Returns the address for metrics.
    pub(crate) fn metrics_address(&self) -> Option<SocketAddr> {
        self.metrics.as_ref().map(|metrics| SocketAddr::new(metrics.address, metrics.port))
    }
}

impl Broker {
    fn check(&self) -> Result<(), String> {
        if self.password_file.is_some() && self.password_env.is_some() {
            return Err("[broker]: give password_file or password_env, not both".into());
        }
        if self.user.is_none() && (self.password_file.is_some() || self.password_env.is_some()) {
            return Err("[broker]: a password needs a user".into());
        }
        if self.keep_alive_seconds < 2 {
            return Err("[broker]: keep_alive_seconds must be 2 or more".into());
        }
        match &self.tls {
            Some(_) if cfg!(not(feature = "tls")) => Err("[broker.tls]: this program was built without TLS".into()),
            Some(tls) if tls.certificate.is_some() != tls.key.is_some() => {
                Err("[broker.tls]: a client needs both certificate and key".into())
            }
            _ => Ok(()),
        }
    }
}

impl Cell {
    fn check(&mut self) -> Result<(), String> {
        name("name", &self.name)?;
        let address: Result<Address, _> = self.address.parse();
        address.map_err(|error| format!("{}: {error}", self.name))?;
        for publish in &self.publish {
            self.points.extend(points(publish).map_err(|error| format!("{}: {error}", self.name))?);
        }
        let mut names = HashSet::new();
        match self.points.iter().find(|point| !names.insert(&point.name)) {
            Some(twice) => Err(format!("{}: {} is published twice", self.name, twice.name)),
            None => Ok(()),
        }
    }
}

/// Describes an error with its line number. The text of the line may be a secret, so it is left out.
fn describe(text: &str, error: &toml::de::Error) -> String {
    let before = error.span().and_then(|span| text.get(..span.start));
    let place = before.map(|before| format!("line {}: ", before.matches('\n').count() + 1)).unwrap_or_default();
    format!("{place}{}", error.message())
}

/// Checks a name that becomes a level of a topic.
fn name(key: &str, name: &str) -> Result<(), String> {
    let wrong = |c: char| c.is_control() || "/+#$".contains(c);
    if name.is_empty() || name.contains(wrong) {
        return Err(format!("{key} {name:?}: a name has at least one character, and none of / + # $"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = "group = \"plant\"\nnode = \"edge1\"\n[broker]\nhost = \"127.0.0.1\"\n\
        [[controller]]\nname = \"cell1\"\naddress = \"tcp:127.0.0.1:5007\"\n";

    #[test]
    fn a_small_file_has_defaults() {
        let config = Config::parse(SMALL).unwrap();
        assert_eq!(config.format, Format::Json);
        assert!(config.commands.allow.is_empty() && config.metrics_address().is_none() && config.buffer.is_none());
        assert_eq!(config.controllers(), 1);
    }

    #[test]
    fn an_error_does_not_print_the_line() {
        for line in ["password = \"hunter2\"", "password = \"hunter2", "password = hunter2", "user = [\"hunter2\"]"] {
            let text = SMALL.replace("[[controller]]", &format!("{line}\n[[controller]]"));
            let error = Config::parse(&text).unwrap_err().to_string();
            assert!(error.contains("line 5") && !error.contains("hunter2"), "{line}: {error}");
        }
    }

    #[test]
    fn an_error_says_what_is_wrong_and_where() {
        let publish = |text: &str| format!("{SMALL}[[controller.publish]]\n{text}\n");
        for (text, word) in [
            (format!("{SMALL}colour = 1\n"), "colour"),
            (format!("{SMALL}colour = 1\n"), "line 8"),
            (SMALL.replace("edge1", "a/b"), "node \"a/b\""),
            (SMALL.replace("tcp:127", "tpc:127"), "[[controller]] number 1, cell1"),
            (SMALL.replace("cell1", "edge1"), "another controller or the node has this name"),
            (
                SMALL.replace(
                    "[[controller]]",
                    "user = \"a\"\npassword_file = \"a\"\npassword_env = \"b\"\n[[controller]]",
                ),
                "not both",
            ),
            (
                SMALL.replace("[[controller]]", "[commands]\nallow = [\"X\"]\n[[controller]]"),
                "the rule \"X\": unknown kind",
            ),
            (format!("primary_host = \"scada\"\n{SMALL}"), "primary_host needs format"),
            (SMALL.replace("[[controller]]", "[standby]\nafter_ms = 199\n[[controller]]"), "200 to 60000"),
            (SMALL.replace("[[controller]]", "client_id = \"a\"\n[standby]\n[[controller]]"), "remove client_id"),
            (publish("names = [\"I5-1\"]"), "I5-1"),
            (publish("names = [\"I1\", \"I0-3\"]"), "I1 is published twice"),
            (publish("names = [\"I1\"]\ninterval_ms = 0"), "interval_ms"),
            (publish("names = [\"I1\"]\ndead_band = -1.0"), "dead_band"),
            (publish("names = [\"robot/#\"]"), "robot/#"),
            (publish("names = [\"values\"]"), "values"),
            (
                format!("format = \"sparkplug\"\n{}", publish("names = [\"I1\"]\njoined = true")),
                "joined needs format = \"json\"",
            ),
        ] {
            let error = Config::parse(&text).unwrap_err().to_string();
            assert!(error.contains(word), "{text}: {error}");
        }
    }
}
