//! The driver on the model of the chip.

use core::cell::RefMut;
use core::future::poll_fn;
use core::task::Poll;
use std::vec;
use std::vec::Vec;

use embassy_futures::block_on;
use embassy_futures::select::{Either, select};
use embassy_net_driver_channel::driver::{Driver, RxToken, TxToken};
use embassy_time::{Instant, with_timeout};
use embedded_hal::spi::ErrorKind;
use proptest::prelude::*;

use super::model::{Model, Shared};
use super::*;

const MAC: [u8; 6] = [2, 0, 0, 0, 0, 0x15];
const LIMIT: Duration = Duration::from_secs(30);

fn frame(number: usize, len: usize) -> Vec<u8> {
    (0..len).map(|at| (number * 31 + at) as u8).collect()
}

fn open() -> (Shared, Chip<Shared>) {
    let model = Model::shared();
    let mut chip = Chip::new(model.clone(), MAC);
    assert_eq!(block_on(chip.init()), Ok(()));
    assert_eq!(model.0.borrow().common[9..15], MAC);
    (model, chip)
}

fn receive(chip: &mut Chip<Shared>) -> Option<Vec<u8>> {
    let mut buffer = [0; MAX_FRAME];
    loop {
        match block_on(chip.receive(&mut buffer)).unwrap() {
            Received::Frame(len) => return Some(buffer[..len].to_vec()),
            Received::Dropped => {}
            Received::Nothing => return None,
        }
    }
}

/// Runs a driver on a chip, and a test with it. The test gets the chip and the driver of embassy-net.
fn run<T>(model: &Shared, test: impl AsyncFnOnce(&Shared, &mut Device<'_>) -> T) -> T {
    let mut state = State::<2, 1>::new();
    block_on(async {
        let (mut device, runner) =
            new(MAC, &mut state, model.clone(), model.clone(), model.clone()).await.expect("a chip");
        match select(runner.run(), with_timeout(LIMIT, test(model, &mut device))).await {
            Either::First(never) => never,
            Either::Second(result) => result.expect("the test ends in time"),
        }
    })
}

async fn next(device: &mut Device<'_>) -> Vec<u8> {
    poll_fn(|cx| match device.receive(cx) {
        Some((frame, _)) => Poll::Ready(frame.consume(|bytes| bytes.to_vec())),
        None => Poll::Pending,
    })
    .await
}

async fn send(device: &mut Device<'_>, frame: &[u8]) {
    poll_fn(|cx| match device.transmit(cx) {
        Some(room) => {
            room.consume(frame.len(), |bytes| bytes.copy_from_slice(frame));
            Poll::Ready(())
        }
        None => Poll::Pending,
    })
    .await;
}

async fn until(model: &Shared, holds: impl Fn(RefMut<'_, Model>) -> bool) {
    poll_fn(|_| if holds(model.0.borrow_mut()) { Poll::Ready(()) } else { Poll::Pending }).await;
}

async fn until_link(device: &mut Device<'_>, link: LinkState) {
    poll_fn(|cx| if device.link_state(cx) == link { Poll::Ready(()) } else { Poll::Pending }).await;
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Frames keep their bytes and their order while positions and memories wrap; none is lost that fits.
    #[test]
    fn frames_arrive_and_leave_unchanged(steps in prop::collection::vec((any::<bool>(), 14..=MAX_FRAME, 0..4_usize), 1..60)) {
        let (model, mut chip) = open();
        let (mut expected, mut received, mut sent) = (Vec::new(), Vec::new(), Vec::new());
        for (number, (is_sent, len, reads)) in steps.into_iter().enumerate() {
            let frame = frame(number, len);
            if is_sent {
                prop_assert_eq!(block_on(chip.send(&frame)), Ok(()));
                sent.push(frame);
            } else if model.0.borrow_mut().receive(&frame) {
                expected.push(frame);
            }
            received.extend((0..reads).filter_map(|_| receive(&mut chip)));
        }
        while let Some(frame) = receive(&mut chip) {
            received.push(frame);
        }
        prop_assert_eq!(received, expected);
        prop_assert_eq!(&model.0.borrow().sent, &sent);
        prop_assert_eq!(model.0.borrow().opened, 1);
    }

    /// Whatever the length is, the next frame after it arrives, and the driver does not panic.
    #[test]
    fn a_damaged_length_costs_the_frames_in_the_chip_only(length: u16, len in 14..=MAX_FRAME) {
        let (model, mut chip) = open();
        model.0.borrow_mut().receive_with_length(length, &frame(1, len));
        while receive(&mut chip).is_some() {}
        prop_assert_eq!(model.0.borrow().unread(), 0);
        prop_assert!(model.0.borrow_mut().receive(&frame(2, 60)));
        prop_assert_eq!(receive(&mut chip), Some(frame(2, 60)));
    }
}

#[test]
fn lengths_that_no_frame_has_open_the_socket_again() {
    for length in [0, 1, 2, 15, MAX_FRAME as u16 + 11, 0x4000, u16::MAX] {
        let (model, mut chip) = open();
        model.0.borrow_mut().receive_with_length(length, &frame(1, 1500));
        assert_eq!(block_on(chip.receive(&mut [0; MAX_FRAME])), Ok(Received::Dropped), "{length}");
        assert_eq!((model.0.borrow().opened, model.0.borrow().unread()), (2, 0), "{length}");
    }
}

#[test]
fn a_frame_with_tags_that_is_too_long_is_skipped_alone() {
    let (model, mut chip) = open();
    for number in 0..3 {
        model.0.borrow_mut().receive(&frame(number, if number == 1 { MAX_FRAME + 4 } else { 60 }));
    }
    let received: Vec<_> = core::iter::from_fn(|| receive(&mut chip)).collect();
    assert_eq!(received, [frame(0, 60), frame(2, 60)]);
    assert_eq!(model.0.borrow().opened, 1);
}

#[test]
fn a_register_that_changes_while_it_is_read_is_read_again() {
    let (model, mut chip) = open();
    model.0.borrow_mut().receive(&frame(1, 254));
    model.0.borrow_mut().faults.torn_reads = [0x1ff, 0].into();
    assert_eq!(receive(&mut chip), Some(frame(1, 254)));
    assert_eq!(model.0.borrow().opened, 1);
}

#[test]
fn a_burst_is_read_after_one_interrupt() {
    run(&Model::shared(), async |model, device| {
        // it waits for an interrupt
        model.0.borrow_mut().receive(&frame(99, 60));
        assert_eq!(next(device).await, frame(99, 60));
        let since = Instant::now();
        for number in 0..50 {
            assert!(model.0.borrow_mut().receive(&frame(number, 300)));
        }
        for number in 0..50 {
            assert_eq!(next(device).await, frame(number, 300));
        }
        until(model, |model| model.unread() == 0).await;
        // a frame for each tick would take 50 ticks
        assert!(since.elapsed() < 25 * TICK);
    });
}

#[test]
fn frames_arrive_without_interrupts() {
    let model = Model::shared();
    model.0.borrow_mut().faults.has_no_interrupt = true;
    run(&model, async |model, device| {
        for number in 0..4 {
            model.0.borrow_mut().receive(&frame(number, 60));
            assert_eq!(next(device).await, frame(number, 60));
        }
    });
}

#[test]
fn an_interrupt_that_stays_does_not_keep_the_bus_busy() {
    let model = Model::shared();
    model.0.borrow_mut().faults.has_shorted_interrupt = true;
    run(&model, async |model, device| {
        until_link(device, LinkState::Up).await;
        let (before, since) = (model.0.borrow().transfers, Instant::now());
        Timer::after(4 * TICK).await;
        let ticks = since.elapsed().as_ticks() / TICK.as_ticks() + 1;
        let transfers = u64::from(model.0.borrow().transfers - before);
        assert!(transfers <= 20 * ticks, "{transfers} in {ticks} ticks");
        model.0.borrow_mut().receive(&frame(1, 60));
        assert_eq!(next(device).await, frame(1, 60));
    });
}

#[test]
fn the_link_is_that_of_the_chip() {
    run(&Model::shared(), async |model, device| {
        for (is_up, state) in [(true, LinkState::Up), (false, LinkState::Down), (true, LinkState::Up)] {
            model.0.borrow_mut().set_link(is_up);
            until_link(device, state).await;
        }
    });
}

#[test]
fn a_chip_that_has_lost_its_registers_is_initialised_again() {
    run(&Model::shared(), async |model, device| {
        until_link(device, LinkState::Up).await;
        model.0.borrow_mut().reset();
        until(model, |model| model.opened == 2).await;
        assert_eq!(model.0.borrow().common[9..15], MAC);
        model.0.borrow_mut().receive(&frame(1, 60));
        assert_eq!(next(device).await, frame(1, 60));
    });
}

#[test]
fn a_bus_that_fails_takes_the_link_down_until_it_works_again() {
    run(&Model::shared(), async |model, device| {
        until_link(device, LinkState::Up).await;
        model.0.borrow_mut().faults.bus_fails = true;
        send(device, &frame(0, 60)).await;
        until_link(device, LinkState::Down).await;
        model.0.borrow_mut().faults.bus_fails = false;
        until_link(device, LinkState::Up).await;
        send(device, &frame(1, 60)).await;
        until(model, |model| model.sent == [frame(1, 60)]).await;
    });
}

#[test]
fn a_frame_that_does_not_leave_is_given_up() {
    run(&Model::shared(), async |model, device| {
        model.0.borrow_mut().faults.sends_nothing = true;
        send(device, &frame(0, 60)).await;
        send(device, &frame(1, 60)).await;
        until(model, |model| model.opened == 2).await;
        model.0.borrow_mut().faults.sends_nothing = false;
        send(device, &frame(2, 60)).await;
        until(model, |model| model.sent == [frame(2, 60)]).await;
        // the other direction continues
        model.0.borrow_mut().receive(&frame(3, 60));
        assert_eq!(next(device).await, frame(3, 60));
    });
}

#[test]
fn a_flood_keeps_no_frame_in_the_board() {
    run(&Model::shared(), async |model, device| {
        until_link(device, LinkState::Up).await;
        let mut sent = vec![];
        for number in 0..40 {
            while model.0.borrow_mut().receive(&frame(number, 60)) {}
            send(device, &frame(number, 1514)).await;
            sent.push(frame(number, 1514));
            let _ = next(device).await;
        }
        until(model, |model| model.sent == sent).await;
    });
}

#[test]
fn a_chip_that_is_not_there_is_an_error() {
    for (version, fails, error) in [(0xff, false, Error::Version(0xff)), (4, true, Error::Spi(ErrorKind::Other))] {
        let model = Model::shared();
        model.0.borrow_mut().version = version;
        model.0.borrow_mut().faults.bus_fails = fails;
        let mut state = State::<1, 1>::new();
        let made = block_on(new(MAC, &mut state, model.clone(), model.clone(), model.clone()));
        assert_eq!(made.err(), Some(error));
    }
}
