//! The two protocols of DENSO robot controllers, b-CAP and RAC, for firmware and for everybody else.
//!
//! * **b-CAP** calls 137 functions on controllers, robots, tasks, variables and files, in binary frames over TCP, UDP
//!   (port 5007) or a serial line.
//! * **RAC** reads and writes the variables of a controller in lines of text (`GET:RC8:10:I:`) over TCP (port 5006).
//!
//! Both carry the values of ORiN2, VARIANTs. This crate is all of that and nothing else: it has no socket, no clock and
//! no thread, allocates nothing, and contains no unsafe code. What moves its bytes is up to you, or to an adapter:
//! `bcap-std` for operating systems, `bcap-embassy` for boards.
//!
//! # Layers, and what each guarantees
//!
//! | module      | what it is                         | guarantee                                                         |
//! |-------------|------------------------------------|-------------------------------------------------------------------|
//! | [`variant`] | values, in binary and text         | a [`Variant`](variant::Variant) has been checked whole; no accessor fails |
//! | [`bcap`]    | frames, functions, calls           | a [`Frame`](bcap::Frame) has been checked whole, against [`limits`] |
//! | [`bcap::client`], [`bcap::server`] | sans-IO state machines | every wait ends; late replies are never answers; a call dropped at any byte leaves the session good |
//! | [`rac`]     | lines, requests, responses, both sides | a line is at most 256 bytes; what cannot be said in text is an error, never another value |
//! | [`gateway`] | RAC on one side, b-CAP on the other | an answer is that of its own request; while the robot is away the error comes at once |
//! | [`io`]      | two short loops over the client    | all progress is in the client, so futures may be dropped          |
//! | [`error`], [`hresult`] | what is wrong, and whose fault | small, `Copy`, say where and what to do                          |
//!
//! Bytes from outside pass exactly one function that checks them, in one pass, with bounded depth. What comes out are
//! views of the caller's memory. An owned value is its own wire encoding in a fixed buffer
//! ([`VariantBuf`](variant::VariantBuf)); there is no second form.
//!
//! # Features
//!
//! None is on by default, and each only adds.
//!
//! | feature             | adds                                                            |
//! |---------------------|-----------------------------------------------------------------|
//! | `alloc`             | `Vec<u8>` as memory that grows with its frames                  |
//! | `embedded-io`       | a blocking transport over any `embedded_io` device              |
//! | `embedded-io-async` | an asynchronous transport over any `embedded_io_async` device   |
//! | `defmt`             | `defmt::Format` for the public types, and a log of odd events   |
//! | `log`               | the same log through the `log` crate                            |
//!
//! # Examples
//!
//! A client and a server, joined without any network; a board does the same with its socket or UART in between.
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
//! // moves a request there and its reply back
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

#[cfg(feature = "alloc")]
extern crate alloc;

pub mod bcap;
pub mod endpoint;
pub mod error;
pub mod gateway;
pub mod handler;
pub mod histogram;
pub mod hresult;
pub mod io;
pub mod limits;
mod num;
mod outbox;
pub mod procedure;
pub mod rac;
pub mod slave;
pub mod storage;
pub mod time;
pub mod variant;
mod wire;
