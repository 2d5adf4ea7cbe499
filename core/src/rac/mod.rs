//! RAC: reads and writes the variables of a controller in lines of text, over TCP port 5006.
//!
//! ```text
//!  client                                   server
//!  GET:RC8:10:I: CR           ─────────►
//!                             ◄─────────    0,3,123 CR
//!  PUT:RC8:10:F:4,123.01 CR   ─────────►
//!                             ◄─────────    0 CR
//! ```
//!
//! | layer                                        | guarantee                                                         |
//! |----------------------------------------------|-------------------------------------------------------------------|
//! | [`LineFramer`]                               | lines of at most 256 bytes; the stream survives an invalid line   |
//! | [`Request`], [`Response`]                    | an error names part and column; a written line reads back the same |
//! | [`client::Client`], [`server::Session`]      | one request at a time; every wait has a deadline                  |
//!
//! RAC has the values of b-CAP, as [text](crate::variant::Variant::write_text). A client or session contains two lines of
//! 256 bytes, one for each direction; the caller provides the memory for a value.
//!
//! # Examples
//!
//! A client reads a variable from a server:
//!
//! ```
//! use bcap_core::endpoint::{Endpoint, Serve};
//! use bcap_core::handler::{Outcome, PeerId, ReplyValue};
//! use bcap_core::hresult::HResult;
//! use bcap_core::rac::client::{Client, Event};
//! use bcap_core::rac::server::{Handler, Session};
//! use bcap_core::rac::{Request, Variable, VariableKind};
//! use bcap_core::time::Instant;
//! use bcap_core::variant::Variant;
//!
//! /// A controller with one integer.
//! struct Counter(i32);
//!
//! impl Handler for Counter {
//!     fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
//!         match *request {
//!             Request::Get(Variable { kind: VariableKind::I, index: 0 }) => match reply.set(&self.0) {
//!                 Ok(()) => HResult::S_OK.into(),
//!                 Err(_) => HResult::E_FAIL.into(),
//!             },
//!             Request::Put(Variable { kind: VariableKind::I, index: 0 }, Variant::I4(n)) => {
//!                 self.0 = n;
//!                 HResult::S_OK.into()
//!             }
//!             _ => HResult::E_INVALIDARG.into(),
//!         }
//!     }
//! }
//!
//! let mut counter = Counter(41);
//! let (mut client, mut session) = (Client::new(Default::default(), [0; 64]), Session::new(Default::default(), [0; 64]));
//! let now = Instant::ZERO;
//!
//! client.start(&Request::Get(Variable::new(VariableKind::I, 0)), now)?;
//! // the work of a link
//! let count = client.transmit().len();
//! session.receive_buffer()[..count].copy_from_slice(client.transmit());
//! session.received(count);
//! client.transmitted(count);
//! while session.run(&mut counter, PeerId(0), now).is_some() {}
//! assert_eq!(session.transmit(), b"0,3,41\r");
//! let count = session.transmit().len();
//! client.receive_buffer()[..count].copy_from_slice(session.transmit());
//! client.received(count);
//! session.transmitted(count);
//!
//! assert_eq!(client.poll_event(now), Some(Event::Replied(HResult::S_OK)));
//! assert_eq!(client.reply().and_then(|reply| reply.value), Some(Variant::I4(41)));
//! # Ok::<(), bcap_core::rac::client::ClientError>(())
//! ```

pub mod client;
mod line;
mod request;
mod response;
pub mod server;

pub use self::client::Client;
pub use self::line::{Framed, LineFramer, MAX_LINE};
pub use self::request::{Request, Variable, VariableKind, Verb};
pub use self::response::Response;
pub use self::server::Session;

/// The port of RAC.
pub const PORT: u16 = 5006;

/// Bytes that hold any value that fits a line; the largest is an array of 250 empty strings.
pub const MAX_VALUE: usize = 1024;

#[cfg(test)]
mod tests;
