//! Tests the settings in flash, with the power cut at bytes that are written or erased.

use std::io::{self, Write as _};
use std::ops::Range;

use bcap_board::slots::{SLOT, SlotError, Slots, TEXT};
use bcap_testkit::flash::{Flash, FlashError};

use crate::stride;

type Small = Flash<4, 2048>;

/// Two slots at the end of a flash, after a sector of other data.
fn slots<const WRITE: usize, const ERASE: usize>(flash: Flash<WRITE, ERASE>) -> Slots<Flash<WRITE, ERASE>> {
    let sector = u32::try_from(ERASE).unwrap();
    Slots::new(flash, sector..sector * 3).unwrap()
}

fn new<const WRITE: usize, const ERASE: usize>() -> Flash<WRITE, ERASE> {
    Flash::new(ERASE * 3)
}

fn text<const WRITE: usize, const ERASE: usize>(slots: &mut Slots<Flash<WRITE, ERASE>>) -> Option<Vec<u8>> {
    slots.read(&mut [0; TEXT]).unwrap().map(<[u8]>::to_vec)
}

/// Settings of this length.
fn settings(letter: char, len: usize) -> Vec<u8> {
    format!("provider={}", String::from(letter).repeat(len - "provider=".len())).into_bytes()
}

#[test]
fn the_newest_settings_are_read() {
    let mut slots = slots::<4, 2048>(new());
    assert_eq!(text(&mut slots), None, "random contents are no settings");
    // both slots are used in turn; the lengths are those around the unit of 32 bytes, and the largest
    for (letter, len) in ('a'..).zip([9, 31, 32, 33, 64, 1000, TEXT - 1, TEXT, 10]) {
        slots.write(&settings(letter, len)).unwrap();
        assert_eq!(text(&mut slots), Some(settings(letter, len)), "{len}");
    }
    slots.write(b"").unwrap();
    assert_eq!(text(&mut slots), Some(Vec::new()), "empty settings are settings");
    assert_eq!(slots.write(&settings('x', TEXT + 1)), Err(SlotError::TooLong { len: TEXT + 1 }));
    assert_eq!(text(&mut slots), Some(Vec::new()));
    slots.clear().unwrap();
    assert_eq!(text(&mut slots), None);
}

#[test]
fn a_range_without_two_slots_of_whole_sectors_is_refused() {
    let make = |range| Slots::new(Small::new(10_240), range).map(drop);
    assert_eq!(make(0..4096), Ok(()));
    assert_eq!(make(2048..10_240), Ok(()), "slots of two sectors");
    for range in [0..0, 0..2048, 0..4095, 1024..5120, 0..6144, 8192..12_288, Range { start: 4096, end: 0 }] {
        assert_eq!(make(range.clone()), Err(SlotError::Range), "{range:?}");
    }
    let small = u32::try_from(SLOT).unwrap();
    assert_eq!(Slots::new(Flash::<1, 256>::new(8192), 0..small * 2 - 512).map(drop), Err(SlotError::Range));
    assert_eq!(Slots::new(Flash::<64, 4096>::new(8192), 0..8192).map(drop), Err(SlotError::Range), "units of 64 bytes");
}

#[test]
fn a_worn_flash_is_reported_and_the_earlier_settings_remain() {
    /// A flash that ignores writes.
    #[derive(Debug)]
    struct Worn(Small, bool);
    use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
    impl ErrorType for Worn {
        type Error = FlashError;
    }
    impl ReadNorFlash for Worn {
        const READ_SIZE: usize = Small::READ_SIZE;
        fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
            self.0.read(offset, bytes)
        }
        fn capacity(&self) -> usize {
            self.0.capacity()
        }
    }
    impl NorFlash for Worn {
        const WRITE_SIZE: usize = Small::WRITE_SIZE;
        const ERASE_SIZE: usize = Small::ERASE_SIZE;
        fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
            self.0.erase(from, to)
        }
        fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
            if self.1 { Ok(()) } else { self.0.write(offset, bytes) }
        }
    }
    let range = 0..4096;
    let mut slots = Slots::new(Worn(Small::new(4096), false), range.clone()).unwrap();
    slots.write(b"echo=7\n").unwrap();
    let Worn(flash, _) = slots.release();
    let mut slots = Slots::new(Worn(flash, true), range).unwrap();
    assert_eq!(slots.write(b"echo=8\n"), Err(SlotError::NotWritten));
    assert_eq!(slots.read(&mut [0; TEXT]), Ok(Some(&b"echo=7\n"[..])));
}

/// Repeats `work`, each time with a later power cut; `check` gets the settings after the restart, and the flash.
fn cut_everywhere<const WRITE: usize, const ERASE: usize>(
    flash: &Flash<WRITE, ERASE>,
    work: impl Fn(&mut Slots<Flash<WRITE, ERASE>>) -> Result<(), SlotError<FlashError>>,
    mut check: impl FnMut(Option<Vec<u8>>, Flash<WRITE, ERASE>),
) -> usize {
    let mut cuts = 0;
    for cut in (1..).step_by(stride()) {
        let mut slots = slots(flash.clone().with_cut_at(Some(cut)));
        let result = work(&mut slots);
        let flash = slots.release().with_cut_at(None);
        if result.is_ok() {
            break;
        }
        cuts += 1;
        assert_eq!(result, Err(SlotError::Flash(FlashError::PowerCut)));
        let mut slots = self::slots(flash);
        check(text(&mut slots), slots.release());
    }
    cuts
}

/// Cuts the power during every change: of a new flash, of one and of two earlier settings, and of their removal.
fn power_cuts<const WRITE: usize, const ERASE: usize>(len: usize) -> usize {
    let [old, new, next] = [('o', 100), ('n', len), ('x', 50)].map(|(letter, len)| settings(letter, len));
    let mut cuts = 0;
    let mut flash = self::new::<WRITE, ERASE>();
    let mut before = None;
    for text_before in [None, Some(&old), Some(&next)] {
        if let Some(text) = text_before {
            let mut slots = slots(flash);
            slots.write(text).unwrap();
            flash = slots.release();
            before = Some(text.clone());
        }
        cuts += cut_everywhere(
            &flash,
            |slots| slots.write(&new),
            |found, flash| {
                assert!(found == before || found.as_ref() == Some(&new), "neither the old nor the new settings");
                // the next change works, whatever the cut has left
                let mut slots = slots(flash);
                slots.write(&next).unwrap();
                assert_eq!(text(&mut slots).as_ref(), Some(&next));
            },
        );
        cuts += cut_everywhere(&flash, Slots::clear, |found, _| {
            assert!(found == before || found.is_none(), "older settings are back");
        });
    }
    cuts
}

#[test]
fn a_power_cut_leaves_the_old_settings_or_the_new_ones() {
    let cuts = [power_cuts::<1, 4096>(90), power_cuts::<4, 2048>(300), power_cuts::<32, 2048>(TEXT / 2)];
    // not `println`, which the tests of cargo show of failures only
    let _ = writeln!(io::stderr(), "settings in flash: {} power cuts, all recovered", cuts.iter().sum::<usize>());
    assert!(cuts.iter().all(|cuts| *cuts > 15_000 / stride()), "{cuts:?}");
}

#[test]
fn a_second_power_cut_during_the_repair_loses_nothing() {
    let [old, new] = [settings('o', 40), settings('n', 60)];
    let mut first = slots::<4, 2048>(self::new());
    first.write(&old).unwrap();
    let flash = first.release();
    let mut cuts = 0;
    let (mut number, old) = (0_u32, Some(old));
    cut_everywhere(
        &flash,
        |slots| slots.write(&new),
        |_, flash| {
            number += 1;
            // some cuts are followed by cuts everywhere
            if number % 200 == 0 {
                cuts += cut_everywhere(
                    &flash,
                    |slots| slots.write(&new),
                    |found, _| {
                        assert!(found == old || found.as_ref() == Some(&new));
                    },
                );
            }
        },
    );
    let _ = writeln!(io::stderr(), "settings in flash: {cuts} second power cuts, all recovered");
    assert!(cuts > 20_000 / stride() / stride(), "{cuts}");
}
