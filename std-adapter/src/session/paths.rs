//! The handles of the controller's variables, by the path that the caller uses.
//!
//! A program polls the same variables in the same order. So each entry stores which entry followed it last time: a look-up of
//! that variable, or of the same variable again, compares one text and hashes nothing. Any other look-up hashes the path once.

use std::sync::Arc;

use bcap_core::bcap::call::VariableHandle;
// the standard library's hasher takes three times as long, to resist hostile keys; the caller chooses these names
use foldhash::HashMap;

#[derive(Debug, Default)]
pub(super) struct Paths {
    entries: Vec<Entry>,
    /// The positions of the entries.
    positions: HashMap<Arc<str>, usize>,
    /// The position of the entry that was used last.
    last: usize,
}

#[derive(Debug)]
struct Entry {
    path: Arc<str>,
    variable: VariableHandle,
    /// The position of the entry that was used next; at first its own.
    next: usize,
}

impl Paths {
    /// Returns the handle of a variable that was added.
    #[inline]
    pub(super) fn get(&mut self, path: &str) -> Option<VariableHandle> {
        let next = self.entries.get(self.last)?.next;
        match self.entries.get(next) {
            Some(entry) if *entry.path == *path => {
                self.last = next;
                Some(entry.variable)
            }
            _ => self.find(path),
        }
    }

    #[inline(never)]
    fn find(&mut self, path: &str) -> Option<VariableHandle> {
        let at = *self.positions.get(path)?;
        self.follow(at);
        self.entries.get(at).map(|entry| entry.variable)
    }

    /// Adds a variable that is not present.
    pub(super) fn add(&mut self, path: &str, variable: VariableHandle) {
        let (path, at) = (Arc::<str>::from(path), self.entries.len());
        self.positions.insert(Arc::clone(&path), at);
        self.entries.push(Entry { path, variable, next: at });
        self.follow(at);
    }

    /// Records that the entry at this position is used after the last one.
    fn follow(&mut self, at: usize) {
        if let Some(last) = self.entries.get_mut(self.last) {
            last.next = at;
        }
        self.last = at;
    }

    /// Removes all variables.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_are_found_in_any_order_until_they_are_cleared() {
        let mut paths = Paths::default();
        assert_eq!(paths.get("I0"), None);
        for number in 0..4 {
            paths.add(&format!("I{number}"), VariableHandle(number));
        }
        // repeated, in order, in reverse order, and alternating
        for number in [3, 3, 0, 1, 2, 3, 0, 1, 2, 3, 2, 1, 0, 2, 0, 2, 1, 1] {
            assert_eq!(paths.get(&format!("I{number}")), Some(VariableHandle(number)));
            assert_eq!(paths.get("I4"), None);
        }
        paths.clear();
        assert_eq!(paths.get("I1"), None);
        paths.add("I1", VariableHandle(7));
        assert_eq!(paths.get("I1"), Some(VariableHandle(7)));
    }

    #[test]
    fn the_next_one_of_a_cycle_is_predicted() {
        let mut paths = Paths::default();
        for (number, name) in (0..).zip(["a", "b", "c"]) {
            paths.add(name, VariableHandle(number));
        }
        let cycle = |paths: &mut Paths| {
            ["a", "b", "c"].map(|name| {
                let predicted = paths.entries[paths.last].next;
                paths.get(name).map(|variable| variable.0) == Some(i32::try_from(predicted).unwrap())
            })
        };
        assert_eq!(cycle(&mut paths), [false, true, true]);
        assert_eq!(cycle(&mut paths), [true; 3]);
        // a variable that is read twice in a row is looked up once, and once more in the next cycle
        assert_eq!(paths.get("c"), Some(VariableHandle(2)));
        assert_eq!(cycle(&mut paths), [false, true, true]);
    }
}
