//! The faults that a proxy injects: which frames are affected, and how.

use std::collections::{HashMap, VecDeque};
use std::str::FromStr;
use std::time::Duration;

use bcap_core::bcap::{Decoder, Header, Progress};
use bcap_core::rac::MAX_LINE;

use crate::call_name::CallName;
use crate::duration;
use crate::role::Role;

/// A share of the frames, `0.1` or `0.1:Robot_Move`.
#[derive(Clone, Debug, PartialEq)]
pub struct Share {
    share: f64,
    of: Option<CallName>,
}

impl FromStr for Share {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (share, of) = match text.split_once(':') {
            Some((share, of)) => (share, Some(of.parse()?)),
            None => (text, None),
        };
        let share = share.parse().ok().filter(|share| (0.0..=1.0).contains(share));
        Ok(Self { share: share.ok_or("write a share from 0 to 1, such as 0.1 or 0.1:Robot_Move")?, of })
    }
}

/// A delay of a share of the frames, `50ms`, `50ms@0.1` or `50ms@0.1:Robot_Move`.
#[derive(Clone, Debug, PartialEq)]
pub struct Delay {
    time: Duration,
    share: Share,
}

impl FromStr for Delay {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (time, of) = match text.split_once(':') {
            Some((time, of)) => (time, Some(of.parse()?)),
            None => (text, None),
        };
        let (time, share) = match time.split_once('@') {
            Some((time, share)) => (time, share.parse::<Share>()?.share),
            None => (time, 1.0),
        };
        Ok(Self { time: duration::parse(time)?, share: Share { share, of } })
    }
}

/// The faults to inject.
#[derive(Clone, Debug, Default)]
pub struct FaultPlan {
    /// The frames to drop.
    pub drop: Vec<Share>,
    /// The frames to delay.
    pub delay: Vec<Delay>,
    /// The frames in which one bit changes.
    pub corrupt: Vec<Share>,
}

impl FaultPlan {
    /// Returns whether every frame passes unchanged.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.drop.is_empty() && self.delay.is_empty() && self.corrupt.is_empty()
    }
}

/// The decision on a frame.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// Whether it is not forwarded.
    pub is_dropped: bool,
    /// The time until it is forwarded.
    pub delay: Duration,
    /// The byte and the bit that change.
    pub flipped: Option<(usize, u8)>,
    /// The fault, for people; empty without a fault.
    pub note: String,
}

/// The faults of one connection: chooses them for each frame, and stores which call a reply belongs to.
#[derive(Debug)]
pub struct Faults {
    plan: FaultPlan,
    random: fastrand::Rng,
    is_rac: bool,
    calls: HashMap<u16, CallName>,
    lines: VecDeque<CallName>,
}

impl Faults {
    /// The faults of a connection, which a seed repeats for the same frames.
    #[must_use]
    pub fn new(plan: FaultPlan, seed: u64, is_rac: bool) -> Self {
        let random = fastrand::Rng::with_seed(seed);
        Self { plan, random, is_rac, calls: HashMap::new(), lines: VecDeque::new() }
    }

    /// Returns the length of the first complete frame or line; `None` if more bytes are needed.
    ///
    /// Bytes that are not a frame count as one unit, so that they pass too.
    #[must_use]
    pub fn first(&self, bytes: &[u8]) -> Option<usize> {
        if self.is_rac {
            let line = bytes.iter().position(|byte| *byte == b'\r').map(|at| at + 1);
            return line.or((bytes.len() > MAX_LINE).then_some(bytes.len()));
        }
        match Decoder::TCP.frame_length(bytes) {
            Ok(length) => length.filter(|length| *length <= bytes.len()),
            Err(_) => Some(bytes.len()),
        }
    }

    /// Chooses the faults of a frame or a line.
    pub fn judge(&mut self, sender: Role, frame: &[u8]) -> Verdict {
        let name = if self.is_rac { self.line(sender, frame) } else { self.frame(sender, frame) };
        let Self { plan, random, .. } = self;
        let mut hit = |share: &Share| {
            let applies = match (&share.of, &name) {
                (None, _) => true,
                (Some(of), Some(name)) => of.has(name),
                (Some(_), None) => false,
            };
            applies && random.f64() < share.share
        };
        let is_dropped = plan.drop.iter().any(&mut hit);
        let delay = plan.delay.iter().filter(|delay| hit(&delay.share)).map(|delay| delay.time).sum();
        let is_corrupt = plan.corrupt.iter().any(&mut hit);
        let flipped = (is_corrupt && !frame.is_empty()).then(|| (random.usize(..frame.len()), random.u8(..8)));
        if self.is_rac && is_dropped && sender == Role::Request {
            // its reply will not arrive
            self.lines.pop_back();
        }
        let mut verdict = Verdict { is_dropped, delay, flipped, note: String::new() };
        verdict.note = verdict.describe(sender, name.as_ref());
        verdict
    }

    /// Returns the call that a frame is a part of.
    fn frame(&mut self, sender: Role, frame: &[u8]) -> Option<CallName> {
        let header = Header::read(frame)?;
        if sender == Role::Response {
            return self.calls.get(&header.serial).cloned();
        }
        let function = header.function();
        let executes = function.argument_names().get(1) == Some(&"command");
        let decoded = executes.then(|| Decoder::TCP.decode(frame).ok()).flatten();
        let command = decoded.and_then(|decoded| match decoded {
            Progress::Complete(frame, _) => frame.args.get(1)?.as_bstr().map(|text| text.to_string()),
            Progress::NeedMore(_) => None,
        });
        let name = CallName { function: function.to_string(), command };
        self.calls.insert(header.serial, name.clone());
        Some(name)
    }

    fn line(&mut self, sender: Role, line: &[u8]) -> Option<CallName> {
        if sender == Role::Response {
            return self.lines.pop_front();
        }
        let start = line.iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        let verb = line.get(start..start + 3).unwrap_or_default().to_ascii_uppercase();
        let name = CallName { function: String::from_utf8_lossy(&verb).into_owned(), command: None };
        self.lines.push_back(name.clone());
        Some(name)
    }
}

impl Verdict {
    /// Returns the frame as it is forwarded.
    #[must_use]
    pub fn applied(&self, frame: &[u8]) -> Vec<u8> {
        let mut forwarded = frame.to_vec();
        if let Some((byte, bit)) = self.flipped
            && let Some(byte) = forwarded.get_mut(byte)
        {
            *byte ^= 1 << bit;
        }
        forwarded
    }

    fn describe(&self, sender: Role, name: Option<&CallName>) -> String {
        let what = match (self.is_dropped, self.flipped) {
            (true, _) => "dropped".into(),
            (false, Some((byte, bit))) => format!("flipped bit {bit} of byte {byte} of"),
            (false, None) if self.delay.is_zero() => return String::new(),
            (false, None) => format!("delayed by {} ms", self.delay.as_millis()),
        };
        let part = if sender == Role::Request { "request" } else { "reply" };
        let name = name.map(|name| format!(" of {name}")).unwrap_or_default();
        format!("fault: {what} the {part}{name}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_parsed() {
        let share: Share = "0.1:variable_get_value".parse().unwrap();
        assert_eq!((share.share, share.of.unwrap().function), (0.1, "Variable_GetValue".into()));
        let delay: Delay = "50ms@0.5:Robot_Execute/slvMove".parse().unwrap();
        assert_eq!((delay.time, delay.share.share), (Duration::from_millis(50), 0.5));
        assert_eq!(delay.share.of.unwrap().command.as_deref(), Some("slvMove"));
        assert_eq!("2s".parse::<Delay>().unwrap().share, Share { share: 1.0, of: None });
        for wrong in ["", "2", "-0.1", "x", "0.1:Jump", "NaN"] {
            assert!(wrong.parse::<Share>().is_err(), "{wrong}");
        }
        for wrong in ["", "ms", "1@2", "1ms:Jump", "0"] {
            assert!(wrong.parse::<Delay>().is_err(), "{wrong}");
        }
    }

    fn plan(drop: &str) -> FaultPlan {
        FaultPlan { drop: vec![drop.parse().unwrap()], ..FaultPlan::default() }
    }

    #[test]
    fn a_fault_of_a_function_is_one_of_its_requests_and_replies() {
        let mut faults = Faults::new(plan("1:PUT"), 1, true);
        assert!(!faults.judge(Role::Request, b"GET:RC8:1:I:\r").is_dropped);
        assert!(faults.judge(Role::Request, b"\nput:RC8:1:I:3,5\r").is_dropped);
        assert!(!faults.judge(Role::Response, b"0,3,5\r").is_dropped);
        // the dropped request has no reply
        assert!(!faults.judge(Role::Request, b"GET:RC8:1:I:\r").is_dropped);
        assert!(!faults.judge(Role::Response, b"0,3,5\r").is_dropped);

        let plan = FaultPlan { delay: vec!["5:PUT".parse().unwrap()], ..FaultPlan::default() };
        let mut faults = Faults::new(plan, 1, true);
        assert_eq!(faults.judge(Role::Request, b"PUT:RC8:1:I:3,5\r").note, "fault: delayed by 5 ms the request of PUT");
        assert_eq!(faults.judge(Role::Response, b"0\r").note, "fault: delayed by 5 ms the reply of PUT");
    }

    #[test]
    fn a_seed_gives_the_same_faults_at_about_the_wanted_rate() {
        let dropped = |seed| -> Vec<bool> {
            let mut faults = Faults::new(plan("0.2"), seed, true);
            (0..1000).map(|_| faults.judge(Role::Request, b"GET:RC8:1:I:\r").is_dropped).collect()
        };
        assert_eq!(dropped(7), dropped(7));
        assert_ne!(dropped(7), dropped(8));
        let count = dropped(7).iter().filter(|dropped| **dropped).count();
        assert!((150..250).contains(&count), "{count}");
    }
}
