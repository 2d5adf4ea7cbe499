//! Puts the frames and lines of the specifications into the corpora: `cargo run --no-default-features --example seeds`.

use std::path::Path;
use std::{fs, io};

use bcap_tests::value::Value;
use bcap_tests::vectors::{frames, texts};

fn main() -> io::Result<()> {
    for (index, frame) in frames().iter().enumerate() {
        seed("frame", index, &[&[0], &frame.bytes[..]])?;
        // a request as a peer of either side sends it: chunk sizes or options first
        seed("stream", index, &[&[0, 15, 3, 7, 200], &frame.bytes[..]])?;
        for arg in frame.args.iter().flatten().map(Value::to_wire) {
            seed("variant", index, &[&[8], &arg[..]])?;
        }
    }
    for (index, vector) in texts().iter().enumerate() {
        let text = vector.text.trim_end_matches('\r');
        let value = text.splitn(5, ':').nth(4).unwrap_or(text);
        seed("text", index, &[value.as_bytes()])?;
        seed("rac_line", index, &[&[7, 0, 30, 255], text.as_bytes(), b"\r"])?;
    }
    Ok(())
}

fn seed(target: &str, index: usize, parts: &[&[u8]]) -> io::Result<()> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    fs::create_dir_all(&corpus)?;
    fs::write(corpus.join(format!("seed-{index:03}")), parts.concat())
}
