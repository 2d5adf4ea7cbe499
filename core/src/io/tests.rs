//! A UART that loses bytes, under both loops.

extern crate std;

use core::cell::Cell;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::collections::VecDeque;

use embedded_io::{ErrorKind, ErrorType};

use super::{CallError, asynch, blocking};
use crate::bcap::Client;
use crate::bcap::call;
use crate::bcap::client::{Config, Timeout};
use crate::bcap::server::{self, Handler, Request, Session};
use crate::endpoint::{Endpoint, Serve};
use crate::handler::{Outcome, PeerId, ReplyValue};
use crate::hresult::HResult;
use crate::time::{Clock, Instant};

/// A controller that executes every call.
struct Controller;

impl Handler for Controller {
    fn call(&mut self, _: PeerId, _: &Request<'_>, _: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        HResult::S_OK.into()
    }
}

/// A UART with a controller at the other end of its line. The first replies lose a byte with an error.
struct Uart {
    session: Session<[u8; 512], [u8; 512], 8>,
    line: VecDeque<Result<u8, ErrorKind>>,
    errors: VecDeque<ErrorKind>,
}

impl Uart {
    fn new(errors: impl IntoIterator<Item = ErrorKind>) -> Self {
        let session = Session::new(server::Config::SERIAL, [0; 512], [0; 512]);
        Self { session, line: VecDeque::new(), errors: errors.into_iter().collect() }
    }

    fn take(&mut self, buffer: &mut [u8]) -> Option<Result<usize, ErrorKind>> {
        let byte = self.line.pop_front()?;
        Some(byte.map(|byte| {
            buffer[0] = byte;
            1
        }))
    }

    fn answer(&mut self, bytes: &[u8]) -> usize {
        let room = self.session.receive_buffer();
        let count = room.len().min(bytes.len());
        room[..count].copy_from_slice(&bytes[..count]);
        self.session.received(count);
        while self.session.run(&mut Controller, PeerId(1), Instant::ZERO).is_some() {}
        let reply = self.session.transmit();
        let length = reply.len();
        self.line.extend(reply.iter().copied().map(Ok));
        self.session.transmitted(length);
        if length > 0
            && let Some(error) = self.errors.pop_front()
        {
            let at = self.line.len().saturating_sub(length / 2);
            self.line[at] = Err(error);
        }
        count
    }
}

impl ErrorType for Uart {
    type Error = ErrorKind;
}

impl embedded_io::ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        Ok(!self.line.is_empty())
    }
}

impl embedded_io::Read for Uart {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        self.take(buffer).unwrap_or(Ok(0))
    }
}

impl embedded_io::Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        Ok(self.answer(bytes))
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

impl embedded_io_async::Read for Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        match self.take(buffer) {
            Some(taken) => taken,
            None => core::future::pending().await,
        }
    }
}

impl embedded_io_async::Write for Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        Ok(self.answer(bytes))
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

/// A clock that advances by 100 us whenever it is read.
#[derive(Default)]
struct Ticks(Cell<u64>);

impl Clock for Ticks {
    fn now(&self) -> Instant {
        self.0.set(self.0.get().saturating_add(100));
        Instant::from_micros(self.0.get())
    }
}

impl asynch::Timer for Ticks {
    async fn sleep_until(&mut self, at: Instant) {
        core::future::poll_fn(|_| if self.now() >= at { Poll::Ready(()) } else { Poll::Pending }).await;
    }
}

fn client() -> Client<[u8; 503]> {
    Client::new(Config::serial(115_200), [0; 503], [0; 503])
}

type Called = Result<(), CallError<ErrorKind>>;

/// Makes a call by the blocking loop.
fn call_blocking(errors: &[ErrorKind]) -> Called {
    let transport = blocking::Polled::new(Uart::new(errors.iter().copied()), Ticks::default());
    let mut connection = blocking::Connection::new(transport, client());
    connection.call(call::service_start(""))
}

/// Makes a call by the asynchronous loop.
fn call_async(errors: &[ErrorKind]) -> Called {
    let transport = asynch::Timed::new(Uart::new(errors.iter().copied()), Ticks::default());
    let mut connection = asynch::Connection::new(transport, client());
    let mut call = pin!(connection.call(call::service_start("")));
    loop {
        if let Poll::Ready(value) = call.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return value;
        }
    }
}

#[test]
fn a_framing_error_costs_an_attempt_and_does_not_end_the_call() {
    for call in [call_blocking, call_async] {
        let attempts = usize::from(Config::serial(115_200).timing.attempts);
        for lost in 0..attempts {
            assert_eq!(call(&std::vec![ErrorKind::InvalidData; lost]), Ok(()), "{lost} of {attempts}");
        }
        let all = call(&std::vec![ErrorKind::InvalidData; attempts]);
        assert!(
            matches!(all, Err(CallError::Client(crate::bcap::client::ClientError::Timeout(Timeout::Attempt)))),
            "{all:?}"
        );
    }
}

#[test]
fn a_connection_that_ends_ends_the_call() {
    for call in [call_blocking, call_async] {
        assert_eq!(call(&[ErrorKind::ConnectionReset]), Err(CallError::Io(ErrorKind::ConnectionReset)));
    }
}
