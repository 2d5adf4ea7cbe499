//! Tests a client on a serial line whose device reports errors of the line.
#![cfg(all(feature = "serial", feature = "server"))]
#![allow(clippy::indexing_slicing, clippy::large_futures, clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::VecDeque;
use std::future::{pending, ready};

use bcap_core::bcap::server::{Config as ServerConfig, Handler, Request, Session};
use bcap_core::bcap::{FunctionId, call, client::Timing};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_embassy::serial::{self, Config};
use embassy_futures::block_on;
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

/// A controller that answers every call with 1.
struct One;

impl Handler for One {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let has_value = request.function == FunctionId::CONTROLLER_CONNECT;
        if has_value { reply.set(&1).map_or(HResult::E_FAIL, |()| HResult::S_OK) } else { HResult::S_OK }.into()
    }
}

/// A UART with a controller at the other end of the line. Each reply up to `damaged` loses a byte with an error.
struct Uart {
    session: Session<[u8; 512], [u8; 512], 8>,
    line: VecDeque<Result<u8, ErrorKind>>,
    damaged: u32,
}

impl ErrorType for Uart {
    type Error = ErrorKind;
}

impl Read for Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        match self.line.pop_front() {
            Some(byte) => {
                buffer[0] = byte?;
                ready(Ok(1)).await
            }
            None => pending().await,
        }
    }
}

impl Write for Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        let room = self.session.receive_buffer();
        let count = room.len().min(bytes.len());
        room[..count].copy_from_slice(&bytes[..count]);
        self.session.received(count);
        let _ = self.session.run(&mut One, PeerId(1), Instant::ZERO);
        let reply = self.session.transmit().to_vec();
        self.session.transmitted(reply.len());
        self.line.extend(reply.iter().copied().map(Ok));
        if !reply.is_empty() && self.damaged > 0 {
            self.damaged -= 1;
            let at = self.line.len() - reply.len() / 2;
            self.line[at] = Err(ErrorKind::InvalidData);
        }
        Ok(count)
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

#[test]
fn an_error_of_the_line_costs_an_attempt_and_not_the_call() {
    let millis = core::time::Duration::from_millis;
    let timing = Timing { attempt_timeout: millis(30), ..Timing::serial(115_200) };
    let config = Config { timing, character_timeout: millis(5), ..Config::serial(115_200) };
    let session = Session::new(ServerConfig::SERIAL, [0; 512], [0; 512]);
    let uart = Uart { session, line: VecDeque::new(), damaged: 4 };
    let mut robot = serial::client(uart, config, [0; 503], [0; 503]);
    block_on(async {
        robot.call(call::service_start("")).await.unwrap();
        robot.call(call::controller_connect("", "P", "localhost", "")).await.unwrap();
    });
}
