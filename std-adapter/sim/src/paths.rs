//! The paths: lists of points.

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

/// The paths.
#[derive(Clone, Debug)]
pub(crate) struct Paths(Vec<Vec<PathPoint>>);

impl Paths {
    pub(crate) fn new() -> Self {
        Self(vec![Vec::new(); PATHS])
    }

    pub(crate) fn path(&self, path: i32) -> Result<&Vec<PathPoint>, HResult> {
        place(path).and_then(|n| self.0.get(n)).ok_or(HResult::E_INVALIDARG)
    }

    pub(crate) fn path_mut(&mut self, path: i32) -> Result<&mut Vec<PathPoint>, HResult> {
        place(path).and_then(|n| self.0.get_mut(n)).ok_or(HResult::E_INVALIDARG)
    }

    /// Returns the points of a path, in work coordinates.
    pub(crate) fn frames(&self, path: i32) -> Result<Vec<Frame>, HResult> {
        Ok(self.path(path)?.iter().map(|point| point.frame).collect())
    }
}

/// Returns the place of a path or a point, whose numbers begin with 1.
pub(crate) fn place(number: i32) -> Option<usize> {
    usize::try_from(number.checked_sub(1)?).ok()
}
