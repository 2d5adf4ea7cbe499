//! The trajectory of a stream: the poses and outputs to send, and the recorded values of the replies.

use std::sync::Arc;

use bcap_core::slave::{AxisLimits, Cycle, Format, MoveReply, Next, Outputs, Pose, PoseType, SendIo, Trajectory};
use bcap_core::time::Instant;

use crate::outputs::OutputBits;
use crate::received::Received;
use crate::report::StreamTimes;
use crate::sample::{CYCLE, Sample};
use crate::status::StreamStatus;

/// The path of the robot.
pub enum Course {
    /// A sequence of poses, played `loops` times.
    Poses {
        /// One pose per cycle.
        poses: Vec<Pose>,
        /// The outputs of each cycle.
        outputs: Vec<OutputBits>,
        /// The number of repetitions.
        loops: u32,
    },
    /// One period of a cosine from the current pose.
    Cosine {
        /// The period in cycles.
        cycles: u32,
        /// The distance to the turning point, in degrees or mm.
        amplitude: f64,
    },
}

impl Course {
    /// Returns the number of cycles.
    pub fn cycles(&self) -> u32 {
        match self {
            Self::Poses { poses, loops, .. } => u32::try_from(poses.len()).unwrap_or(u32::MAX).saturating_mul(*loops),
            Self::Cosine { cycles, .. } => *cycles,
        }
    }

    /// Checks all poses against limits, from rest at the first pose, as they are checked again before each is sent. The error is
    /// a sentence with the number of the pose, counted from 0.
    pub fn check(&self, limits: &AxisLimits) -> Result<(), String> {
        let Self::Poses { poses, loops, .. } = self else { return Ok(()) };
        // the step from the last pose to the first is the same in every loop
        let rounds = usize::try_from(*loops).unwrap_or(usize::MAX).min(2);
        let played = poses.iter().cycle().take(poses.len().saturating_mul(rounds));
        limits
            .check_path(CYCLE, played)
            .map_err(|(number, error)| format!("pose {}: {error}; nothing was moved", number % poses.len().max(1)))
    }

    fn pose(&self, cycle: &Cycle<'_>) -> Option<Pose> {
        match self {
            _ if cycle.number >= self.cycles() => None,
            Self::Poses { poses, .. } => poses.get(cycle.number as usize % poses.len().max(1)).copied(),
            Self::Cosine { cycles, amplitude } => {
                let part = f64::from(cycle.number + 1) / f64::from(*cycles);
                let by = amplitude / 2.0 * (1.0 - (part * std::f64::consts::TAU).cos());
                let mut numbers = cycle.start.numbers().to_vec();
                let kind = cycle.start.layout().pose;
                // joint 1, or Z
                if let Some(number) = numbers.get_mut(if kind == PoseType::J { 0 } else { 2 }) {
                    *number += by;
                }
                let pose = Pose::from_numbers(kind, &numbers)?;
                Some(cycle.start.extended().map_or(pose, |joints| pose.with_extended(joints)))
            }
        }
    }

    /// Returns the outputs that the file has for a cycle.
    fn outputs(&self, number: u32) -> OutputBits {
        match self {
            Self::Poses { outputs, .. } => {
                outputs.get(number as usize % outputs.len().max(1)).copied().unwrap_or_default()
            }
            Self::Cosine { .. } => OutputBits::default(),
        }
    }

    /// Returns the pose where the stream starts; `None` for the current pose.
    pub fn start(&self) -> Option<Pose> {
        match self {
            Self::Poses { poses, .. } => poses.first().copied(),
            Self::Cosine { .. } => None,
        }
    }
}

/// The outputs that the next pose sets.
#[derive(Clone, Copy, Debug)]
struct NextOutputs {
    mini: i32,
    hand: i32,
    user: [u8; 8],
    /// The bytes of user IO that the format sends.
    user_bytes: usize,
}

impl NextOutputs {
    /// Returns the outputs at the start.
    fn new(bits: OutputBits, user_bytes: usize) -> Self {
        Self {
            mini: low(bits.mini.unwrap_or(0)),
            hand: low(bits.hand.unwrap_or(0)),
            user: bits.user.unwrap_or(0).to_le_bytes(),
            user_bytes,
        }
    }

    /// Changes the outputs that the file sets.
    fn change(&mut self, file: OutputBits) {
        if let Some(mini) = file.mini {
            self.mini = low(mini);
        }
        if let Some(hand) = file.hand {
            self.hand = low(hand);
        }
        if let Some(user) = file.user {
            self.user = user.to_le_bytes();
        }
    }
}

/// Returns the low 32 bits; a file with more bits was refused.
fn low(bits: u64) -> i32 {
    u32::try_from(bits & u64::from(u32::MAX)).unwrap_or(0).cast_signed()
}

/// The trajectory of a running stream.
pub struct Player {
    course: Course,
    status: Arc<StreamStatus>,
    kind: PoseType,
    outputs: NextOutputs,
    commanded: [f64; 10],
    began: Option<Instant>,
    /// The round trips and the jitter.
    pub times: StreamTimes,
    /// The cycles for the plot. It never grows beyond its initial capacity, so recording does not allocate.
    pub samples: Vec<Sample>,
    /// The replies for the file, which does not allocate either.
    pub received: Received,
}

impl Player {
    /// Creates the trajectory of a stream with this format. It sets no outputs, and keeps no cycles and no replies.
    #[must_use]
    pub fn new(course: Course, format: &Format) -> Self {
        let user_bytes = match format.send.io {
            SendIo::User(range) => range.bytes().into(),
            SendIo::None | SendIo::Mini => 0,
        };
        Self {
            course,
            status: Arc::default(),
            kind: format.mode.pose,
            outputs: NextOutputs::new(OutputBits::default(), user_bytes),
            commanded: [0.0; 10],
            began: None,
            times: StreamTimes::default(),
            samples: Vec::new(),
            received: Received::new(format.receive, 0),
        }
    }

    /// Begins with these outputs.
    #[must_use]
    pub fn with_outputs(mut self, bits: OutputBits) -> Self {
        self.outputs = NextOutputs::new(bits, self.outputs.user_bytes);
        self
    }

    /// Reports the progress to `status`, and stops when it requests that.
    #[must_use]
    pub fn with_status(self, status: Arc<StreamStatus>) -> Self {
        Self { status, ..self }
    }

    /// Keeps this number of cycles for a plot.
    #[must_use]
    pub fn keeping_samples(self, count: usize) -> Self {
        Self { samples: Vec::with_capacity(count), ..self }
    }

    /// Keeps this number of replies for a file.
    #[must_use]
    pub fn keeping_replies(self, count: usize) -> Self {
        Self { received: Received::new(self.received.format, count), ..self }
    }
}

impl Trajectory for Player {
    fn next(&mut self, cycle: &Cycle<'_>) -> Next {
        self.times.follow(cycle.stats);
        self.status.update(cycle.number, cycle.stats.late, cycle.stats.refused, cycle.margin);
        if self.status.is_stopped() {
            return Next::Stop;
        }
        match self.course.pose(cycle) {
            Some(pose) => {
                self.outputs.change(self.course.outputs(cycle.number));
                self.commanded = padded(pose.numbers());
                Next::Pose(pose)
            }
            None => Next::Finish,
        }
    }

    fn outputs(&mut self) -> Option<Outputs<'_>> {
        let NextOutputs { mini, hand, user, user_bytes } = &self.outputs;
        Some(Outputs { mini_io: *mini, hand_io: *hand, user_io: user.get(..*user_bytes)? })
    }

    fn moved(&mut self, reply: &MoveReply<'_>, now: Instant) {
        let at = now.saturating_since(*self.began.get_or_insert(now)).as_secs_f64();
        self.received.record(at, reply);
        if self.samples.len() == self.samples.capacity() {
            return;
        }
        let actual = match self.kind {
            PoseType::P => reply.position().map(|numbers| padded(&numbers)),
            PoseType::J => reply.joints().map(|numbers| padded(&numbers)),
            PoseType::T => reply.transform().map(|numbers| padded(&numbers)),
        };
        self.samples.push(Sample { at, commanded: self.commanded, actual: actual.unwrap_or_default() });
    }
}

fn padded(numbers: &[f64]) -> [f64; 10] {
    let mut out = [0.0; 10];
    for (slot, number) in out.iter_mut().zip(numbers) {
        *slot = *number;
    }
    out
}
