//! The log of operations: what clients, persons and scenarios have done to the controller.

use std::collections::VecDeque;

use bcap_core::time::Instant;

/// The capacity of the log; a full log drops its oldest entry.
const CAPACITY: usize = 1000;

/// An operation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Operation {
    pub(crate) text: String,
    pub(crate) at: Instant,
}

/// The operations in reverse order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Operations {
    log: VecDeque<Operation>,
}

impl Operations {
    pub(crate) fn record(&mut self, text: impl Into<String>, at: Instant) {
        self.log.truncate(CAPACITY - 1);
        self.log.push_front(Operation { text: text.into(), at });
    }

    pub(crate) fn log(&self) -> &VecDeque<Operation> {
        &self.log
    }
}
