//! The screen of `bcap jog`: a key moves the robot by a step.
//!
//! Each step is a whole motion with an end, on a thread with the session, while the main thread reads keys. So a lost terminal, a
//! key that is stuck in a slow link, or a crash of this program never leaves a motion without an end.

use std::thread;
use std::time::Duration;

use bcap_live::axis::Axis;
use bcap_terminal::screen::{KeyCode, KeyEvent, KeyModifiers, Line, Panel, Part, Screen, Terminal, require};

use crate::commands::robot::axis;
use crate::commands::robot::motion::{self, MotionArgs};
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::note;
use crate::session::Session;

/// The steps, in mm or degrees.
const STEPS: [f64; 4] = [0.1, 1.0, 5.0, 10.0];

/// Maximum time between two drawings.
const FRAME: Duration = Duration::from_millis(50);

const KEYS: &str = "Up Down axis  Left Right step  [ ] its size  Esc HALT and end";

/// Moves the robot by keys until the user ends that.
pub(super) fn by_keys(how: &MotionArgs, session: &mut Session, json: bool) -> Result<(), Failure> {
    if json {
        return Err(Failure::Input("a live screen has no JSON; `bcap jog J1 +5 --json` makes one step".into()));
    }
    require("`bcap jog J1 +5` makes one step").map_err(Failure::Input)?;
    motion::ask("moves by keys", how, session)?;
    let mut keys = Keys {
        title: format!("bcap jog {}", session.link().target()?),
        how,
        interrupt: session.handle_signals()?,
        axes: Vec::new(),
        selected: 0,
        size: 1,
        ends: false,
        halted: false,
        notice: Line::default(),
    };
    motion::with_arm(how, session, |session| keys.run(session))?;
    let arm = match session.has_arm() {
        // the line of the shell or the script gives it back, and says so
        true if keys.interrupt.is_interrupted() => return Ok(()),
        true => "this session keeps the arm, and leaves the motor on",
        false => "the arm was given back",
    };
    note(&match keys.halted {
        true => format!("the robot was halted, and {arm}; `bcap errors --clear` before the next motion"),
        false => arm.to_owned(),
    });
    Ok(())
}

struct Keys<'a> {
    title: String,
    how: &'a MotionArgs,
    interrupt: Interrupt,
    /// Each axis with its position.
    axes: Vec<(Axis, f64)>,
    selected: usize,
    /// The step, of [`STEPS`].
    size: usize,
    /// Whether the user has ended it.
    ends: bool,
    /// Whether the last step was halted.
    halted: bool,
    notice: Line,
}

impl Keys<'_> {
    /// Draws and handles keys. The arm is taken.
    fn run(&mut self, session: &mut Session) -> Result<(), Failure> {
        let mut terminal = Terminal::open()?;
        while !self.ends && !self.interrupt.is_interrupted() {
            session.restart_budget();
            self.axes = axis::read_all(session)?;
            terminal.draw(&self.screen())?;
            // keys of a slow link arrive together: only the last key counts
            let by = terminal.keys(FRAME)?.into_iter().filter_map(|key| self.key(key)).last();
            if let Some(by) = by.filter(|_| !self.ends) {
                self.step(by, &mut terminal, session)?;
            }
        }
        Ok(())
    }

    /// Handles a key that arrives while the robot rests; returns the requested step.
    fn key(&mut self, key: KeyEvent) -> Option<f64> {
        self.ends |= halts(key);
        self.notice = Line::default();
        let size = STEPS.get(self.size).copied();
        match key.code {
            KeyCode::Left => return size.map(|size| -size),
            KeyCode::Right => return size,
            KeyCode::Up => self.selected = self.selected.saturating_sub(1),
            KeyCode::Down => self.selected = (self.selected + 1).min(self.axes.len().saturating_sub(1)),
            KeyCode::Char('[') => self.size = self.size.saturating_sub(1),
            KeyCode::Char(']') => self.size = (self.size + 1).min(STEPS.len() - 1),
            _ => {}
        }
        None
    }

    /// Creates a step. A key that halts, a signal and a lost terminal halt the robot.
    fn step(&mut self, by: f64, terminal: &mut Terminal, session: &mut Session) -> Result<(), Failure> {
        let Some((axis, _)) = self.axes.get(self.selected) else { return Ok(()) };
        let args = motion::step(*axis, by, self.how);
        self.notice = Line::alarm(format!("{axis} moves by {by:+}; Esc HALTS"));
        terminal.draw(&self.screen())?;
        let (mut watched, mut halted) = (Ok(()), Ok(false));
        let moved = thread::scope(|scope| {
            let moving =
                thread::Builder::new().name("step".into()).spawn_scoped(scope, || motion::go(&args, session))?;
            while !moving.is_finished() {
                if self.ends || watched.is_err() {
                    // again and again, because the motion may begin just after a halt
                    halted = self.interrupt.halt();
                    self.interrupt.wait_for(1, FRAME);
                } else {
                    watched = terminal.keys(FRAME).map(|keys| self.ends = keys.into_iter().any(halts));
                }
            }
            // the panic has printed its message
            moving.join().unwrap_or_else(|_| Err(Failure::Input("the thread of the step has ended by a panic".into())))
        });
        watched?;
        self.notice = Line::default();
        match moved {
            Err(Failure::Unfit { .. }) if halted? || self.interrupt.is_interrupted() => {
                self.halted = true;
                Ok(())
            }
            moved => moved.map(drop),
        }
    }

    fn screen(&self) -> Screen {
        let line = |(axis, position): &(Axis, f64)| Line::named(axis.to_string(), format!("{position:9.3}"));
        let title = format!("step {} mm or degrees, speed {} %", STEPS[self.size], self.how.speed);
        let axes = Panel::new(title, self.axes.iter().map(line).collect()).showing(Part::Around(self.selected));
        Screen {
            title: self.title.clone(),
            notice: self.notice.clone(),
            keys: KEYS.into(),
            overlay: Some(axes),
            ..Screen::default()
        }
    }
}

/// Returns whether a key halts the robot and ends the command.
fn halts(key: KeyEvent) -> bool {
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    match key.code {
        KeyCode::Char(c) if control => matches!(c, 'c' | 'x'),
        KeyCode::Char(c) => matches!(c, ' ' | 'h' | 'H' | 'q'),
        key => key == KeyCode::Esc,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_asks_for_a_step_selects_or_ends() {
        let how = MotionArgs { speed: 10.0, tool: None, work: None, within: FRAME, prepare: false, yes: true };
        let mut keys = Keys {
            title: String::new(),
            how: &how,
            interrupt: Interrupt::of_session().unwrap(),
            axes: vec![(Axis::Joint(1), 0.0), (Axis::Coordinate(0), 0.0)],
            selected: 0,
            size: 1,
            ends: false,
            halted: false,
            notice: Line::default(),
        };
        let mut press = |code: KeyCode| (keys.key(code.into()), keys.selected, keys.size, keys.ends);
        assert_eq!(press(KeyCode::Right), (Some(1.0), 0, 1, false));
        assert_eq!(press(KeyCode::Left), (Some(-1.0), 0, 1, false));
        assert_eq!(press(KeyCode::Up), (None, 0, 1, false));
        assert_eq!(press(KeyCode::Down), (None, 1, 1, false));
        assert_eq!(press(KeyCode::Down), (None, 1, 1, false));
        for (key, size) in [('[', 0), ('[', 0), (']', 1), (']', 2), (']', 3), (']', 3), ('x', 3)] {
            assert_eq!(press(KeyCode::Char(key)), (None, 1, size, false), "{key}");
        }
        assert_eq!(press(KeyCode::Left), (Some(-10.0), 1, 3, false));
        assert_eq!(press(KeyCode::Esc), (None, 1, 3, true));
        for key in [' ', 'h', 'H', 'q'] {
            assert!(halts(KeyCode::Char(key).into()), "{key}");
        }
        assert!(halts(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL)));
        assert!(!halts(KeyCode::Char('c').into()) && !halts(KeyCode::Right.into()));
    }
}
