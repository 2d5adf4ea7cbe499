//! Streams of poses in Slave Mode: their files, the trajectory, and the report.
//!
//! | module         | contents                                                                      |
//! |----------------|-------------------------------------------------------------------------------|
//! | [`poses`]      | files of poses, and the interpolation to one pose for each cycle              |
//! | [`mod@format`] | texts of the formats of slvMove and of its replies                            |
//! | [`outputs`]    | the outputs that a pose sets: MiniIO, user IO and HandIO                      |
//! | [`player`]     | the trajectory of a stream, which records the replies                         |
//! | [`steps`]      | a stream whose loop the caller owns                                           |
//! | [`status`]     | the progress of a stream, which another thread shows and stops                |
//! | [`received`]   | the replies of a stream as a CSV file                                         |
//! | [`report`]     | the statistics of a stream as JSON and as text                                |
//! | [`plot`]       | poses, differences and cycle times as SVG                                     |
//! | [`trajectory`] | the trajectory of an arm as an MCAP or CSV file                               |
//! | [`line_speed`] | whether a serial line is fast enough                                          |
//!
//! Without the feature `files` there is only [`steps`].
//!
//! # Examples
//!
#![cfg_attr(feature = "files", doc = include_str!("../README.md"))]

#[cfg(feature = "files")]
pub mod format;
#[cfg(feature = "files")]
pub mod line_speed;
#[cfg(feature = "files")]
pub mod outputs;
#[cfg(feature = "files")]
pub mod player;
#[cfg(feature = "files")]
pub mod plot;
#[cfg(feature = "files")]
pub mod poses;
#[cfg(feature = "files")]
pub mod received;
#[cfg(feature = "files")]
pub mod report;
#[cfg(feature = "files")]
pub mod sample;
#[cfg(feature = "files")]
pub mod status;
pub mod steps;
#[cfg(feature = "files")]
pub mod trajectory;
