//! Tries everything once: the broker, each controller, each variable.

use std::time::{Duration, Instant};

use bcap_std::asynch::Controller;
use rumqttc::{ConnectReturnCode, Event, Packet};
use tokio::task::JoinSet;
use tokio::time::timeout;

use crate::broker::Connector;
use crate::config::{Cell, Config};
use crate::error::Error;
use crate::fleet::settings;
use crate::scan::read;
use crate::stream::StreamCheck;

/// Maximum time of one connection attempt, and of one reading.
const LIMIT: Duration = Duration::from_secs(5);

/// An attempt and its outcome.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Row {
    /// `broker`, or the name of the controller.
    pub name: String,
    /// The address, or the name of the variable.
    pub what: String,
    /// The value as JSON and the time that it took, or why it failed.
    pub result: Result<(String, Duration), String>,
}

/// Connects to the broker and to all controllers, and reads each variable once.
///
/// # Errors
///
/// An [`Error`] for a secret or certificate that cannot be read. All other failures are in the rows.
///
/// # Cancel safety
///
/// Dropping the future closes all connections.
pub async fn check(config: &Config) -> Result<Vec<Row>, Error> {
    let connector = Connector::new(config)?.with_suffix("-check");
    let mut cells = JoinSet::new();
    for (index, cell) in config.controllers.iter().enumerate() {
        let cell = cell.clone();
        cells.spawn(async move { (index, check_cell(&cell).await) });
    }
    let mut rows = vec![check_broker(config, &connector).await];
    let mut results = cells.join_all().await;
    results.sort_by_key(|(index, _)| *index);
    rows.extend(results.into_iter().flat_map(|(_, rows)| rows));
    Ok(rows)
}

/// Reads the secrets and certificates, without connecting.
///
/// # Errors
///
/// An [`Error`] for a secret or certificate that cannot be read.
pub fn check_offline(config: &Config) -> Result<Vec<Row>, Error> {
    Connector::new(config)?;
    let row = |name: &str, what: &str, value: String| Row {
        name: name.into(),
        what: what.into(),
        result: Ok((value, Duration::ZERO)),
    };
    let mut rows = vec![row("broker", &config.broker.host, "not connected".into())];
    let cells = config.controllers.iter();
    rows.extend(cells.map(|cell| row(&cell.name, &cell.address, format!("{} variables", cell.points.len()))));
    Ok(rows)
}

async fn check_broker(config: &Config, connector: &Connector) -> Row {
    let began = Instant::now();
    let mut link = connector.connect(None);
    let result = match timeout(LIMIT, link.events.recv()).await {
        Ok(Some(Ok(Event::Incoming(Packet::ConnAck(ack))))) if ack.code == ConnectReturnCode::Success => {
            Ok(("connected".into(), began.elapsed()))
        }
        Ok(Some(Err(reason))) => Err(reason),
        Ok(other) => Err(format!("unexpected reply: {other:?}")),
        Err(_) => Err(format!("no answer within {} s", LIMIT.as_secs())),
    };
    Row { name: "broker".into(), what: config.broker.host.clone(), result }
}

async fn check_cell(cell: &Cell) -> Vec<Row> {
    let row = |what: &str, result| Row { name: cell.name.clone(), what: what.into(), result };
    let silent = || format!("no answer within {} s", LIMIT.as_secs());
    let began = Instant::now();
    let controller = match timeout(LIMIT, Controller::connect(&cell.address, &settings(cell))).await {
        Ok(Ok(controller)) => controller,
        Ok(Err(error)) => return vec![row(&cell.address, Err(error.to_string()))],
        Err(_) => return vec![row(&cell.address, Err(silent()))],
    };
    let mut rows = vec![row(&cell.address, Ok(("connected".into(), began.elapsed())))];
    let stream = StreamCheck::default();
    for point in &cell.points {
        let began = Instant::now();
        let result = match timeout(LIMIT, read(&controller, &stream, &point.source)).await {
            Ok(Ok(Some(value))) => Ok((serde_json::to_string(&value).unwrap_or_default(), began.elapsed())),
            Ok(Ok(None)) => Err("its value is EMPTY or of a type that cannot be published".into()),
            Ok(Err(error)) => Err(error.to_string()),
            Err(_) => Err(silent()),
        };
        rows.push(row(&point.name, result));
    }
    // the rows say all that matters
    let _ = timeout(LIMIT, controller.close()).await;
    rows
}
