//! The replies of a stream, which are written to a CSV file after its end.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use bcap_core::slave::{CURRENT_LEN, MoveReply, PoseType, ReceiveFormat, ReceivePose, TimeUnit};

/// The maximum number of numbers of a pose in a reply.
const POSE_MAX: usize = 18;

/// The maximum size of user IO in a reply in bytes.
const USER_MAX: usize = 8;

/// The replies. It never grows beyond its initial capacity, so recording does not allocate.
pub struct Received {
    pub(crate) format: ReceiveFormat,
    replies: Vec<Reply>,
}

#[derive(Clone, Copy)]
struct Reply {
    at: f64,
    time: i32,
    pose: [f64; POSE_MAX],
    mini: i32,
    user: [u8; USER_MAX],
    hand: i32,
    current: [f64; CURRENT_LEN],
}

impl Received {
    /// Reserves capacity for this number of replies.
    pub fn new(format: ReceiveFormat, room: usize) -> Self {
        Self { format, replies: Vec::with_capacity(room) }
    }

    /// Records a reply that arrived at `at` seconds.
    pub fn record(&mut self, at: f64, reply: &MoveReply<'_>) {
        if self.replies.len() == self.replies.capacity() {
            return;
        }
        let (mut pose, mut user) = ([0.0; POSE_MAX], [0; USER_MAX]);
        pose.iter_mut().zip(reply.pose().iter()).for_each(|(slot, number)| *slot = number);
        user.iter_mut().zip(reply.user_io().unwrap_or_default()).for_each(|(slot, byte)| *slot = *byte);
        self.replies.push(Reply {
            at,
            time: reply.timestamp().map_or(0, |stamp| stamp.ticks),
            pose,
            mini: reply.mini_io().unwrap_or(0),
            user,
            hand: reply.hand_io().unwrap_or(0),
            current: reply.current().unwrap_or_default(),
        });
    }

    /// Writes the file.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let mut file = BufWriter::new(File::create(path)?);
        writeln!(file, "{}", self.header().join(","))?;
        self.replies.iter().try_for_each(|reply| writeln!(file, "{}", self.fields(reply).join(",")))?;
        file.flush()
    }

    fn header(&self) -> Vec<String> {
        let Self { format, .. } = self;
        let kinds: &[PoseType] = match format.pose {
            ReceivePose::P => &[PoseType::P],
            ReceivePose::J => &[PoseType::J],
            ReceivePose::T => &[PoseType::T],
            ReceivePose::PJ => &[PoseType::P, PoseType::J],
            ReceivePose::TJ => &[PoseType::T, PoseType::J],
        };
        let mut names = vec!["t"];
        names.extend(format.time.map(|unit| if unit == TimeUnit::Micros { "TIME_us" } else { "TIME_ms" }));
        names.extend(kinds.iter().flat_map(|kind| kind.columns()));
        names.extend(format.mini_io.then_some("MINI"));
        names.extend(format.user_io.map(|_| "USER"));
        names.extend(format.hand_io.then_some("HAND"));
        let currents = (1..=CURRENT_LEN).filter(|_| format.current).map(|axis| format!("CURRENT{axis}"));
        names.into_iter().map(str::to_owned).chain(currents).collect()
    }

    fn fields(&self, reply: &Reply) -> Vec<String> {
        let Self { format, .. } = self;
        let bits = |bits: i32| format!("{:#x}", bits.cast_unsigned());
        let mut fields = vec![format!("{:.6}", reply.at)];
        fields.extend(format.time.map(|_| reply.time.cast_unsigned().to_string()));
        fields.extend(reply.pose.iter().take(format.pose.len()).map(f64::to_string));
        fields.extend(format.mini_io.then(|| bits(reply.mini)));
        // byte 0 has the first IO; `slave play` reads the number
        fields.extend(format.user_io.map(|_| format!("{:#x}", u64::from_le_bytes(reply.user))));
        fields.extend(format.hand_io.then(|| bits(reply.hand)));
        fields.extend(reply.current.iter().filter(|_| format.current).map(f64::to_string));
        fields
    }
}
