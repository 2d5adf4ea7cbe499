//! Texts of the formats of slvMove and of its replies, such as `user:128:2,hand`.

use bcap_core::slave::{ExtendedAxes, PoseType, ReceiveFormat, ReceivePose, SendFormat, SendIo, TimeUnit, UserIo};

use crate::outputs::parse_bits;
use crate::steps::reply_pose;

/// The parts of a reply.
#[derive(Clone, Copy, Debug)]
pub struct ReceiveParts {
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
    /// Returns the format of a reply to a stream of this type.
    #[must_use]
    pub fn format(self, stream: PoseType) -> ReceiveFormat {
        let pose = self.pose.unwrap_or(reply_pose(stream));
        ReceiveFormat { pose, ..self.format }
    }

    /// Parses parts such as `PJ,time,user:128:2`.
    ///
    /// # Errors
    ///
    /// The part that is wrong, and what to write.
    pub fn parse(text: &str) -> Result<Self, String> {
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

/// Parses the parts that slvMove carries in addition to the pose, such as `user:128:2,hand`.
///
/// # Errors
///
/// The part that is wrong, and what to write.
pub fn send_format(text: &str) -> Result<SendFormat, String> {
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

/// Parses the extended joints: `none`, `7`, `8` or `7,8`.
///
/// # Errors
///
/// A text that says what to write.
pub fn extended(text: &str) -> Result<ExtendedAxes, String> {
    match text.replace(' ', "").as_str() {
        "none" => Ok(ExtendedAxes::None),
        "7" => Ok(ExtendedAxes::Seven),
        "8" => Ok(ExtendedAxes::Eight),
        "7,8" => Ok(ExtendedAxes::Both),
        _ => Err("write 7, 8 or 7,8".into()),
    }
}

/// Parses 32 bits.
///
/// # Errors
///
/// The text, and its fault.
pub fn bits(text: &str) -> Result<i32, String> {
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
