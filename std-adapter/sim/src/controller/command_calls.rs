//! Opens and executes command objects.

use bcap_core::bcap::server::Request;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;

use super::{Controller, controller_execute};
use crate::answer::{Answer, Answered};
use crate::command_objects::CommandObject;
use crate::objects::Item;
use crate::table::Command;
use crate::waits::Wait;

impl Controller {
    pub(super) fn open_command(&mut self, peer: PeerId, name: &str) -> Answered {
        let functions = self.shared.config.model.functions;
        let command = Command::find(controller_execute::COMMANDS, name).filter(|command| command.exists(functions));
        let name = command.ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?.name;
        self.open(peer, Item::Command(CommandObject::default()), name.to_owned())
    }

    fn command_mut(&mut self, peer: PeerId, handle: i32) -> Result<&mut CommandObject, HResult> {
        match &mut self.objects.get_mut(peer, handle, Object::Command)?.item {
            Item::Command(command) => Ok(command),
            _ => Err(HResult::E_HANDLE),
        }
    }

    pub(super) fn call_command(&mut self, peer: PeerId, request: &Request<'_>) -> Answered {
        let handle = request.handle();
        let running = self.command_mut(peer, handle)?.running();
        // it may have ended while no call waited for it
        if let Some(outcome) = running.and_then(|wait| self.outcome(wait)) {
            self.command_mut(peer, handle)?.end(outcome);
        }
        match request.function {
            FunctionId::COMMAND_EXECUTE => self.execute_command(peer, handle, request.int(1)),
            FunctionId::COMMAND_CANCEL => self.cancel_command(peer, handle),
            _ => self.command_mut(peer, handle)?.call(request),
        }
    }

    /// Returns how the event has ended that a command without a waiting call has started; `None` if it has not.
    fn outcome(&self, wait: Wait) -> Option<Result<(), HResult>> {
        match wait {
            Wait::Tasks => (!self.is_busy()).then_some(Ok(())),
            wait => self.arm.outcome(wait, self.shared.now),
        }
    }

    fn execute_command(&mut self, peer: PeerId, handle: i32, mode: i32) -> Answered {
        if ![0, 1].contains(&mode) {
            return Err(HResult::E_INVALIDARG);
        }
        let name = self.objects.get(peer, handle, Object::Command)?.name.clone();
        let now = self.shared.now;
        let parameters = self.command_mut(peer, handle)?.begin(now)?;
        let mut answered = self.run(peer, &name, &parameters.as_variant());
        if let Ok(Answer::Until(wait)) = answered {
            self.shared.waits.begin(peer, wait);
            self.arm.advance(now, &mut self.shared.waits);
            answered = self.poll(peer).map(Answer::of_command);
        }
        let answer = self.record(peer, handle, answered)?;
        if mode == 0 {
            return Ok(answer);
        }
        if let Answer::Poll(_) = answer {
            self.shared.waits.forget(peer);
        }
        Ok(Answer::Done)
    }

    /// Continues an execution, up to the timeout of its command.
    pub(super) fn resume_command(&mut self, peer: PeerId, handle: i32) -> Answered {
        let now = self.shared.now;
        let is_overdue = self.command_mut(peer, handle)?.is_overdue(now);
        if is_overdue && !matches!(self.shared.waits.get(peer), Some(Wait::Over(_))) {
            // the command itself continues
            self.shared.waits.forget(peer);
            return Err(HResult::E_TIMEOUT);
        }
        let answered = self.poll(peer).map(Answer::of_command);
        self.record(peer, handle, answered)
    }

    /// Records the progress of an execution, and returns its answer.
    fn record(&mut self, peer: PeerId, handle: i32, answered: Answered) -> Answered {
        let command = self.command_mut(peer, handle)?;
        command.record(&answered);
        let deadline = command.deadline();
        Ok(match answered? {
            Answer::Until(wait) => {
                let at = self.poll_time(wait);
                Answer::Poll(deadline.map_or(at, |deadline| deadline.min(at)))
            }
            answer => answer,
        })
    }

    fn cancel_command(&mut self, peer: PeerId, handle: i32) -> Answered {
        let Some(wait) = self.command_mut(peer, handle)?.running() else { return Ok(Answer::Code(HResult::S_FALSE)) };
        self.arm.cancel(wait, self.shared.now, &mut self.shared.waits);
        self.command_mut(peer, handle)?.end(Err(HResult::E_CANCEL));
        Ok(Answer::Done)
    }
}
