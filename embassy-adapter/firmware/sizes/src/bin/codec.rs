//! The b-CAP codec: it decodes frames of any link, reads every value in them and encodes the values in a new request.
#![no_std]
#![no_main]

use core::hint::black_box;

use bcap_core::bcap::{Decoder, FrameWriter, Progress};
use bcap_core::error::EncodeError;
use bcap_core::variant::Variant;
use bcap_sizes::{Memory, entry};

entry!(run);

fn run(memory: &mut Memory) {
    // the link, the strictness and the limits are known only at run time
    let decoder = black_box(Decoder::TCP);
    let seen = match decoder.decode(&memory.input) {
        Ok(Progress::Complete(frame, used)) => {
            let sum = frame.args.iter().fold(used, |sum, value| sum.wrapping_add(read(value)));
            sum.wrapping_add(write(&decoder, &frame, &mut memory.output).unwrap_or(0))
        }
        Ok(Progress::NeedMore(count)) => count,
        Err(error) => error.offset.wrapping_add(decoder.resync(&memory.input)),
    };
    black_box(seen);
}

/// Reads a value of any type, and the elements of an array.
fn read(value: Variant<'_>) -> usize {
    match value {
        Variant::Bstr(text) => text.len(),
        Variant::Array(array) => {
            let pose = array.items::<f64>().and_then(|items| items.to_array::<8>());
            array.iter().fold(usize::from(black_box(pose).is_some()), |sum, element| sum.wrapping_add(number(&element)))
        }
        scalar => number(&scalar),
    }
}

fn number(value: &Variant<'_>) -> usize {
    let float = black_box(value.as_f64()).is_some();
    value.as_i32().map_or(usize::from(float), |number| usize::try_from(number).unwrap_or(0))
}

/// Writes a request with the arguments of a typical call and the received values.
fn write(decoder: &Decoder, frame: &bcap_core::bcap::Frame<'_>, output: &mut [u8]) -> Result<usize, EncodeError> {
    let mut out = FrameWriter::new(output)?.with_crc(decoder.crc);
    out.argument(&black_box(1_i32))?;
    out.argument(black_box("slvMove"))?;
    out.argument(black_box(&[1.0_f64; 8]))?;
    for value in frame.args {
        out.argument(&value)?;
    }
    out.finish(frame.serial, frame.reserved, frame.code).map(<[u8]>::len)
}
