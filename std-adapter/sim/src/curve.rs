//! Circles, for arcs and rotations.

use crate::kinematics::{Frame, cross, dot, unit};

/// A point or a vector, in mm.
pub(crate) type Point = [f64; 3];

/// A part of a circle, from its first point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arc {
    pub(crate) centre: Point,
    /// The unit vector about which the arc turns, right-handed.
    pub(crate) axis: Point,
    pub(crate) degrees: f64,
}

impl Arc {
    /// Finds the arc from one point through another to a third; `None` if they are on one line.
    pub(crate) fn through(from: Point, via: Point, to: Point) -> Option<Self> {
        let (a, b) = (difference(via, from), difference(to, from));
        let axis = unit(cross(unit(a)?, unit(b)?))?;
        let normal = cross(a, b);
        let scaled = |v: Point, by: f64| v.map(|x| x * by);
        let offset = difference(scaled(cross(b, normal), dot(a, a)), scaled(cross(a, normal), dot(b, b)));
        let centre = sum(from, scaled(offset, 1.0 / (2.0 * dot(normal, normal))));
        let start = difference(from, centre);
        let end = difference(to, centre);
        let angle = dot(cross(start, end), axis).atan2(dot(start, end)).to_degrees();
        // the axis points so that the arc reaches `via` before `to` when it turns right-handed
        Some(Self { centre, axis, degrees: angle.rem_euclid(360.0) })
    }

    /// Returns its length in mm, for a point at this place.
    pub(crate) fn length(&self, from: Point) -> f64 {
        let arm = difference(from, self.centre);
        let along = dot(arm, self.axis);
        (dot(arm, arm) - along * along).max(0.0).sqrt() * self.degrees.abs().to_radians()
    }
}

/// Returns the place on a curve through frames, at least two; `part` is 0 to 1.
///
/// The positions are on a Catmull-Rom spline, the orientations turn evenly between two frames.
pub(crate) fn on_curve(frames: &[Frame], part: f64) -> Frame {
    let last = frames.len() - 1;
    let place = part.clamp(0.0, 1.0) * last as f64;
    let (n, t) = ((place as usize).min(last - 1), place - (place as usize).min(last - 1) as f64);
    let point = |n: usize| frames[n.min(last)].position;
    let (before, from, to, after) = (point(n.saturating_sub(1)), point(n), point(n + 1), point(n + 2));
    let position = [0, 1, 2].map(|i| {
        let (a, b, c, d) = (before[i], from[i], to[i], after[i]);
        b + t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a))) / 2.0
    });
    frames[n].towards(&frames[n + 1], t).moved_to(position)
}

fn sum(a: Point, b: Point) -> Point {
    [0, 1, 2].map(|i| a[i] + b[i])
}

fn difference(a: Point, b: Point) -> Point {
    [0, 1, 2].map(|i| a[i] - b[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arc_passes_its_points_in_order() {
        let quarter = Arc::through([10.0, 0.0, 5.0], [7.0710678, 7.0710678, 5.0], [0.0, 10.0, 5.0]).unwrap();
        assert!(quarter.centre.iter().zip([0.0, 0.0, 5.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{quarter:?}");
        assert!((quarter.degrees - 90.0).abs() < 1e-6 && quarter.axis[2] > 0.999, "{quarter:?}");
        assert!((quarter.length([10.0, 0.0, 5.0]) - 15.707963).abs() < 1e-5);
        // the same ends the other way round
        let rest = Arc::through([10.0, 0.0, 5.0], [-10.0, 0.0, 5.0], [0.0, 10.0, 5.0]).unwrap();
        assert!((rest.degrees - 270.0).abs() < 1e-6 && rest.axis[2] < -0.999, "{rest:?}");
        assert_eq!(Arc::through([0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]), None);
        assert_eq!(Arc::through([0.0; 3], [0.0; 3], [2.0, 0.0, 0.0]), None);
    }
}
