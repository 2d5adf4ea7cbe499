//! An LRU cache of variable handles, of fixed size.

use bcap_core::bcap::call::VariableHandle;
use bcap_core::rac::Variable;

/// A variable and its handle.
#[derive(Clone, Copy, Debug)]
pub(super) struct CachedHandle {
    variable: Variable,
    handle: VariableHandle,
    /// The time of its last use, on the table's own clock.
    used: u32,
}

/// The result of a lookup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lookup {
    /// The handle of the variable.
    Known(VariableHandle),
    /// Its handle must be requested; there is room for it.
    Unknown,
    /// The table is full: this handle, used longest ago, must be released first.
    Full(VariableHandle),
}

/// A table of handles, whose clock counts its uses.
#[derive(Debug)]
pub(super) struct Handles<'m> {
    entries: &'m mut [Option<CachedHandle>],
    clock: u32,
}

impl<'m> Handles<'m> {
    pub(super) fn new(entries: &'m mut [Option<CachedHandle>]) -> Self {
        entries.fill(None);
        Self { entries, clock: 0 }
    }

    /// Looks a variable up, and marks it as used.
    pub(super) fn look_up(&mut self, variable: Variable) -> Lookup {
        self.clock = self.clock.wrapping_add(1);
        let clock = self.clock;
        if let Some(entry) = self.entries.iter_mut().flatten().find(|entry| entry.variable == variable) {
            entry.used = clock;
            return Lookup::Known(entry.handle);
        }
        if self.entries.iter().any(Option::is_none) {
            return Lookup::Unknown;
        }
        // compares differences, because the clock wraps
        match self.entries.iter().flatten().max_by_key(|entry| clock.wrapping_sub(entry.used)) {
            Some(oldest) => Lookup::Full(oldest.handle),
            None => Lookup::Unknown,
        }
    }

    /// Adds a handle, if there is room.
    pub(super) fn insert(&mut self, variable: Variable, handle: VariableHandle) {
        if let Some(free) = self.entries.iter_mut().find(|entry| entry.is_none()) {
            *free = Some(CachedHandle { variable, handle, used: self.clock });
        }
    }

    /// Removes a handle.
    pub(super) fn remove(&mut self, handle: VariableHandle) {
        for entry in &mut *self.entries {
            if entry.is_some_and(|entry| entry.handle == handle) {
                *entry = None;
            }
        }
    }

    /// Removes all handles, which are invalid after their connection.
    pub(super) fn clear(&mut self) {
        self.entries.fill(None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bcap_core::rac::VariableKind;

    fn variable(index: u32) -> Variable {
        Variable::new(VariableKind::I, index)
    }

    #[test]
    fn the_least_recently_used_handle_is_replaced_even_when_the_clock_wraps() {
        let mut memory = [None; 3];
        let mut handles = Handles::new(&mut memory);
        handles.clock = u32::MAX - 3;
        for index in 0..3 {
            assert_eq!(handles.look_up(variable(index)), Lookup::Unknown);
            handles.insert(variable(index), VariableHandle(index.cast_signed() + 10));
        }
        assert_eq!(handles.look_up(variable(0)), Lookup::Known(VariableHandle(10)));
        assert_eq!(handles.look_up(variable(7)), Lookup::Full(VariableHandle(11)), "the clock has wrapped");
        handles.remove(VariableHandle(11));
        assert_eq!(handles.look_up(variable(7)), Lookup::Unknown);
        handles.insert(variable(7), VariableHandle(17));
        assert_eq!(handles.look_up(variable(1)), Lookup::Full(VariableHandle(12)));
        handles.clear();
        assert_eq!(handles.look_up(variable(0)), Lookup::Unknown);
    }

    #[test]
    fn the_same_index_of_another_kind_is_another_variable() {
        let mut memory = [None; 2];
        let mut handles = Handles::new(&mut memory);
        handles.insert(variable(1), VariableHandle(1));
        assert_eq!(handles.look_up(Variable::new(VariableKind::Io, 1)), Lookup::Unknown);
    }
}
