//! The two protocols of DENSO robot controllers, b-CAP and RAC, without I/O: for firmware and for operating systems.
//!
//! * **b-CAP** calls 137 functions on controllers, robots, tasks, variables and files, in binary frames over TCP, UDP
//!   (port 5007) or a serial line.
//! * **RAC** reads and writes the variables of a controller in lines of text (`GET:RC8:10:I:`) over TCP (port 5006).
//!
//! Both carry values of ORiN2 (VARIANT). The crate contains no socket, clock, thread, allocation or unsafe code. The
//! application moves the bytes, or an adapter: `bcap-std` for operating systems, `bcap-embassy` for boards.
//!
//! # Layers and their guarantees
//!
//! | module      | contents                           | guarantee                                                         |
//! |-------------|------------------------------------|-------------------------------------------------------------------|
//! | [`variant`] | values, in binary and text         | a [`Variant`](variant::Variant) is validated; no accessor fails   |
//! | [`position`] | values of P, J and T variables    | units are in the names; no NaN is sent                            |
//! | [`bcap`]    | frames, functions, calls           | a [`Frame`](bcap::Frame) is validated, within [`limits`]          |
//! | [`bcap::client`], [`bcap::server`] | sans-IO state machines | every wait has a deadline; a late reply never answers another call; the session survives a call dropped at any byte |
//! | [`rac`]     | lines, requests, responses, client and server | a line has at most 256 bytes; a value without a text is an error |
//! | [`device`]  | a table of variables as a server   | clients can access only the listed variables                      |
//! | [`procedure`], [`slave`] | jobs of several calls, Slave Mode | a failed procedure undoes its calls; no pose outside the limits is sent |
//! | [`io`]      | blocking and asynchronous loops over the clients | all progress is in the client, so futures may be dropped |
//! | [`error`], [`hresult`] | errors and result codes | small and `Copy`; an error says what is wrong, where, and whose fault it is |
//!
//! One function validates all received bytes, in one pass and with limited depth. Its results are views of the caller's
//! memory. An owned value ([`VariantBuf`](variant::VariantBuf)) is the wire encoding in a fixed buffer; there is no second
//! representation.
//!
//! # Features
//!
//! No feature is enabled by default, and all features are additive.
//!
//! | feature             | adds                                                            |
//! |---------------------|-----------------------------------------------------------------|
//! | `alloc`             | `OwnedVariant`, `String` and `Vec` as values; `Vec<u8>` as a buffer that grows |
//! | `serde`             | serialisation of positions, joints and transforms; of `OwnedVariant` with `alloc` |
//! | `embedded-io`       | a blocking transport over any `embedded_io` device              |
//! | `embedded-io-async` | an asynchronous transport over any `embedded_io_async` device   |
//! | `defmt`             | `defmt::Format` for the public types, and a log of unusual events |
//! | `log`               | the same log through the `log` crate                            |
//!
//! # Examples
//!
//! A client and a server without a network; a board puts a socket or UART between them.
//!
//! ```
//! use bcap_core::bcap::call::{self, VariableHandle};
//! use bcap_core::bcap::server::{self, Handler, Request, Session};
//! use bcap_core::bcap::client::{self, Client, Timing};
//! use bcap_core::bcap::FunctionId;
//! use bcap_core::endpoint::{Endpoint, Serve};
//! use bcap_core::handler::{Outcome, PeerId, ReplyValue};
//! use bcap_core::hresult::HResult;
//! use bcap_core::time::Instant;
//! use bcap_core::variant::Variant;
//!
//! /// A controller with one variable.
//! struct One(i32);
//!
//! impl Handler for One {
//!     fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
//!         let result = match request.function {
//!             FunctionId::SERVICE_START | FunctionId::SERVICE_STOP => Ok(()),
//!             FunctionId::CONTROLLER_CONNECT | FunctionId::CONTROLLER_GET_VARIABLE => reply.set(&1_i32),
//!             FunctionId::VARIABLE_GET_VALUE => reply.set(&self.0),
//!             FunctionId::VARIABLE_RELEASE | FunctionId::CONTROLLER_DISCONNECT => Ok(()),
//!             _ => return HResult::E_NOTIMPL.into(),
//!         };
//!         if result.is_ok() { HResult::S_OK.into() } else { HResult::E_OUTOFMEMORY.into() }
//!     }
//! }
//!
//! let now = Instant::ZERO;
//! let mut controller = One(42);
//! let mut client = Client::new(client::Config::TCP, [0; 512], [0; 512]);
//! let mut server = Session::<_, _, 8>::new(server::Config::TCP, [0; 512], [0; 512]);
//!
//! // moves a request to the server and its reply to the client
//! let mut exchange = |client: &mut Client<[u8; 512]>| {
//!     let request = client.transmit();
//!     server.receive_buffer()[..request.len()].copy_from_slice(request);
//!     server.received(request.len());
//!     client.transmitted(client.transmit().len());
//!     while server.run(&mut controller, PeerId(1), now).is_some() {}
//!     let reply = server.transmit();
//!     client.receive_buffer()[..reply.len()].copy_from_slice(reply);
//!     client.received(reply.len());
//!     server.transmitted(server.transmit().len());
//!     client.poll_event(now)
//! };
//!
//! client.start(&call::service_start("WDT=400"), Timing::TCP, now)?;
//! exchange(&mut client);
//! client.start(&call::controller_connect("", "CaoProv.DENSO.VRC9", "localhost", ""), Timing::TCP, now)?;
//! exchange(&mut client);
//! let controller = client.value::<call::ControllerHandle>()?;
//! client.start(&call::controller_get_variable(controller, "I1", ""), Timing::TCP, now)?;
//! exchange(&mut client);
//! let variable = client.value::<VariableHandle>()?;
//! client.start(&call::variable_get_value(variable), Timing::TCP, now)?;
//! exchange(&mut client);
//! assert_eq!(client.value::<call::Any>()?, Variant::I4(42));
//! # Ok::<(), bcap_core::bcap::client::ClientError>(())
//! ```
#![no_std]
#![cfg_attr(docsrs, feature(doc_cfg))]

#[cfg(feature = "alloc")]
extern crate alloc;

pub mod bcap;
pub mod device;
pub mod endpoint;
pub mod error;
pub mod handler;
pub mod histogram;
pub mod hresult;
pub mod io;
pub mod limits;
mod num;
mod outbox;
pub mod peers;
pub mod position;
pub mod procedure;
pub mod rac;
pub mod slave;
pub mod storage;
pub mod time;
pub mod variant;
mod wire;

/// The examples of the crate's page.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
