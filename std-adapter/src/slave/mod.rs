//! Slave Mode over sockets: real-time settings for the streams of [`bcap_core::slave`].
//!
//! A stream is a [`Procedure`](bcap_core::procedure::Procedure). [`Engine::stream`](bcap_core::slave::Engine::stream)
//! makes it from an engine and a trajectory. [`Connection::run`](crate::blocking::Connection::run) runs it, in the blocking
//! and the tokio client. [`Realtime`] requests the scheduling and memory settings that a stream needs on a busy machine.
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
//! use bcap_std::blocking;
//! use bcap_std::core::slave::{
//!     AxisLimits, Config, Cycle, Engine, Format, Mode, Next, Pose, PoseType, ReceiveFormat, ReceivePose, SlaveMode,
//! };
//! use bcap_std::core::procedure::{Provider, open_robot, release_robot};
//! use bcap_std::slave::Realtime;
//!
//! let mut motion = blocking::connect_udp("192.168.0.1:5007", &Default::default())?;
//! let mut watch = blocking::connect_tcp("192.168.0.1:5007", &Default::default())?;
//! let handles = motion.run(open_robot(Provider::RC9, None))?;
//! let watching = watch.run(open_robot(Provider::RC9, None))?;
//!
//! let mode = SlaveMode { mode: Mode::Mode2, pose: PoseType::J };
//! let format = Format::new(mode, ReceiveFormat::pose(ReceivePose::J));
//! let limits = AxisLimits::uniform(100.0, 800.0);
//! let mut engine = Engine::<256>::new(Config { watch: Some(watching), limits, ..Config::new(format, handles) })?;
//!
//! Realtime { fifo: Some(80), lock_memory: true, core: Some(1) }.apply()?;
//! let mut swing = |cycle: &Cycle<'_>| {
//!     let turn = f64::from(cycle.number) / 250.0;
//!     if turn > 1.0 {
//!         return Next::Finish;
//!     }
//!     let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
//!     joints[0] += 0.5 * (1.0 - (turn * std::f64::consts::TAU).cos());
//!     Next::Pose(Pose::j(joints))
//! };
//! motion.run_beside(&mut watch, engine.stream(&mut swing))?;
//! println!("{} cycles, {} late", engine.stats().cycles, engine.stats().late);
//! watch.run(release_robot(watching))?;
//! motion.run(release_robot(handles))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod realtime;

pub use self::realtime::{Realtime, RealtimeError};
