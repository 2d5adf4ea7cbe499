//! Whether a serial line is fast enough for a stream.

use std::time::Duration;

use bcap_core::bcap::Link;
use bcap_core::slave::Format;
use bcap_std::SerialLine;

/// The time limit for a pose and its reply on the line.
const CYCLE: Duration = Duration::from_millis(8);

/// The time in a cycle that the programs at both ends need.
const ENDS: Duration = Duration::from_millis(1);

/// Refuses a serial line that cannot carry a pose and its reply in each cycle.
///
/// # Errors
///
/// The time of a pose and its reply, and the required baud rate.
pub fn check(line: &SerialLine, format: &Format) -> Result<(), String> {
    let [request, reply] = format.frame_lengths(Link::Serial).map(|bytes| u32::try_from(bytes).unwrap_or(u32::MAX));
    let bytes = request.saturating_add(reply);
    let time = line.transfer_time(bytes);
    if time + ENDS <= CYCLE {
        return Ok(());
    }
    let bits = bytes.saturating_mul(line.byte_bits());
    let needed = f64::from(bits) / (CYCLE - ENDS).as_secs_f64();
    Err(format!(
        "serial:{line} is too slow for Slave Mode: slvMove has {request} bytes and its reply {reply}, together {bytes} bytes of \
         {} bits, which are {bits} bits and take {:.1} ms at {} baud; a pose is sent every 8 ms, and the two ends need 1 ms of \
         it. The line needs {needed:.0} baud or more, such as 460800 or 921600; or use TCP or UDP",
        line.byte_bits(),
        time.as_secs_f64() * 1000.0,
        line.baud,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::slave::{Mode, PoseType, ReceiveFormat, ReceivePose, SlaveMode};
    use bcap_std::Parity;

    #[test]
    fn the_line_must_carry_a_pose_and_its_reply_in_a_cycle() {
        let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
        let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
        let at = |baud| check(&SerialLine::new("/dev/ttyS0").baud(baud), &format);
        let error = at(115_200).unwrap_err();
        let part = "slvMove has 134 bytes and its reply 92, together 226 bytes of 10 bits, which are 2260 bits and take 19.6 ms at \
                    115200 baud";
        assert!(error.contains(part), "{error}");
        assert!(error.contains("The line needs 322857 baud"), "{error}");
        assert!(at(230_400).is_err() && at(322_850).is_err());
        assert!(at(322_860).is_ok() && at(921_600).is_ok());
        // a parity bit is an eleventh bit
        assert!(check(&SerialLine::new("/dev/ttyS0").baud(322_860).parity(Parity::Even), &format).is_err());
    }
}
