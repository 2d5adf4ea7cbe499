//! Access rules for PLCs: which variables they may read and write, with which values, and how often.
//!
//! Nothing may be written unless a rule allows it. The gateway checks a request before it sends anything to the robot, in
//! this order; the first violation is the reply:
//!
//! | [`Refusal`]             | reply              | reason                                                   |
//! |-------------------------|--------------------|----------------------------------------------------------|
//! | `Line`                  | the error's code   | the line is not a valid request                          |
//! | `Rate`                  | `E_BUSY_PROC`      | the client exceeds its rate                              |
//! | `ReadOnly`              | `E_ACCESSDENIED`   | this client may write no variable                        |
//! | `Kind`, `Index`         | `E_ACCESSDENIED`   | no variable of this kind, or not this one                |
//! | `Type`                  | `E_INVALIDARGTYPE` | the value is not of the variable's type                  |
//! | `Value`                 | `E_INVALIDARG`     | the value is out of range                                |
//! | `NotFinite`             | `E_INVALIDARG`     | NaN, or an infinity that no range has as its bound       |

use core::fmt;
use core::net::Ipv4Addr;
use core::time::Duration;

use super::convert::{converts, float};
use super::network::Network;
use bcap_core::error::TextError;
use bcap_core::hresult::HResult;
use bcap_core::rac::{Request, Variable, VariableKind};
use bcap_core::time::Instant;
use bcap_core::variant::Variant;

/// Access rules for PLCs.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rules<'a> {
    /// The networks whose clients may connect; without any, all clients may.
    pub clients: &'a [Network],
    /// The variables that may be read; bounds are ignored.
    pub get: &'a [Allow<'a>],
    /// The variables that may be written.
    pub put: &'a [Allow<'a>],
    /// Whether a PUT of another type is converted if that is lossless; otherwise it is refused.
    pub convert: bool,
    /// The rate of each client.
    pub rate: Rate,
}

impl Rules<'_> {
    /// Everything may be read and nothing written, at any rate.
    pub const READ_ONLY: Self =
        Self { clients: &[], get: &Allow::EVERYTHING, put: &[], convert: false, rate: Rate::UNLIMITED };

    /// Returns whether a client may connect.
    #[must_use]
    pub fn admits(&self, address: Option<Ipv4Addr>) -> bool {
        self.clients.is_empty() || self.clients.iter().any(|network| network.contains(address))
    }
}

impl Default for Rules<'_> {
    fn default() -> Self {
        Self::READ_ONLY
    }
}

/// Variables of one kind that may be read or written, and the values that may be written to them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Allow<'a> {
    /// The kind.
    pub kind: VariableKind,
    /// The first index.
    pub first: u32,
    /// The last index.
    pub last: u32,
    /// The range of each element of the value; the last range applies to all further elements. An empty slice allows any
    /// value that is finite.
    pub values: &'a [Bounds],
    /// The clients that the rule applies to.
    pub clients: Network,
}

impl Allow<'_> {
    /// All variables, with any finite value.
    pub const EVERYTHING: [Self; 9] = [
        Self::all(VariableKind::I),
        Self::all(VariableKind::F),
        Self::all(VariableKind::D),
        Self::all(VariableKind::S),
        Self::all(VariableKind::V),
        Self::all(VariableKind::P),
        Self::all(VariableKind::J),
        Self::all(VariableKind::T),
        Self::all(VariableKind::Io),
    ];

    /// Allows all variables of a kind, with any finite value.
    #[must_use]
    pub const fn all(kind: VariableKind) -> Self {
        Self::range(kind, 0, u32::MAX)
    }

    /// Allows the variables from `first` to `last`, with any finite value.
    #[must_use]
    pub const fn range(kind: VariableKind, first: u32, last: u32) -> Self {
        Self { kind, first, last, values: &[], clients: Network::ANY }
    }

    const fn has_index(&self, index: u32) -> bool {
        self.first <= index && index <= self.last
    }

    fn has_value(&self, value: &Variant<'_>) -> bool {
        match value.flatten() {
            Variant::Array(array) => array.iter().enumerate().all(|(at, element)| self.has_element(at, &element)),
            value => self.has_element(0, &value),
        }
    }

    fn has_element(&self, at: usize, element: &Variant<'_>) -> bool {
        match self.values.get(at).or(self.values.last()) {
            Some(bounds) => bounds.contain(element),
            None => is_finite(element),
        }
    }
}

/// Returns whether a value has no infinity and no NaN, which a program of the robot could use as a position or a speed.
fn is_finite(value: &Variant<'_>) -> bool {
    let scalar = |value: &Variant<'_>| value.as_f64().is_none_or(f64::is_finite);
    match value.flatten() {
        Variant::Array(array) => array.iter().all(|element| scalar(&element.flatten())),
        value => scalar(&value),
    }
}

/// A range of values, both ends included: an infinite end allows that infinity. BOOL counts as 0 or 1, a string as its
/// length in UTF-16 units.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Bounds {
    /// The minimum.
    pub min: f64,
    /// The maximum.
    pub max: f64,
}

impl Bounds {
    /// Returns whether a value is in the range. NaN is in no range. A finite R4 is compared with the bounds as R4, because 0.1
    /// as R4 is more than 0.1.
    #[expect(clippy::as_conversions, reason = "a bound is rounded as a value of 32 bits is")]
    fn contain(&self, value: &Variant<'_>) -> bool {
        if let Variant::R4(number) = value.flatten()
            && number.is_finite()
            && self.min as f32 <= number
            && number <= self.max as f32
        {
            return true;
        }
        let number = match value.flatten() {
            Variant::Bool(b) => Some(f64::from(u8::from(b))),
            Variant::Bstr(text) => u32::try_from(text.len()).ok().map(f64::from),
            other => float(&other),
        };
        number.is_some_and(|number| self.min <= number && number <= self.max)
    }
}

/// The rate of requests: a token bucket per slot of the gateway.
///
/// A client that connects again to the same slot gets no new tokens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rate {
    /// Requests per second; 0 means unlimited.
    pub per_second: u32,
    /// Burst: the number of requests without a pause, at least 1.
    pub burst: u32,
}

impl Rate {
    /// No limit.
    pub const UNLIMITED: Self = Self { per_second: 0, burst: 1 };

    fn interval(self) -> Duration {
        Duration::from_micros(1_000_000_u32.checked_div(self.per_second).unwrap_or(0).into())
    }
}

/// The token bucket of one slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// When all admitted requests would be finished at the allowed rate.
    deadline: Instant,
}

impl Pace {
    pub(super) const NEW: Self = Self { deadline: Instant::ZERO };

    /// Takes a token for a request; `false` if the bucket is empty.
    fn admits(&mut self, rate: Rate, now: Instant) -> bool {
        let interval = rate.interval();
        let ahead = interval.saturating_mul(rate.burst.saturating_sub(1));
        if self.deadline.saturating_since(now) > ahead {
            return false;
        }
        self.deadline = self.deadline.max(now).saturating_add(interval);
        true
    }
}

/// Why the gateway refused a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Refusal {
    /// The line is not a valid request.
    Line(TextError),
    /// The client exceeds its rate.
    Rate,
    /// This client may write no variable.
    ReadOnly,
    /// No variable of this kind may be read, or written.
    Kind,
    /// This variable may not be read, or written.
    Index,
    /// The value is not of the variable's type.
    Type,
    /// The value is out of range.
    Value,
    /// The value is NaN, or an infinity that no rule allows.
    NotFinite,
    /// A stream of Slave Mode runs, or may run, and writing may end it.
    SlaveMode,
}

impl Refusal {
    /// Returns the code with which the request is answered.
    #[must_use]
    pub const fn hresult(&self) -> HResult {
        match self {
            Self::Line(error) => error.hresult(),
            Self::Rate => HResult::E_BUSY_PROC,
            Self::ReadOnly | Self::Kind | Self::Index => HResult::E_ACCESSDENIED,
            Self::Type => HResult::E_INVALIDARGTYPE,
            Self::Value | Self::NotFinite => HResult::E_INVALIDARG,
            Self::SlaveMode => HResult::E_SLVMODE_ON,
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Line(error) => return error.fmt(f),
            Self::Rate => "more requests than the rate allows",
            Self::ReadOnly => "the gateway is read-only",
            Self::Kind => "no rule allows this kind of variable",
            Self::Index => "no rule allows this variable",
            Self::Type => "the value is not of the variable's type",
            Self::Value => "the value is out of the range that the rules allow",
            Self::NotFinite => "the value is not a finite number, and no rule allows one that is not",
            Self::SlaveMode => "skipped: a stream of Slave Mode runs or may run, and writing may end it",
        })
    }
}

impl core::error::Error for Refusal {}

impl Rules<'_> {
    /// Checks a request against the rules.
    pub(super) fn check(
        &self,
        request: &Request<'_>,
        client: Option<Ipv4Addr>,
        pace: &mut Pace,
        now: Instant,
    ) -> Result<(), Refusal> {
        if !pace.admits(self.rate, now) {
            return Err(Refusal::Rate);
        }
        self.permits(request, client)
    }

    /// Checks a request of a client against all rules except the rate, for a program that makes its own requests. Rules
    /// for networks apply only to a client whose address is known.
    ///
    /// # Errors
    ///
    /// The first [`Refusal`].
    pub fn permits(&self, request: &Request<'_>, client: Option<Ipv4Addr>) -> Result<(), Refusal> {
        match request {
            Request::Get(variable) => {
                find(self.get, client, *variable)?;
            }
            Request::Put(..) if applying(self.put, client).next().is_none() => return Err(Refusal::ReadOnly),
            Request::Put(variable, value) => {
                find(self.put, client, *variable)?;
                let fits = variable.kind.fits(value) || self.convert && converts(variable.kind, value);
                if !fits {
                    return Err(Refusal::Type);
                }
                if !matching(self.put, client, *variable).any(|allow| allow.has_value(value)) {
                    return Err(if is_finite(value) { Refusal::Value } else { Refusal::NotFinite });
                }
            }
        }
        Ok(())
    }
}

/// Returns the rules that apply to a client.
fn applying<'a>(rules: &'a [Allow<'a>], client: Option<Ipv4Addr>) -> impl Iterator<Item = &'a Allow<'a>> {
    rules.iter().filter(move |allow| allow.clients.contains(client))
}

/// Returns the rules of a client that name a variable.
fn matching<'a>(
    rules: &'a [Allow<'a>],
    client: Option<Ipv4Addr>,
    variable: Variable,
) -> impl Iterator<Item = &'a Allow<'a>> {
    applying(rules, client).filter(move |allow| allow.kind == variable.kind && allow.has_index(variable.index))
}

/// Checks that a rule of a client names a variable.
fn find(rules: &[Allow<'_>], client: Option<Ipv4Addr>, variable: Variable) -> Result<(), Refusal> {
    match matching(rules, client, variable).next() {
        Some(_) => Ok(()),
        None if applying(rules, client).any(|allow| allow.kind == variable.kind) => Err(Refusal::Index),
        None => Err(Refusal::Kind),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use VariableKind as Kind;
    use bcap_core::variant::{Encode, VariantBuf};

    fn at(micros: u64) -> Instant {
        Instant::from_micros(micros)
    }

    fn get(rules: &Rules<'_>, kind: Kind, index: u32) -> Result<(), Refusal> {
        let mut pace = Pace::NEW;
        rules.check(&Request::Get(Variable::new(kind, index)), None, &mut pace, at(0))
    }

    fn put(rules: &Rules<'_>, kind: Kind, index: u32, value: &dyn Encode) -> Result<(), Refusal> {
        let value = VariantBuf::<128>::new(value).unwrap();
        let mut pace = Pace::NEW;
        rules.check(&Request::Put(Variable::new(kind, index), value.as_variant()), None, &mut pace, at(0))
    }

    #[test]
    fn everything_is_read_and_nothing_written_by_default() {
        for kind in Kind::ALL {
            assert_eq!(get(&Rules::READ_ONLY, kind, u32::MAX), Ok(()));
        }
        assert_eq!(put(&Rules::READ_ONLY, Kind::I, 0, &1_i32), Err(Refusal::ReadOnly));
    }

    #[test]
    fn kinds_indices_and_values_are_checked() {
        let values = [Bounds { min: -10.0, max: 10.0 }];
        let put_rules = [
            Allow { values: &values, ..Allow::range(Kind::I, 10, 20) },
            Allow::range(Kind::I, 20, 20),
            Allow { values: &values, ..Allow::all(Kind::Io) },
        ];
        let get_rules = [Allow::range(Kind::P, 3, 4)];
        let rules = Rules { get: &get_rules, put: &put_rules, ..Rules::READ_ONLY };
        assert_eq!(get(&rules, Kind::P, 3), Ok(()));
        assert_eq!(get(&rules, Kind::P, 5), Err(Refusal::Index));
        assert_eq!(get(&rules, Kind::I, 10), Err(Refusal::Kind), "a variable that may be written need not be readable");
        assert_eq!(put(&rules, Kind::I, 10, &-10_i32), Ok(()));
        assert_eq!(put(&rules, Kind::I, 10, &11_i32), Err(Refusal::Value));
        assert_eq!(put(&rules, Kind::I, 20, &11_i32), Ok(()), "one rule that allows it is enough");
        assert_eq!(put(&rules, Kind::I, 9, &1_i32), Err(Refusal::Index));
        assert_eq!(put(&rules, Kind::I, 21, &1_i32), Err(Refusal::Index));
        assert_eq!(put(&rules, Kind::D, 10, &1.0_f64), Err(Refusal::Kind));
        assert_eq!(put(&rules, Kind::Io, 1, &true), Ok(()));
    }

    #[test]
    fn ranges_count_by_element_and_the_last_for_the_rest() {
        let values = [Bounds { min: 0.0, max: 1.0 }, Bounds { min: -5.0, max: 5.0 }];
        let allow = [
            Allow { values: &values, ..Allow::all(Kind::V) },
            Allow { values: &values, ..Allow::all(Kind::F) },
            Allow { values: &values[1..], ..Allow::all(Kind::S) },
        ];
        let rules = Rules { put: &allow, ..Rules::READ_ONLY };
        assert_eq!(put(&rules, Kind::V, 1, &[1.0_f32, 5.0, -5.0]), Ok(()));
        assert_eq!(put(&rules, Kind::V, 1, &[2.0_f32, 5.0, -5.0]), Err(Refusal::Value));
        assert_eq!(put(&rules, Kind::V, 1, &[1.0_f32, 5.0, -5.5]), Err(Refusal::Value));
        assert_eq!(put(&rules, Kind::S, 1, &"12345"), Ok(()));
        assert_eq!(put(&rules, Kind::S, 1, &"123456"), Err(Refusal::Value));
    }

    #[test]
    fn only_finite_numbers_are_written_unless_a_range_has_infinity_as_a_bound() {
        let everything = Rules { put: &Allow::EVERYTHING, convert: true, ..Rules::READ_ONLY };
        let values = [Bounds { min: -1.0, max: f64::INFINITY }];
        let upward = Allow::EVERYTHING.map(|allow| Allow { values: &values, ..allow });
        let upward = Rules { put: &upward, ..everything };
        let refused = Err(Refusal::NotFinite);
        let cases: [(Kind, &dyn Encode, Result<(), Refusal>); 10] = [
            (Kind::F, &f32::INFINITY, Ok(())),
            (Kind::F, &f32::NEG_INFINITY, refused),
            (Kind::F, &f32::NAN, refused),
            (Kind::F, &f64::INFINITY, Ok(())),
            (Kind::D, &f64::INFINITY, Ok(())),
            (Kind::D, &f32::INFINITY, Ok(())),
            (Kind::D, &f64::NAN, refused),
            (Kind::V, &[0.0, f32::INFINITY, 0.0], Ok(())),
            (Kind::V, &[0.0, 0.0, f32::NAN], refused),
            (Kind::V, &(0.0_f32, 1_i32, f64::INFINITY), Ok(())),
        ];
        for (kind, value, in_range) in cases {
            assert_eq!(put(&everything, kind, 1, value), refused, "{kind}");
            assert_eq!(put(&upward, kind, 1, value), in_range, "{kind}");
        }
        for rules in [everything, upward] {
            assert_eq!(put(&rules, Kind::F, 1, &f32::MAX), Ok(()));
            assert_eq!(put(&rules, Kind::D, 1, &f64::MAX), Ok(()));
        }
        assert_eq!(put(&everything, Kind::D, 1, &f64::MIN), Ok(()));
        assert_eq!(put(&upward, Kind::D, 1, &f64::MIN), Err(Refusal::Value));
    }

    #[test]
    fn the_bounds_of_a_range_are_allowed_as_r4() {
        let range = |min, max| [Bounds { min, max }];
        let put = |values: &[Bounds], value: f32| {
            let allow = [Allow { values, ..Allow::all(Kind::F) }];
            put(&Rules { put: &allow, ..Rules::READ_ONLY }, Kind::F, 1, &value)
        };
        // as an R8, 0.1_f32 is 0.10000000149
        assert_eq!(put(&range(0.0, 0.1), 0.1), Ok(()));
        assert_eq!(put(&range(0.0, 0.1), 0.1_f32.next_up()), Err(Refusal::Value));
        assert_eq!(put(&range(-0.1, 0.0), -0.1), Ok(()));
        assert_eq!(put(&range(-0.1, 0.0), (-0.1_f32).next_down()), Err(Refusal::Value));
        // 1e300 is infinite as an R4, and does not allow infinity
        assert_eq!(put(&range(0.0, 1e300), f32::MAX), Ok(()));
        assert_eq!(put(&range(0.0, 1e300), f32::INFINITY), Err(Refusal::NotFinite));
    }

    #[test]
    fn another_type_is_refused_unless_conversion_is_allowed_and_lossless() {
        let allow = [Allow::all(Kind::F), Allow::all(Kind::J)];
        let strict = Rules { put: &allow, ..Rules::READ_ONLY };
        let converting = Rules { convert: true, ..strict };
        assert_eq!(put(&strict, Kind::F, 1, &5.0_f32), Ok(()));
        assert_eq!(put(&strict, Kind::F, 1, &5_i32), Err(Refusal::Type));
        assert_eq!(put(&converting, Kind::F, 1, &5_i32), Ok(()));
        assert_eq!(put(&converting, Kind::F, 1, &0.1_f64), Err(Refusal::Type));
        assert_eq!(put(&strict, Kind::J, 1, &[0.0_f32; 7]), Err(Refusal::Type), "one element is missing");
        assert_eq!(put(&converting, Kind::J, 1, &[0.0_f32; 7]), Err(Refusal::Type));
    }

    #[test]
    fn a_client_has_a_burst_and_then_its_rate() {
        let rules = Rules { rate: Rate { per_second: 10, burst: 3 }, ..Rules::READ_ONLY };
        let request = Request::Get(Variable::new(Kind::I, 1));
        let mut pace = Pace::NEW;
        let mut ask = |micros| rules.check(&request, None, &mut pace, at(micros));
        let start = 5_000_000;
        assert_eq!([ask(start), ask(start), ask(start)], [Ok(()); 3]);
        assert_eq!(ask(start), Err(Refusal::Rate));
        assert_eq!(ask(start + 99_999), Err(Refusal::Rate));
        assert_eq!(ask(start + 100_000), Ok(()));
        assert_eq!(ask(start + 100_000), Err(Refusal::Rate), "a refused request takes no token");
        assert_eq!([ask(start + 900_000), ask(start + 900_000), ask(start + 900_000)], [Ok(()); 3]);
        assert_eq!(ask(start + 900_000), Err(Refusal::Rate), "no more tokens than the burst are saved");
    }

    #[test]
    fn a_rule_for_a_network_applies_to_its_clients_only() {
        let network = |text| Network::parse(text).unwrap();
        let put = [
            Allow::range(Kind::I, 0, 9),
            Allow { clients: network("10.0.0.0/24"), ..Allow::range(Kind::I, 10, 19) },
            Allow { clients: network("10.0.0.7"), ..Allow::all(Kind::F) },
        ];
        let clients = [network("10.0.0.0/16")];
        let rules = Rules { clients: &clients, put: &put, ..Rules::READ_ONLY };
        let client = |a, b, c, d| Some(Ipv4Addr::new(a, b, c, d));
        let put = |rules: &Rules<'_>, client, kind, index| {
            let value = if kind == Kind::I { Variant::I4(1) } else { Variant::R4(1.0) };
            rules.check(&Request::Put(Variable::new(kind, index), value), client, &mut Pace { deadline: at(0) }, at(0))
        };
        for (from, in_network, float) in [
            (client(10, 0, 0, 7), Ok(()), Ok(())),
            (client(10, 0, 0, 8), Ok(()), Err(Refusal::Kind)),
            (client(10, 0, 1, 7), Err(Refusal::Index), Err(Refusal::Kind)),
            (None, Err(Refusal::Index), Err(Refusal::Kind)),
        ] {
            assert_eq!(put(&rules, from, Kind::I, 5), Ok(()), "{from:?}");
            assert_eq!(put(&rules, from, Kind::I, 15), in_network, "{from:?}");
            assert_eq!(put(&rules, from, Kind::F, 1), float, "{from:?}");
        }
        let own = Rules { put: &rules.put[1..], ..rules };
        assert_eq!(put(&own, client(10, 0, 1, 7), Kind::I, 15), Err(Refusal::ReadOnly));
        assert!(rules.admits(client(10, 0, 200, 1)) && !rules.admits(client(10, 1, 0, 1)) && !rules.admits(None));
        assert!(Rules::READ_ONLY.admits(None) && Rules::READ_ONLY.admits(client(1, 1, 1, 1)));
    }
}
