//! Slave Mode over sockets.
//!
//! [`Arm::stream`](crate::blocking::Arm::stream) streams the poses of a trajectory. Below it, a stream is a
//! [`Procedure`](bcap_core::procedure::Procedure) that [`Engine::stream`](bcap_core::slave::Engine::stream) makes, with all
//! formats, IO, a required start, and a second connection for the controller's errors;
//! [`Connection::run_watched`](crate::blocking::Connection::run_watched) runs it. `Realtime` (feature `realtime`) requests the
//! scheduling and memory settings that a stream needs on a busy machine.
//!
//! Timers of tokio have a resolution of one millisecond and never fire early, so in modes 0 and 1 poses are sent one to two
//! milliseconds after their deadline. That jitter does not accumulate, and the buffer of mode 0 (24 ms) absorbs it. Mode 2
//! uses no timer. In mode 1 the blocking client has less jitter.
//!
//! # Examples
//!
//! Moves the first joint by one degree and back:
//!
//! ```no_run
//! use bcap_std::Settings;
//! use bcap_std::blocking::Controller;
//! use bcap_std::core::slave::{
//!     AxisLimits, Cycle, Format, Mode, Next, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode,
//! };
//!
//! let mut cell = Controller::connect("udp:192.168.0.1", &Settings::rc9())?;
//! let mut arm = cell.robot()?.take_arm()?;
//! arm.motor_on()?;
//! let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
//! let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
//! let mut swing = |cycle: &Cycle<'_>| {
//!     let turn = f64::from(cycle.number) / 250.0;
//!     if turn > 1.0 {
//!         return Next::Finish;
//!     }
//!     let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
//!     joints[0] += 0.5 * (1.0 - (turn * std::f64::consts::TAU).cos());
//!     Next::Pose(Pose::j(joints))
//! };
//! let stats = arm.stream(format, AxisLimits::uniform(100.0, 800.0), &mut swing)?;
//! println!("{} cycles, {} late", stats.cycles, stats.late);
//! # Ok::<(), bcap_std::Error>(())
//! ```

#[cfg(feature = "realtime")]
mod realtime;

#[cfg(feature = "realtime")]
pub use self::realtime::{Realtime, RealtimeError};
