//! The definitions of the areas: 34 numbers each.

use bcap_core::hresult::HResult;

/// The number of areas.
const COUNT: usize = 32;

/// The length of a definition, the minimum length for SetAreaDef, and the indices of the sides, the IO and the flag.
const PLACES: usize = 34;
const LEAST: usize = 11;
pub(crate) const SIDES: usize = 6;
pub(crate) const IO: usize = 9;
pub(crate) const ENABLED: usize = 33;

/// The definitions.
#[derive(Clone, Debug)]
pub(crate) struct Areas(Vec<[f64; PLACES]>);

impl Areas {
    pub(crate) fn new() -> Self {
        Self(vec![[0.0; PLACES]; COUNT])
    }

    pub(crate) fn get(&self, area: i32) -> Result<&[f64; PLACES], HResult> {
        usize::try_from(area).ok().and_then(|n| self.0.get(n)).ok_or(HResult::E_INVALIDARG)
    }

    pub(crate) fn get_mut(&mut self, area: i32) -> Result<&mut [f64; PLACES], HResult> {
        usize::try_from(area).ok().and_then(|n| self.0.get_mut(n)).ok_or(HResult::E_INVALIDARG)
    }

    /// Replaces the first numbers of a definition.
    pub(crate) fn set(&mut self, area: i32, given: &[f64]) -> Result<(), HResult> {
        let definition = self.get_mut(area)?;
        if !(LEAST..=PLACES).contains(&given.len()) || given.iter().any(|n| !n.is_finite()) {
            return Err(HResult::E_INVALIDARG);
        }
        definition[..given.len()].copy_from_slice(given);
        Ok(())
    }
}
