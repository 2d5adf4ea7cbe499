//! Writes the frames and lines of the specifications to the unpacked corpora:
//! `cargo run --no-default-features --example seeds`, between `just corpora unpack` and `just corpora pack`.
//!
//! The seeds of the state machines follow the encoding of `arbitrary`: the highest bits of a `u32` choose a variant, and
//! before each byte of a vector, a byte says that the vector continues. See the `Op` of each target.

use std::path::Path;
use std::{fs, io};

use bcap_testkit::frame::field;
use bcap_testkit::value::Value;
use bcap_testkit::vectors::{frames, texts};

fn main() -> io::Result<()> {
    for (index, frame) in frames().iter().enumerate() {
        seed("frame", index, &[&[0], &frame.bytes[..]])?;
        // a request from either side, after chunk sizes or options
        seed("stream", index, &[&[0, 15, 3, 7, 200], &frame.bytes[..]])?;
        // a server receives it; a client receives it as a reply or as a stray frame; a gateway receives it from its robot
        seed("server", index, &[&[0; 33], &variant(2, 7), &bytes(&frame.bytes), &variant(3, 7), &[255]])?;
        let mut reply = frame.bytes.clone();
        reply[field::SERIAL].copy_from_slice(&[1, 0]);
        seed("client", index, &[&[0], &variant(0, 11), &NULL, &variant(2, 11), &variant(5, 11), &bytes(&reply)])?;
        seed("gateway", index, &[&[0], &variant(12, 15), &bytes(&frame.bytes), &variant(8, 15)])?;
        for arg in frame.args.iter().flatten().map(Value::to_wire) {
            seed("variant", index, &[&[8], &arg[..]])?;
        }
    }
    for (index, vector) in texts().iter().enumerate() {
        let text = vector.text.trim_end_matches('\r');
        let value = text.splitn(5, ':').nth(4).unwrap_or(text);
        seed("text", index, &[value.as_bytes()])?;
        seed("rac_line", index, &[&[7, 0, 30, 255], text.as_bytes(), b"\r"])?;
        let line = bytes(text.as_bytes());
        seed("rac_client", index, &[&[0], &variant(0, 11), &[0, 0], &variant(2, 11), &variant(4, 11), &line])?;
        let line = bytes(&[text.as_bytes(), b"\r"].concat());
        seed(
            "gateway",
            100 + index,
            &[&[0], &variant(3, 15), &[0], &line, &variant(8, 15), &variant(4, 15), &[0, 99]],
        )?;
    }
    regressions()
}

/// The two regressions of the table in `README.md` that were known before the first fuzzing.
fn regressions() -> io::Result<()> {
    // a request, 300 bytes of its reply without an end, the next request
    let start = [&variant(0, 11)[..], &[0, 0]].concat();
    let long = [&variant(6, 11)[..], &300_u16.to_le_bytes()].concat();
    write("regressions/rac_client", "rest-of-an-over-long-reply", &[&[0], &start, &variant(2, 11), &long, &start])?;
    // Service_Start on a serial line, for which the handler waits, and its retransmission after a byte of noise
    let wait = [&variant(3, 6)[..], &[0xff; 2]].concat().repeat(8);
    let again = [&variant(0, 7)[..], &[1, 7, 0, 0, 7]].concat();
    write("regressions/server", "repetition-behind-noise", &[&[10], &wait, &variant(1, 7), &variant(0, 4), &again])
}

/// A value of the last kind: the second scalar.
const NULL: [u8; 2] = [7, 1];

/// Returns the encoding of variant `index` of `count`.
fn variant(index: u64, count: u64) -> [u8; 4] {
    // the lowest number that selects it
    ((index << 32).div_ceil(count) as u32).to_le_bytes()
}

/// A vector of bytes.
fn bytes(bytes: &[u8]) -> Vec<u8> {
    bytes.iter().flat_map(|byte| [1, *byte]).chain([0]).collect()
}

fn seed(target: &str, index: usize, parts: &[&[u8]]) -> io::Result<()> {
    write(&format!("corpus/{target}"), &format!("seed-{index:03}"), parts)
}

fn write(folder: &str, name: &str, parts: &[&[u8]]) -> io::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    fs::create_dir_all(&folder)?;
    fs::write(folder.join(name), parts.concat())
}
