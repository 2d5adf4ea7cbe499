//! The health of a gateway board, as a page and as JSON.
//!
//! ```text
//!  /             a page for people, which reloads itself every 5 s
//!  /health.json  the same for programs
//!  /rules        what PLCs may read and write
//!  /log          the last messages
//!  /settings     the settings, with a password only
//! ```
//!
//! The others are read-only. They show no other settings, because any client that can reach the port can read them.

use core::fmt::{self, Write};
use core::time::Duration;

use bcap_core::time::micros;
use bcap_gateway::{Counters, Tally};

/// The maximum size of a page in bytes; a test makes the longest one.
pub const LONGEST: usize = 2368;

/// The running version, and the outcome of the last update ([`update::Status`](crate::update::Status)).
#[derive(Clone, Copy)]
pub struct Update<'a> {
    /// The name of the board.
    pub board: &'a str,
    /// The version of the image that runs.
    pub version: &'a str,
    /// The outcome of the last update.
    pub phase: &'a dyn fmt::Display,
    /// The version of the last update; empty without one.
    pub last: &'a str,
    /// Why it was rolled back; empty otherwise.
    pub reason: &'a str,
}

impl fmt::Debug for Update<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Update").field("board", &self.board).field("version", &self.version).finish_non_exhaustive()
    }
}

/// The content of a board's page.
#[derive(Clone, Copy)]
pub struct Health<'a> {
    /// The name of the image.
    pub image: &'a str,
    /// The version of the image.
    pub version: &'a str,
    /// The state of updates, for an image that receives them.
    pub update: Option<Update<'a>>,
    /// The time since the start.
    pub uptime: Duration,
    /// The cause of the last reset, with the fault if there was one.
    pub last_reset: &'a dyn fmt::Display,
    /// Whether there is a session with the robot.
    pub robot_is_up: bool,
    /// The number of clients, and the number of slots for them.
    pub sessions: (usize, usize),
    /// The counters of the gateway.
    pub counters: &'a Counters,
    /// Memory: its name, the most bytes that were in use, its size in bytes.
    pub memory: &'a [(&'a str, usize, usize)],
    /// Further counters of the board, such as received frames.
    pub board: &'a [(&'a str, u32)],
}

impl fmt::Debug for Health<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Health").field("image", &self.image).field("uptime", &self.uptime).finish_non_exhaustive()
    }
}

impl Health<'_> {
    /// Writes the JSON object.
    ///
    /// # Errors
    ///
    /// When `out` has no room for it.
    pub fn write_json(&self, out: &mut dyn Write) -> fmt::Result {
        let Self { image, version, counters, sessions: (used, slots), .. } = *self;
        let state = if self.robot_is_up { "up" } else { "down" };
        write!(out, "{{\"image\":\"{}\",\"version\":\"{}\"", Json(&image), Json(&version))?;
        if let Some(Update { board, version, phase, last, reason }) = &self.update {
            write!(out, ",\"update\":{{\"board\":\"{}\",\"version\":\"{}\"", Json(board), Json(version))?;
            write!(out, ",\"phase\":\"{}\",\"last\":\"{}\"", Json(phase), Json(last))?;
            write!(out, ",\"reason\":\"{}\"}}", Json(reason))?;
        }
        write!(out, ",\"uptime_s\":{},\"last_reset\":\"{}\"", self.uptime.as_secs(), Json(&self.last_reset))?;
        write!(out, ",\"robot\":{{\"state\":\"{state}\",\"sessions\":{}}}", counters.connected)?;
        write!(out, ",\"clients\":{{\"connected\":{used},\"slots\":{slots}}}")?;
        write!(out, ",\"requests\":{{\"refused\":{}", counters.refused)?;
        for (name, tally) in [("served", &counters.served), ("failed", &counters.failed)] {
            write!(out, ",\"{name}\":")?;
            write_tally(tally, out)?;
        }
        out.write_str("},\"memory\":{")?;
        for (at, (name, most, size)) in self.memory.iter().enumerate() {
            write!(out, "{}\"{}\":{{\"most\":{most},\"size\":{size}}}", comma(at), Json(name))?;
        }
        out.write_str("},\"board\":{")?;
        for (at, (name, count)) in self.board.iter().enumerate() {
            write!(out, "{}\"{}\":{count}", comma(at), Json(name))?;
        }
        out.write_str("}}\n")
    }

    /// Writes the page.
    ///
    /// # Errors
    ///
    /// When `out` has no room for it.
    pub fn write_page(&self, out: &mut dyn Write) -> fmt::Result {
        let Self { image, version, counters, sessions: (used, slots), .. } = *self;
        out.write_str("<!DOCTYPE html><html lang=en><meta charset=utf-8><meta http-equiv=refresh content=5>")?;
        write!(out, "<title>{0}</title><h1>{0} {1}</h1><table>", Html(&image), Html(&version))?;
        row(out, &"robot", &if self.robot_is_up { "up" } else { "down" })?;
        row(out, &"sessions with the robot", &counters.connected)?;
        row(out, &"clients", &format_args!("{used} of {slots}"))?;
        for (name, tally) in [("served", &counters.served), ("failed", &counters.failed)] {
            let [p50, p99, most] = times(tally);
            row(out, &name, &format_args!("{}, p50 {p50} us, p99 {p99} us, longest {most} us", tally.count()))?;
        }
        row(out, &"refused", &counters.refused)?;
        row(out, &"uptime", &format_args!("{} s", self.uptime.as_secs()))?;
        row(out, &"last reset", &self.last_reset)?;
        if let Some(Update { board, version, phase, last, reason }) = &self.update {
            row(out, &"update", &format_args!("{board} {version} {phase}"))?;
            row(out, &"last update", last)?;
            if !reason.is_empty() {
                row(out, &"reason of the roll-back", reason)?;
            }
        }
        for (name, most, size) in self.memory {
            row(out, name, &format_args!("{most} of {size} bytes at most"))?;
        }
        for (name, count) in self.board {
            row(out, name, count)?;
        }
        out.write_str("</table><p><a href=health.json>JSON</a> <a href=rules>Rules</a> <a href=log>Log</a> <a href=settings>Settings</a>\n")
    }
}

fn row(out: &mut dyn Write, name: &dyn fmt::Display, value: &dyn fmt::Display) -> fmt::Result {
    write!(out, "<tr><td>{}<td>{}", Html(name), Html(value))
}

fn comma(at: usize) -> &'static str {
    if at == 0 { "" } else { "," }
}

/// Returns the median, the 99th percentile and the longest time, in microseconds.
fn times(tally: &Tally) -> [u64; 3] {
    [tally.percentile(50), tally.percentile(99), tally.max()].map(micros)
}

fn write_tally(tally: &Tally, out: &mut dyn Write) -> fmt::Result {
    let [p50, p99, most] = times(tally);
    write!(out, "{{\"count\":{},\"p50_us\":{p50},\"p99_us\":{p99},\"max_us\":{most}}}", tally.count())
}

/// A text inside a string of JSON.
struct Json<'a>(&'a dyn fmt::Display);

impl fmt::Display for Json<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            Escaped {
                out: f,
                escape: |c| match c {
                    '"' => Some("\\\""),
                    '\\' => Some("\\\\"),
                    '\n' => Some("\\n"),
                    c if c.is_control() => Some(" "),
                    _ => None,
                }
            },
            "{}",
            self.0
        )
    }
}

/// A text inside HTML.
pub(crate) struct Html<'a>(pub(crate) &'a dyn fmt::Display);

impl fmt::Display for Html<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            Escaped {
                out: f,
                escape: |c| match c {
                    '<' => Some("&lt;"),
                    '>' => Some("&gt;"),
                    '&' => Some("&amp;"),
                    _ => None,
                }
            },
            "{}",
            self.0
        )
    }
}

/// Escapes characters of the text.
struct Escaped<'a, 'f> {
    out: &'a mut fmt::Formatter<'f>,
    escape: fn(char) -> Option<&'static str>,
}

impl Write for Escaped<'_, '_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        text.chars().try_for_each(|c| match (self.escape)(c) {
            Some(escaped) => self.out.write_str(escaped),
            None => self.out.write_char(c),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    const ROLLED_BACK: Update<'_> = Update {
        board: "pico",
        version: "0.1.0",
        phase: &"rolled back",
        last: "0.2.0",
        reason: "panic at \"a<b\".rs:7",
    };

    fn counters(refused: u32, connected: u32) -> Counters {
        let mut counters = Counters::default();
        (counters.refused, counters.connected) = (refused, connected);
        counters
    }

    fn written(update: Option<Update<'_>>, write: impl Fn(&Health<'_>, &mut dyn Write) -> fmt::Result) -> String {
        let counters = counters(3, 2);
        let health = Health {
            image: "gateway",
            version: "0.1.0",
            update,
            uptime: Duration::from_secs(90),
            last_reset: &"panic at \"a<b\".rs:7",
            robot_is_up: true,
            sessions: (1, 4),
            counters: &counters,
            memory: &[("stack", 6520, 12_288), ("log", 0, 4096)],
            board: &[("frames received", 45)],
        };
        let mut out = String::new();
        write(&health, &mut out).unwrap();
        out
    }

    #[test]
    fn json_has_every_figure() {
        let none = "{\"count\":0,\"p50_us\":0,\"p99_us\":0,\"max_us\":0}";
        let expected = [
            r#"{"image":"gateway","version":"0.1.0","uptime_s":90,"last_reset":"panic at \"a<b\".rs:7""#,
            r#","robot":{"state":"up","sessions":2},"clients":{"connected":1,"slots":4},"requests":{"refused":3,"served":"#,
            none,
            r#","failed":"#,
            none,
            r#"},"memory":{"stack":{"most":6520,"size":12288},"log":{"most":0,"size":4096}},"board":{"frames received":45}}"#,
            "\n",
        ];
        assert_eq!(written(None, |health, out| health.write_json(out)), expected.concat());
    }

    #[test]
    fn the_longest_page_fits() {
        // a name has at most 32 bytes, a version 20, and the reason is a part of a record of 160
        let (name, version, text) = ("n".repeat(32), "1".repeat(20), "<".repeat(100));
        let update = Update { board: &name, version: &version, phase: &"rolled back", last: &version, reason: &text };
        let counters = counters(u32::MAX, u32::MAX);
        let health = Health {
            image: "gateway",
            version: &version,
            update: Some(update),
            uptime: Duration::from_secs(u32::MAX.into()),
            last_reset: &text,
            robot_is_up: false,
            sessions: (7, 7),
            counters: &counters,
            memory: &[("robot receive buffer", 100_000, 100_000); 6],
            board: &[("a counter of this board", u32::MAX); 8],
        };
        let (mut page, mut json) = (String::new(), String::new());
        health.write_page(&mut page).unwrap();
        health.write_json(&mut json).unwrap();
        // the counts and the six times of requests are zero here, and have up to ten digits
        let longest = page.len().max(json.len()) + 8 * 9;
        assert!((LONGEST / 2..=LONGEST).contains(&longest), "{longest}");
    }

    #[test]
    fn the_page_escapes_texts() {
        let page = written(None, |health, out| health.write_page(out));
        assert!(page.contains("<tr><td>last reset<td>panic at \"a&lt;b\".rs:7<tr>"), "{page}");
        assert!(
            page.contains("<tr><td>clients<td>1 of 4<tr>") && page.contains("<tr><td>uptime<td>90 s<tr>"),
            "{page}"
        );
        assert!(page.contains("<tr><td>stack<td>6520 of 12288 bytes at most<tr>"), "{page}");
    }

    #[test]
    fn an_image_with_updates_shows_their_state() {
        let json = written(Some(ROLLED_BACK), |health, out| health.write_json(out));
        let expected = concat!(
            r#","version":"0.1.0","update":{"board":"pico","version":"0.1.0","phase":"rolled back","last":"0.2.0","#,
            r#""reason":"panic at \"a<b\".rs:7"},"uptime_s":90,"#
        );
        assert!(json.contains(expected), "{json}");
        let page = written(Some(ROLLED_BACK), |health, out| health.write_page(out));
        assert!(
            page.contains(
                "<tr><td>update<td>pico 0.1.0 rolled back<tr><td>last update<td>0.2.0\
                 <tr><td>reason of the roll-back<td>panic at \"a&lt;b\".rs:7<tr>"
            ),
            "{page}"
        );
        let confirmed = Update { phase: &"confirmed", reason: "", ..ROLLED_BACK };
        let page = written(Some(confirmed), |health, out| health.write_page(out));
        assert!(page.contains("<td>pico 0.1.0 confirmed<tr>") && !page.contains("roll-back"), "{page}");
    }
}
