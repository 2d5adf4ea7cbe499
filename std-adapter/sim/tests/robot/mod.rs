//! The arm over the handler of b-CAP: authority, motor, motions and what stops them.

mod authority;
mod curves;
mod drives;
mod motions;
mod poses;
mod queue;
mod random;
mod stops;

use bcap_core::hresult::HResult;
use bcap_sim::kinematics::SPEEDS;
use bcap_sim::motion::ACCELERATION_TIME;

use crate::common::{Client, World, close, doubles};

/// The pose and the joints of the guide's slvMove example, where every robot of this file starts.
const POSE: [f64; 7] = [364.16, 0.0, 278.5355, 180.0, 0.0, 180.0, 5.0];
const JOINTS: [f64; 8] = [0.0, 45.0, 90.0, 0.0, 45.0, 0.0, 0.0, 0.0];

fn joints(world: &mut World, client: Client) -> Vec<f64> {
    let (result, value) = world.robot(client, "CurJnt", ());
    assert_eq!(result, HResult::S_OK);
    doubles(&value)
}

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    assert!(close(a, b, tolerance), "{a:?} is not {b:?}");
}

/// The time in seconds of a motion at full speed in which one joint turns by `degrees`.
fn joint_time(axis: usize, degrees: f64) -> f64 {
    degrees / SPEEDS[axis - 1] + ACCELERATION_TIME
}

fn seconds(world: &World) -> f64 {
    world.now.as_micros() as f64 / 1e6
}
