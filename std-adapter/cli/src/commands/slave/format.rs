//! The arguments of `bcap slave` for the values that slvMove and its reply carry in addition to the pose.

use std::path::PathBuf;

use bcap_core::slave::{
    ExtendedAxes, Format, PoseType, ReceiveFormat, ReceivePose, SendFormat, SendIo, SlaveMode, TimeUnit, UserIo,
};
use clap::Args;

use bcap_stream::outputs::{self, OutputBits, parse_bits};

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
        let parts = self.recv_format.unwrap_or_default();
        let pose = parts.pose.unwrap_or(match mode.pose {
            PoseType::P => ReceivePose::P,
            PoseType::J => ReceivePose::J,
            PoseType::T => ReceivePose::T,
        });
        let receive = ReceiveFormat { pose, ..parts.format };
        Format { extended: self.extended, send: self.send_format, ..Format::new(mode, receive) }
    }

    /// Checks the options of the outputs.
    pub(crate) fn check_options(&self) -> Result<(), String> {
        let OutputBits { mini, user, hand } = self.outputs();
        outputs::check(self.send_format, ["--mini-io", "--user-io", "--hand-io"], [mini, user, hand])
    }

    /// Returns the outputs of the command line.
    pub(crate) fn outputs(&self) -> OutputBits {
        let [mini, hand] = [self.mini_io, self.hand_io].map(|bits| bits.map(|bits| bits.cast_unsigned().into()));
        OutputBits { mini, user: self.user_io, hand }
    }
}

/// The parts of a reply.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReceiveParts {
    /// `None` is the type of the stream.
    pose: Option<ReceivePose>,
    format: ReceiveFormat,
}

impl Default for ReceiveParts {
    fn default() -> Self {
        Self { pose: None, format: ReceiveFormat::pose(ReceivePose::J) }
    }
}

impl ReceiveParts {
    fn parse(text: &str) -> Result<Self, String> {
        let mut parts = Self::default();
        for part in text.split(',').map(str::trim) {
            let Self { pose, format } = &mut parts;
            match part.to_ascii_lowercase().as_str() {
                "p" => *pose = Some(ReceivePose::P),
                "j" => *pose = Some(ReceivePose::J),
                "t" => *pose = Some(ReceivePose::T),
                "pj" => *pose = Some(ReceivePose::PJ),
                "tj" => *pose = Some(ReceivePose::TJ),
                "time" => format.time = Some(TimeUnit::Millis),
                "time-us" => format.time = Some(TimeUnit::Micros),
                "mini" => format.mini_io = true,
                "hand" => format.hand_io = true,
                "current" => format.current = true,
                user if user.starts_with("user:") => format.user_io = Some(user_io(user)?),
                _ => {
                    return Err(format!(
                        "{part:?} is not a part of a reply; write P, J, T, PJ, TJ, time, time-us, mini, user:PORT:BYTES, hand \
                         or current"
                    ));
                }
            }
        }
        Ok(parts)
    }
}

fn send_format(text: &str) -> Result<SendFormat, String> {
    let mut format = SendFormat::POSE;
    for part in text.split(',').map(str::trim) {
        let io = match part.to_ascii_lowercase().as_str() {
            "none" => continue,
            "hand" => {
                format.hand_io = true;
                continue;
            }
            "mini" => SendIo::Mini,
            user if user.starts_with("user:") => SendIo::User(user_io(user)?),
            _ => return Err(format!("{part:?} is not a part of slvMove; write none, mini, user:PORT:BYTES or hand")),
        };
        if format.io != SendIo::None {
            return Err("MiniIO and user IO exclude each other; write one of them".into());
        }
        format.io = io;
    }
    Ok(format)
}

/// Parses `user:PORT:BYTES`.
fn user_io(text: &str) -> Result<UserIo, String> {
    let parts: Vec<&str> = text.split(':').collect();
    let [_, port, bytes] = parts.as_slice() else { return Err(format!("{text:?}: write user:PORT:BYTES")) };
    let wrong = || format!("{text:?}: write a port, and a number of bytes from 1 to 8, such as user:128:2");
    let bytes = bytes.parse().ok().filter(|bytes| (1..=8).contains(bytes)).ok_or_else(wrong)?;
    UserIo::new(port.parse().map_err(|_| wrong())?, bytes).map_err(|error| error.to_string())
}

fn extended(text: &str) -> Result<ExtendedAxes, String> {
    match text.replace(' ', "").as_str() {
        "none" => Ok(ExtendedAxes::None),
        "7" => Ok(ExtendedAxes::Seven),
        "8" => Ok(ExtendedAxes::Eight),
        "7,8" => Ok(ExtendedAxes::Both),
        _ => Err("write 7, 8 or 7,8".into()),
    }
}

/// Parses 32 bits.
fn bits(text: &str) -> Result<i32, String> {
    let bits = parse_bits(text)?;
    u32::try_from(bits).map(u32::cast_signed).map_err(|_| format!("{text} has more than 32 bits"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_have_the_numbers_of_the_specification() {
        let send = |text| send_format(text).unwrap().code();
        assert_eq!(["none", "hand", "mini", "mini,hand"].map(send), [0, 0x20, 0x100, 0x120]);
        assert_eq!(["user:128:2", "hand,user:128:2"].map(send), [0x200, 0x220]);
        let receive = |text| {
            let ReceiveParts { pose, format } = ReceiveParts::parse(text).unwrap();
            ReceiveFormat { pose: pose.unwrap_or(ReceivePose::J), ..format }.code()
        };
        assert_eq!(["P", "j", "T", "PJ", "tj"].map(receive), [1, 2, 3, 4, 5]);
        assert_eq!(["time", "time-us", "hand", "current", "mini"].map(receive), [0x12, 0x12, 0x22, 0x42, 0x102]);
        assert_eq!(receive("PJ, time, mini, user:136:1, hand, current"), 0x374);
    }

    #[test]
    fn wrong_formats_are_refused_with_what_to_write() {
        for (error, part) in [
            (send_format("mini,user:128:1").unwrap_err(), "exclude each other"),
            (send_format("current").unwrap_err(), "\"current\" is not a part of slvMove"),
            (send_format("user:100:1").unwrap_err(), "cannot begin at port 100"),
            (send_format("user:128").unwrap_err(), "write user:PORT:BYTES"),
            (send_format("user:128:9").unwrap_err(), "from 1 to 8"),
            (ReceiveParts::parse("P,x").unwrap_err(), "\"x\" is not a part of a reply"),
            (extended("9").unwrap_err(), "write 7, 8 or 7,8"),
            (bits("0x100000000").unwrap_err(), "more than 32 bits"),
            (bits("-1").unwrap_err(), "write a number"),
        ] {
            assert!(error.contains(part), "{error}");
        }
    }
}
