//! Support code for tests and fuzz targets of b-CAP software: values and their generators, an independent decoder, a
//! simulated network and the frames of the specifications.
//!
//! | module         | what it gives                                                                       |
//! |----------------|-------------------------------------------------------------------------------------|
//! | [`value`]      | [`Value`](value::Value), an owned tree, with an encoder of its own                   |
//! | [`frame`]      | [`TestFrame`](frame::TestFrame), a frame of such values                              |
//! | [`oracle`]     | a slow recursive decoder, written from the specification and not from the core       |
//! | [`text`]       | the same for the text of values, with the standard library's floats                  |
//! | [`strategies`] | proptest strategies for values, frames and damage to them                           |
//! | [`vectors`]    | the frames and lines of the specifications, from `tests/vectors`                     |
//! | [`network`]    | a simulated network between a client and a server, with a clock of its own          |
//!
//! It depends only on the core. It is written for clarity, not for speed; where it disagrees with the core, one of the two
//! has a bug.

pub mod frame;
pub mod network;
pub mod oracle;
pub mod strategies;
pub mod text;
pub mod value;
pub mod vectors;
