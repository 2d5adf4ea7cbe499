//! A line of the shell or of a script: a command of `bcap`, or one that exists only there.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use bcap_capture::duration;
use bcap_core::bcap::FunctionId;
use bcap_std::ObjectPath;
use bcap_terminal::escape;
use bcap_terminal::words::{self, is_name};
use clap::error::ErrorKind;
use clap::{CommandFactory as _, Parser, Subcommand};

use crate::cli::{Command, Run};
use crate::commands::calls::call::Call;
use crate::commands::calls::exec::Exec;
use crate::commands::calls::reference;
use crate::commands::variables::get::LAST_PACKETS;
use crate::failure::Failure;
use crate::interrupt::{Interrupt, State};
use crate::output::{print_line, print_raw};
use crate::session::Session;
use crate::session::variables::get_one;
use bcap_capture::value::data;
use bcap_core::variant::OwnedVariant as Value;

/// A line with a command.
#[derive(Debug, Parser)]
#[command(name = "bcap", no_binary_name = true, disable_help_subcommand = true, disable_help_flag = false)]
struct CommandLine {
    /// Prints results as JSON, one object per line
    #[arg(long, global = true)]
    json: bool,

    #[command(subcommand)]
    command: LineCommand,
}

#[derive(Debug, Subcommand)]
enum LineCommand {
    #[command(flatten)]
    Verb(Box<Command>),
    /// Sets a variable of the shell or the script: set x = 3
    Set {
        /// The name
        name: String,
        /// The value, after `=`
        #[arg(num_args = 1.., allow_hyphen_values = true)]
        value: Vec<String>,
    },
    /// Waits for a time: sleep 100ms
    Sleep {
        /// The time
        #[arg(value_parser = duration::parse)]
        time: Duration,
    },
    /// Runs a command several times: repeat 3 move P1; `repeat 3 run FILE` repeats lines
    Repeat {
        /// How often
        count: u32,
        /// The command
        #[arg(required = true, num_args = 1.., trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    /// Runs a command while a variable of the controller has a value: while I1 < 5 run part.bcap
    While {
        /// The condition, with its three words, and the command
        #[arg(value_name = "CONDITION COMMAND", num_args = 4.., trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    /// Runs a command if a variable of the controller has a value: if IO130 = true put I1 5
    If {
        /// The condition, with its three words, and the command
        #[arg(value_name = "CONDITION COMMAND", num_args = 4.., trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    /// Waits until a variable of the controller has a value: wait I1 = 5 --within 2s; without a time a minute
    Wait {
        #[command(flatten)]
        condition: Condition,
        /// The longest time to wait, such as 500ms or 2s
        #[arg(value_parser = duration::parse, default_value = "60s")]
        timeout: Duration,
        /// The same
        #[arg(long, value_name = "TIME", value_parser = duration::parse, conflicts_with = "timeout")]
        within: Option<Duration>,
    },
    /// Fails unless a variable of the controller has a value: expect I1 = 5
    Expect {
        #[command(flatten)]
        condition: Condition,
    },
    /// Connects, or connects again
    Connect,
    /// Ends the session; the next command connects again
    Disconnect,
    /// Prints the commands, or the help of a command or a function
    Help {
        /// A command, or one of the 137 functions
        topic: Option<String>,
    },
    /// Ends the shell or the script
    #[command(alias = "quit")]
    Exit,
}

const RELATIONS: [&str; 7] = ["=", "==", "!=", "<", "<=", ">", ">="];

/// The condition for a variable.
#[derive(Debug, clap::Args)]
struct Condition {
    /// The variable, as for `get`
    name: String,
    /// = != < <= > >=
    #[arg(value_parser = RELATIONS, default_value = "=", requires = "value")]
    relation: String,
    /// The value, as for `put`; without it, true
    #[arg(allow_hyphen_values = true, default_value = "true")]
    value: String,
}

/// Whether the shell or the script continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Flow {
    /// With the next line.
    Continue,
    /// It ends.
    Exit,
}

/// Runs a command of `bcap`.
pub(crate) type Verb = fn(&Command, &mut Session, bool) -> Result<(), Failure>;

/// Checks the arguments of a command of `bcap` without a call.
pub(crate) type Check = fn(&Command) -> Result<(), Failure>;

/// A line that was checked.
pub(crate) enum Checked {
    /// The next line follows.
    Continue,
    /// The lines of this script run before the next line.
    Script(Run),
    /// The script ends.
    Exit,
}

/// Checks lines in sequence, without a call.
pub(crate) struct Checker {
    variables: HashMap<String, String>,
    check: Check,
}

impl Checker {
    pub(crate) fn new(variables: HashMap<String, String>, check: Check) -> Self {
        Self { variables, check }
    }

    /// Checks a line: its command, its arguments, and the variables of the script that it uses.
    pub(crate) fn line(&mut self, line: &str) -> Result<Checked, Failure> {
        words_of(line, &self.variables)?.map_or(Ok(Checked::Continue), |words| self.words(&words))
    }

    fn words(&mut self, words: &[String]) -> Result<Checked, Failure> {
        match CommandLine::try_parse_from(words) {
            Ok(line) => self.command(line.command),
            Err(error) if is_help(&error) => Ok(Checked::Continue),
            Err(error) => Err(invalid(&error)),
        }
    }

    /// Checks words that possibly do not run: the lines after an `exit` are also checked.
    fn perhaps(&mut self, words: &[String]) -> Result<Checked, Failure> {
        Ok(match self.words(words)? {
            Checked::Exit => Checked::Continue,
            checked => checked,
        })
    }

    fn command(&mut self, command: LineCommand) -> Result<Checked, Failure> {
        match command {
            LineCommand::Verb(command) => match *command {
                Command::Shell(_) => return Err(no_shell()),
                Command::Run(args) => return Ok(Checked::Script(args)),
                command => (self.check)(&command)?,
            },
            LineCommand::Set { name, value } => set(&mut self.variables, &name, &value)?,
            LineCommand::Repeat { words, .. } => {
                repeated(&words)?;
                return self.perhaps(&words);
            }
            LineCommand::While { words } | LineCommand::If { words } => {
                let (condition, words) = guarded(&words)?;
                ObjectPath::variable(&condition.name)?;
                return self.perhaps(words);
            }
            LineCommand::Wait { condition, .. } | LineCommand::Expect { condition } => {
                ObjectPath::variable(&condition.name)?;
            }
            LineCommand::Exit => return Ok(Checked::Exit),
            LineCommand::Sleep { .. } | LineCommand::Connect | LineCommand::Disconnect | LineCommand::Help { .. } => {}
        }
        Ok(Checked::Continue)
    }
}

/// Runs lines in sequence over one session.
pub(crate) struct Runner {
    pub(crate) interrupt: Interrupt,
    verb: Verb,
    json: bool,
}

impl Runner {
    pub(crate) fn new(interrupt: Interrupt, verb: Verb, json: bool) -> Self {
        interrupt.set_going_on();
        Self { interrupt, verb, json }
    }

    /// Runs a line. After an interruption the robot is halted and the arm given back.
    pub(crate) fn run(&self, line: &str, session: &mut Session) -> Result<Flow, Failure> {
        words_of(line, &session.variables)?.map_or(Ok(Flow::Continue), |words| self.run_words(&words, session))
    }

    fn run_words(&self, words: &[String], session: &mut Session) -> Result<Flow, Failure> {
        let line = match CommandLine::try_parse_from(words) {
            Ok(line) => line,
            Err(error) => return explained(&error).map(|()| Flow::Continue),
        };
        match &line.command {
            LineCommand::Repeat { count, words } => {
                repeated(words)?;
                let mut flows = (0..*count).map(|_| self.run_words(words, session));
                return flows.find(|flow| !matches!(flow, Ok(Flow::Continue))).unwrap_or(Ok(Flow::Continue));
            }
            LineCommand::While { words } => {
                let (condition, words) = guarded(words)?;
                while self.holds(&condition, session)? {
                    if self.run_words(words, session)? == Flow::Exit {
                        return Ok(Flow::Exit);
                    }
                }
                return Ok(Flow::Continue);
            }
            LineCommand::If { words } => {
                let (condition, words) = guarded(words)?;
                let holds = self.holds(&condition, session)?;
                return if holds { self.run_words(words, session) } else { Ok(Flow::Continue) };
            }
            _ => {}
        }
        session.restart_budget();
        if let LineCommand::Verb(command) = &line.command
            && may_take_arm(command)
        {
            session.prepare_halt(&self.interrupt)?;
        }
        let had_arm = session.has_arm();
        self.interrupt.enter(if had_arm { State::Moving } else { State::Calling });
        // a signal from now on halts the robot, an earlier one prevents the call
        let done = if self.interrupt.is_interrupted() { Ok(Flow::Continue) } else { self.command(&line, session) };
        self.interrupt.enter(State::Stepping);
        self.conclude(done, had_arm, session)
    }

    /// Halts the robot and gives the arm back after an interruption, and closes a lost connection.
    fn conclude(&self, done: Result<Flow, Failure>, had_arm: bool, session: &mut Session) -> Result<Flow, Failure> {
        if session.is_lost() {
            session.abandon();
            return done;
        }
        if !self.interrupt.is_interrupted() {
            return done;
        }
        if had_arm || session.has_arm() {
            return Err(self.interrupt.failure(session.stop()?));
        }
        match done {
            Err(Failure::Interrupted(_)) => done,
            _ => Err(Failure::Interrupted("interrupted".into())),
        }
    }

    /// Returns whether a condition holds.
    fn holds(&self, condition: &Condition, session: &mut Session) -> Result<bool, Failure> {
        session.restart_budget();
        let had_arm = session.has_arm();
        let checked = condition.check(session);
        let holds = checked.as_ref().is_ok_and(Result::is_ok);
        self.conclude(checked.map(|_| Flow::Continue), had_arm, session).map(|_| holds)
    }

    fn command(&self, line: &CommandLine, session: &mut Session) -> Result<Flow, Failure> {
        let json = self.json || line.json;
        match &line.command {
            LineCommand::Verb(command) if matches!(**command, Command::Shell(_)) => return Err(no_shell()),
            LineCommand::Verb(command) => (self.verb)(command, session, json)?,
            LineCommand::Set { name, value } => set(&mut session.variables, name, value)?,
            LineCommand::Sleep { time } => self.interrupt.sleep(*time)?,
            LineCommand::Wait { condition, timeout, within } => {
                self.wait(condition, within.unwrap_or(*timeout), session)?;
            }
            LineCommand::Expect { condition } => expect(condition, session)?,
            LineCommand::Connect => session.reconnect()?,
            LineCommand::Disconnect => session.end()?,
            LineCommand::Help { topic } => help(topic.as_deref())?,
            LineCommand::Exit => return Ok(Flow::Exit),
            // its command runs line by line
            LineCommand::Repeat { .. } | LineCommand::While { .. } | LineCommand::If { .. } => {}
        }
        Ok(Flow::Continue)
    }

    fn wait(&self, condition: &Condition, timeout: Duration, session: &mut Session) -> Result<(), Failure> {
        const INTERVAL: Duration = Duration::from_millis(20);
        let until = Instant::now() + timeout;
        loop {
            session.restart_budget();
            let found = condition.check(session)?;
            let Err(found) = found else { return Ok(()) };
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(Failure::Timeout {
                    message: format!("waited {timeout:?} for {condition}, found {found}"),
                    hint: "allow more time with --within".into(),
                });
            }
            self.interrupt.sleep(INTERVAL.min(left))?;
        }
    }
}

/// Splits a line into words; `None` for a line without a command.
fn words_of(line: &str, variables: &HashMap<String, String>) -> Result<Option<Vec<String>>, Failure> {
    let words = words::split(line, variables, &LAST_PACKETS).map_err(Failure::Input)?;
    match words.first() {
        None => Ok(None),
        Some(first) if first == "bcap" => Err(Failure::Input("write the command without the word bcap".into())),
        Some(_) => Ok(Some(words)),
    }
}

fn set(variables: &mut HashMap<String, String>, name: &str, value: &[String]) -> Result<(), Failure> {
    let value = match value {
        [equals, value @ ..] if equals == "=" && !value.is_empty() => value.join(" "),
        _ => return Err(Failure::Input("write `set NAME = VALUE`".into())),
    };
    if name.is_empty() || !name.chars().all(is_name) {
        return Err(Failure::Input(format!("{name}: a name has letters, digits and _")));
    }
    variables.insert(name.to_owned(), value);
    Ok(())
}

/// Refuses nested `repeat`, `while` and `if`, whose depth would have no limit.
fn repeated(words: &[String]) -> Result<(), Failure> {
    match words.first() {
        Some(word) if ["repeat", "while", "if"].contains(&word.as_str()) => {
            Err(Failure::Input(format!("a line has one of repeat, while and if; write a script for {word}")))
        }
        _ => Ok(()),
    }
}

/// Splits the words of `while` and `if` into the condition and the command.
fn guarded(words: &[String]) -> Result<(Condition, &[String]), Failure> {
    match words {
        [name, relation, value, command @ ..] if RELATIONS.contains(&relation.as_str()) => {
            let [name, relation, value] = [name, relation, value].map(String::to_owned);
            repeated(command).map(|()| (Condition { name, relation, value }, command))
        }
        _ => Err(Failure::Input("write a condition of three words, such as IO130 = true, and a command".into())),
    }
}

fn no_shell() -> Failure {
    Failure::Input("a shell does not run inside a shell or a script".into())
}

impl std::fmt::Display for Condition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {} {}", self.name, self.relation, self.value)
    }
}

impl Condition {
    /// Reads the variable; returns its value as text if the condition does not hold.
    fn check(&self, session: &mut Session) -> Result<Result<(), String>, Failure> {
        let found = get_one(session, &ObjectPath::variable(&self.name)?)?;
        let wanted = data::from_input(&self.value, found.as_variant()).map_err(Failure::Input)?;
        let holds = self.holds(&found, &wanted)?;
        Ok(if holds { Ok(()) } else { Err(data::format(found.as_variant())) })
    }

    fn holds(&self, found: &Value, wanted: &Value) -> Result<bool, Failure> {
        // values with the same text are equal
        let equal = || found == wanted || data::format(found.as_variant()) == data::format(wanted.as_variant());
        let numbers = || match (found.as_variant().as_f64(), wanted.as_variant().as_f64()) {
            (Some(found), Some(wanted)) => Ok((found, wanted)),
            _ => Err(Failure::Input(format!("{}: only numbers can be compared with {}", self.name, self.relation))),
        };
        Ok(match self.relation.as_str() {
            "=" | "==" => equal(),
            "!=" => !equal(),
            "<" => numbers().map(|(found, wanted)| found < wanted)?,
            "<=" => numbers().map(|(found, wanted)| found <= wanted)?,
            ">" => numbers().map(|(found, wanted)| found > wanted)?,
            _ => numbers().map(|(found, wanted)| found >= wanted)?,
        })
    }
}

fn expect(condition: &Condition, session: &mut Session) -> Result<(), Failure> {
    let message = |found| format!("expected {condition}, found {found}");
    condition.check(session)?.map_err(|found| Failure::Unfit { message: message(found), code: None, hint: None })
}

/// Returns whether a command may take the arm or move the robot.
fn may_take_arm(command: &Command) -> bool {
    match command {
        Command::Move(_) | Command::Jog(_) => true,
        Command::Exec(Exec { command, .. }) => command.eq_ignore_ascii_case("TakeArm"),
        Command::Call(Call { function: Some(name), help: false, .. }) => {
            FunctionId::parse(name) == Some(FunctionId::ROBOT_EXECUTE)
        }
        _ => false,
    }
}

/// Prints requested help, or converts the error of an invalid command.
fn explained(error: &clap::Error) -> Result<(), Failure> {
    if is_help(error) { Ok(print_raw(error.render().to_string().trim_end())?) } else { Err(invalid(error)) }
}

/// Returns whether the user requested help.
fn is_help(error: &clap::Error) -> bool {
    matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion)
}

/// Converts the error of an invalid command.
fn invalid(error: &clap::Error) -> Failure {
    let text = error.render().to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text).trim_end();
    // the advice to use --help and the usage of `bcap` itself are about the command line
    let about_bcap = |line: &str| line.starts_with("For more information") || line.starts_with("Usage: bcap [");
    let lines: Vec<_> = text.lines().filter(|line| !about_bcap(line)).collect();
    Failure::Input(escape::block(lines.join("\n").trim_end()))
}

/// Returns the names and the summaries of all commands of a line.
pub(crate) fn commands() -> Vec<(String, String)> {
    let line = CommandLine::command();
    let summary = |command: &clap::Command| command.get_about().map(ToString::to_string).unwrap_or_default();
    line.get_subcommands().map(|command| (command.get_name().to_owned(), summary(command))).collect()
}

fn help(topic: Option<&str>) -> Result<(), Failure> {
    let Some(topic) = topic else {
        for (name, summary) in commands() {
            print_line(&format!("{name:12} {summary}"))?;
        }
        print_line("`help NAME` describes a command or one of the 137 functions; `call --list` lists the functions")?;
        return Ok(());
    };
    if let Some(function) = FunctionId::parse(topic) {
        return Ok(reference::function(function)?);
    }
    let mut line = CommandLine::command();
    line.build();
    match line.find_subcommand_mut(topic) {
        Some(command) => Ok(print_raw(command.render_long_help().to_string().trim_end())?),
        None => Err(Failure::Input(format!("there is no command or function {topic}; `help` lists the commands"))),
    }
}
