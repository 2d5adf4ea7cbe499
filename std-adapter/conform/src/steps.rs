//! Runs a case: its setup, its steps, and the end, which undoes their changes.

use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_testkit::value::Value;

use crate::bench::{Bench, Stop, fail};
use crate::case::{Body, Case};
use crate::device::Refusals;
use crate::language::{Arg, Setup, Slot, Step, Want};
use crate::line;
use crate::reply::request_text;

/// The pause between two pieces of a frame: longer than the gap between the segments of one write.
const PIECE_PAUSE: Duration = Duration::from_millis(20);

impl Bench<'_> {
    /// Runs a case, then undoes its changes.
    pub(crate) fn run(&mut self, case: &Case) -> Result<(), Stop> {
        let result = self.setup(case.setup).and_then(|()| match &case.body {
            Body::Steps(steps) => steps.iter().try_for_each(|step| self.step(step)),
            Body::Run(run) => run(self),
        });
        let (log, refused) = (self.log.len(), self.refused);
        let restored = self.clean_up();
        // a connection that the device refuses at the end does not excuse the case
        self.refused = refused;
        if restored.is_ok() {
            self.log.truncate(log);
        }
        match (result, restored) {
            // the reader must see both
            (Err(Stop::Fail { expected, came }), Err(Stop::Fail { expected: then, came: end })) => {
                fail(format!("{expected}; at the end, {then}"), format!("{came}; at the end, {end}"))
            }
            (Err(Stop::Skip(_)), Err(failed @ Stop::Fail { .. })) => Err(failed),
            (result, restored) => result.and(restored),
        }
    }

    fn step(&mut self, step: &Step) -> Result<(), Stop> {
        match *step {
            Step::Call(function, args, want) => self.want(function, args, want).map(drop),
            Step::Must(function, args, want) => self.must(function, args, want).map(drop),
            Step::Open(slot, function, args) => self.open(slot, function, args),
            Step::Differ(a, b) if self.handle(a) == self.handle(b) => {
                fail("two open objects have different handles", format!("both are {}", self.handle(a)))
            }
            Step::Differ(..) => Ok(()),
            Step::Edited(edits, reaction) => self.edited(edits, reaction),
            Step::Pieces(sizes) => self.pieces(sizes),
            Step::Copy { renumbered } => self.copy(renumbered),
            Step::Reconnect => {
                self.connect()?;
                self.must(FunctionId::SERVICE_START, &[Arg::S("")], Want::NoValue).map(drop)
            }
            Step::ReconnectController => self.setup(Setup::Controller),
            Step::ConnectController => self.open_controller(),
            Step::Save(kind) => self.save(kind),
            Step::Line(line, want) => line::check(self, line, want),
            Step::Other(step) => self.as_another(step),
            Step::Here => {
                let reply = self.robot_command("CurJnt", "0,")?;
                self.check(FunctionId::ROBOT_EXECUTE, &reply, Want::Array(5, 8), Refusals::Skip)?;
                self.here = reply.args.into_iter().next();
                Ok(())
            }
            Step::SlvMove(want) => {
                let Some(here) = self.here.clone() else { return fail("the present joints", "they were not read") };
                let args = vec![self.argument(&Arg::H(Slot::Robot))?, Value::text("slvMove"), here];
                let reply = self.exchange(FunctionId::ROBOT_EXECUTE, args)?;
                self.check(FunctionId::ROBOT_EXECUTE, &reply, want, Refusals::Skip)
            }
        }
    }

    /// Executes a step in a new session of another client. Its refusals count for this case too.
    fn as_another(&mut self, step: &Step) -> Result<(), Stop> {
        let mut other = self.another()?;
        let made = other.open_controller().and_then(|()| other.open_robot()).and_then(|()| other.step(step));
        self.caused.append(&mut other.caused);
        self.log.extend(other.log.drain(..).map(|line| format!("other client: {line}")));
        made
    }

    /// Sends Service_Start in pieces, each after a pause.
    fn pieces(&mut self, sizes: &[usize]) -> Result<(), Stop> {
        let (serial, bytes) = self.request(FunctionId::SERVICE_START, &[Value::text("WDT=400")]);
        let mut rest = bytes.as_slice();
        for size in sizes.iter().copied().chain([usize::MAX]) {
            let (piece, after) = rest.split_at(size.min(rest.len()));
            rest = after;
            self.send(piece, "a piece of Service_Start")?;
            if !rest.is_empty() {
                std::thread::sleep(PIECE_PAUSE);
            }
        }
        let reply = self.reply(FunctionId::SERVICE_START, serial)?;
        self.check(FunctionId::SERVICE_START, &reply, Want::NoValue, Refusals::Fail)
    }

    fn copy(&mut self, renumbered: bool) -> Result<(), Stop> {
        let Some(last) = self.last.clone() else { return fail("a call", "no call was made") };
        let serial = if renumbered { self.next_serial() } else { last.serial };
        let bytes = self.encode(serial, last.marker, last.function, &last.args);
        self.send(&bytes, &format!("copy of #{}: {}", last.marker, request_text(serial, last.function, &last.args)))?;
        let reply = self.reply(last.function, serial)?;
        let Some(first) = last.reply else { return fail("a first reply", "no reply") };
        if first.code == reply.code && first.args == reply.args {
            Ok(())
        } else {
            fail(format!("the first reply again: {}", first.text()), reply.text())
        }
    }
}
