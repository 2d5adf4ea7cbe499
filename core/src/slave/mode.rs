//! The mode numbers of Slave Mode.
//!
//! ```text
//!   0x 0 m t      m = 0, 1, 2   when slvMove is answered, and what happens when the buffer is full or empty
//!                 t = 1, 2, 3   what a pose is: P, J, T
//!   0x 0 0 0      Slave Mode is off
//! ```

use core::fmt;

/// When the controller answers slvMove, and what it does with the pose (S2:1187-1296).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Mode {
    /// A buffer of 3; answers at once, S_BUF_FULL when the pose filled it and E_BUF_FULL when it was not stored.
    Mode0,
    /// A buffer of 1 that each pose overwrites; answers at once.
    Mode1,
    /// A buffer of 3; the answer waits until the pose has a place.
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

/// What the numbers of a pose are; millimetres and degrees.
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
    /// Returns how many numbers a pose has, without the extended-joint option.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "no pose is empty")]
    pub const fn len(self) -> usize {
        match self {
            Self::P => P_LEN,
            Self::J => J_LEN,
            Self::T => T_LEN,
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

/// The numbers of a P pose.
pub const P_LEN: usize = 7;
/// The numbers of a J pose.
pub const J_LEN: usize = 8;
/// The numbers of a T pose.
pub const T_LEN: usize = 10;

/// A mode with a type of pose: what slvChangeMode switches on and slvGetMode tells.
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

    /// Returns the mode with this number; `None` for [`OFF`](Self::OFF) and for numbers that mean nothing.
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
