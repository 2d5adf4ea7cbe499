//! The mode numbers of Slave Mode.
//!
//! ```text
//!   0x 0 m t      m = 0, 1, 2   when the controller replies to slvMove, and how it treats a full or an empty buffer
//!                 t = 1, 2, 3   the type of the poses: P, J, T
//!   0x 0 0 0      Slave Mode is off
//! ```

use core::fmt;

/// When the controller replies to slvMove, and how it buffers the pose (b-CAP specification, sections 5.3 to 5.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// A buffer of 3 poses; replies immediately: S_BUF_FULL when the pose filled the buffer, E_BUF_FULL when it was not stored.
    Mode0,
    /// A buffer of 1 pose, which each pose overwrites; replies immediately.
    Mode1,
    /// A buffer of 3 poses; replies when the pose is stored.
    Mode2,
}

impl Mode {
    /// Returns how many poses the controller buffers.
    #[must_use]
    pub const fn buffer(self) -> u32 {
        match self {
            Self::Mode0 | Self::Mode2 => 3,
            Self::Mode1 => 1,
        }
    }
}

/// The type of a pose, in millimetres and degrees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PoseType {
    /// X, Y, Z, RX, RY, RZ, Fig.
    P,
    /// The joints J1 to J8.
    J,
    /// X, Y, Z, the orientation vector, the approach vector, Fig.
    T,
}

impl PoseType {
    /// Returns the number of values of a pose, without the extended-joint option.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "no pose is empty")]
    pub const fn len(self) -> usize {
        match self {
            Self::P => P_LEN,
            Self::J => J_LEN,
            Self::T => T_LEN,
        }
    }

    /// Returns the names of the values of a pose, without the extended-joint option.
    #[must_use]
    pub const fn columns(self) -> &'static [&'static str] {
        match self {
            Self::P => &["X", "Y", "Z", "RX", "RY", "RZ", "FIG"],
            Self::J => &["J1", "J2", "J3", "J4", "J5", "J6", "J7", "J8"],
            Self::T => &["X", "Y", "Z", "OX", "OY", "OZ", "AX", "AY", "AZ", "FIG"],
        }
    }

    const fn code(self) -> i32 {
        match self {
            Self::P => 1,
            Self::J => 2,
            Self::T => 3,
        }
    }
}

/// The number of values of a P pose.
pub const P_LEN: usize = 7;
/// The number of values of a J pose.
pub const J_LEN: usize = 8;
/// The number of values of a T pose.
pub const T_LEN: usize = 10;

/// A mode and a type of pose: the parameter of slvChangeMode and the reply to slvGetMode.
///
/// # Examples
///
/// ```
/// use bcap_core::slave::{Mode, PoseType, SlaveMode};
///
/// let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
/// assert_eq!(mode.code(), 0x202);
/// assert_eq!(SlaveMode::from_code(0x202), Some(mode));
/// assert_eq!(SlaveMode::from_code(0x304), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SlaveMode {
    /// Mode 0, 1 or 2.
    pub mode: Mode,
    /// P, J or T.
    pub pose: PoseType,
}

impl SlaveMode {
    /// The number of slvChangeMode that leaves Slave Mode.
    pub const OFF: i32 = 0;

    /// Returns the number that slvChangeMode takes.
    #[must_use]
    pub const fn code(self) -> i32 {
        let high = match self.mode {
            Mode::Mode0 => 0,
            Mode::Mode1 => 0x100,
            Mode::Mode2 => 0x200,
        };
        high | self.pose.code()
    }

    /// Returns the mode with this number; `None` for [`OFF`](Self::OFF) and for invalid numbers.
    #[must_use]
    pub const fn from_code(code: i32) -> Option<Self> {
        let mode = match code & !0xf {
            0 => Mode::Mode0,
            0x100 => Mode::Mode1,
            0x200 => Mode::Mode2,
            _ => return None,
        };
        let pose = match code & 0xf {
            1 => PoseType::P,
            2 => PoseType::J,
            3 => PoseType::T,
            _ => return None,
        };
        Some(Self { mode, pose })
    }
}

impl fmt::Display for SlaveMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.mode {
            Mode::Mode0 => "mode 0, type ",
            Mode::Mode1 => "mode 1, type ",
            Mode::Mode2 => "mode 2, type ",
        })?;
        f.write_str(match self.pose {
            PoseType::P => "P",
            PoseType::J => "J",
            PoseType::T => "T",
        })
    }
}
