//! Runs a target on random bytes, without libFuzzer and sanitizers, on any toolchain:
//! `cargo run --release --no-default-features --example random -- TARGET [COUNT [SEED [FIRST-BYTE]]]`.
//!
//! Bytes that break a guarantee are written to the file `random-input`, for the example `replay`.

use std::time::Instant;

use bcap_testkit::network::Random;

fn main() -> Result<(), String> {
    let mut args = std::env::args().skip(1);
    let name = args.next().ok_or("usage: random TARGET [COUNT [SEED [FIRST-BYTE]]]")?;
    let (_, body) = bcap_fuzz::TARGETS.iter().find(|target| target.0 == name).ok_or("unknown target")?;
    let mut number = |default: u64| match args.next() {
        Some(text) => text.parse().map_err(|e| format!("{text}: {e}")),
        None => Ok(default),
    };
    let (count, seed, first) = (number(1_000_000)?, number(1)?, number(256)?);
    let mut random = Random(seed);
    let start = Instant::now();
    let mut data = Vec::new();
    for _ in 0..count {
        data.clear();
        let len = 8 + random.below(120);
        data.extend((0..len).map(|_| random.number() as u8));
        if let (Some(byte), Ok(first)) = (data.first_mut(), u8::try_from(first)) {
            *byte = first;
        }
        if std::panic::catch_unwind(|| body(&data)).is_err() {
            std::fs::write("random-input", &data).map_err(|e| format!("random-input: {e}"))?;
            return Err("a guarantee is broken; the input is in the file random-input".into());
        }
    }
    println!("{name}: {count} runs in {:.1} s, seed {seed}", start.elapsed().as_secs_f64());
    Ok(())
}
