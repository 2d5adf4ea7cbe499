//! The sans-IO client of b-CAP in memory of the caller.

use core::mem::MaybeUninit;
use core::time::Duration;

use bcap_core::bcap::call::Call;
use bcap_core::bcap::client::{Client, Config, Event, Timing};
use bcap_core::bcap::{FrameWriter, FunctionId};
use bcap_core::endpoint::Endpoint;
use bcap_core::error::EncodeError;
use bcap_core::time::Instant;

use crate::entry::guard;
use crate::memory::{Memory, caller, check, put, slice};
use crate::status::{self, *};
use crate::value::bcap_value;

/// The link of a client.
pub type bcap_link = i32;
/// A stream: TCP.
pub const BCAP_LINK_STREAM: bcap_link = 0;
/// Datagrams: UDP. Calls are sent again when replies are lost.
pub const BCAP_LINK_DATAGRAM: bcap_link = 1;
/// A serial line; its frames have a CRC.
pub const BCAP_LINK_SERIAL: bcap_link = 2;

/// What `bcap_client_poll` reports.
pub type bcap_event_kind = i32;
/// No event: move bytes, or wait until the deadline.
pub const BCAP_EVENT_NONE: bcap_event_kind = 0;
/// The reply arrived; `status` is its result, and `bcap_client_value` its value.
pub const BCAP_EVENT_REPLIED: bcap_event_kind = 1;
/// The call ended without a reply; `status` says why.
pub const BCAP_EVENT_FAILED: bcap_event_kind = 2;
/// The controller still executes the call.
pub const BCAP_EVENT_EXECUTING: bcap_event_kind = 3;
/// The client sends the call again.
pub const BCAP_EVENT_RETRIED: bcap_event_kind = 4;
/// A reply that belongs to no call, or invalid bytes, were dropped.
pub const BCAP_EVENT_DROPPED: bcap_event_kind = 5;

/// An event of a client.
#[repr(C)]
pub struct bcap_event {
    /// One of `BCAP_EVENT_...`.
    pub kind: bcap_event_kind,
    /// The result of a call that has ended; otherwise `BCAP_OK`.
    pub status: bcap_status,
}

/// A client in memory of the caller. Its content is private; it must not be moved or copied. Fill it with zeros before
/// `bcap_client_init`, so that functions recognise a client that was not initialised.
#[repr(C)]
pub struct bcap_client {
    /// Private.
    pub private_: [u64; 40],
}

/// The content of [`bcap_client`].
#[repr(C)]
struct Inner {
    /// The address of this structure, changed by [`MAGIC`]: other content, and a copy, are recognised.
    mark: usize,
    /// The receive buffer, for the values of replies.
    rx: *const u8,
    rx_size: usize,
    client: Client<Memory>,
}

const MAGIC: usize = 0x6263_6170;

const _: () = assert!(size_of::<Inner>() <= size_of::<bcap_client>());
const _: () = assert!(align_of::<Inner>() <= align_of::<bcap_client>());

/// Returns a client that was initialised.
///
/// # Safety
///
/// `client` is null, or valid for reads and writes, and no other function uses it during `'a`.
unsafe fn open<'a>(client: *mut bcap_client) -> Result<&'a mut Inner, Status> {
    check(client)?;
    // SAFETY: it is not null and aligned; the first word is an integer, whatever the memory contains
    if unsafe { client.cast::<usize>().read() } != client.addr() ^ MAGIC {
        return Err(BCAP_E_HANDLE);
    }
    // SAFETY: the mark proves that `bcap_client_init` wrote the content at this address; the caller promises that no other code
    // uses it
    Ok(unsafe { &mut *client.cast::<Inner>() })
}

/// Returns whether two parts of memory overlap.
fn overlap(first: (usize, usize), second: (usize, usize)) -> bool {
    first.0 < second.0.saturating_add(second.1) && second.0 < first.0.saturating_add(first.1)
}

/// Initialises a client with two buffers: `tx` for a request, `rx` for a reply. 512 bytes each suit most boards. The buffers belong to
/// the client until it is initialised again or its memory is no longer used; it needs no end.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_init(
    client: *mut bcap_client,
    link: bcap_link,
    tx: *mut u8,
    tx_size: usize,
    rx: *mut u8,
    rx_size: usize,
) -> bcap_status {
    guard(|| {
        let config = match link {
            BCAP_LINK_STREAM => Config::TCP,
            BCAP_LINK_DATAGRAM => Config::UDP,
            BCAP_LINK_SERIAL => Config::SERIAL,
            _ => return Err(BCAP_E_RANGE),
        };
        check(client)?;
        let own = (client.addr(), size_of::<bcap_client>());
        let (tx_part, rx_part) = ((tx.addr(), tx_size), (rx.addr(), rx_size));
        if overlap(own, tx_part) || overlap(own, rx_part) || overlap(tx_part, rx_part) {
            return Err(BCAP_E_POINTER);
        }
        let (tx, rx_memory) = (caller!(Memory::new(tx, tx_size))?, caller!(Memory::new(rx, rx_size))?);
        let state = Client::new(config, tx, rx_memory);
        let inner = Inner { mark: client.addr() ^ MAGIC, rx, rx_size, client: state };
        caller!(put(client.cast::<MaybeUninit<Inner>>(), MaybeUninit::new(inner)))
    })
}

/// Ends the use of a client: each later call returns `BCAP_E_HANDLE`. The buffers belong to the caller again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_deinit(client: *mut bcap_client) -> bcap_status {
    guard(|| {
        caller!(open(client))?;
        caller!(put(client.cast::<usize>(), 0))
    })
}

/// Prepares for a new connection: drops the call in flight and all received bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_reset(client: *mut bcap_client) -> bcap_status {
    guard(|| caller!(open(client)).map(|inner| inner.client.reset()))
}

/// Sets the time limits of further calls: how long an attempt waits, the number of attempts on a link that loses frames, and how long a
/// call may take in total. The defaults are 3 s, one attempt and 180 s for a stream, and five attempts of 500 ms otherwise.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_set_timing(
    client: *mut bcap_client,
    attempt_ms: u32,
    attempts: u8,
    deadline_ms: u32,
) -> bcap_status {
    guard(|| {
        let [attempt_timeout, deadline] = [attempt_ms, deadline_ms].map(|ms| Duration::from_millis(ms.into()));
        let timing = Timing { attempt_timeout, attempts: attempts.max(1), deadline, keep_alive: deadline };
        caller!(open(client)).map(|inner| inner.client.set_timing(timing))
    })
}

/// Sets the serial of the next call. Over UDP begin with a random one, so that replies to an earlier client are recognised.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_set_serial(client: *mut bcap_client, serial: u16) -> bcap_status {
    guard(|| caller!(open(client)).map(|inner| inner.client.set_next_serial(serial)))
}

/// A call of any function.
struct AnyCall<'a> {
    function: i32,
    arguments: &'a [bcap_value],
}

impl Call for AnyCall<'_> {
    type Reply = bcap_core::bcap::call::Any;

    fn function(&self) -> FunctionId {
        FunctionId(self.function)
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.arguments.iter().try_for_each(|argument| frame.argument(argument))
    }
}

/// Starts a call: `function` is one of `BCAP_FN_...`. `bcap_client_transmit` then returns its bytes. `now_us` is the time of any clock
/// that never goes back, in microseconds.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_start(
    client: *mut bcap_client,
    function: i32,
    arguments: *const bcap_value,
    count: usize,
    now_us: u64,
) -> bcap_status {
    guard(|| {
        let client = &mut caller!(open(client))?.client;
        let call = AnyCall { function, arguments: caller!(slice(arguments, count))? };
        client.start(&call, client.timing(), Instant::from_micros(now_us)).map_err(status::client)
    })
}

/// Returns the bytes to send: one datagram, or the rest of a frame. `count` is 0 if there are no bytes to send.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_transmit(
    client: *mut bcap_client,
    bytes: *mut *const u8,
    count: *mut usize,
) -> bcap_status {
    guard(|| {
        let unsent = caller!(open(client))?.client.transmit();
        caller!(put(bytes, unsent.as_ptr()))?;
        caller!(put(count, unsent.len()))
    })
}

/// Records that the link has taken `count` bytes of `bcap_client_transmit`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_transmitted(client: *mut bcap_client, count: usize) -> bcap_status {
    guard(|| {
        let client = &mut caller!(open(client))?.client;
        let is_unsent = count <= client.transmit().len();
        is_unsent.then(|| client.transmitted(count)).ok_or(BCAP_E_RANGE)
    })
}

/// Returns memory for received bytes; `size` is 0 when there is no room. The values of earlier replies are invalid then.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_receive_buffer(
    client: *mut bcap_client,
    bytes: *mut *mut u8,
    size: *mut usize,
) -> bcap_status {
    guard(|| {
        let room = caller!(open(client))?.client.receive_buffer();
        caller!(put(bytes, room.as_mut_ptr()))?;
        caller!(put(size, room.len()))
    })
}

/// Records that `count` bytes were put into the memory of `bcap_client_receive_buffer`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_received(client: *mut bcap_client, count: usize) -> bcap_status {
    guard(|| {
        let client = &mut caller!(open(client))?.client;
        let has_room = count <= client.receive_buffer().len();
        has_room.then(|| client.received(count)).ok_or(BCAP_E_RANGE)
    })
}

/// Handles received bytes and the time, and reports the next event. Call it until it reports `BCAP_EVENT_NONE`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_poll(
    client: *mut bcap_client,
    now_us: u64,
    event: *mut bcap_event,
) -> bcap_status {
    guard(|| {
        let client = &mut caller!(open(client))?.client;
        let now = Instant::from_micros(now_us);
        let found = client.poll_event(now).or_else(|| client.handle_timeout(now));
        let (kind, status) = match found {
            None => (BCAP_EVENT_NONE, BCAP_OK),
            Some(Event::Replied(result)) => (BCAP_EVENT_REPLIED, if result.is_err() { result.0 } else { BCAP_OK }),
            Some(Event::Failed(error)) => (BCAP_EVENT_FAILED, status::client(error)),
            Some(Event::Executing) => (BCAP_EVENT_EXECUTING, BCAP_OK),
            Some(Event::Retried { .. }) => (BCAP_EVENT_RETRIED, BCAP_OK),
            Some(_) => (BCAP_EVENT_DROPPED, BCAP_OK),
        };
        caller!(put(event, bcap_event { kind, status }))
    })
}

/// Returns when `bcap_client_poll` must be called even if no bytes arrive, in microseconds; `UINT64_MAX` while no call is in flight.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_deadline(client: *mut bcap_client, at_us: *mut u64) -> bcap_status {
    guard(|| {
        let deadline = caller!(open(client))?.client.poll_timeout().unwrap_or(Instant::FAR_FUTURE);
        caller!(put(at_us, deadline.as_micros()))
    })
}

/// Returns the value of the reply; EMPTY if it has no value. It points into the receive buffer, until
/// `bcap_client_receive_buffer` or `bcap_client_start`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_value(client: *mut bcap_client, value: *mut bcap_value) -> bcap_status {
    guard(|| {
        let inner = caller!(open(client))?;
        let frame = inner.client.reply().ok_or(BCAP_E_NO_REPLY)?;
        let view = |found| bcap_value::received(found, inner.rx, inner.rx_size);
        let found = frame.value().map_or(Ok(bcap_value::EMPTY), view)?;
        caller!(put(value, found))
    })
}

/// Abandons the call in flight. Its reply is then dropped; the controller may execute it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn bcap_client_abandon(client: *mut bcap_client) -> bcap_status {
    guard(|| caller!(open(client)).map(|inner| inner.client.abandon()))
}
