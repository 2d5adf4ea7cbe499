//! The published points of a controller: variables, ranges of them, and readings of the robot.

use std::time::Duration;

use bcap_core::rac::VariableKind;
use serde::Deserialize;

/// Variables that are published in the same way.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Publish {
    names: Vec<String>,
    #[serde(default = "interval")]
    interval_ms: u64,
    /// The change of a number below which it counts as equal.
    #[serde(default)]
    dead_band: f64,
    /// Whether equal readings are left out.
    #[serde(default = "yes")]
    on_change: bool,
    /// Whether readings of the same scan share a message of JSON.
    #[serde(default)]
    joined: bool,
}

impl Publish {
    pub(crate) const fn is_joined(&self) -> bool {
        self.joined
    }

    const fn interval(&self) -> Duration {
        Duration::from_millis(self.interval_ms)
    }
}

const fn interval() -> u64 {
    1000
}

const fn yes() -> bool {
    true
}

/// One thing that is read of a controller.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Point {
    /// The last levels of its topic.
    pub(crate) name: String,
    pub(crate) source: Source,
    /// `None` for system variables.
    pub(crate) kind: Option<VariableKind>,
    pub(crate) interval: Duration,
    pub(crate) dead_band: f64,
    pub(crate) on_change: bool,
    pub(crate) joined: bool,
}

/// The source of a reading.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// A variable of the controller.
    Controller(String),
    /// A variable of the robot.
    Robot(String),
    /// CurPos.
    Pose,
    /// CurJnt.
    Joints,
    /// The status of a task.
    Task(String),
    /// The statuses of all tasks.
    Tasks,
}

impl Source {
    /// Returns the name of a variable of the controller.
    pub(crate) fn variable(&self) -> Option<&str> {
        match self {
            Self::Controller(name) => Some(name),
            _ => None,
        }
    }
}

/// The maximum number of variables of a range.
const LONGEST: u32 = 10_000;

/// Maximum interval.
const DAY: Duration = Duration::from_secs(86_400);

/// Returns the points of a table `publish`.
pub(crate) fn points(publish: &Publish) -> Result<Vec<Point>, String> {
    if publish.interval().is_zero() || publish.interval() > DAY {
        return Err(format!("interval_ms {}: expected 1 to {}", publish.interval_ms, DAY.as_millis()));
    }
    if !(publish.dead_band.is_finite() && publish.dead_band >= 0.0) {
        return Err(format!("dead_band {}: expected a number that is 0 or more", publish.dead_band));
    }
    let mut points = Vec::new();
    for text in &publish.names {
        for (name, source, kind) in named(text)? {
            let Publish { dead_band, on_change, joined, .. } = *publish;
            points.push(Point { name, source, kind, interval: publish.interval(), dead_band, on_change, joined });
        }
    }
    Ok(points)
}

/// Returns the points that a name of the file stands for.
fn named(text: &str) -> Result<Vec<(String, Source, Option<VariableKind>)>, String> {
    let one = |name: &str, source, kind| Ok(vec![(name.to_owned(), source, kind)]);
    match text {
        "pose" => return one("pose", Source::Pose, Some(VariableKind::P)),
        "joints" => return one("joints", Source::Joints, Some(VariableKind::J)),
        "mode" => return one("mode", Source::Controller("@MODE".into()), None),
        "tasks" => return one("tasks", Source::Tasks, None),
        "state" | "command" | "answer" | "values" => {
            return Err(format!("{text:?} is a topic of its own; it cannot be a variable"));
        }
        "error" => return one("error", Source::Controller("@ERROR_CODE".into()), None),
        _ => {}
    }
    let wrong = |c: char| c.is_control() || c.is_whitespace() || "+#/".contains(c);
    let (source, name): (fn(String) -> Source, _) = match text.split_once('/') {
        Some(("robot", name)) => (Source::Robot, name),
        Some(("task", name)) => (Source::Task, name),
        _ => (Source::Controller, text),
    };
    if name.is_empty() || name.contains(wrong) {
        return Err(format!(
            "{text:?}: expected a variable (I1, @MODE, robot/@SERVO_ON), a range (I1-9), pose, joints, mode, error, task/NAME \
             or tasks"
        ));
    }
    if text.starts_with("task/") {
        return one(text, source(name.to_owned()), None);
    }
    let digits = name.find(|c: char| c.is_ascii_digit()).unwrap_or(name.len());
    let (letters, index) = name.split_at(digits);
    let kind = VariableKind::from_name(letters).filter(|_| !index.is_empty());
    let Some((first, last)) = index.split_once('-').filter(|_| kind.is_some()) else {
        return one(text, source(name.to_owned()), kind);
    };
    let invalid = || format!("invalid range {text}: expected FIRST-LAST, at most {LONGEST} variables");
    let (first, last): (u32, u32) =
        first.parse().ok().zip(last.trim_start_matches(letters).parse().ok()).ok_or_else(invalid)?;
    if first > last || last - first >= LONGEST {
        return Err(invalid());
    }
    Ok((first..=last).map(|index| format!("{letters}{index}")).map(|name| (name.clone(), source(name), kind)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_stands_for_its_variables() {
        let names = |text| named(text).unwrap().into_iter().map(|(name, ..)| name).collect::<Vec<_>>();
        assert_eq!(names("I8-10"), ["I8", "I9", "I10"]);
        assert_eq!(names("robot/@SERVO_ON"), ["robot/@SERVO_ON"]);
        assert_eq!(
            named("IO128").unwrap(),
            [("IO128".into(), Source::Controller("IO128".into()), Some(VariableKind::Io))]
        );
        // a task may have the name of a variable
        assert_eq!(named("task/I1").unwrap(), [("task/I1".into(), Source::Task("I1".into()), None)]);
        assert_eq!(named("@CURRENT_TIME").unwrap()[0].2, None);
        assert!(named("I3-1").is_err() && named("I 1").is_err() && named("").is_err() && named("I0-99999").is_err());
    }

    #[test]
    fn a_name_that_no_command_could_write_is_refused_at_start() {
        for name in ["P/5", "I/1", "robot/P/5", "task/a/b", "I1/", "/I1", "I+1", "I#"] {
            let error = named(name).unwrap_err();
            assert!(error.starts_with(&format!("{name:?}: expected a variable (I1, ")), "{error}");
        }
    }
}
