//! `bcap-fleet CONFIG --check`: tries the broker, each controller and each variable once.

use std::time::Duration;

use bcap_fleet::{Config, Row};
use serde::Serialize;

use crate::failure::Failure;
use crate::output::{print_json, print_line};
use crate::runtime;

/// A row as JSON.
#[derive(Serialize)]
struct RowLine<'a> {
    name: &'a str,
    what: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    us: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'a str>,
}

impl<'a> From<&'a Row> for RowLine<'a> {
    fn from(row: &'a Row) -> Self {
        let us = |time: &Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        let ok = row.result.as_ref().ok();
        Self {
            name: &row.name,
            what: &row.what,
            value: ok.map(|(value, _)| value.as_str()),
            us: ok.map(|(_, time)| us(time)),
            error: row.result.as_ref().err().map(String::as_str),
        }
    }
}

/// Prints the rows as a table, or as JSON.
pub(crate) fn check(config: &Config, offline: bool, json: bool) -> Result<(), Failure> {
    let rows = match offline {
        true => bcap_fleet::check_offline(config)?,
        false => runtime()?.block_on(bcap_fleet::check(config))?,
    };
    if json {
        rows.iter().try_for_each(|row| print_json(&RowLine::from(row)))?;
    } else {
        print_table(&rows)?;
    }
    let failed = rows.iter().filter(|row| row.result.is_err()).count();
    if failed == 0 { Ok(()) } else { Err(Failure::Checks { failed, total: rows.len() }) }
}

fn print_table(rows: &[Row]) -> std::io::Result<()> {
    let width = |of: fn(&Row) -> &str| rows.iter().map(|row| of(row).chars().count()).max().unwrap_or(0);
    let (names, whats) = (width(|row| &row.name), width(|row| &row.what));
    rows.iter().try_for_each(|Row { name, what, result, .. }| {
        let result = match result {
            Ok((value, time)) => format!("ok    {:>8.1} ms  {value}", time.as_secs_f64() * 1000.0),
            Err(error) => format!("error {error}"),
        };
        print_line(&format!("{name:names$}  {what:whats$}  {result}"))
    })
}
