//! How tasks of a controller start and stop, and their status.

/// How a task is started (b-CAP specification, section 4.2.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TaskStart {
    /// Once (1).
    OneCycle,
    /// Continuously (2). The b-CAP specification calls this number "one cycle" in a packet (section 4.2.2) and
    /// "continuous" in a sample (section 4.2.4): expect that the task does not end.
    Continuous,
    /// One step of the program (3).
    OneStep,
}

/// When a task stops (b-CAP specification, section 4.2.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TaskStop {
    /// The controller chooses (0).
    Default,
    /// Immediately (1).
    Now,
    /// After the current step (2).
    AfterStep,
    /// After the current cycle (3).
    AfterCycle,
    /// Immediately; the next start is from the beginning (4).
    Initialize,
}

/// The status of a task, from its command `GetStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum TaskStatus {
    /// There is no such program (0).
    None,
    /// On hold (1).
    Suspended,
    /// It can be started (2).
    Ready,
    /// It runs (3).
    Running,
    /// It has stopped after a step (4).
    StoppedAtStep,
    /// A number that the specification does not define.
    Other(i32),
}

impl TaskStart {
    pub(crate) const fn number(self) -> i32 {
        match self {
            Self::OneCycle => 1,
            Self::Continuous => 2,
            Self::OneStep => 3,
        }
    }
}

impl TaskStop {
    pub(crate) const fn number(self) -> i32 {
        match self {
            Self::Default => 0,
            Self::Now => 1,
            Self::AfterStep => 2,
            Self::AfterCycle => 3,
            Self::Initialize => 4,
        }
    }
}

impl TaskStatus {
    pub(crate) const fn of(number: i32) -> Self {
        match number {
            0 => Self::None,
            1 => Self::Suspended,
            2 => Self::Ready,
            3 => Self::Running,
            4 => Self::StoppedAtStep,
            other => Self::Other(other),
        }
    }
}
