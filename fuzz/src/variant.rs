//! Fuzzes the binary format of values against the oracle, and calls every accessor of accepted values.

use bcap_core::hresult::HResult;
use bcap_core::limits::{Limits, MAX_DEPTH, Strictness};
use bcap_core::variant::{Bstr, Currency, Encode as _, OleDate, Scalar, Variant, VariantBuf, Writer};
use bcap_testkit::oracle::Oracle;
use bcap_testkit::value::Value;

use crate::input::BOTH;

/// Decodes bytes as one value; the first byte chooses the maximum depth.
///
/// # Panics
///
/// When an assertion about the core fails.
pub fn variant(data: &[u8]) {
    let Some((depth, bytes)) = data.split_first() else { return };
    let limits = Limits { depth: depth % (MAX_DEPTH + 4), ..Limits::STREAM };
    let [strict, lenient] = BOTH.map(|strictness| {
        match Variant::decode(bytes, &limits, strictness) {
            Ok(value) => {
                look_at(value);
                encode_again(value, bytes, strictness);
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
        judge_value(&limits, strictness, bytes)
    });
    assert!(strict.is_none() || strict == lenient);
}

/// Decodes a value with the core and with the oracle; returns it, or `None` when both refuse it.
///
/// # Panics
///
/// When they differ, or an error is outside the bytes.
pub fn judge_value(limits: &Limits, strictness: Strictness, bytes: &[u8]) -> Option<Value> {
    let decoded = Variant::decode(bytes, limits, strictness);
    assert!(decoded.is_ok() || decoded.is_err_and(|error| error.offset <= bytes.len()), "{bytes:02x?}");
    let ours = decoded.ok().map(Value::read);
    let oracle = Oracle { limits: *limits, strictness, crc: false };
    assert_eq!(ours, oracle.decode_value(bytes), "{strictness:?} {bytes:02x?}");
    ours
}

/// Checks that a decoded value encodes canonically, and that the encoding decodes strictly to the same value.
fn encode_again(value: Variant<'_>, bytes: &[u8], strictness: Strictness) {
    let mut buffer = vec![0xa5; bytes.len()];
    let mut out = Writer::new(&mut buffer);
    value.encode(&mut out).expect("the canonical form is not longer");
    let canonical = out.into_bytes();
    assert_eq!(canonical, Value::read(value).to_wire());
    let deepest = Limits { depth: MAX_DEPTH, ..Limits::STREAM };
    assert_eq!(Variant::decode(canonical, &deepest, Strictness::Strict), Ok(value));
    if strictness == Strictness::Strict && !canonical.contains(&0xff) && !bytes.contains(&11) {
        assert_eq!(canonical, bytes, "a strict value is canonical, except for the bits of BOOL");
    }
    match VariantBuf::<256>::decode(bytes, &deepest, strictness) {
        Ok(owned) => assert!(owned.as_variant() == value && owned.as_bytes() == canonical),
        Err(_) => assert!(canonical.len() > 256),
    }
}

/// Calls every accessor of a value.
fn look_at(value: Variant<'_>) {
    let same = value;
    assert_eq!(value, same, "a value equals itself, even with a NaN");
    let _ = (value.as_i32(), value.as_i64(), value.as_f64(), value.as_bool(), value.is_empty());
    assert!(!format!("{value:?}").is_empty());
    assert!(!matches!(value.flatten(), Variant::Nested(_)));
    match value {
        Variant::Nested(inner) => look_at(inner.value()),
        Variant::Bstr(text) => look_at_text(text),
        Variant::Date(date) => look_at_date(date),
        Variant::Cy(amount) => {
            let (whole, fraction) = amount.to_parts();
            assert_eq!(whole.unsigned_abs() * 10_000 + u64::from(fraction), amount.raw().unsigned_abs());
            assert!(!amount.to_string().is_empty());
        }
        Variant::Array(array) => {
            assert_eq!(array.iter().len(), array.len());
            for (index, item) in array.iter().enumerate() {
                assert_eq!(array.get(index), Some(item));
                look_at(item);
            }
            assert_eq!(array.get(array.len()), None);
            assert_eq!(array.strings().map(Iterator::count), (array.element().0 == 8).then_some(array.len()));
            let as_scalars = [
                items::<i16>(array),
                items::<i32>(array),
                items::<i64>(array),
                items::<u8>(array),
                items::<u16>(array),
                items::<u32>(array),
                items::<u64>(array),
                items::<f32>(array),
                items::<f64>(array),
                items::<bool>(array),
                items::<Currency>(array),
                items::<OleDate>(array),
                items::<HResult>(array),
            ];
            let numbers = !matches!(array.element().0, 0 | 1 | 8 | 12);
            assert_eq!(as_scalars.into_iter().flatten().collect::<Vec<_>>(), vec![array.len(); usize::from(numbers)]);
        }
        _ => {}
    }
}

fn items<T: Scalar>(array: bcap_core::variant::Array<'_>) -> Option<usize> {
    let items = array.items::<T>()?;
    assert_eq!(items.len(), items.iter().count());
    Some(items.len())
}

fn look_at_text(text: Bstr<'_>) {
    let units: Vec<u16> = text.units().collect();
    assert_eq!(text.to_string(), String::from_utf16_lossy(&units));
    let mut buffer = vec![0; units.len() * 3];
    let expected = String::from_utf16(&units).ok();
    assert_eq!(text.to_str(&mut buffer), expected.as_deref());
    if let Some(expected) = expected {
        assert!(text == expected.as_str() && text.eq_ignore_ascii_case(&expected.to_ascii_uppercase()));
    }
}

fn look_at_date(date: OleDate) {
    if let Some(civil) = date.to_civil() {
        assert!((1..=12).contains(&civil.month) && (1..=31).contains(&civil.day), "{civil:?}");
        assert!(civil.hour < 24 && civil.minute < 60 && civil.second < 60 && civil.millisecond < 1000, "{civil:?}");
        let again = OleDate::from_civil(civil).expect("the civil time of a date is a valid date");
        assert_eq!(again.to_civil(), Some(civil), "{:?}", date.raw());
        // the fraction of a date before day 0 also counts forward
        let instant = |date: OleDate| date.raw().trunc() + date.raw().fract().abs();
        assert!((instant(again) - instant(date)).abs() < 1e-7, "{:?} {:?}", again.raw(), date.raw());
    }
    if let Some(millis) = date.to_unix_millis() {
        assert_eq!(OleDate::from_unix_millis(millis).and_then(OleDate::to_unix_millis), Some(millis));
    }
}
