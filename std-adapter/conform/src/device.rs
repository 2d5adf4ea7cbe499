//! The device under test and the settings of a run.

use std::net::SocketAddr;
use std::time::Duration;

use crate::language::{Group, Level};
use bcap_testkit::wire::Link;

/// The addresses of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Target {
    /// The link and the address of b-CAP.
    pub bcap: Option<(Link, SocketAddr)>,
    /// The address of RAC.
    pub rac: Option<SocketAddr>,
}

/// The settings of a run.
#[derive(Clone, Debug)]
pub struct Options {
    /// The device.
    pub target: Target,
    /// The highest level of the cases that run.
    pub level: Level,
    /// The groups that run; empty means all.
    pub groups: Vec<Group>,
    /// The names of the cases that run, such as `frames/wrong-eot`; empty means all.
    pub cases: Vec<String>,
    /// The time limit of each reply, and of connecting.
    pub timeout: Duration,
    /// The maximum wait for a device that accepts no connections after a case, such as after a crash.
    pub wait: Duration,
    /// The command that restarts such a device, in a shell.
    pub restart: Option<String>,
    /// The maximum number of runs of the command.
    pub restarts: u32,
    /// The time without bytes after which a case treats the device as silent.
    pub quiet: Duration,
    /// The provider of Controller_Connect.
    pub provider: String,
    /// The machine of Controller_Connect.
    pub machine: String,
    /// The option of Controller_Connect.
    pub option: String,
    /// The name of the task for the cases of tasks.
    pub task: String,
    /// The index of the variables that cases of level `write` may write: I49, F49, D49, S49, V49, P49, J49, T49. A real RC8A has 50 of
    /// D, S, V and T.
    pub scratch: u32,
}

impl Options {
    /// Returns the settings for a device: level `read`, all cases, 3 s for a reply.
    #[must_use]
    pub fn new(target: Target) -> Self {
        Self {
            target,
            level: Level::Read,
            groups: Vec::new(),
            cases: Vec::new(),
            timeout: Duration::from_secs(3),
            wait: Duration::from_secs(30),
            restart: None,
            restarts: 100,
            quiet: Duration::from_millis(250),
            provider: "CaoProv.DENSO.VRC".into(),
            machine: "localhost".into(),
            option: String::new(),
            task: "Pro1".into(),
            scratch: 49,
        }
    }

    /// Returns the name of the scratch variable of a kind.
    pub(crate) fn scratch(&self, kind: &str) -> String {
        format!("{kind}{}", self.scratch)
    }
}

/// The meaning of a missing function or object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refusals {
    /// The case does not apply.
    Skip,
    /// The case fails.
    Fail,
}
