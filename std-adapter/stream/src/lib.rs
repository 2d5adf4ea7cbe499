//! Streams of poses in Slave Mode: their files, the trajectory, and the report.
//!
//! | module         | contents                                                                      |
//! |----------------|-------------------------------------------------------------------------------|
//! | [`poses`]      | files of poses, and the interpolation to one pose for each cycle              |
//! | [`mod@format`] | texts of the formats of slvMove and of its replies                            |
//! | [`outputs`]    | the outputs that a pose sets: MiniIO, user IO and HandIO                      |
//! | [`player`]     | the trajectory of a stream, which records the replies                         |
//! | [`status`]     | the progress of a stream, which another thread shows and stops                |
//! | [`received`]   | the replies of a stream as a CSV file                                         |
//! | [`report`]     | the statistics of a stream as JSON and as text                                |
//! | [`plot`]       | poses, differences and cycle times as SVG                                     |
//! | [`line_speed`] | whether a serial line is fast enough                                          |
//!
//! # Examples
//!
#![doc = include_str!("../README.md")]

pub mod format;
pub mod line_speed;
pub mod outputs;
pub mod player;
pub mod plot;
pub mod poses;
pub mod received;
pub mod report;
pub mod sample;
pub mod status;
