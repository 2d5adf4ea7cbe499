//! The right of a page to work with backups: a dump and a comparison only read, a restore needs the control and a question.

use serde_json::{Value, json};

use crate::backup;
use crate::job::{Kind, Work};
use crate::socket::Page;
use crate::threads::lock;

impl Page {
    /// Begins a dump, a comparison, or the plan of a restore.
    pub(crate) fn work(&self, robot: usize, work: Work) -> Result<Value, String> {
        if work.kind == Kind::Restore {
            return Err("a restore needs the name of the robot; nothing was done".into());
        }
        let robot = self.robot(robot)?;
        let who = robot.control.user(self.client()).unwrap_or_else(|_| "a page".into());
        backup::start(&self.app, &robot, self.client(), who, work)
    }

    /// Begins the restore that this page has planned. `name` is the robot's name in the question.
    pub(crate) fn restore(&self, number: usize, name: &str, folder: String) -> Result<Value, String> {
        let (who, robot) = (self.writer(number)?, self.named(number, name)?);
        backup::start(
            &self.app,
            &robot,
            self.client(),
            who,
            Work { kind: Kind::Restore, folder, with: None, io: false },
        )
    }

    /// Ends the work on backups of a robot between two calls.
    pub(crate) fn end_work(&self, number: usize) -> Result<Value, String> {
        let robot = self.robot(number)?;
        if let Some(job) = &*lock(&robot.backup) {
            if job.client != self.client() && job.work.kind == Kind::Restore {
                return Err("another page restores; it ends that, or releases the control".into());
            }
            job.end("the user ended it");
        }
        Ok(json!(null))
    }
}
