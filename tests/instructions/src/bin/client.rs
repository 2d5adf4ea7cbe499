//! A blocking client of `bcap-std`, against a peer that answers each request immediately.

#![allow(clippy::expect_used, clippy::panic, reason = "a program of the developer may panic")]

use std::error::Error;
use std::hint::black_box;
use std::io::{self, Read, Write};
use std::net::{TcpListener, UdpSocket};
use std::thread;

use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_std::Settings;
use bcap_std::blocking::Controller;

/// Repetitions of the two runs.
const FEW: u64 = 500;
const MANY: u64 = 2_500;

struct Case {
    name: &'static str,
    /// Instructions of one run, 5 % above the measured ones.
    bar: u64,
    /// Starts a peer and returns its address.
    serve: fn() -> io::Result<String>,
    run: fn(&mut Controller) -> Result<(), bcap_std::Error>,
}

const CASES: &[Case] = &[
    Case { name: "read::<i32> of a variable over TCP", bar: 1_464, serve: serve_tcp, run: read },
    Case { name: "read::<i32> of a variable over UDP", bar: 1_474, serve: serve_udp, run: read },
];

fn main() -> Result<(), Box<dyn Error>> {
    if let Some((case, times, more)) = bcap_instructions::arguments() {
        let (case, address) = CASES.get(case).zip(more.first()).ok_or("no such case")?;
        return repeat(case, address, times);
    }
    bcap_instructions::print_head();
    let mut within = true;
    for (index, case) in CASES.iter().enumerate() {
        let measured = bcap_instructions::count(index, FEW, MANY, &[(case.serve)()?])?;
        within &= bcap_instructions::print(case.name, measured, Some(case.bar));
    }
    if within { Ok(()) } else { Err("a figure is over its bar".into()) }
}

/// Connects and runs a case many times; what callgrind watches.
fn repeat(case: &Case, address: &str, times: u64) -> Result<(), Box<dyn Error>> {
    let mut cell = Controller::connect(address, &Settings::rc8())?;
    for _ in 0..times {
        (case.run)(&mut cell)?;
    }
    Ok(())
}

fn read(cell: &mut Controller) -> Result<(), bcap_std::Error> {
    let value: i32 = cell.read(black_box("I1"))?;
    black_box(value);
    Ok(())
}

fn serve_tcp() -> io::Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?;
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.expect("a connection");
            thread::spawn(move || {
                let mut buffer = [0; 1024];
                while let Ok(count @ 1..) = stream.read(&mut buffer) {
                    stream.write_all(&reply(&buffer[..count])).expect("the client receives");
                }
            });
        }
    });
    Ok(format!("tcp:{address}"))
}

fn serve_udp() -> io::Result<String> {
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    let address = socket.local_addr()?;
    thread::spawn(move || {
        let mut buffer = [0; 1024];
        while let Ok((count, peer)) = socket.recv_from(&mut buffer) {
            socket.send_to(&reply(&buffer[..count]), peer).expect("the client receives");
        }
    });
    Ok(format!("udp:{address}"))
}

/// Answers any request with I4 7, as a handle or as a value.
fn reply(request: &[u8]) -> Vec<u8> {
    let Ok(Progress::Complete(request, _)) = Decoder::TCP.decode(request) else {
        panic!("{request:02x?} is no request")
    };
    let mut buffer = [0; 64];
    let mut reply = FrameWriter::new(&mut buffer).expect("64 bytes hold a header");
    reply.argument(&7).expect("64 bytes hold a number");
    reply.finish(request.serial, 0, 0).expect("64 bytes hold the frame").to_vec()
}
