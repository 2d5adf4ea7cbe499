//! Times of large arrays of doubles: encoding a frame and decoding one, compared with a `memcpy` of the same bytes.
//!
//! ```text
//! cargo bench -p bcap-tests --bench arrays
//! ```
//!
//! Times are the medians of many rounds, all three interleaved. Decoding is measured twice: `decode` checks the frame and
//! borrows the array, which should not depend on its size; `copy out` turns it into Rust's doubles as well.

use std::hint::black_box;
use std::time::{Duration, Instant};

use bcap_core::bcap::{Decoder, FrameWriter};

const ROUNDS: usize = 301;

fn main() {
    println!(
        "{:<10} {:>12} {:>12} {:>7} {:>12} {:>12} {:>7}",
        "array", "memcpy", "encode", "ratio", "decode", "copy out", "ratio"
    );
    for (name, bytes) in [("64 KiB", 64 << 10), ("1 MiB", 1 << 20)] {
        measure(name, bytes);
    }
}

fn measure(name: &str, bytes: usize) {
    let values: Vec<f64> = (0..bytes / 8).map(|n| n as f64 * 0.25).collect();
    let raw: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let (mut plain, mut buffer, mut out) = (vec![0; bytes], vec![0; bytes + 64], vec![0.0; values.len()]);
    let frame = encode(&values, &mut buffer).to_vec();
    let mut times: [Vec<Duration>; 4] = Default::default();
    for _ in 0..ROUNDS {
        times[0].push(time(|| black_box(&mut plain).copy_from_slice(black_box(&raw))));
        times[1].push(time(|| {
            black_box(encode(black_box(&values), black_box(&mut buffer)));
        }));
        times[2].push(time(|| {
            black_box(decode(black_box(&frame), None));
        }));
        times[3].push(time(|| {
            black_box(decode(black_box(&frame), Some(black_box(&mut out))));
        }));
    }
    assert_eq!(out, values, "what was timed is right");
    let [memcpy, encode, decode, copied] = times.map(median);
    let ratio = |time: Duration| time.as_secs_f64() / memcpy.as_secs_f64();
    println!(
        "{name:<10} {memcpy:>12.1?} {encode:>12.1?} {:>7.2} {decode:>12.1?} {copied:>12.1?} {:>7.2}",
        ratio(encode),
        ratio(copied)
    );
}

fn time(body: impl FnOnce()) -> Duration {
    let begun = Instant::now();
    body();
    begun.elapsed()
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}

fn encode<'b>(values: &[f64], buffer: &'b mut [u8]) -> &'b [u8] {
    let mut writer = FrameWriter::new(buffer).expect("there is room");
    writer.argument(values).expect("there is room");
    writer.finish(1, 0, 0).expect("there is room")
}

/// Returns the number of elements, which are copied out where that is wished.
fn decode(frame: &[u8], out: Option<&mut Vec<f64>>) -> usize {
    let frame = Decoder::TCP.decode_datagram(frame).expect("it is a frame");
    let items = frame.value().and_then(|value| value.as_array()).and_then(|array| array.items::<f64>());
    let items = items.expect("it is an array of R8");
    match out {
        Some(out) => items.copy_to(out).expect("there is room"),
        None => items.len(),
    }
}
