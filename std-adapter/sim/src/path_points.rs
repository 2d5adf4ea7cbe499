//! The points of the 20 paths that clients define.

use bcap_core::hresult::HResult;

use crate::kinematics::Frame;

/// The number of paths, and of the points of a path.
const PATHS: usize = 20;
pub(crate) const POINTS_MAX: usize = 5000;

/// A point: the pose in work coordinates, and its Fig or -1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PathPoint {
    pub(crate) frame: Frame,
    pub(crate) fig: f64,
}

/// The points of all paths.
#[derive(Clone, Debug)]
pub(crate) struct PathPoints(Vec<Vec<PathPoint>>);

impl PathPoints {
    pub(crate) fn new() -> Self {
        Self(vec![Vec::new(); PATHS])
    }

    pub(crate) fn path(&self, path: i32) -> Result<&Vec<PathPoint>, HResult> {
        position(path).and_then(|n| self.0.get(n)).ok_or(HResult::E_INVALIDARG)
    }

    pub(crate) fn path_mut(&mut self, path: i32) -> Result<&mut Vec<PathPoint>, HResult> {
        position(path).and_then(|n| self.0.get_mut(n)).ok_or(HResult::E_INVALIDARG)
    }

    /// Returns the points of a path, in work coordinates.
    pub(crate) fn frames(&self, path: i32) -> Result<Vec<Frame>, HResult> {
        Ok(self.path(path)?.iter().map(|point| point.frame).collect())
    }
}

/// Returns the position in its list of a path or a point, whose numbers begin with 1.
pub(crate) fn position(number: i32) -> Option<usize> {
    usize::try_from(number.checked_sub(1)?).ok()
}
