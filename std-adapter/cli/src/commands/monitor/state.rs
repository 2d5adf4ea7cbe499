//! The state of `bcap monitor`, and the effects of its keys. The state reads neither the clock nor the terminal.

use std::collections::BTreeSet;
use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_live::errors::{described, short};
use bcap_live::model::{self, Model, Robot, Variable};
use bcap_live::write::Write;
use bcap_terminal::screen::{KeyCode, KeyEvent, KeyModifiers, Line, Mark, Panel, Part, Screen};

use crate::commands::screen::{calls_panel, log_key, log_panel, numbered, robot_lines};
use crate::failure::{Failure, hint_of};
use bcap_capture::value::data;

const KEYS: &str = "q quit  h HALT  w write  ? keys  Tab panel  Enter details  / filter  s sort";

/// All keys, as in the help of the command.
pub(crate) const ALL_KEYS: &str = "\
\x20 q, Ctrl-C            quits
  h, H, Ctrl-X         halts the robot at once; Ctrl-X also at a question
  w                    writes a variable: NAME=VALUE, then y; Esc cancels
  u                    writes what the last write replaced; asks, too
  Tab                  moves to the next panel
  Up, Down, Home, End  selects a line of the panel
  Enter                shows the whole line; of an error the remedy
  /                    shows names that have a text; Esc ends that
  Esc                  removes the message of a halt that failed
  Space                marks a variable: it moves to the top
  o                    shows each function and object once: count, rate
  s                    sorts the variables by last change, or as given
  a                    shows all packets, or only changed replies
  p                    pauses the packets
  ?                    shows the keys";

/// The panels, in the order of Tab.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Focus {
    #[default]
    Variables,
    Tasks,
    Errors,
    Messages,
    Packets,
}

/// The state of the monitor.
#[derive(Debug, Default)]
pub(crate) struct MonitorState {
    address: String,
    model: Model,
    /// The names of the variables that the user has marked.
    marked: BTreeSet<String>,
    focus: Focus,
    /// The selected line of the panel.
    selected: usize,
    /// The text that the names of the variables must have.
    filter: String,
    sorts_by_change: bool,
    /// Whether the calls by object are shown in place of the variables.
    shows_calls: bool,
    input: Input,
    /// Whether a value that the user typed is being checked. A halt and a lost connection cancel the check, because its
    /// question would be too late.
    checks: bool,
    notice: Line,
    /// The outcome of the last halt, if it failed. It stays on the screen until a halt succeeds or the user presses Esc.
    not_halted: Option<String>,
    /// A long text in place of the panels.
    overlay: Option<Panel>,
    /// The name and the value that the last write replaced.
    undo: Option<(String, String)>,
}

/// The text that the user is typing.
#[derive(Debug, Default)]
enum Input {
    #[default]
    None,
    /// `NAME=VALUE`.
    Editing(String),
    /// The text of the filter is edited in place.
    Filtering,
    /// Whether to write.
    Asking(Box<Write>),
}

/// A result of the reader.
#[derive(Debug)]
pub(crate) enum ScreenUpdate {
    /// The controller was read.
    Live(model::Update),
    /// A value that was typed was checked.
    Checked(Result<Box<Write>, String>),
    /// The outcome of a write, or a remark.
    Done(Result<String, String>),
    Halted(Result<(), Failure>),
}

/// The outcome of a halt that succeeded.
pub(crate) const HALTED: &str = "the robot rests";

const NOT_HALTED: &str = "NOT HALTED, use the emergency stop";

/// Formats the outcome of a halt that failed.
pub(crate) fn not_halted(failure: &Failure) -> String {
    format!("{NOT_HALTED}: {failure}")
}

/// The command of a key.
#[derive(Debug)]
pub(crate) enum Action {
    Quit,
    Halt,
    /// Sends a request to the thread that communicates with the controller.
    Request(Request),
}

/// A request of the user to the controller.
#[derive(Debug)]
pub(crate) enum Request {
    /// Checks the value that was typed for a variable.
    Check(String, String),
    Write(Box<Write>),
    /// Halts the robot over the session that reads, where there is no other.
    Halt,
}

impl MonitorState {
    pub(crate) fn new(address: String, shows_calls: bool) -> Self {
        Self { address, shows_calls, ..Self::default() }
    }

    /// Sets the time since the start.
    pub(crate) fn set_time(&mut self, now: Duration) {
        self.model.now = now;
    }

    pub(crate) fn apply(&mut self, update: ScreenUpdate) {
        match update {
            ScreenUpdate::Live(update) => {
                let count = self.model.variables.len();
                if matches!(update, model::Update::Lost(_)) {
                    self.end_question();
                }
                self.model.apply(update);
                if self.model.variables.len() != count {
                    self.selected = 0;
                }
            }
            ScreenUpdate::Checked(Ok(write)) if self.checks && matches!(self.input, Input::None) => {
                self.input = Input::Asking(write);
            }
            // a `y` that the user types now is not an answer
            ScreenUpdate::Checked(Ok(write)) => self.notice = Line::alarm(format!("{} was not written", write.path)),
            ScreenUpdate::Checked(Err(why)) | ScreenUpdate::Done(Err(why)) => self.notice = Line::alarm(why),
            ScreenUpdate::Done(Ok(what)) => self.notice = Line::new(what),
            ScreenUpdate::Halted(Ok(())) => (self.notice, self.not_halted) = (Line::new(HALTED), None),
            ScreenUpdate::Halted(Err(failure)) => self.not_halted = Some(not_halted(&failure)),
        }
    }

    /// Cancels a question, or the check before it, because the value may have changed since.
    fn end_question(&mut self) {
        self.checks = false;
        if let Input::Asking(write) = &self.input {
            self.notice = Line::alarm(format!("{} was not written", write.path));
            self.input = Input::None;
        }
    }

    /// Returns the outcome of the last halt, if it failed.
    pub(crate) fn not_halted(&self) -> Option<&str> {
        self.not_halted.as_deref()
    }

    /// Handles a key.
    pub(crate) fn key(&mut self, key: KeyEvent) -> Option<Action> {
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        match (key.code, control) {
            (KeyCode::Char('c'), true) => return Some(Action::Quit),
            (KeyCode::Char('x'), true) => return Some(self.halt()),
            (KeyCode::Char(_), true) => return None,
            _ => {}
        }
        match std::mem::take(&mut self.input) {
            Input::None => self.command(key.code),
            Input::Filtering => self.filter(key.code),
            Input::Editing(text) => self.edit(text, key.code),
            Input::Asking(write) => self.answer(write, key.code),
        }
    }

    fn halt(&mut self) -> Action {
        (self.input, self.checks, self.not_halted) = (Input::None, false, None);
        self.notice = Line::alarm("halting");
        Action::Halt
    }

    fn command(&mut self, key: KeyCode) -> Option<Action> {
        self.notice = Line::default();
        let was_open = self.overlay.take().is_some();
        let last = self.focused().lines.len().saturating_sub(1);
        match key {
            KeyCode::Char('q') => return Some(Action::Quit),
            KeyCode::Char('h' | 'H') => return Some(self.halt()),
            _ if was_open => {}
            KeyCode::Char('w') => {
                self.input = Input::Editing(self.selected_name().map(|name| name + "=").unwrap_or_default());
            }
            KeyCode::Char('u') => match self.undo.clone() {
                Some((name, value)) => return Some(self.check(&name, &value)),
                None => self.notice = Line::new("nothing was written"),
            },
            KeyCode::Char('/') => (self.focus, self.selected, self.input) = (Focus::Variables, 0, Input::Filtering),
            KeyCode::Char(' ') => {
                if let Some(name) = self.selected_name()
                    && !self.marked.remove(&name)
                {
                    self.marked.insert(name);
                }
            }
            KeyCode::Char('o') => (self.shows_calls, self.selected) = (!self.shows_calls, 0),
            KeyCode::Char('s') => self.sorts_by_change = !self.sorts_by_change,
            KeyCode::Char('?') => self.overlay = Some(whole("keys", ALL_KEYS.lines())),
            KeyCode::Enter => self.overlay = self.details(),
            KeyCode::Esc if self.not_halted.is_some() => self.not_halted = None,
            KeyCode::Esc => self.filter.clear(),
            KeyCode::Tab => (self.focus, self.selected) = (self.focus.next(), 0),
            KeyCode::Up => self.selected = self.selected.saturating_sub(1),
            KeyCode::Down => self.selected = (self.selected + 1).min(last),
            KeyCode::Home => self.selected = 0,
            KeyCode::End => self.selected = last,
            key => log_key(&mut self.model.log, key),
        }
        None
    }

    fn filter(&mut self, key: KeyCode) -> Option<Action> {
        match key {
            KeyCode::Enter => return None,
            KeyCode::Esc => {
                self.filter.clear();
                return None;
            }
            KeyCode::Backspace => {
                self.filter.pop();
            }
            KeyCode::Char(c) => self.filter.push(c),
            _ => {}
        }
        self.input = Input::Filtering;
        None
    }

    /// Returns the name of the selected variable.
    fn selected_name(&self) -> Option<String> {
        let is_shown = self.focus == Focus::Variables && !self.shows_calls;
        self.shown().nth(self.selected).filter(|_| is_shown).map(|variable| variable.name.clone())
    }

    /// Returns the panel with the selection.
    fn focused(&self) -> Panel {
        match self.focus {
            Focus::Variables => self.variables_panel(),
            Focus::Tasks => self.tasks_panel(),
            Focus::Errors => self.errors_panel(),
            Focus::Messages => self.messages_panel(),
            Focus::Packets => log_panel(&self.model.log, "packets"),
        }
    }

    /// Returns the whole text of the selected line.
    fn details(&self) -> Option<Panel> {
        let panel = self.focused();
        let line = panel.lines.get(self.selected)?;
        let error = self.model.errors.as_ref().ok().and_then(|errors| errors.get(self.selected));
        let text = match error {
            Some((code, text)) if self.focus == Focus::Errors => explained(*code, text),
            _ if line.name.is_empty() => line.text.clone(),
            _ => format!("{} = {}", line.name, line.text),
        };
        Some(whole(&panel.title, [text.as_str()]))
    }

    fn edit(&mut self, mut text: String, key: KeyCode) -> Option<Action> {
        match key {
            KeyCode::Esc => {
                self.notice = Line::new("nothing was written");
                return None;
            }
            KeyCode::Enter => match text.split_once('=') {
                Some((name, value)) if !name.trim().is_empty() => {
                    return Some(self.check(name.trim(), value));
                }
                _ => self.notice = Line::alarm(format!("{text}: write NAME=VALUE, such as I1=5")),
            },
            KeyCode::Backspace => {
                text.pop();
            }
            KeyCode::Char(c) => text.push(c),
            _ => {}
        }
        self.input = Input::Editing(text);
        None
    }

    fn check(&mut self, name: &str, value: &str) -> Action {
        self.checks = true;
        Action::Request(Request::Check(name.into(), value.into()))
    }

    fn answer(&mut self, write: Box<Write>, key: KeyCode) -> Option<Action> {
        if matches!(key, KeyCode::Char('y' | 'Y')) {
            self.undo = Some((write.path.to_string(), data::format(write.before.as_variant())));
            return Some(Action::Request(Request::Write(write)));
        }
        self.notice = Line::new("nothing was written");
        None
    }

    /// Returns the current content.
    pub(crate) fn screen(&self) -> Screen {
        let state = match &self.model.lost {
            Some(why) => format!("NOT CONNECTED: {why}"),
            None => self.model.words.join(" "),
        };
        let (notice, keys) = self.footer();
        let mut screen = Screen {
            title: format!("bcap monitor {}", self.address),
            state,
            alarm: self.model.lost.is_some() || self.model.has_error,
            values: self.variables_panel(),
            robot: robot_panel(&self.model.robot),
            tasks: self.tasks_panel(),
            errors: self.errors_panel(),
            messages: self.messages_panel(),
            log: log_panel(&self.model.log, "packets"),
            notice,
            keys,
            overlay: self.overlay.clone(),
        };
        let focused = match self.focus {
            Focus::Variables => &mut screen.values,
            Focus::Tasks => &mut screen.tasks,
            Focus::Errors => &mut screen.errors,
            Focus::Messages => &mut screen.messages,
            Focus::Packets => &mut screen.log,
        };
        focused.view = Part::Around(self.selected);
        // a call is a long line
        if self.shows_calls {
            screen.robot = Panel::default();
        }
        screen
    }

    fn tasks_panel(&self) -> Panel {
        let line = |(name, status): &(String, String)| Line::new(format!("{name:16} {status}"));
        Panel::new("tasks", self.model.tasks.iter().map(line).collect())
    }

    fn errors_panel(&self) -> Panel {
        let errors = match &self.model.errors {
            Ok(errors) => errors,
            Err(why) => return Panel::new("errors", vec![Line::new(why)]),
        };
        let title = match errors.len() {
            0 | 1 => "errors".into(),
            count => format!("{count} errors, first cause first"),
        };
        let none = errors.is_empty() && !self.model.has_error;
        let lines = errors.iter().map(|(code, text)| Line::new(short(*code, text)));
        Panel::new(title, lines.chain(none.then(|| Line::new("no errors"))).collect())
    }

    fn messages_panel(&self) -> Panel {
        Panel::new("messages, latest first", self.model.messages.iter().rev().map(Line::new).collect())
    }

    /// Returns the variables that the filter shows, in their order.
    fn shown(&self) -> impl Iterator<Item = &Variable> {
        let mut shown: Vec<_> =
            self.model.variables.iter().filter(|variable| variable.name.contains(&self.filter)).collect();
        if self.sorts_by_change {
            shown.sort_by_key(|variable| std::cmp::Reverse(variable.changed));
        }
        shown.sort_by_key(|variable| !self.marked.contains(&variable.name));
        shown.into_iter()
    }

    fn variables_panel(&self) -> Panel {
        if self.shows_calls {
            return calls_panel(&self.model.log, self.model.now);
        }
        let line = |variable: &Variable| Line {
            history: variable.history.clone(),
            mark: if variable.has_changed(self.model.now) { Mark::Changed } else { Mark::Plain },
            ..Line::named(&variable.name, &variable.text)
        };
        let filter = if self.filter.is_empty() { String::new() } else { format!(" with {}", self.filter) };
        let order = if self.sorts_by_change { ", latest change first" } else { "" };
        let marked = if self.model.variables.iter().any(|variable| self.marked.contains(&variable.name)) {
            ", marked ones first"
        } else {
            ""
        };
        Panel::new(format!("variables{filter}{order}{marked}"), self.shown().map(line).collect())
    }

    fn footer(&self) -> (Line, String) {
        let (line, keys) = self.prompt();
        let line = match (&self.not_halted, &self.input) {
            (None, _) => line,
            (Some(text), Input::None) => Line::alarm(text),
            (Some(_), _) => Line::alarm(format!("{NOT_HALTED}   {}", line.text)),
        };
        (line, keys)
    }

    /// Returns the notice or the question, and the keys.
    fn prompt(&self) -> (Line, String) {
        match &self.input {
            Input::None => (self.notice.clone(), KEYS.into()),
            Input::Filtering => {
                (Line::new(format!("show names with: {}_", self.filter)), "Enter done  Esc all  Ctrl-X HALT".into())
            }
            Input::Editing(text) => {
                let notice =
                    if self.notice.mark == Mark::Alarm { format!("   {}", self.notice.text) } else { String::new() };
                (Line::new(format!("write NAME=VALUE: {text}_{notice}")), "Enter check  Esc cancel  Ctrl-X HALT".into())
            }
            Input::Asking(write) => {
                let Write { path, value, before } = write.as_ref();
                let [value, before] = [value, before].map(|value| data::format(value.as_variant()));
                (
                    Line::alarm(format!("write {path} = {value}, now {before}? y/N")),
                    "y write  n cancel  Ctrl-X HALT".into(),
                )
            }
        }
    }
}

impl Focus {
    const fn next(self) -> Self {
        match self {
            Self::Variables => Self::Tasks,
            Self::Tasks => Self::Errors,
            Self::Errors => Self::Messages,
            Self::Messages => Self::Packets,
            Self::Packets => Self::Variables,
        }
    }
}

/// Returns a panel of whole lines.
fn whole<'a>(title: &str, lines: impl IntoIterator<Item = &'a str>) -> Panel {
    let title = format!("{title}; any key closes this, h HALTS");
    Panel::new(title, lines.into_iter().map(Line::new).collect()).showing(Part::Wrapped)
}

fn robot_panel(robot: &Robot) -> Panel {
    let mut lines = robot_lines(&robot.joints, &robot.position);
    let figure = robot.position.get(6).map(ToString::to_string);
    let line = numbered(&[
        ("FIG", figure),
        ("tool", robot.tool.clone()),
        ("work", robot.work.clone()),
        ("ext speed", robot.speed.as_ref().map(|speed| format!("{speed} %"))),
    ]);
    if !line.is_empty() {
        lines.push(Line::new(line));
    }
    Panel::new("robot, degrees and mm", lines)
}

/// Formats an error with its meaning, its text, and what to do.
fn explained(code: HResult, text: &str) -> String {
    let hint = hint_of(code).map(|hint| format!(" Hint: {hint}")).unwrap_or_default();
    format!("{}{hint}", described(code, text))
}

#[cfg(test)]
mod tests {
    use bcap_capture::Role;
    use bcap_core::variant::OwnedVariant as Value;
    use bcap_live::model::Update as Live;
    use bcap_std::ObjectPath;

    use super::*;

    fn text(screen: &Screen) -> Vec<String> {
        screen.values.lines.iter().map(|line| format!("{} = {}", line.name, line.text)).collect()
    }

    fn value(n: i32) -> Result<Value, String> {
        Ok(Value::new(&n).unwrap())
    }

    fn state() -> MonitorState {
        let mut state = MonitorState::new("tcp:robot".into(), false);
        state.apply(ScreenUpdate::Live(Live::Connected(vec!["I1".into(), "IO128".into()])));
        state.apply(ScreenUpdate::Live(Live::Value(0, value(3))));
        state
    }

    fn typed(state: &mut MonitorState, keys: &str) -> Option<Action> {
        keys.chars().map(|c| state.key(KeyCode::Char(c).into())).last().flatten()
    }

    #[test]
    fn a_change_is_marked_for_two_seconds() {
        let mut state = state();
        assert_eq!(state.screen().values.lines[0].mark, Mark::Plain);
        state.set_time(Duration::from_secs(5));
        state.apply(ScreenUpdate::Live(Live::Value(0, value(4))));
        state.apply(ScreenUpdate::Live(Live::Value(1, Ok(Value::new(&true).unwrap()))));
        state.apply(ScreenUpdate::Live(Live::Value(9, value(4))));
        let screen = state.screen();
        assert_eq!(text(&screen), ["I1 = 4", "IO128 = true"]);
        let marks = screen.values.lines.iter().map(|line| (line.mark, line.history.clone())).collect::<Vec<_>>();
        // the first value of a variable is not a change
        assert_eq!(marks, [(Mark::Changed, vec![3.0, 4.0]), (Mark::Plain, vec![1.0])]);
        state.set_time(Duration::from_secs(7));
        assert_eq!(state.screen().values.lines[0].mark, Mark::Plain);
    }

    #[test]
    fn a_lost_connection_is_shown_and_the_history_stays() {
        let mut state = state();
        state.apply(ScreenUpdate::Live(Live::Errors(Ok(Vec::new()))));
        assert_eq!(state.screen().errors.lines, [Line::new("no errors")]);
        state.apply(ScreenUpdate::Live(Live::Lost("the cable is broken".into())));
        let screen = state.screen();
        assert_eq!(screen.errors.lines, [Line::new("the connection is lost")]);
        assert_eq!((screen.state.as_str(), screen.alarm), ("NOT CONNECTED: the cable is broken", true));
        state.apply(ScreenUpdate::Live(Live::Connected(vec!["I1".into(), "IO128".into()])));
        state.apply(ScreenUpdate::Live(Live::State(vec!["RC8".into(), "auto".into()], false)));
        let screen = state.screen();
        assert_eq!((screen.state.as_str(), screen.alarm), ("RC8 auto", false));
        assert_eq!(screen.values.lines[0].history, [3.0]);
    }

    #[test]
    fn a_write_is_checked_and_asked_for() {
        let mut state = state();
        assert!(typed(&mut state, "w5x").is_none());
        assert_eq!(state.screen().notice.text, "write NAME=VALUE: I1=5x_");
        state.key(KeyCode::Backspace.into());
        // `q` and `h` are text here
        typed(&mut state, "qh");
        assert_eq!(state.screen().notice.text, "write NAME=VALUE: I1=5qh_");
        let Some(Action::Request(Request::Check(name, data))) = state.key(KeyCode::Enter.into()) else {
            panic!("no check")
        };
        assert_eq!((name.as_str(), data.as_str()), ("I1", "5qh"));
        let [value, before] = [5, 3].map(|n| Value::new(&n).unwrap());
        let write = Box::new(Write { path: ObjectPath::variable("I1").unwrap(), value, before });
        state.apply(ScreenUpdate::Checked(Ok(write.clone())));
        assert_eq!(state.screen().notice.text, "write I1 = 5, now 3? y/N");
        assert!(typed(&mut state, "n").is_none());
        assert_eq!(state.screen().notice.text, "nothing was written");
        state.checks = true;
        state.apply(ScreenUpdate::Checked(Ok(write.clone())));
        assert!(matches!(typed(&mut state, "y"), Some(Action::Request(Request::Write(_)))));
        // a question of a connection that is lost is not answered
        state.checks = true;
        state.apply(ScreenUpdate::Checked(Ok(write)));
        state.apply(ScreenUpdate::Live(Live::Lost("the cable is broken".into())));
        assert!(typed(&mut state, "y").is_none());
        // a check that ends while the next value is typed shows no question
        let [value, before] = [6, 5].map(|n| Value::new(&n).unwrap());
        typed(&mut state, "w");
        let write = Write { path: ObjectPath::variable("I1").unwrap(), value, before };
        state.apply(ScreenUpdate::Checked(Ok(Box::new(write))));
        assert!(typed(&mut state, "y").is_none());
        assert_eq!(state.screen().notice.text, "write NAME=VALUE: I1=y_   I1 was not written");
        state.key(KeyCode::Esc.into());
        // an input without an equals sign is not checked
        typed(&mut state, "w");
        (0..3).for_each(|_| assert!(state.key(KeyCode::Backspace.into()).is_none()));
        assert!(state.key(KeyCode::Enter.into()).is_none());
        assert!(state.screen().notice.text.contains("such as I1=5"));
    }

    #[test]
    fn the_write_is_undone_after_a_question() {
        let mut state = state();
        typed(&mut state, "u");
        assert_eq!(state.screen().notice.text, "nothing was written");
        let [value, before] = [5, 3].map(|n| Value::new(&n).unwrap());
        let write = Write { path: ObjectPath::variable("I1").unwrap(), value, before };
        state.checks = true;
        state.apply(ScreenUpdate::Checked(Ok(Box::new(write))));
        typed(&mut state, "y");
        let Some(Action::Request(Request::Check(name, text))) = typed(&mut state, "u") else { panic!("no check") };
        assert_eq!([name, text], ["I1", "3"]);
    }

    #[test]
    fn six_errors_are_one_line_each_and_enter_explains_one() {
        let mut state = state();
        let error = |n: u8| (HResult::E_MOTOR_OFF, format!("error {n}"));
        state.apply(ScreenUpdate::Live(Live::Errors(Ok((1..=6).map(error).collect()))));
        assert_eq!(state.screen().errors.title, "6 errors, first cause first");
        assert_eq!((state.screen().errors.lines.len(), state.screen().errors.view), (6, Part::First));
        for key in [KeyCode::Tab, KeyCode::Tab, KeyCode::Down, KeyCode::Enter] {
            state.key(key.into());
        }
        let screen = state.screen();
        assert_eq!((screen.errors.view, screen.values.view), (Part::Around(1), Part::First));
        let overlay = screen.overlay.unwrap();
        let meaning = HResult::E_MOTOR_OFF.meaning().unwrap();
        let hint = hint_of(HResult::E_MOTOR_OFF).unwrap();
        let expected = format!("{} {meaning} The controller says: error 2 Hint: {hint}", HResult::E_MOTOR_OFF);
        assert_eq!(overlay.lines, [Line::new(expected)]);
        // the details do not hide the halt, and any other key closes them
        assert!(matches!(typed(&mut state, "H"), Some(Action::Halt)));
        state.key(KeyCode::Enter.into());
        typed(&mut state, "w");
        assert_eq!((state.screen().overlay.is_none(), state.screen().notice.text), (true, String::new()));
        typed(&mut state, "?");
        assert!(state.screen().overlay.unwrap().lines.iter().any(|line| line.text.contains("halts the robot at once")));
    }

    #[test]
    fn the_filter_and_the_order_choose_the_variable_that_is_written() {
        let mut state = state();
        state.set_time(Duration::from_secs(1));
        state.apply(ScreenUpdate::Live(Live::Value(1, value(1))));
        state.apply(ScreenUpdate::Live(Live::Value(1, value(2))));
        typed(&mut state, "s");
        assert_eq!(text(&state.screen()), ["IO128 = 2", "I1 = 3"]);
        typed(&mut state, "/1h");
        assert_eq!(state.screen().notice.text, "show names with: 1h_");
        assert!(text(&state.screen()).is_empty());
        state.key(KeyCode::Backspace.into());
        state.key(KeyCode::Enter.into());
        typed(&mut state, "s/");
        state.key(KeyCode::Backspace.into());
        typed(&mut state, "O");
        state.key(KeyCode::Enter.into());
        assert_eq!(state.screen().values.title, "variables with O");
        typed(&mut state, "w");
        assert_eq!(state.screen().notice.text, "write NAME=VALUE: IO128=_");
    }

    #[test]
    fn marked_variables_are_first_and_calls_are_shown_once() {
        let mut state = state();
        state.key(KeyCode::Down.into());
        typed(&mut state, " ");
        assert_eq!(
            (text(&state.screen()), state.screen().values.title.as_str()),
            (vec!["IO128 = ".into(), "I1 = 3".into()], "variables, marked ones first")
        );
        state.key(KeyCode::Home.into());
        typed(&mut state, " ");
        assert_eq!(text(&state.screen())[0], "I1 = 3");
        let packet = |state: &mut MonitorState, role, text: &str| {
            state.apply(ScreenUpdate::Live(Live::Packet(role, text.into())));
        };
        packet(&mut state, Role::Request, "#1 Controller_GetVariable(controller: I4(1), name: \"I1\", option: \"\")");
        packet(&mut state, Role::Response, "#1 0x00000000 (S_OK): I4(6)");
        for (second, value) in [(1, 7), (2, 7), (3, 8)] {
            state.set_time(Duration::from_secs(second));
            packet(&mut state, Role::Request, "#2 Variable_GetValue(variable: I4(6))");
            packet(&mut state, Role::Response, &format!("#2 0x00000000 (S_OK): I4({value})"));
        }
        state.set_time(Duration::from_millis(3500));
        typed(&mut state, "o");
        let lines = state.screen().values.lines;
        let shown: Vec<_> = lines.iter().map(|line| (line.text.as_str(), line.mark)).collect();
        assert_eq!(shown, [("     3    1.0/s   0.5 s  Variable_GetValue I1 = I4(8)", Mark::Changed)]);
        // no variable is selected for writing
        typed(&mut state, "w");
        assert_eq!(state.screen().notice.text, "write NAME=VALUE: _");
    }

    #[test]
    fn a_halt_is_not_asked_for() {
        let mut state = state();
        assert!(matches!(typed(&mut state, "h"), Some(Action::Halt)));
        let halt = KeyEvent::new(KeyCode::Char('x'), KeyModifiers::CONTROL);
        typed(&mut state, "w1");
        assert!(matches!(state.key(halt), Some(Action::Halt)));
        state.apply(ScreenUpdate::Done(Err("the cable is broken".into())));
        assert_eq!(state.screen().notice, Line::alarm("the cable is broken"));
        let quit = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        typed(&mut state, "w1");
        assert!(matches!(state.key(quit), Some(Action::Quit)));
    }

    #[test]
    fn a_halt_that_failed_stays_on_the_screen() {
        let mut state = state();
        let failed = || {
            let (message, hint) = ("the cable is broken".into(), "plug it in".into());
            ScreenUpdate::Halted(Err(Failure::Connection { message, hint }))
        };
        let text = "NOT HALTED, use the emergency stop: the cable is broken";
        state.checks = true;
        typed(&mut state, "h");
        // a check that ends after the halt shows no question
        let [value, before] = [5, 3].map(|n| Value::new(&n).unwrap());
        let write = Write { path: ObjectPath::variable("I1").unwrap(), value, before };
        state.apply(ScreenUpdate::Checked(Ok(Box::new(write))));
        assert_eq!(state.screen().notice, Line::alarm("I1 was not written"));
        state.apply(failed());
        typed(&mut state, "n");
        state.apply(ScreenUpdate::Done(Ok("I1 = 5 is written".into())));
        assert_eq!(state.screen().notice, Line::alarm(text));
        typed(&mut state, "/");
        assert!(state.screen().notice.text.starts_with("NOT HALTED, use the emergency stop   show names"));
        state.key(KeyCode::Esc.into());
        assert_eq!(state.screen().notice, Line::alarm(text));
        state.apply(ScreenUpdate::Halted(Ok(())));
        assert_eq!((state.screen().notice, state.not_halted()), (Line::new(HALTED), None));
        state.apply(failed());
        state.key(KeyCode::Esc.into());
        assert_eq!(state.not_halted(), None);
    }

    #[test]
    fn the_selection_stays_in_the_list() {
        let mut state = state();
        for (key, selected) in
            [(KeyCode::Up, 0), (KeyCode::Down, 1), (KeyCode::Down, 1), (KeyCode::Home, 0), (KeyCode::End, 1)]
        {
            state.key(key.into());
            assert_eq!(state.screen().values.view, Part::Around(selected));
        }
        let mut empty = MonitorState::new(String::new(), false);
        empty.key(KeyCode::Down.into());
        assert_eq!(empty.screen().values.view, Part::Around(0));
    }
}
