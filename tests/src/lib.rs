//! What the tests of the b-CAP stack share: values and their generators, an independent decoder, vectors, a counter of
//! allocations.
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
//! | [`served`]     | a server on real sockets with a small application                                   |
//! | [`slowed`]     | a virtual controller with a slow clock                                              |
//! | [`proxy`]      | what stands between a client and a server on real sockets, and does its worst       |
//! | [`process`]    | memory, processor time and file descriptors of a process                            |
//! | [`allocation`] | an allocator that counts what each thread asks of it                                |
//! | [`async_functions`] | the async functions of a crate, read from its sources                          |
//!
//! Nothing here is fast or frugal; where it disagrees with the core, one of the two is wrong.

pub mod allocation;
pub mod async_functions;
pub mod frame;
pub mod network;
pub mod oracle;
pub mod process;
pub mod proxy;
pub mod served;
pub mod slowed;
pub mod strategies;
pub mod text;
pub mod value;
pub mod vectors;

/// The examples of the README are compiled.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
pub struct Readme;
