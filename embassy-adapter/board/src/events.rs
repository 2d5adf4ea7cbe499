//! The last messages of a board, for its page and for syslog: one memory for both.

use heapless::String;

/// Maximum length of the text of a message. Longer texts are cut.
pub(crate) const TEXT: usize = 192;

/// A message.
#[derive(Clone, Debug)]
pub(crate) struct Event {
    /// When it occurred, in microseconds since the start.
    pub(crate) at: u64,
    /// The code of its severity.
    pub(crate) severity: u8,
    /// The kind of the message; `None` in an unused entry.
    pub(crate) id: Option<&'static str>,
    pub(crate) text: String<TEXT>,
}

impl Event {
    /// All zero, so that static memory takes no flash.
    const NONE: Self = Self { at: 0, severity: 0, id: None, text: String::new() };
}

/// The last `N` messages, and which of them were sent.
#[derive(Debug)]
pub(crate) struct Events<const N: usize> {
    entries: [Event; N],
    /// The number of all messages, and of those that were sent or lost.
    next: usize,
    sent: usize,
    lost: u32,
}

impl<const N: usize> Events<N> {
    pub(crate) const fn new() -> Self {
        Self { entries: [const { Event::NONE }; N], next: 0, sent: 0, lost: 0 }
    }

    /// Adds a message in the place of the oldest one.
    pub(crate) fn push(&mut self, event: Event) {
        if let Some(place) = self.entries.get_mut(self.next % N) {
            *place = event;
        }
        self.next = self.next.wrapping_add(1);
    }

    /// Returns whether a message was not sent yet.
    pub(crate) const fn has_unsent(&self) -> bool {
        self.next != self.sent
    }

    /// Returns the oldest message that was not sent, and counts it as sent. Those that were replaced before are lost.
    pub(crate) fn take(&mut self) -> Option<Event> {
        let waiting = self.next.wrapping_sub(self.sent);
        if let Some(replaced @ 1..) = waiting.checked_sub(N) {
            self.lost = self.lost.saturating_add(u32::try_from(replaced).unwrap_or(u32::MAX));
            self.sent = self.next.wrapping_sub(N);
        }
        let event = self.entries.get(self.sent % N).filter(|_| waiting > 0).cloned()?;
        self.sent = self.sent.wrapping_add(1);
        Some(event)
    }

    /// Counts a message that was not sent.
    pub(crate) const fn lose(&mut self) {
        self.lost = self.lost.saturating_add(1);
    }

    /// Returns how many messages were lost.
    pub(crate) const fn lost(&self) -> u32 {
        self.lost
    }

    /// Returns the messages in reverse order.
    pub(crate) fn in_reverse_order(&self) -> impl Iterator<Item = &Event> {
        (1..=N).filter_map(|back| self.entries.get(self.next.wrapping_sub(back) % N)).filter(|event| event.id.is_some())
    }
}

#[cfg(test)]
mod tests {
    use core::fmt::Write;
    use std::vec::Vec;

    use super::*;

    fn event(at: u64) -> Event {
        let mut text = String::new();
        write!(text, "text {at}").unwrap();
        Event { at, severity: 5, id: Some("id"), text }
    }

    fn shown(events: &Events<4>) -> Vec<u64> {
        events.in_reverse_order().map(|event| event.at).collect()
    }

    #[test]
    fn the_last_messages_are_shown_and_each_is_sent_once() {
        let mut events = Events::<4>::new();
        assert!(events.take().is_none() && !events.has_unsent() && shown(&events).is_empty());
        for at in 1..=3 {
            events.push(event(at));
        }
        assert_eq!(shown(&events), [3, 2, 1]);
        let first = events.take().unwrap();
        assert_eq!((first.at, first.severity, &*first.text), (1, 5, "text 1"));
        for at in 4..=6 {
            events.push(event(at));
        }
        // 2 was replaced before it was sent
        assert_eq!(shown(&events), [6, 5, 4, 3]);
        let sent: Vec<u64> = core::iter::from_fn(|| events.take()).map(|event| event.at).collect();
        assert_eq!((sent, events.lost(), events.has_unsent()), ([3, 4, 5, 6].to_vec(), 1, false));
        events.lose();
        assert_eq!((events.lost(), shown(&events)), (2, [6, 5, 4, 3].to_vec()), "sent ones are still shown");
    }
}
