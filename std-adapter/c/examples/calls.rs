//! As `calls.c`, in Rust; also "frame", which encodes a request and decodes a reply without a socket.

use std::ffi::c_long;
use std::hint::black_box;
use std::time::Instant;

use bcap_std::blocking::Controller;
use bcap_std::core::bcap::call::{Any, Call, RawCall, Reply};
use bcap_std::core::bcap::{Decoder, FrameWriter, FunctionId};
use bcap_std::core::variant::Encode;
use bcap_std::{MainError, Settings};

unsafe extern "C" {
    /// Returns the processor time of this process; POSIX says that it is in microseconds.
    safe fn clock() -> c_long;
}

/// Encodes a frame with one I4.
fn frame(number: i32, function_or_result: i32, buffer: &mut [u8]) -> Option<&[u8]> {
    let call = RawCall { function: FunctionId(function_or_result), arguments: &[&number as &dyn Encode] };
    let mut frame = FrameWriter::new(buffer).ok()?;
    call.arguments(&mut frame).ok()?;
    frame.finish(1, 0, function_or_result).ok()
}

fn call(cell: &mut Controller, operation: &str, reply: &[u8]) -> Result<(), MainError> {
    match operation {
        "write" => cell.write("I1", 5)?,
        "pose" => _ = black_box(cell.read::<Vec<f64>>("P1")?),
        "joints" => _ = black_box(cell.robot()?.joints()?),
        "frame" => {
            black_box(frame(black_box(7), FunctionId::VARIABLE_GET_VALUE.0, &mut [0; 64]));
            let value = Any::read(Decoder::TCP.decode_datagram(black_box(reply))?.args)?;
            black_box(value.as_i64());
        }
        _ => _ = black_box(cell.read::<i64>("I1")?),
    }
    Ok(())
}

fn main() -> Result<(), MainError> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1".into());
    let mut cell = Controller::connect(&address, &Settings::rc8())?;
    let mut buffer = [0; 64];
    let reply = frame(5, 0, &mut buffer).unwrap_or_default();
    for line in std::io::stdin().lines() {
        let line = line?;
        let (operation, count) = line.split_once(' ').unwrap_or((&line, "1000"));
        let count: u32 = count.parse()?;
        for _ in 0..count / 5 {
            call(&mut cell, operation, reply)?;
        }
        let (processor, began) = (clock(), Instant::now());
        for _ in 0..count {
            call(&mut cell, operation, reply)?;
        }
        let used = (clock() - processor) as f64;
        println!("{:.3} {:.3}", used / f64::from(count), began.elapsed().as_secs_f64() * 1e6 / f64::from(count));
    }
    Ok(())
}
