//! Tools and work coordinates: the frames that poses refer to.
//!
//! ```text
//!  base ── work ──> work coordinates ── pose ──> tool centre point <── tool ── flange
//! ```

use crate::kinematics::{Frame, Geometry, Joints, measured, pose_numbers};
use crate::pose::Pose;

/// The number of definitions of each kind; number 0 is the base or the flange itself.
const COUNT: usize = 64;

/// The arm, the tool and the work coordinates of a pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coordinates {
    pub(crate) arm: Geometry,
    /// The tool centre point, relative to the flange.
    pub(crate) tool: Frame,
    /// Relative to the base.
    pub(crate) work: Frame,
}

impl Coordinates {
    /// Returns the pose of the tool centre point in work coordinates.
    pub(crate) fn pose(&self, flange: &Frame) -> Frame {
        self.work.inverse().times(flange).times(&self.tool)
    }

    /// Returns the tool centre point in work coordinates.
    pub(crate) fn place(&self, joints: &Joints) -> Frame {
        self.pose(&self.arm.forward(joints))
    }

    /// Returns X Y Z RX RY RZ Fig of the tool centre point.
    pub(crate) fn position(&self, joints: &Joints) -> Vec<f64> {
        pose_numbers(&self.place(joints), self.arm.figure(joints))
    }

    /// Returns position, orient vector, approach vector and Fig of the tool centre point.
    pub(crate) fn trans(&self, joints: &Joints) -> Vec<f64> {
        let [x, y, z, vectors @ ..] = self.place(joints).to_trans();
        let mut numbers = measured([x, y, z]);
        // the components of a unit vector; a difference of 1e-9 is less than 1e-6 degrees
        numbers.extend(vectors.map(|n| (n * 1e9).round() / 1e9 + 0.0));
        numbers.push(f64::from(self.arm.figure(joints)));
        numbers
    }

    /// Returns the tool centre point of a pose, and its Fig if it has one.
    pub(crate) fn pose_of(&self, pose: &Pose) -> (Frame, Option<u8>) {
        match pose {
            Pose::Joints(joints) => (self.place(joints), None),
            Pose::Frame(frame, fig) => (*frame, *fig),
        }
    }

    /// Returns the pose of the flange, relative to the base.
    pub(crate) fn flange(&self, pose: Pose) -> Pose {
        match pose {
            Pose::Frame(frame, fig) => Pose::Frame(self.work.times(&frame).times(&self.tool.inverse()), fig),
            joints @ Pose::Joints(_) => joints,
        }
    }
}

/// The definitions of tools, of work coordinates or of bases, each with its attribute.
#[derive(Clone, Debug)]
pub(crate) struct Definitions(Vec<(Frame, i32)>);

impl Definitions {
    pub(crate) fn new() -> Self {
        Self(vec![(Frame::IDENTITY, 0); COUNT])
    }

    /// Returns a definition; an invalid number has the definition of 0.
    pub(crate) fn get(&self, number: i32) -> Frame {
        self.entry(number).0
    }

    /// Returns the attribute of a definition: 0, or 1 for work coordinates with a fixed tool.
    pub(crate) fn attribute(&self, number: i32) -> i32 {
        self.entry(number).1
    }

    fn entry(&self, number: i32) -> (Frame, i32) {
        usize::try_from(number).ok().and_then(|n| self.0.get(n)).copied().unwrap_or((Frame::IDENTITY, 0))
    }

    /// Sets a definition, except number 0; returns whether the number is valid.
    pub(crate) fn set(&mut self, number: i32, frame: Frame, attribute: i32) -> bool {
        let place = usize::try_from(number).ok().filter(|n| *n > 0).and_then(|n| self.0.get_mut(n));
        place.map(|place| *place = (frame, attribute)).is_some()
    }
}
