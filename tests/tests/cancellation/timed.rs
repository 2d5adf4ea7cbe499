//! The core's transport over a device and a timer: a future that is dropped before it is ready has moved no byte.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, VecDeque};
use std::convert::Infallible;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::Poll;
use std::time::Duration;

use bcap_core::io::asynch::{Timed, Timer, Transport};
use bcap_core::time::{Clock, Instant};
use embedded_io_async::{ErrorType, Read, Write};

use crate::cancellation::sweep::{finish, poll_times};

/// A clock that advances by a millisecond whenever its timer is polled.
#[derive(Clone, Default)]
struct Ticks(Rc<Cell<u64>>);

impl Clock for Ticks {
    fn now(&self) -> Instant {
        Instant::from_millis(self.0.get())
    }
}

impl Timer for Ticks {
    async fn sleep_until(&mut self, at: Instant) {
        poll_fn(|_| {
            self.0.set(self.0.get() + 1);
            if self.now() < at { Poll::Pending } else { Poll::Ready(()) }
        })
        .await;
    }
}

/// A device with a buffer each way, ready for one byte at every third poll.
#[derive(Default)]
struct Device {
    polls: usize,
    written: Rc<RefCell<Vec<u8>>>,
    incoming: VecDeque<u8>,
}

impl Device {
    fn poll<T>(&mut self, work: impl FnOnce(&mut Self) -> Option<T>) -> Poll<T> {
        self.polls += 1;
        if !self.polls.is_multiple_of(3) {
            return Poll::Pending;
        }
        work(self).map_or(Poll::Pending, Poll::Ready)
    }
}

impl ErrorType for Device {
    type Error = Infallible;
}

impl Read for Device {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let byte = poll_fn(|_| self.poll(|device| device.incoming.pop_front())).await;
        buffer[0] = byte;
        Ok(1)
    }
}

impl Write for Device {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            self.poll(|device| {
                device.written.borrow_mut().push(bytes[0]);
                Some(Ok(1))
            })
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        poll_fn(|_| self.poll(|_| Some(()))).await;
        Ok(())
    }
}

const LATER: Duration = Duration::from_secs(1000);
const BYTES: &[u8] = b"a request";

/// Drops `send` and `receive` of a byte after `polls` polls, then moves all bytes.
fn dropped(polls: usize, sends: bool) -> bool {
    let (mut device, ticks) = (Device::default(), Ticks::default());
    device.incoming.extend(BYTES);
    let (until, written) = (ticks.now().saturating_add(LATER), Rc::clone(&device.written));
    let (mut sent, mut received) = (0, Vec::<u8>::new());
    let mut transport = Timed::new(device, ticks.clone());
    let mut buffer = [0; 4];
    let ended = if sends {
        let done = poll_times(transport.send(&BYTES[sent..], until), polls);
        sent += done.map_or(0, |count| count.unwrap().unwrap());
        done.is_some()
    } else {
        let done = poll_times(transport.receive(&mut buffer, until), polls);
        let count = done.map_or(0, |count| count.unwrap().unwrap());
        received.extend(&buffer[..count]);
        done.is_some()
    };
    while sent < BYTES.len() {
        sent += finish(transport.send(&BYTES[sent..], until)).unwrap().unwrap();
    }
    while received.len() < BYTES.len() {
        let count = finish(transport.receive(&mut buffer, until)).unwrap().unwrap();
        received.extend(&buffer[..count]);
    }
    assert_eq!(received, BYTES, "received, after {polls} polls");
    // its own time limit applies, not the limit of the dropped call
    let soon = ticks.now().saturating_add(Duration::from_millis(2));
    let at_once = finish(transport.receive(&mut buffer, soon)).unwrap();
    assert!(at_once.is_none(), "after {polls} polls");
    assert!(ticks.now() < until, "after {polls} polls");
    assert_eq!(*written.borrow(), BYTES, "sent, after {polls} polls");
    ended
}

/// Drops the functions of the transport at every await point; returns how many each has.
pub(crate) fn all() -> BTreeMap<&'static str, usize> {
    let points = |ended: &dyn Fn(usize) -> bool| (1..).find(|polls| ended(*polls)).map_or(0, |polls| polls - 1);
    let sleeps = |polls| {
        let ticks = Ticks::default();
        let mut transport = Timed::new(Device::default(), ticks.clone());
        let ended = poll_times(transport.sleep_until(Instant::from_millis(20)), polls).is_some();
        finish(transport.sleep_until(Instant::from_millis(30)));
        assert!((30..=31).contains(&ticks.0.get()), "after {polls} polls");
        ended
    };
    BTreeMap::from([
        ("Timed::send", points(&|polls| dropped(polls, true))),
        ("Timed::receive", points(&|polls| dropped(polls, false))),
        ("Timed::sleep_until", points(&sleeps)),
    ])
}
