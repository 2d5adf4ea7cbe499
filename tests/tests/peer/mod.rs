//! Tests this project's servers and clients with a peer that shares no code with them: its bytes, frames, values and texts
//! are those of `bcap-testkit`, which were written from the specifications only.
//!
//! | test                | proves                                                                                          |
//! |---------------------|-------------------------------------------------------------------------------------------------|
//! | `server::*`         | facts that no case of `bcap-conform` has, because they need IO, tags or more than a device promises |
//! | `serial`            | the CRC of frames on a serial line, and noise between them                                        |
//! | `client::*`         | values of every type arrive as they were sent, at a server that loses, delays and repeats packets |
//!
//! `bcap-conform` judges everything else with the same peer: servers in `std-adapter/conform/tests/devices.rs`, clients in
//! `std-adapter/conform/tests/clients.rs`.

mod client;
mod serial;
mod server;
mod session;

use bcap_testkit::value::{VARIANT, Value};

/// Values of every VARTYPE, with extremes, empty arrays, and arrays in arrays.
fn values() -> Vec<Value> {
    let scalars = vec![
        Value::I2(i16::MIN),
        Value::I4(i32::MIN),
        Value::R4(f32::MAX.to_bits()),
        Value::R4(1),
        Value::R8((-0.0_f64).to_bits()),
        Value::R8(f64::NAN.to_bits()),
        Value::R8(f64::NEG_INFINITY.to_bits()),
        Value::Cy(i64::MIN),
        Value::Date((-1.25_f64).to_bits()),
        Value::text("日本語 \u{1f916} \0,(\")\r\n"),
        Value::text(""),
        Value::Bstr(vec![0xd800]),
        Value::Error(-1),
        Value::Bool(true),
        Value::Bool(false),
        Value::Ui1(u8::MAX),
        Value::Ui2(u16::MAX),
        Value::Ui4(u32::MAX),
        Value::I8(i64::MIN),
        Value::Ui8(u64::MAX),
    ];
    let array = |count: usize| move |value: &Value| Value::Array(value.vartype(), vec![value.clone(); count]);
    let mut values: Vec<_> = [0, 1, 3].into_iter().flat_map(|count| scalars.iter().map(array(count))).collect();
    values.push(Value::Array(VARIANT, scalars.clone()));
    let mut nested = Value::Array(VARIANT, vec![Value::Array(VARIANT, Vec::new()), Value::Empty, Value::Null]);
    for _ in 0..6 {
        nested = Value::Array(VARIANT, vec![nested, Value::Bool(true), Value::Array(17, Vec::new())]);
    }
    values.extend([nested, Value::Empty, Value::Null]);
    values.extend(scalars);
    values
}
