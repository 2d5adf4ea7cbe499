//! The arguments of `bcap slave` for the values that slvMove and its reply carry in addition to the pose.

use std::path::PathBuf;

use bcap_core::slave::{ExtendedAxes, Format, SendFormat, SlaveMode};
use bcap_stream::format::{ReceiveParts, bits, extended, send_format};
use bcap_stream::outputs::{self, OutputBits, parse_bits};
use bcap_stream::poses::Poses;
use clap::Args;

/// The values that slvMove and its reply carry in addition to the pose (b-CAP specification, section 5.2).
#[derive(Debug, Args)]
pub(crate) struct FormatArgs {
    /// Values that slvMove sets in addition to the pose (slvSendFormat): mini or user:PORT:BYTES, and hand, separated
    /// by commas
    ///
    /// MiniIO and user IO exclude each other. PORT is the number of the first IO, a multiple of 8 from 128 on. --mini-io,
    /// --user-io and --hand-io have the values; columns MINI, USER and HAND of a file change them in each pose. A value whose
    /// part is not in PARTS, or that does not fit it, is refused.
    #[arg(long, value_name = "PARTS", default_value = "none", value_parser = send_format)]
    pub(crate) send_format: SendFormat,

    /// Values of a reply (slvRecvFormat): P, J, T, PJ or TJ, and time or time-us, mini, user:PORT:BYTES, hand, current,
    /// separated by commas [default: the pose in the type of the stream]
    #[arg(long, value_name = "PARTS", value_parser = ReceiveParts::parse)]
    pub(crate) recv_format: Option<ReceiveParts>,

    /// The bits of MiniIO that slvMove sets, such as 0x10000 for IO16 [default: 0]
    #[arg(long, value_name = "BITS", value_parser = bits)]
    pub(crate) mini_io: Option<i32>,

    /// The bits of HandIO that slvMove sets [default: 0]
    #[arg(long, value_name = "BITS", value_parser = bits)]
    pub(crate) hand_io: Option<i32>,

    /// The bits of the user IO that slvMove sets; bit 0 is the first IO of its range [default: 0]
    #[arg(long, value_name = "BITS", value_parser = parse_bits)]
    pub(crate) user_io: Option<u64>,

    /// The extended joints that slvMove moves: 7, 8 or 7,8
    ///
    /// Poses of type P and T have them in the columns J7 and J8, or after their other numbers; a cosine holds them.
    #[arg(long, value_name = "AXES", default_value = "none", value_parser = extended)]
    pub(crate) extended: ExtendedAxes,

    /// Writes each reply to a CSV file: the time of its arrival, the pose, and the other parts of --recv-format
    #[arg(long, value_name = "FILE.csv")]
    pub(crate) received: Option<PathBuf>,
}

impl FormatArgs {
    /// Returns the format of a stream.
    pub(crate) fn format(&self, mode: SlaveMode) -> Format {
        let receive = self.recv_format.unwrap_or_default().format(mode.pose);
        Format { extended: self.extended, send: self.send_format, ..Format::new(mode, receive) }
    }

    /// Checks the options of the outputs.
    pub(crate) fn check_options(&self) -> Result<(), String> {
        let OutputBits { mini, user, hand } = self.outputs();
        let checked = outputs::check(self.send_format, ["--mini-io", "--user-io", "--hand-io"], [mini, user, hand]);
        checked.map_err(with_option)
    }

    /// Checks that slvMove carries the outputs of a file.
    pub(crate) fn check_poses(&self, poses: &Poses) -> Result<(), String> {
        poses.check_outputs(self.send_format).map_err(with_option)
    }

    /// Returns the outputs of the command line.
    pub(crate) fn outputs(&self) -> OutputBits {
        let [mini, hand] = [self.mini_io, self.hand_io].map(|bits| bits.map(|bits| bits.cast_unsigned().into()));
        OutputBits { mini, user: self.user_io, hand }
    }
}

/// Names the option of the command line in an error of the library.
fn with_option(problem: String) -> String {
    problem.replace("the send format", "--send-format")
}
