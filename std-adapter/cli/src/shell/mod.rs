//! `bcap shell`: a prompt over one session.

mod line;
pub(crate) mod script;
mod terminal;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::{env, process};

use bcap_core::bcap::FunctionId;
use bcap_live::messages::next_message;
use bcap_live::reader::MESSAGES;
use bcap_std::ObjectPath;
use bcap_terminal::signal::{self, Signal};
use rustyline::completion::{Completer, FilenameCompleter};
use rustyline::error::ReadlineError;
use rustyline::history::FileHistory;
use rustyline::{Config, Context, Editor};

use crate::commands::variables::names::all_names;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output::{note, print_line};
use crate::session::variables::{get_one, short_type, state_words};
use crate::session::{Session, traffic};
use crate::shell::line::{Flow, Runner, Verb};
use crate::shell::terminal::Terminal;
use bcap_live::stream::StreamCheck;

/// The session of the shell, which a signal ends and the completion reads.
type SharedSession = Arc<Mutex<Session>>;

/// The lines that are kept from one shell to the next.
const HISTORY: usize = 1000;

/// Runs `bcap shell` until `exit` or the end of the input.
pub(crate) fn shell(session: &mut Session, verb: Verb, json: bool) -> Result<(), Failure> {
    let link = session.link().clone();
    let shared: SharedSession = Arc::new(Mutex::new(Session::new(&link)));
    let signalled = Arc::clone(&shared);
    let terminal = Terminal::saved();
    let interrupt = Interrupt::install(move |received| {
        if received == Signal::End {
            locked(&signalled).close();
            // the prompt has changed it
            terminal.restore();
            if let Err(failure) = traffic::finish() {
                failure.print(json, None);
            }
            process::exit(130);
        }
        // while a line runs, the line itself ends; it has the session
        let Ok(mut session) = signalled.try_lock() else { return };
        stop(&mut session, json);
        if received == Signal::Suspend {
            let prompt = Terminal::saved();
            terminal.restore();
            signal::suspend();
            prompt.restore();
        }
        if let Some(interrupt) = &session.interrupt {
            interrupt.begin();
        }
    })?;
    interrupt.set_going_on();
    locked(&shared).interrupt = Some(interrupt.clone());
    let mut editor = editor(&shared)?;
    let history = history_file();
    if let Some(file) = &history {
        // a failure is ignored: the shell works without its history, and the first shell has no history yet
        let _ = file.parent().map(std::fs::create_dir_all);
        let _ = editor.load_history(file);
    }
    connect(&shared, json)?;
    let runner = Runner::new(interrupt, verb, json);
    let ended = read_lines(&mut editor, history.as_deref(), &shared, &runner, json);
    locked(&shared).end_after(ended)
}

/// Connects; a failure is printed, and `connect` tries again.
fn connect(shared: &SharedSession, json: bool) -> Result<(), Failure> {
    match locked(shared).reconnect() {
        Ok(()) => print_line("`help` lists the commands, `exit` ends, Ctrl-C halts the robot")?,
        Err(failure) => {
            failure.print(json, None);
            note("`connect` tries again");
        }
    }
    Ok(())
}

fn read_lines(
    editor: &mut Editor<NameCompleter, FileHistory>,
    history: Option<&Path>,
    shared: &SharedSession,
    runner: &Runner,
    json: bool,
) -> Result<(), Failure> {
    let mut inbox = Some(StreamCheck::default());
    loop {
        let prompt = format!("{}> ", prompt(&mut locked(shared), &mut inbox));
        // Ctrl-C after the end of the last line, while the state for the prompt was read
        if runner.interrupt.is_interrupted() {
            stop(&mut locked(shared), json);
            runner.interrupt.suspend_if_requested();
            runner.interrupt.begin();
        }
        let line = match editor.readline(&prompt) {
            Ok(line) => line,
            Err(ReadlineError::Interrupted) => {
                stop(&mut locked(shared), json);
                continue;
            }
            Err(ReadlineError::Eof) => return Ok(()),
            Err(error) => return Err(Failure::Input(format!("the terminal: {error}"))),
        };
        if line.trim().is_empty() {
            continue;
        }
        // a line that cannot be kept is run all the same; a signal may end the shell at its next prompt
        let _ = editor.add_history_entry(&line);
        let _ = history.map(|file| editor.append_history(file));
        runner.interrupt.begin();
        let (done, is_open) = {
            let mut session = locked(shared);
            let done = runner.run(&line, &mut session);
            (done, session.is_open())
        };
        match done {
            Ok(Flow::Continue) => {}
            Ok(Flow::Exit) => return Ok(()),
            Err(failure) => {
                failure.print(json, None);
                if !is_open && !failure.leaves_the_session_alive() {
                    note("`connect` connects again");
                }
            }
        }
        runner.interrupt.suspend_if_requested();
        if runner.interrupt.is_ended() {
            return Err(Failure::Interrupted("ended by a signal; the arm was given back".into()));
        }
    }
}

/// Ctrl-C at the prompt: halts a motion that an earlier line has started, and gives the arm back.
fn stop(session: &mut Session, json: bool) {
    session.abandon();
    if !session.has_arm() {
        return;
    }
    match session.halt().and_then(|()| session.give_arm()) {
        Ok(()) => note("the robot was halted, and the arm was given back"),
        Err(failure) => {
            failure.print(json, None);
            // over the other connection, if this one was lost
            session.abandon();
        }
    }
}

fn locked(shared: &SharedSession) -> MutexGuard<'_, Session> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Prints the new messages of the controller, and returns the state for the prompt. The packets are not traced, because the user did
/// not cause them. `inbox` becomes `None` when the controller refuses messages: each refusal may be an entry of its log.
fn prompt(session: &mut Session, inbox: &mut Option<StreamCheck>) -> String {
    session.packets.set_paused(true);
    for _ in 0..MESSAGES {
        let Some(check) = inbox.as_mut().filter(|_| session.is_open()) else { break };
        session.restart_budget();
        match next_message(session, check) {
            Ok(Some(message)) => note(&message.to_string()),
            Err(Failure::Refused { .. }) => *inbox = None,
            // no messages, or a stream runs
            Ok(None) | Err(_) => break,
        }
    }
    let state = state(session);
    session.packets.set_paused(false);
    state
}

/// Returns the state of the session and of the controller: `RC8 auto ok arm motor`.
fn state(session: &mut Session) -> String {
    // the messages may have found that the connection is lost
    session.abandon();
    if !session.is_open() {
        return "not connected".into();
    }
    session.restart_budget();
    let kind = read(session, "@TYPE").map(|kind| if kind.is_empty() { "robot".into() } else { short_type(&kind) });
    let (mode, code) = (read(session, "@MODE"), read(session, "@ERROR_CODE"));
    let mut words = state_words(kind, mode, code.as_deref());
    if session.has_arm() {
        words.push("arm".into());
    }
    if let Ok(true) = session.with(|controller| controller.robot()?.read::<bool>("@SERVO_ON")) {
        words.push("motor".into());
    }
    if session.is_lost() {
        session.abandon();
        return "not connected".into();
    }
    if words.is_empty() { "connected".into() } else { words.join(" ") }
}

/// Reads a variable of the controller as text; `None` if the controller does not have it.
fn read(session: &mut Session, name: &str) -> Option<String> {
    let value = get_one(session, &ObjectPath::variable(name).ok()?).ok()?;
    Some(bcap_terminal::escape::line(&bcap_capture::value::data::format(value.as_variant())))
}

fn editor(shared: &SharedSession) -> Result<Editor<NameCompleter, FileHistory>, Failure> {
    let wrong = |error: ReadlineError| Failure::Input(format!("the terminal: {error}"));
    let config = Config::builder().max_history_size(HISTORY).map_err(wrong)?;
    let config = config.completion_type(rustyline::CompletionType::List).build();
    let mut editor = Editor::with_config(config).map_err(wrong)?;
    editor.set_helper(Some(NameCompleter { session: Arc::clone(shared), listed: Mutex::new(None) }));
    Ok(editor)
}

/// Returns the file of the history: `BCAP_HISTORY`, or a file in the user's state directory.
fn history_file() -> Option<PathBuf> {
    let variable = |name| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    variable("BCAP_HISTORY").or_else(|| {
        let state = variable("XDG_STATE_HOME").or_else(|| Some(variable("HOME")?.join(".local/state")))?;
        Some(state.join("bcap/history"))
    })
}

/// Completes commands, functions, and the names that the controller lists.
struct NameCompleter {
    session: SharedSession,
    /// The controller's names, once they have been read.
    listed: Mutex<Option<Vec<String>>>,
}

impl NameCompleter {
    /// Returns the names of the controller. They are read at the first completion.
    fn listed(&self) -> Vec<String> {
        let mut listed = self.listed.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(names) = &*listed {
            return names.clone();
        }
        let mut session = locked(&self.session);
        if !session.is_open() {
            return Vec::new();
        }
        session.restart_budget();
        session.packets.set_paused(true);
        let names = all_names(&mut session);
        session.packets.set_paused(false);
        names.map_or_else(Vec::new, |names| listed.insert(names).clone())
    }
}

impl Completer for NameCompleter {
    type Candidate = String;

    fn complete(&self, line: &str, at: usize, context: &Context<'_>) -> rustyline::Result<(usize, Vec<String>)> {
        if line.trim_start().starts_with("run ") {
            let (start, files) = FilenameCompleter::new().complete(line, at, context)?;
            return Ok((start, files.into_iter().map(|file| file.replacement).collect()));
        }
        let before = line.get(..at).unwrap_or(line);
        let start = before.rfind(char::is_whitespace).map_or(0, |blank| blank + 1);
        let (word, earlier) = (before.get(start..).unwrap_or_default(), before.get(..start).unwrap_or_default());
        let earlier: Vec<&str> = earlier.split_whitespace().collect();
        let commands = || line::commands().into_iter().map(|(name, _)| name);
        let functions = || FunctionId::all().map(|function| function.to_string());
        let mut names: Vec<String> = match earlier.as_slice() {
            [] => commands().collect(),
            ["help"] => commands().chain(functions()).collect(),
            ["call"] => functions().collect(),
            ["exec", _] => {
                self.listed().iter().filter_map(|name| Some(name.strip_prefix("command:")?.to_owned())).collect()
            }
            _ => {
                let objects = ["controller", "robot"].map(str::to_owned);
                self.listed().into_iter().filter(|name| !name.starts_with("command:")).chain(objects).collect()
            }
        };
        let word = word.to_lowercase();
        names.retain(|name| name.to_lowercase().starts_with(&word));
        names.sort();
        names.dedup();
        Ok((start, names))
    }
}

impl rustyline::hint::Hinter for NameCompleter {
    type Hint = String;
}

impl rustyline::highlight::Highlighter for NameCompleter {}

impl rustyline::validate::Validator for NameCompleter {}

impl rustyline::Helper for NameCompleter {}
