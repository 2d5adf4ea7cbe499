//! Tests and fuzzes b-CAP and RAC software: generators, an independent decoder, a judge of replies, and links without sockets.
//!
//! | module         | contents                                                                    | feature     |
//! |----------------|-----------------------------------------------------------------------------|-------------|
//! | [`value`]      | [`Value`](value::Value), an owned tree, with an independent encoder         |             |
//! | [`frame`]      | [`TestFrame`](frame::TestFrame), a frame of such values                     |             |
//! | [`damage`]     | damage to encoded frames                                                    |             |
//! | [`oracle`]     | a slow recursive decoder, written from the specification and not from the core |          |
//! | [`text`]       | the same for the text of values, with the standard library's floats         |             |
//! | [`judge`]      | judges replies: form, serial number, type of the value                      |             |
//! | [`step`]       | the steps of a client, as values and as a text that can be replayed         |             |
//! | [`duplex`]     | a pair of byte streams in memory, and a server on one end                   |             |
//! | [`wire`]       | the raw end of a TCP, UDP or serial connection, as client or server         |             |
//! | [`network`]    | a simulated network between a client and a server, with a virtual clock     |             |
//! | [`restart`]    | restarts a device that has stopped, with a command                          |             |
//! | `generate`     | `Arbitrary` for values and frames                                           | `arbitrary` |
//! | `grammar`      | steps that are valid, nearly valid and hostile                              | `arbitrary` |
//! | `fuzz`         | the engine of `bcap fuzz`: sends sessions to a device, reduces and saves findings | `arbitrary` |
//! | `strategies`   | proptest strategies for values, frames and damage to them                   | `proptest`  |
//! | `vectors`      | the frames and lines of the specifications                                  | `vectors`   |
//! | `flash`        | a NOR flash whose power can be cut at every byte                            | `flash`     |
//!
//! It depends only on the core. It is written for clarity, not for speed; where it disagrees with the core, one of the two has a
//! bug.
#![cfg_attr(feature = "arbitrary", doc = "\n# Examples\n")]
#![cfg_attr(feature = "arbitrary", doc = include_str!("../README.md"))]
#![cfg_attr(docsrs, feature(doc_cfg))]

pub mod damage;
pub mod duplex;
#[cfg(feature = "flash")]
pub mod flash;
pub mod frame;
#[cfg(feature = "arbitrary")]
pub mod fuzz;
#[cfg(feature = "arbitrary")]
pub mod generate;
#[cfg(feature = "arbitrary")]
pub mod grammar;
pub mod judge;
pub mod network;
pub mod oracle;
pub mod restart;
pub mod step;
#[cfg(feature = "proptest")]
pub mod strategies;
pub mod text;
pub mod value;
#[cfg(feature = "vectors")]
pub mod vectors;
pub mod wire;
