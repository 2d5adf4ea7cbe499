//! The user variables: I F D V P J T S, and the IO bits with their views as byte, word, dword and float.
//!
//! | name                 | VARTYPE read | written with                                                     |
//! |----------------------|--------------|------------------------------------------------------------------|
//! | `I`n                 | I4           | integers that fit; R4 and R8 without a fraction                  |
//! | `F`n                 | R4           | integers, R4, R8: rounded to R4, as clients without R4 expect it |
//! | `D`n                 | R8           | integers, R4, R8                                                 |
//! | `S`n                 | BSTR         | BSTR                                                             |
//! | `V`n                 | R4\[3\]      | an array of 3 numbers (R4, R8, integers, or VARIANTs of these)   |
//! | `P`n                 | R4\[7\]      | ... of 7: X Y Z in mm, RX RY RZ in degrees, Fig                  |
//! | `J`n                 | R4\[8\]      | ... of 8: J1 to J8 in degrees                                    |
//! | `T`n                 | R4\[10\]     | ... of 10: position, orient vector, approach vector, Fig         |
//! | `IO`n                | BOOL         | BOOL; integers, where 0 is off                                   |
//! | `IOB`n `IOW`n `IOD`n | UI1, I2, I4  | integers that fit the 8, 16 or 32 bits, signed or unsigned       |
//! | `IOF`n               | R4           | as `F`                                                           |
//!
//! The lowest bit of a view is IO n. Other values are refused: a wrong type with `E_INVALIDARGTYPE`, a fraction for an integer
//! with `DISP_E_TYPEMISMATCH`, a number that does not fit with `DISP_E_OVERFLOW`, a wrong number of elements with
//! `E_INVALIDARG`, an index out of range with `DISP_E_BADINDEX`.
//!
//! Names are `I1` or `I[1]`, ignoring case, with indices from 0. `I*` and `I*_1` are wildcards for all variables of a kind:
//! they denote number 0 until PutID chooses another number.

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind as Kind;
use bcap_core::variant::{Bstr, Variant};

use crate::value::{ValueResult, number, numbers_of_array, owned, whole};

/// The number of variables of each kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// `@VAR_I_LEN`.
    pub i: u16,
    /// `@VAR_F_LEN`.
    pub f: u16,
    /// `@VAR_D_LEN`.
    pub d: u16,
    /// `@VAR_V_LEN`.
    pub v: u16,
    /// `@VAR_P_LEN`.
    pub p: u16,
    /// `@VAR_J_LEN`.
    pub j: u16,
    /// `@VAR_T_LEN`.
    pub t: u16,
    /// `@VAR_S_LEN`.
    pub s: u16,
    /// `@VAR_IO_LEN`.
    pub io: u16,
}

impl Default for Sizes {
    /// 100 of each kind, and 512 IO.
    fn default() -> Self {
        Self { i: 100, f: 100, d: 100, v: 100, p: 100, j: 100, t: 100, s: 100, io: 512 }
    }
}

impl Sizes {
    /// Returns the number of variables of a kind.
    #[must_use]
    pub const fn of(&self, kind: Kind) -> u16 {
        match kind {
            Kind::I => self.i,
            Kind::F => self.f,
            Kind::D => self.d,
            Kind::V => self.v,
            Kind::P => self.p,
            Kind::J => self.j,
            Kind::T => self.t,
            Kind::S => self.s,
            Kind::Io => self.io,
        }
    }

    pub(crate) fn of_mut(&mut self, kind: Kind) -> &mut u16 {
        match kind {
            Kind::I => &mut self.i,
            Kind::F => &mut self.f,
            Kind::D => &mut self.d,
            Kind::V => &mut self.v,
            Kind::P => &mut self.p,
            Kind::J => &mut self.j,
            Kind::T => &mut self.t,
            Kind::S => &mut self.s,
            Kind::Io => &mut self.io,
        }
    }
}

/// The maximum bytes of all S variables together; they outlive their writer. The size of a packet limits a single one.
const S_MAX: usize = 64 << 20;

/// The kind of variable that a name denotes: one of the nine, or a view of the IO bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Family {
    Plain(Kind),
    /// IOB: 8 bits.
    Byte,
    /// IOW: 16 bits.
    Word,
    /// IOD: 32 bits.
    Dword,
    /// IOF: 32 bits as a float.
    Float,
}

impl Family {
    /// All families, those with longer names first.
    const BY_NAME: [Self; 13] = [
        Self::Byte,
        Self::Word,
        Self::Dword,
        Self::Float,
        Self::Plain(Kind::Io),
        Self::Plain(Kind::I),
        Self::Plain(Kind::F),
        Self::Plain(Kind::D),
        Self::Plain(Kind::V),
        Self::Plain(Kind::P),
        Self::Plain(Kind::J),
        Self::Plain(Kind::T),
        Self::Plain(Kind::S),
    ];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Plain(kind) => kind.name(),
            Self::Byte => "IOB",
            Self::Word => "IOW",
            Self::Dword => "IOD",
            Self::Float => "IOF",
        }
    }

    /// The IO bits that a view covers.
    const fn bits(self) -> usize {
        match self {
            Self::Plain(_) => 1,
            Self::Byte => 8,
            Self::Word => 16,
            Self::Dword | Self::Float => 32,
        }
    }
}

/// Reads a name: a family and an index, or a whole family (`I*`).
pub(crate) fn parse_name(name: &str) -> Option<(Family, Option<u32>)> {
    let upper = name.trim().to_ascii_uppercase();
    let (family, rest) = Family::BY_NAME.iter().find_map(|f| Some((*f, upper.strip_prefix(f.name())?)))?;
    if is_wildcard(rest) {
        return Some((family, None));
    }
    let digits = rest.strip_prefix('[').and_then(|r| r.strip_suffix(']')).unwrap_or(rest);
    let plain = !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit());
    // more digits than fit are an index out of range, but a valid name
    plain.then(|| (family, Some(digits.parse().unwrap_or(u32::MAX))))
}

/// Returns whether the rest of a name is a wildcard: `*`, `[*]`, or a numbered one, `*_1`.
pub(crate) fn is_wildcard(rest: &str) -> bool {
    let (star, number) = rest.split_once('_').map_or((rest, "0"), |(star, number)| (star, number));
    matches!(star, "*" | "[*]") && !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit())
}

/// Returns the wildcard names of all families, in the order of Controller_GetVariableNames.
pub(crate) fn wildcard_names() -> impl Iterator<Item = String> {
    let views = [Family::Byte, Family::Word, Family::Dword, Family::Float];
    Kind::ALL.into_iter().map(Family::Plain).chain(views).map(|f| format!("{}*", f.name()))
}

/// Describes the values that a variable of a family accepts.
pub(crate) const fn accepted(family: Family) -> &'static str {
    match family {
        Family::Plain(Kind::I) => "one integer of 32 bits; R4 or R8 without a fraction",
        Family::Plain(Kind::F | Kind::D) | Family::Float => "one number: an integer, R4 or R8",
        Family::Plain(Kind::V) => "an array of 3 numbers",
        Family::Plain(Kind::P) => "an array of 7 numbers: X Y Z RX RY RZ Fig; 3 or 6 numbers leave the last ones out",
        Family::Plain(Kind::J) => "an array of 8 numbers: J1 to J8",
        Family::Plain(Kind::T) => "an array of 10 numbers: position, orient, approach, Fig",
        Family::Plain(Kind::S) => "BSTR; all S variables have 64 MiB together",
        Family::Plain(Kind::Io) => "BOOL, or an integer: 0 is off",
        Family::Byte => "one integer of 8 bits",
        Family::Word => "one integer of 16 bits",
        Family::Dword => "one integer of 32 bits",
    }
}

/// The variables' values.
#[derive(Clone, Debug)]
pub(crate) struct Variables {
    i: Vec<i32>,
    f: Vec<f32>,
    d: Vec<f64>,
    v: Vec<[f32; 3]>,
    p: Vec<[f32; 7]>,
    j: Vec<[f32; 8]>,
    t: Vec<[f32; 10]>,
    /// UTF-16LE.
    s: Vec<Vec<u8>>,
    /// The bytes of all `s`, at most [`S_MAX`].
    s_bytes: usize,
    io: Vec<bool>,
}

impl Variables {
    pub(crate) fn new(sizes: &Sizes) -> Self {
        Self {
            i: vec![0; sizes.i.into()],
            f: vec![0.0; sizes.f.into()],
            d: vec![0.0; sizes.d.into()],
            v: vec![[0.0; 3]; sizes.v.into()],
            p: vec![[0.0; 7]; sizes.p.into()],
            j: vec![[0.0; 8]; sizes.j.into()],
            t: vec![[0.0; 10]; sizes.t.into()],
            s: vec![Vec::new(); sizes.s.into()],
            s_bytes: 0,
            io: vec![false; sizes.io.into()],
        }
    }

    /// Changes the number of variables of a kind; new ones are zero or empty.
    pub(crate) fn resize(&mut self, kind: Kind, count: u16) {
        let count = usize::from(count);
        match kind {
            Kind::I => self.i.resize(count, 0),
            Kind::F => self.f.resize(count, 0.0),
            Kind::D => self.d.resize(count, 0.0),
            Kind::V => self.v.resize(count, [0.0; 3]),
            Kind::P => self.p.resize(count, [0.0; 7]),
            Kind::J => self.j.resize(count, [0.0; 8]),
            Kind::T => self.t.resize(count, [0.0; 10]),
            Kind::S => {
                self.s.resize(count, Vec::new());
                self.s_bytes = self.s.iter().map(Vec::len).sum();
            }
            Kind::Io => self.io.resize(count, false),
        }
    }

    /// Checks that a variable exists, and returns its index.
    pub(crate) fn check(&self, family: Family, index: u32) -> Result<usize, HResult> {
        let index = usize::try_from(index).map_err(|_| HResult::DISP_E_BADINDEX)?;
        let len = match family {
            Family::Plain(Kind::I) => self.i.len(),
            Family::Plain(Kind::F) => self.f.len(),
            Family::Plain(Kind::D) => self.d.len(),
            Family::Plain(Kind::V) => self.v.len(),
            Family::Plain(Kind::P) => self.p.len(),
            Family::Plain(Kind::J) => self.j.len(),
            Family::Plain(Kind::T) => self.t.len(),
            Family::Plain(Kind::S) => self.s.len(),
            Family::Plain(Kind::Io) | Family::Byte | Family::Word | Family::Dword | Family::Float => self.io.len(),
        };
        let end = index.checked_add(family.bits()).ok_or(HResult::DISP_E_BADINDEX)?;
        if end <= len { Ok(index) } else { Err(HResult::DISP_E_BADINDEX) }
    }

    pub(crate) fn get(&self, family: Family, index: u32) -> ValueResult {
        let n = self.check(family, index)?;
        match family {
            Family::Plain(Kind::I) => owned(self.i[n]),
            Family::Plain(Kind::F) => owned(self.f[n]),
            Family::Plain(Kind::D) => owned(self.d[n]),
            Family::Plain(Kind::V) => owned(self.v[n]),
            Family::Plain(Kind::P) => owned(self.p[n]),
            Family::Plain(Kind::J) => owned(self.j[n]),
            Family::Plain(Kind::T) => owned(self.t[n]),
            Family::Plain(Kind::S) => Ok(Variant::Bstr(Bstr::from_utf16le(&self.s[n]).unwrap_or_default()).into()),
            Family::Plain(Kind::Io) => owned(self.io[n]),
            Family::Byte => owned(self.bits(n, 8) as u8),
            Family::Word => owned((self.bits(n, 16) as u16).cast_signed()),
            Family::Dword => owned(self.bits(n, 32).cast_signed()),
            Family::Float => owned(f32::from_bits(self.bits(n, 32))),
        }
    }

    pub(crate) fn put(&mut self, family: Family, index: u32, value: &Variant<'_>) -> Result<(), HResult> {
        let n = self.check(family, index)?;
        let value = &value.flatten();
        match family {
            Family::Plain(Kind::I) => self.i[n] = integer(value)?,
            Family::Plain(Kind::F) => self.f[n] = float(value)?,
            Family::Plain(Kind::D) => self.d[n] = number(value).ok_or(HResult::E_INVALIDARGTYPE)?,
            Family::Plain(Kind::V) => self.v[n] = floats(value)?,
            Family::Plain(Kind::P) => self.p[n] = position(value)?,
            Family::Plain(Kind::J) => self.j[n] = floats(value)?,
            Family::Plain(Kind::T) => self.t[n] = floats(value)?,
            Family::Plain(Kind::S) => {
                let text = value.as_bstr().ok_or(HResult::E_INVALIDARGTYPE)?.as_bytes();
                let others = self.s_bytes - self.s[n].len();
                if text.len() > S_MAX - others {
                    return Err(HResult::E_OUTOFMEMORY);
                }
                self.s_bytes = others + text.len();
                self.s[n] = text.to_vec();
            }
            Family::Plain(Kind::Io) => self.io[n] = value.as_bool().ok_or(HResult::E_INVALIDARGTYPE)?,
            Family::Byte => self.set_bits(n, 8, pattern(value, 8)?),
            Family::Word => self.set_bits(n, 16, pattern(value, 16)?),
            Family::Dword => self.set_bits(n, 32, pattern(value, 32)?),
            Family::Float => self.set_bits(n, 32, float(value)?.to_bits()),
        }
        Ok(())
    }

    /// Returns the numbers of a P, J or T variable.
    pub(crate) fn pose(&self, kind: Kind, index: u32) -> Result<Vec<f64>, HResult> {
        numbers_of_array(&self.get(Family::Plain(kind), index)?.as_variant())
    }

    /// Reads a number in text, or the I, F or D variable that the text names.
    pub(crate) fn number_of_text(&self, text: &str) -> Result<f64, HResult> {
        if let Ok(number) = text.trim().parse() {
            return Ok(number);
        }
        let (family, index) = parse_name(text).ok_or(HResult::E_INVALIDARG)?;
        let value = self.get(family, index.ok_or(HResult::E_INVALIDARG)?)?;
        match family {
            Family::Plain(Kind::I | Kind::F | Kind::D) => number(&value.as_variant()).ok_or(HResult::E_INVALIDARG),
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Returns the number of IO.
    pub(crate) fn io_len(&self) -> usize {
        self.io.len()
    }

    /// Reads an IO; an IO that does not exist is off.
    pub(crate) fn io(&self, n: usize) -> bool {
        self.io.get(n).copied().unwrap_or(false)
    }

    /// Sets an IO, if it exists.
    pub(crate) fn set_io(&mut self, n: usize, on: bool) {
        if let Some(io) = self.io.get_mut(n) {
            *io = on;
        }
    }

    fn bits(&self, from: usize, count: usize) -> u32 {
        self.io[from..from + count].iter().rev().fold(0, |bits, on| bits << 1 | u32::from(*on))
    }

    fn set_bits(&mut self, from: usize, count: usize, bits: u32) {
        for (n, on) in self.io[from..from + count].iter_mut().enumerate() {
            *on = bits >> n & 1 != 0;
        }
    }
}

fn integer(value: &Variant<'_>) -> Result<i32, HResult> {
    match (value.as_i64(), value) {
        (Some(n), _) => i32::try_from(n).map_err(|_| HResult::DISP_E_OVERFLOW),
        (None, Variant::R4(_) | Variant::R8(_)) => whole(value.as_f64().unwrap_or(f64::NAN)),
        // the only integers that as_i64 refuses
        (None, Variant::Ui8(_)) => Err(HResult::DISP_E_OVERFLOW),
        _ => Err(HResult::E_INVALIDARGTYPE),
    }
}

fn float(value: &Variant<'_>) -> Result<f32, HResult> {
    narrow(number(value).ok_or(HResult::E_INVALIDARGTYPE)?)
}

/// Rounds to R4. Infinity and NaN are accepted; a finite number must stay finite.
fn narrow(wide: f64) -> Result<f32, HResult> {
    let narrow = wide as f32;
    if wide.is_finite() && !narrow.is_finite() { Err(HResult::DISP_E_OVERFLOW) } else { Ok(narrow) }
}

fn floats<const N: usize>(value: &Variant<'_>) -> Result<[f32; N], HResult> {
    let array = value.as_array().ok_or(HResult::E_INVALIDARGTYPE)?;
    if array.len() != N {
        return Err(HResult::E_INVALIDARG);
    }
    let mut out = [0.0; N];
    for (slot, item) in out.iter_mut().zip(array) {
        *slot = float(&item.flatten())?;
    }
    Ok(out)
}

/// Reads X Y Z RX RY RZ Fig, as public programs write them: without the Fig it is -1, any posture, and without RX RY RZ
/// these are 0.
fn position(value: &Variant<'_>) -> Result<[f32; 7], HResult> {
    let array = value.as_array().ok_or(HResult::E_INVALIDARGTYPE)?;
    if ![3, 6, 7].contains(&array.len()) {
        return Err(HResult::E_INVALIDARG);
    }
    let mut numbers = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0];
    for (slot, item) in numbers.iter_mut().zip(array) {
        *slot = float(&item.flatten())?;
    }
    Ok(numbers)
}

/// Reads an integer, signed or unsigned, that fits `bits`.
fn pattern(value: &Variant<'_>, bits: u32) -> Result<u32, HResult> {
    let n = match value {
        Variant::Ui8(_) if value.as_i64().is_none() => return Err(HResult::DISP_E_OVERFLOW),
        _ => value.as_i64().ok_or(HResult::E_INVALIDARGTYPE)?,
    };
    if (-(1_i64 << (bits - 1))..1_i64 << bits).contains(&n) {
        Ok(n as u32 & (u32::MAX >> (32 - bits)))
    } else {
        Err(HResult::DISP_E_OVERFLOW)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_all_spellings() {
        let plain = |kind, n| Some((Family::Plain(kind), n));
        assert_eq!(parse_name("I1"), plain(Kind::I, Some(1)));
        assert_eq!(parse_name("i[12]"), plain(Kind::I, Some(12)));
        for name in ["P*", "P[*]", "p*_1", "P[*]_20"] {
            assert_eq!(parse_name(name), plain(Kind::P, None), "{name}");
        }
        assert_eq!(parse_name("io150"), plain(Kind::Io, Some(150)));
        assert_eq!(parse_name("IOB128"), Some((Family::Byte, Some(128))));
        assert_eq!(parse_name("IOW[8]"), Some((Family::Word, Some(8))));
        assert_eq!(parse_name("I99999999999"), plain(Kind::I, Some(u32::MAX)));
        for name in ["", "I", "X1", "I-1", "I+1", "I[1", "I1]", "I1x", "@MODE", "IOX1", "I*_", "I*_x"] {
            assert_eq!(parse_name(name), None, "{name}");
        }
    }

    #[test]
    fn views_share_the_bits_of_io() {
        let mut vars = Variables::new(&Sizes::default());
        vars.put(Family::Word, 16, &Variant::I4(-2)).unwrap();
        assert_eq!(vars.get(Family::Word, 16), owned(-2_i16));
        assert_eq!(vars.get(Family::Byte, 16), owned(0xfe_u8));
        assert_eq!(vars.get(Family::Plain(Kind::Io), 16), owned(false));
        assert_eq!(vars.get(Family::Plain(Kind::Io), 31), owned(true));
        vars.put(Family::Word, 16, &Variant::I4(0x8001)).unwrap();
        assert_eq!(vars.get(Family::Dword, 12), owned(0x8001 << 4));
        assert_eq!(vars.put(Family::Word, 16, &Variant::I4(0x1_0000)), Err(HResult::DISP_E_OVERFLOW));
        vars.put(Family::Float, 64, &Variant::R4(-1.5)).unwrap();
        assert_eq!(vars.get(Family::Float, 64), owned(-1.5_f32));
        assert_eq!(vars.get(Family::Dword, 64), owned((-1.5_f32).to_bits().cast_signed()));
        assert_eq!(vars.get(Family::Dword, 481), Err(HResult::DISP_E_BADINDEX));
        assert!(vars.get(Family::Dword, 480).is_ok());
    }
}
