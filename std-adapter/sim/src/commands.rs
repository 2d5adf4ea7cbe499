//! Command objects: a command of Controller_Execute with its parameters and its result, to be executed again and again.
//!
//! | function                                 | what it does                                                    |
//! |------------------------------------------|-----------------------------------------------------------------|
//! | Controller_GetCommand                    | opens a command by the name that Controller_Execute takes       |
//! | Controller_GetCommandNames               | BSTR array: those that this controller has                      |
//! | Command_PutParameters, -GetParameters    | what Controller_Execute would get; EMPTY before                 |
//! | Command_Execute 0                        | executes it and answers its result                              |
//! | Command_Execute 1                        | begins it and answers; `E_CAO_CMD_EXECUTE` while it runs        |
//! | Command_GetState                         | I4: 0 not executed yet, 1 running, 2 done, 3 failed, cancelled  |
//! | Command_GetResult                        | the result; the code with which it failed; EMPTY before         |
//! | Command_PutTimeout, -GetTimeout          | I4, ms that Execute 0 waits, then `E_TIMEOUT`; 0 is without end |
//! | Command_Cancel                           | stops the motor or the hand; `S_FALSE` when nothing runs        |
//!
//! Only Motor and the motions of a COBOTTA's hand take time; all others are done when they are begun. The numbers of
//! the states and of the modes are this model's: no public client uses command objects.

use std::time::Duration;

use bcap_core::bcap::server::Request;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::controller::{Controller, Wait};
use crate::dispatch::{Answer, Answered};
use crate::objects::{Contents, Item};
use crate::robot::Servo;
use crate::value::{Value, keep, kept};

/// A command object's own state.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Command {
    /// Encoded; nothing is EMPTY.
    parameters: Vec<u8>,
    /// Zero for as long as it takes.
    timeout: Duration,
    progress: Progress,
    /// When Execute gives up waiting.
    give_up: Option<Instant>,
}

/// How far a command has come.
#[derive(Clone, Debug, Default, PartialEq)]
enum Progress {
    #[default]
    NotYet,
    /// It waits for this.
    Running(Wait),
    /// With its result, encoded.
    Done(Vec<u8>),
    Failed(HResult),
}

impl Controller {
    pub(crate) fn open_command(&mut self, peer: PeerId, name: &str) -> Answered {
        let known = self.command_names().find(|known| known.eq_ignore_ascii_case(name.trim()));
        let name = known.ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
        self.open_with(peer, Item::Command, name.to_owned(), Contents::Command(Command::default()))
    }

    pub(crate) fn command_call(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let handle = request.handle();
        if request.resumed {
            return self.resume_command(peer, handle);
        }
        self.look_at_command(peer, handle)?;
        let entry = self.objects.get_mut(peer, handle, Object::Command)?;
        let Contents::Command(command) = &mut entry.contents else { return Err(HResult::E_HANDLE) };
        Ok(match request.function {
            FunctionId::COMMAND_EXECUTE => return self.execute_command(peer, handle, request.int(1)),
            FunctionId::COMMAND_CANCEL => return self.cancel_command(peer, handle),
            FunctionId::COMMAND_GET_TIMEOUT => {
                Value::I4(i32::try_from(command.timeout.as_millis()).unwrap_or(i32::MAX)).into()
            }
            FunctionId::COMMAND_PUT_TIMEOUT => {
                let millis = u64::try_from(request.int(1)).map_err(|_| HResult::E_INVALIDARG)?;
                command.timeout = Duration::from_millis(millis);
                Answer::Done
            }
            FunctionId::COMMAND_GET_STATE => Value::I4(match command.progress {
                Progress::NotYet => 0,
                Progress::Running(_) => 1,
                Progress::Done(_) => 2,
                Progress::Failed(_) => 3,
            })
            .into(),
            FunctionId::COMMAND_GET_PARAMETERS => Value::Kept(command.parameters.clone()).into(),
            FunctionId::COMMAND_PUT_PARAMETERS => {
                command.parameters = keep(&request.value(1))?;
                Answer::Done
            }
            FunctionId::COMMAND_GET_RESULT => match &command.progress {
                Progress::Done(result) => Value::Kept(result.clone()).into(),
                Progress::Failed(code) => return Err(*code),
                Progress::NotYet | Progress::Running(_) => Value::Empty.into(),
            },
            _ => return Err(HResult::E_NOTIMPL),
        })
    }

    fn command(&mut self, peer: PeerId, handle: i32) -> Result<&mut Command, HResult> {
        match &mut self.objects.get_mut(peer, handle, Object::Command)?.contents {
            Contents::Command(command) => Ok(command),
            _ => Err(HResult::E_HANDLE),
        }
    }

    fn execute_command(&mut self, peer: PeerId, handle: i32, mode: i32) -> Answered {
        if ![0, 1].contains(&mode) {
            return Err(HResult::E_INVALIDARG);
        }
        let name = self.objects.get(peer, handle, Object::Command)?.name.clone();
        let now = self.now;
        let command = self.command(peer, handle)?;
        if matches!(command.progress, Progress::Running(_)) {
            return Err(HResult::E_CAO_CMD_EXECUTE);
        }
        command.give_up = (!command.timeout.is_zero()).then(|| now.saturating_add(command.timeout));
        let parameters = command.parameters.clone();
        let answered = self.controller_execute(peer, &name, &kept(&parameters));
        let answered = self.note_progress(peer, handle, answered)?;
        match (mode, answered) {
            (1, Answer::Wait(_)) => {
                self.waits.remove(&peer);
                Ok(Answer::Done)
            }
            (1, _) => Ok(Answer::Done),
            (_, answer) => Ok(answer),
        }
    }

    /// Goes on waiting, for as long as the timeout lets it.
    fn resume_command(&mut self, peer: PeerId, handle: i32) -> Answered {
        let give_up = self.command(peer, handle)?.give_up;
        if give_up.is_some_and(|at| at <= self.now) && !matches!(self.waits.get(&peer), Some(Wait::Over(_))) {
            // what was begun goes on
            self.waits.remove(&peer);
            return Err(HResult::E_TIMEOUT);
        }
        let answered = self.resume_execute(peer);
        self.note_progress(peer, handle, answered)
    }

    /// Keeps what has become of a command.
    fn note_progress(&mut self, peer: PeerId, handle: i32, answered: Answered) -> Answered {
        let waits = self.waits.get(&peer).copied();
        let command = self.command(peer, handle)?;
        command.progress = match (&answered, waits) {
            (Ok(Answer::Wait(_)), Some(wait)) => Progress::Running(wait),
            (Ok(Answer::Value(value) | Answer::Coded(_, value)), _) => Progress::Done(value.encoded()),
            (Ok(_), _) => Progress::Done(Vec::new()),
            (Err(code), _) => Progress::Failed(*code),
        };
        let give_up = command.give_up;
        Ok(match answered? {
            Answer::Wait(at) => Answer::Wait(give_up.map_or(at, |give_up| give_up.min(at))),
            answer => answer,
        })
    }

    /// Finds out whether what runs without anybody waiting for it has ended.
    fn look_at_command(&mut self, peer: PeerId, handle: i32) -> Result<(), HResult> {
        let stands = self.hand.end(self.now).is_none();
        let servo = self.robot.servo;
        let command = self.command(peer, handle)?;
        let ended = match command.progress {
            Progress::Running(Wait::Servo) => match servo {
                Servo::On => Some(Progress::Done(Vec::new())),
                Servo::Off => Some(Progress::Failed(HResult::E_MOTOR_OFF)),
                Servo::TurningOn(_) => None,
            },
            Progress::Running(Wait::Hand) if stands => Some(Progress::Done(Vec::new())),
            _ => None,
        };
        if let Some(ended) = ended {
            command.progress = ended;
        }
        Ok(())
    }

    fn cancel_command(&mut self, peer: PeerId, handle: i32) -> Answered {
        let Progress::Running(wait) = self.command(peer, handle)?.progress else {
            return Ok(Answer::Code(HResult::S_FALSE));
        };
        match wait {
            Wait::Servo => self.motor_off(HResult::E_CANCEL),
            _ => drop(self.stop_hand(HResult::E_CANCEL)),
        }
        self.command(peer, handle)?.progress = Progress::Failed(HResult::E_CANCEL);
        Ok(Answer::Done)
    }
}
