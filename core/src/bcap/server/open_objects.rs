//! The objects that a peer has open.

use crate::bcap::Object;

/// The objects that a peer has open, in the order in which they were opened.
///
/// Most handlers assign ascending handles. As long as they do, an object is found by a binary search.
#[derive(Debug)]
pub(super) struct OpenObjects<const N: usize> {
    objects: heapless::Vec<(Object, i32), N>,
    /// Whether the handles are sorted in ascending order.
    is_ascending: bool,
}

impl<const N: usize> OpenObjects<N> {
    pub(super) const fn new() -> Self {
        Self { objects: heapless::Vec::new(), is_ascending: true }
    }

    pub(super) fn len(&self) -> usize {
        self.objects.len()
    }

    pub(super) fn is_full(&self) -> bool {
        self.objects.is_full()
    }

    pub(super) fn contains(&self, object: Object, handle: i32) -> bool {
        let is_ascending = self.is_ascending;
        let first = if is_ascending { self.objects.partition_point(|(_, known)| *known < handle) } else { 0 };
        let candidates = self.objects.iter().skip(first);
        // objects of different kinds may have the same handle
        let mut candidates = candidates.take_while(|(_, known)| !is_ascending || *known == handle);
        candidates.any(|known| *known == (object, handle))
    }

    /// Adds an object, unless it is known. A full list remains as it is.
    pub(super) fn insert(&mut self, object: Object, handle: i32) {
        if self.contains(object, handle) {
            return;
        }
        let ascends = self.objects.last().is_none_or(|(_, last)| *last <= handle);
        if self.objects.push((object, handle)).is_ok() {
            self.is_ascending &= ascends;
        }
    }

    pub(super) fn remove(&mut self, object: Object, handle: i32) {
        self.objects.retain(|known| *known != (object, handle));
        self.is_ascending |= self.objects.is_empty();
    }

    /// Removes the object that was opened last.
    pub(super) fn pop(&mut self) -> Option<(Object, i32)> {
        let last = self.objects.pop();
        self.is_ascending |= self.objects.is_empty();
        last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Object::{Controller, Robot, Service, Task, Variable};

    /// Removes all objects, in reverse order.
    fn drain<const N: usize>(mut opened: OpenObjects<N>) -> heapless::Vec<(Object, i32), N> {
        core::iter::from_fn(|| opened.pop()).collect()
    }

    #[test]
    fn objects_are_found_whatever_the_order_of_their_handles() {
        for handles in [[2, 3, 4, 5], [5, 4, 3, 2], [3, 5, 2, 4], [i32::MAX, -1, 0, i32::MIN]] {
            let mut opened = OpenObjects::<8>::new();
            for handle in handles {
                opened.insert(Variable, handle);
            }
            for handle in handles {
                assert!(opened.contains(Variable, handle), "{handle} of {handles:?}");
                assert!(!opened.contains(Task, handle), "{handle} of {handles:?}");
            }
            assert!(!opened.contains(Variable, 6));
            opened.remove(Variable, handles[1]);
            assert!(!opened.contains(Variable, handles[1]));
            let left = [handles[3], handles[2], handles[0]].map(|handle| (Variable, handle));
            assert_eq!(drain(opened), left);
        }
    }

    #[test]
    fn kinds_with_the_same_handle_are_different_objects() {
        let mut opened = OpenObjects::<8>::new();
        for (object, handle) in [(Service, 0), (Controller, 7), (Robot, 7), (Task, 7), (Robot, 7)] {
            opened.insert(object, handle);
        }
        assert_eq!(opened.len(), 4);
        opened.remove(Robot, 7);
        opened.remove(Robot, 7);
        assert_eq!(drain(opened), [(Task, 7), (Controller, 7), (Service, 0)]);
    }

    #[test]
    fn an_emptied_list_ascends_again() {
        let mut opened = OpenObjects::<4>::new();
        for handle in [2, 1] {
            opened.insert(Variable, handle);
        }
        assert!(!opened.is_ascending);
        opened.remove(Variable, 2);
        assert!(!opened.is_ascending);
        opened.remove(Variable, 1);
        assert!(opened.is_ascending);
    }

    #[test]
    fn a_full_list_remains_as_it_is() {
        let mut opened = OpenObjects::<2>::new();
        for handle in [4, 6, 5] {
            opened.insert(Variable, handle);
        }
        assert!(opened.is_full() && opened.is_ascending);
        assert_eq!(drain(opened), [(Variable, 6), (Variable, 4)]);
    }
}
