//! Tests a client on a serial line whose device reports errors of the line.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::{pending, ready};
use std::rc::Rc;

use bcap_core::bcap::server::{Config as ServerConfig, Handler, Request, Session};
use bcap_core::bcap::{FunctionId, call, client::Timing};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_embassy::gateway::{Front, Limits, SerialRobot, SharedGateway, run_robot, serve};
use bcap_embassy::serial::{self, Config};
use embassy_futures::block_on;
use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::{Duration, Timer, with_timeout};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

/// A controller that answers every call that returns something with 1.
struct One;

impl Handler for One {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        let has_value = matches!(
            request.function,
            FunctionId::CONTROLLER_CONNECT | FunctionId::CONTROLLER_GET_VARIABLE | FunctionId::VARIABLE_GET_VALUE
        );
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

/// The gateway's end of a PLC's serial line: the bytes that the PLC has sent or the line has lost, and the bytes that
/// the PLC receives.
#[derive(Clone, Default)]
struct PlcLine {
    sent: Rc<RefCell<VecDeque<Result<u8, ErrorKind>>>>,
    received: Rc<RefCell<Vec<u8>>>,
}

impl ErrorType for PlcLine {
    type Error = ErrorKind;
}

impl Read for PlcLine {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ErrorKind> {
        loop {
            if let Some(byte) = self.sent.borrow_mut().pop_front() {
                buffer[0] = byte?;
                return Ok(1);
            }
            Timer::after_millis(1).await;
        }
    }
}

impl Write for PlcLine {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        self.received.borrow_mut().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

#[test]
fn a_gateway_between_two_serial_lines_serves_a_plc_despite_errors_of_the_line() {
    let millis = core::time::Duration::from_millis;
    let timing = Timing { attempt_timeout: millis(30), ..Timing::serial(115_200) };
    let client = Config { timing, character_timeout: millis(5), ..Config::serial(115_200) };
    let session = Session::new(ServerConfig::SERIAL, [0; 512], [0; 512]);
    let uart = Uart { session, line: VecDeque::new(), damaged: 4 };
    let mut memory = bcap_gateway::Memory::<1, 4>::new();
    let config = bcap_gateway::Config { client, ..bcap_gateway::Config::RC8 };
    let plant = SharedGateway::<NoopRawMutex, 1>::new(bcap_gateway::Gateway::new(config, &mut memory), |_| {});
    let (mut robot, mut frame) = (SerialRobot::new(uart), [0; 512]);
    let plc = PlcLine::default();
    let mut line = serial::transport(plc.clone());
    let test = async {
        while !plant.view(|gateway| gateway.is_up()).unwrap() {
            Timer::after_millis(1).await;
        }
        for (request, answer) in [("GET:RC8:7:I:\r", "0,3,1\r"), ("PUT:RC8:7:I:3,2\r", "-2147024891\r")] {
            plc.received.borrow_mut().clear();
            // an error of the line before the request, which leaves the session open
            plc.sent.borrow_mut().push_back(Err(ErrorKind::InvalidData));
            plc.sent.borrow_mut().extend(request.bytes().map(Ok));
            while !plc.received.borrow().ends_with(b"\r") {
                Timer::after_millis(1).await;
            }
            assert_eq!(plc.received.borrow().as_slice(), answer.as_bytes());
        }
    };
    let limits = Limits::default();
    let board = join(run_robot(&mut robot, &mut frame, &plant), serve(&mut line, Front::Rac, None, &plant, &limits));
    let test = with_timeout(Duration::from_secs(60), test);
    assert!(matches!(block_on(select(board, test)), Either::Second(Ok(()))), "it hangs");
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
