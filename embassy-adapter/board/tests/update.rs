//! Tests updates with the boot loader of embassy-boot, with the power cut at bytes that are written or erased.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::io::{self, Write as _};

use bcap_board::crc::Crc32;
use bcap_board::identity::{BLOCK, Identity};
use bcap_board::signature::{Manifest, public_of};
use bcap_board::slots::{Slots, TEXT};
use bcap_board::update::{Partitions, Phase, StateFlash, UpdateError, Updater, check_pending};
use bcap_testkit::flash::{Flash, FlashError};
use embassy_boot::{BootLoader, BootLoaderConfig};
use embassy_embedded_hal::flash::partition::BlockingPartition;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_storage::nor_flash::NorFlash;

use crate::stride;

static OLD: Identity = Identity::new("test-board", "0.1.0");
static NEW: Identity = Identity::new("test-board", "0.2.0");
/// The initial stack pointer 0x20042000 and the reset vector 0x100101b5.
const VECTORS: &[u8] = b"\x00\x20\x04\x20\xb5\x01\x01\x10";
const SETTINGS: &[u8] = b"put=I/0-99\n";
/// The sizes of an image partition and of the settings partition.
const IMAGE: u32 = 1024;
const SLOTS: u32 = 4096;

/// The secret key of a board that takes signed images only.
const SECRET: [u8; 32] = [7; 32];

type Result<T> = std::result::Result<T, UpdateError<FlashError>>;

/// The boot loader would be at the start.
fn partitions(sector: u32) -> Partitions {
    let active = sector..sector + IMAGE;
    let other = active.end..active.end + IMAGE + sector;
    let state = other.end..other.end + 2 * sector;
    let history = state.end.next_multiple_of(4096)..state.end.next_multiple_of(4096) + SLOTS;
    // after the settings
    let signature = history.end + SLOTS..history.end + SLOTS + sector;
    Partitions { active, other, state, history, signature }
}

/// An image of `len` bytes.
fn image(identity: &Identity, len: usize) -> Vec<u8> {
    let version = identity.version().as_bytes();
    let code = (0..len).map(|at| version[at % version.len()].wrapping_mul(u8::try_from(at % 251).unwrap()));
    let mut image: Vec<u8> = code.collect();
    image[..8].copy_from_slice(VECTORS);
    image[100..164].copy_from_slice(identity.as_bytes());
    image
}

/// A board: everything that a power cut leaves is in its flash.
#[derive(Clone)]
struct Board<const WRITE: usize, const ERASE: usize> {
    flash: Flash<WRITE, ERASE>,
    /// The cause of the last reset, set by the test.
    last_reset: &'static str,
    /// The secret key of the only images that the board takes, if it has a key.
    secret: Option<[u8; 32]>,
}

impl<const WRITE: usize, const ERASE: usize> Board<WRITE, ERASE> {
    /// Creates a board with the old image and settings.
    fn new() -> Self {
        let partitions = partitions(u32::try_from(ERASE).unwrap());
        let mut flash = Flash::new(usize::try_from(partitions.signature.end).unwrap());
        {
            flash.erase(partitions.active.start, partitions.active.end).unwrap();
            flash.write(partitions.active.start, &image(&OLD, 700)).unwrap();
        }
        let flash = flash.with_erased_at_once(ERASE / 8);
        let mut slots = Slots::new(flash, partitions.history.end..partitions.history.end + SLOTS).unwrap();
        slots.write(SETTINGS).unwrap();
        Self { flash: slots.release(), last_reset: "power-on", secret: None }
    }

    fn partitions() -> Partitions {
        partitions(u32::try_from(ERASE).unwrap())
    }

    /// Runs the boot loader.
    fn boot(&mut self) -> std::result::Result<(), embassy_boot::BootError> {
        if let Some(secret) = &self.secret {
            check_pending(&mut self.flash, &Self::partitions(), "test-board", &public_of(secret))
                .map_err(|_| embassy_boot::BootError::BadMagic)?;
        }
        let Partitions { active, other, state, .. } = Self::partitions();
        let flash = Mutex::<NoopRawMutex, _>::new(RefCell::new(&mut self.flash));
        let part = |range: &std::ops::Range<u32>| BlockingPartition::new(&flash, range.start, range.end - range.start);
        let whole = BlockingPartition::new(&flash, 0, Self::partitions().history.end);
        let state = StateFlash::new(whole, state).map_err(|_| embassy_boot::BootError::BadMagic)?;
        let config = BootLoaderConfig { active: part(&active), dfu: part(&other), state };
        BootLoader::new(config).prepare_boot(&mut [0; 64]).map(drop)
    }

    /// Returns the image that the boot loader would start; fails if it is not complete.
    fn identity(&self) -> &'static Identity {
        let active = Self::partitions().active;
        let active = &self.flash.bytes()[usize::try_from(active.start).unwrap()..usize::try_from(active.end).unwrap()];
        let found = [(&OLD, 700), (&NEW, 1000)].into_iter().find(|(id, len)| active.starts_with(&image(id, *len)));
        found.expect("the active partition has no complete image").0
    }

    /// Starts the image in the active partition.
    fn start(&mut self) -> Result<Updater> {
        let identity = self.identity();
        let updater = Updater::start(&mut self.flash, Self::partitions(), identity, &self.last_reset)?;
        Ok(updater.with_key(self.secret.as_ref().map(public_of)))
    }

    /// Receives an image and installs it.
    fn install(&mut self, updater: &mut Updater, identity: &Identity, len: usize) -> Result<()> {
        let image = image(identity, len);
        let crc = Crc32::new().and(&image).value();
        updater.begin("test-board", identity.version(), u32::try_from(len).unwrap(), crc, true)?;
        if let Some(secret) = &self.secret {
            let manifest = Manifest::of(&image, identity).unwrap();
            updater.sign(&manifest.digest, &manifest.sign(secret))?;
        }
        for (number, data) in (0..).zip(image.chunks(BLOCK)) {
            updater.block(&mut self.flash, number, block_crc(number, data), data)?;
        }
        updater.install(&mut self.flash)
    }

    fn status(&mut self) -> String {
        let updater = self.start().unwrap();
        updater.status(&mut self.flash).unwrap().to_string()
    }

    fn settings(&mut self) -> Option<Vec<u8>> {
        let start = Self::partitions().history.end;
        let mut slots = Slots::new(&mut self.flash, start..start + SLOTS).unwrap();
        slots.read(&mut [0; TEXT]).unwrap().map(<[u8]>::to_vec)
    }
}

fn block_crc(number: u32, data: &[u8]) -> u32 {
    Crc32::new().and(&number.to_le_bytes()).and(data).value()
}

/// Installs the new image, and restarts into it. Returns `None` when the power was cut.
fn into_trial<const W: usize, const E: usize>(board: &mut Board<W, E>) -> Option<Updater> {
    let mut updater = board.start().ok()?;
    board.install(&mut updater, &NEW, 1000).ok()?;
    board.boot().ok()?;
    board.start().ok()
}

/// An update that is confirmed, and a further start.
fn confirmed<const W: usize, const E: usize>(board: &mut Board<W, E>) -> Option<()> {
    let mut updater = into_trial(board)?;
    updater.confirm(&mut board.flash).ok()?;
    board.boot().ok()?;
    board.start().ok().map(drop)
}

/// An update that is reset on trial, which rolls it back, and a further start.
fn rolled_back<const W: usize, const E: usize>(board: &mut Board<W, E>) -> Option<()> {
    into_trial(board)?;
    board.last_reset = "the watchdog";
    board.boot().ok()?;
    board.start().ok().map(drop)
}

/// Switches the board on until a boot is not cut; then checks it, and repeats the update.
fn recover<const W: usize, const E: usize>(board: &mut Board<W, E>) {
    board.last_reset = "power-on";
    board.boot().unwrap();
    let mut updater = board.start().unwrap();
    assert_eq!(board.settings().as_deref(), Some(SETTINGS), "the settings");
    updater.confirm(&mut board.flash).unwrap();
    let next = if board.identity() == &OLD { (&NEW, 1000) } else { (&OLD, 700) };
    board.install(&mut updater, next.0, next.1).unwrap();
    board.boot().unwrap();
    assert_eq!(board.identity(), next.0, "a repeated update");
    board.start().unwrap().confirm(&mut board.flash).unwrap();
    board.boot().unwrap();
    assert_eq!(board.identity(), next.0, "a repeated update, confirmed");
}

/// Runs `work` with the power cut at each step in turn, and calls `check` with the flash after it.
fn cut_everywhere<const W: usize, const E: usize>(
    board: &Board<W, E>,
    work: impl Fn(&mut Board<W, E>) -> Option<()>,
    mut check: impl FnMut(Board<W, E>),
) -> usize {
    let mut cuts = 0;
    for cut in (1..).step_by(stride()) {
        let mut board = board.clone();
        board.flash = board.flash.with_cut_at(Some(cut));
        let done = work(&mut board);
        board.flash = board.flash.with_cut_at(None);
        if done.is_some() {
            break;
        }
        cuts += 1;
        check(board);
    }
    cuts
}

fn power_cuts<const W: usize, const E: usize>(noise: u32, secret: Option<[u8; 32]>) -> usize {
    let mut board = Board::<W, E>::new();
    board.secret = secret;
    board.flash = board.flash.with_noise(noise);
    let mut cuts = cut_everywhere(&board, confirmed, |mut board| recover(&mut board));
    let (mut number, mut second) = (0_u32, 0);
    cuts += cut_everywhere(&board, rolled_back, |mut board| {
        number += 1;
        // some cuts are followed by cuts everywhere in the next start
        if number % 1500 == 0 {
            second += cut_everywhere(&board, |board| board.boot().ok(), |mut board| recover(&mut board));
        }
        recover(&mut board);
    });
    // the banks of the state and the slots of the history are then used the other way round
    confirmed(&mut board).unwrap();
    cuts += cut_everywhere(&board, rolled_back_again, |mut board| recover(&mut board));
    cuts + second
}

/// An update to the old image, which is rolled back.
fn rolled_back_again<const W: usize, const E: usize>(board: &mut Board<W, E>) -> Option<()> {
    let mut updater = board.start().ok()?;
    board.install(&mut updater, &OLD, 700).ok()?;
    board.boot().ok()?;
    board.start().ok()?;
    board.boot().ok()?;
    board.start().ok().map(drop)
}

#[test]
fn a_power_cut_leaves_a_complete_image_and_the_settings() {
    let cuts = [power_cuts::<1, 256>(0, None), power_cuts::<4, 512>(1, Some(SECRET))];
    // not `println`, which the tests of cargo show of failures only
    let _ = writeln!(
        io::stderr(),
        "updates: {} power cuts, {} of them with signed images, all recovered",
        cuts[0] + cuts[1],
        cuts[1]
    );
    assert!(cuts.iter().all(|cuts| *cuts > 10_000 / stride()), "{cuts:?}");
}

#[test]
fn an_update_is_confirmed() {
    let mut board = Board::<1, 256>::new();
    board.boot().unwrap();
    assert_eq!(board.status(), "test-board 0.1.0 confirmed");
    let mut updater = board.start().unwrap();
    board.install(&mut updater, &NEW, 1000).unwrap();
    let status = updater.status(&mut board.flash).unwrap().to_string();
    assert_eq!(status, "test-board 0.1.0 runs; a restart swaps in 0.2.0");
    assert_eq!(updater.begin::<()>("test-board", "0.2.0", 9, 0, false), Err(UpdateError::Busy));
    // no update was on trial, so nothing is confirmed
    updater.confirm(&mut board.flash).unwrap();
    board.boot().unwrap();
    assert_eq!(board.status(), "test-board 0.2.0 on trial");
    let mut updater = board.start().unwrap();
    assert_eq!(updater.begin::<()>("test-board", "0.2.0", 9, 0, false), Err(UpdateError::Busy));
    updater.confirm(&mut board.flash).unwrap();
    for _ in 0..3 {
        board.boot().unwrap();
        assert_eq!(board.status(), "test-board 0.2.0 confirmed");
    }
}

#[test]
fn an_update_that_is_reset_on_trial_is_rolled_back_and_the_reason_is_kept() {
    let mut board = Board::<4, 512>::new();
    rolled_back(&mut board).unwrap();
    for _ in 0..3 {
        board.last_reset = "something else";
        assert_eq!(board.status(), "test-board 0.1.0 confirmed; 0.2.0 was rolled back: the watchdog");
        let status = board.start().unwrap().status(&mut board.flash).unwrap();
        assert_eq!((status.identity(), status.phase), (&OLD, Phase::RolledBack));
        assert_eq!(status.last_update(), ("0.2.0", "the watchdog"));
        board.boot().unwrap();
    }
    confirmed(&mut board).unwrap();
    assert_eq!(board.status(), "test-board 0.2.0 confirmed");
}

#[test]
fn an_image_that_does_not_fit_is_refused_before_anything_is_erased() {
    let mut board = Board::<1, 256>::new();
    let mut updater = board.start().unwrap();
    let before = board.flash.done();
    let refused = updater.begin::<()>("other-board", "0.2.0", 9, 0, false);
    assert_eq!(
        refused.clone().map_err(|error| error.to_string()).unwrap_err(),
        "the image is for another board: this is a test-board"
    );
    assert_eq!(updater.begin::<()>("test-board", "0.2.0", IMAGE + 1, 0, false), Err(UpdateError::Size { most: IMAGE }));
    assert_eq!(updater.begin::<()>("test-board", "0.2.0", 0, 0, false), Err(UpdateError::Size { most: IMAGE }));
    assert_eq!(updater.block(&mut board.flash, 0, 0, &[]), Err(UpdateError::NotBegun));
    assert_eq!(updater.install(&mut board.flash), Err(UpdateError::NotBegun));
    updater.begin::<()>("test-board", "0.2.0", IMAGE, 0, false).unwrap();
    assert_eq!(board.flash.done(), before, "bytes written or erased");
}

#[test]
fn damaged_lost_and_repeated_blocks_leave_the_image_complete() {
    let mut board = Board::<1, 256>::new();
    let mut updater = board.start().unwrap();
    let image = image(&NEW, 1000);
    let crc = Crc32::new().and(&image).value();
    updater.begin::<()>("test-board", "0.2.0", 1000, crc, false).unwrap();
    for (number, data) in (0..).zip(image.chunks(BLOCK)) {
        let good = block_crc(number, data);
        let flash = &mut board.flash;
        assert_eq!(updater.install(flash), Err(UpdateError::Incomplete { expected: number }));
        assert_eq!(updater.block(flash, number, good ^ 1, data), Err(UpdateError::Damaged));
        assert_eq!(updater.block(flash, number, good, &data[1..]), Err(UpdateError::Damaged));
        if let Some(next) = image.chunks(BLOCK).nth(usize::try_from(number).unwrap() + 1) {
            let lost = updater.block(flash, number + 1, block_crc(number + 1, next), next);
            assert_eq!(lost, Err(UpdateError::Sequence { expected: number }));
        }
        for _ in 0..2 {
            updater.block(flash, number, good, data).unwrap();
        }
    }
    updater.install(&mut board.flash).unwrap();
    board.boot().unwrap();
    assert_eq!(board.identity(), &NEW);
}

#[test]
fn an_image_with_another_crc_is_not_installed() {
    let mut board = Board::<1, 256>::new();
    let mut updater = board.start().unwrap();
    updater.begin::<()>("test-board", "0.2.0", 3, 7, false).unwrap();
    updater.block(&mut board.flash, 0, block_crc(0, b"abc"), b"abc").unwrap();
    assert_eq!(updater.install(&mut board.flash), Err(UpdateError::Crc));
    board.boot().unwrap();
    assert_eq!(board.status(), "test-board 0.1.0 confirmed");
}

#[test]
fn an_image_without_a_vector_table_is_not_installed() {
    let mut board = Board::<1, 256>::new();
    let mut updater = board.start().unwrap();
    for start in [&b"UF2\nWQ]\x9e"[..], b"\x00\x20\x04\x20\xb4\x01\x01\x10", b"\x00\x20\x04"] {
        let crc = Crc32::new().and(start).value();
        updater.begin::<()>("test-board", "0.2.0", u32::try_from(start.len()).unwrap(), crc, false).unwrap();
        updater.block(&mut board.flash, 0, block_crc(0, start), start).unwrap();
        assert_eq!(updater.install(&mut board.flash), Err(UpdateError::NoVectors), "{start:?}");
    }
    board.boot().unwrap();
    assert_eq!(board.status(), "test-board 0.1.0 confirmed");
}

#[test]
fn a_power_cut_in_the_update_after_a_roll_back_keeps_its_reason() {
    let mut board = Board::<1, 256>::new();
    rolled_back(&mut board).unwrap();
    let install = |board: &mut Board<1, 256>| {
        let mut updater = board.start().ok()?;
        board.install(&mut updater, &OLD, 700).ok()
    };
    let mut found = BTreeSet::new();
    let cuts = cut_everywhere(&board, install, |mut board| {
        board.last_reset = "power-on";
        board.boot().unwrap();
        found.insert(board.status());
    });
    let expected = ["test-board 0.1.0 confirmed; 0.2.0 was rolled back: the watchdog", "test-board 0.1.0 on trial"];
    assert!(found.iter().eq(expected) && cuts >= 900 / stride(), "{cuts}: {found:?}");
}

#[test]
fn a_second_roll_back_has_its_own_reason() {
    let mut board = Board::<4, 512>::new();
    rolled_back(&mut board).unwrap();
    assert_eq!(board.status(), "test-board 0.1.0 confirmed; 0.2.0 was rolled back: the watchdog");
    let mut updater = into_trial(&mut board).unwrap();
    assert_eq!(updater.status(&mut board.flash).unwrap().to_string(), "test-board 0.2.0 on trial");
    // a block that is received on trial would overwrite the earlier image
    assert_eq!(updater.begin::<()>("test-board", "0.3.0", 9, 0, false), Err(UpdateError::Busy));
    board.last_reset = "a panic";
    board.boot().unwrap();
    for _ in 0..2 {
        assert_eq!(board.status(), "test-board 0.1.0 confirmed; 0.2.0 was rolled back: a panic");
        board.last_reset = "power-on";
        board.boot().unwrap();
    }
}

/// A board with a key, and its updater.
fn signed_board() -> (Board<1, 256>, Updater) {
    let mut board = Board::<1, 256>::new();
    board.secret = Some(SECRET);
    let updater = board.start().unwrap();
    (board, updater)
}

/// Sends an image in an update that says this about it, and installs it.
fn send(board: &mut Board<1, 256>, updater: &mut Updater, sent: &Sent<'_>) -> Result<()> {
    let Sent { board: name, version, image, manifest, secret } = *sent;
    let crc = Crc32::new().and(image).value();
    updater.begin(name, version, u32::try_from(image.len()).unwrap(), crc, false)?;
    if let Some(secret) = secret {
        updater.sign(&manifest.digest, &manifest.sign(&secret))?;
    }
    for (number, data) in (0..).zip(image.chunks(BLOCK)) {
        updater.block(&mut board.flash, number, block_crc(number, data), data)?;
    }
    updater.install(&mut board.flash)
}

/// An update as a host sends it.
#[derive(Clone, Copy)]
struct Sent<'a> {
    board: &'a str,
    version: &'a str,
    image: &'a [u8],
    manifest: Manifest<'a>,
    secret: Option<[u8; 32]>,
}

#[test]
fn a_board_with_a_key_refuses_every_image_but_the_signed_one() {
    let new = image(&NEW, 1000);
    let manifest = Manifest::of(&new, &NEW).unwrap();
    let good = Sent { board: "test-board", version: "0.2.0", image: &new, manifest, secret: Some(SECRET) };
    let (mut flipped, mut vectors) = (new.clone(), new.clone());
    flipped[500] ^= 1;
    vectors[4] ^= 1;
    let (long, cut) = (vec![0x55; 1025], &new[..999]);
    let no_vectors = Manifest::of(&vectors, &NEW).unwrap();
    let older = Manifest { version: "0.0.9", ..manifest };
    let signature = Err(UpdateError::Signature);
    let refusals: [(&str, Sent<'_>, Result<()>); 13] = [
        ("no signature", Sent { secret: None, ..good }, Err(UpdateError::Unsigned)),
        ("another key", Sent { secret: Some([8; 32]), ..good }, signature.clone()),
        ("a flipped bit", Sent { image: &flipped, ..good }, signature.clone()),
        (
            "signed for another board",
            Sent { manifest: Manifest { board: "other", ..manifest }, ..good },
            signature.clone(),
        ),
        ("for another board", Sent { board: "other", ..good }, Err(UpdateError::OtherBoard { board: "test-board" })),
        (
            "an older version",
            Sent { version: "0.0.9", manifest: older, ..good },
            Err(UpdateError::Older { running: "0.1.0" }),
        ),
        ("an older version under a newer name", Sent { manifest: older, ..good }, signature.clone()),
        ("another version", Sent { version: "0.3.0", ..good }, signature.clone()),
        ("a version without numbers", Sent { version: "new", ..good }, Err(UpdateError::Older { running: "0.1.0" })),
        ("cut", Sent { image: cut, ..good }, signature.clone()),
        ("too long", Sent { image: &long, ..good }, Err(UpdateError::Size { most: IMAGE })),
        ("empty", Sent { image: &[], ..good }, Err(UpdateError::Size { most: IMAGE })),
        ("no vectors", Sent { image: &vectors, manifest: no_vectors, ..good }, Err(UpdateError::NoVectors)),
    ];
    let (mut board, mut updater) = signed_board();
    for (what, sent, refusal) in refusals {
        assert_eq!(send(&mut board, &mut updater, &sent), refusal, "{what}");
        assert_eq!(updater.phase(), Phase::Confirmed, "{what}");
        board.boot().unwrap();
        assert_eq!(board.status(), "test-board 0.1.0 confirmed", "{what}");
    }
    // before its signature is checked nothing is erased, and a signature belongs to one update
    let before = board.flash.done();
    updater.begin::<()>("test-board", "0.2.0", 1000, 0, false).unwrap();
    assert_eq!(
        updater.block(&mut board.flash, 0, block_crc(0, &new[..BLOCK]), &new[..BLOCK]),
        Err(UpdateError::Unsigned)
    );
    assert_eq!(board.flash.done(), before, "bytes written or erased");
    send(&mut board, &mut updater, &good).unwrap();
    board.boot().unwrap();
    assert_eq!(board.status(), "test-board 0.2.0 on trial");
}

#[test]
fn an_older_image_is_taken_when_told() {
    let (mut board, mut updater) = signed_board();
    let old = image(&OLD, 700);
    let manifest = Manifest { version: "0.0.9", ..Manifest::of(&old, &OLD).unwrap() };
    updater.begin::<()>("test-board", "0.0.9", 700, Crc32::new().and(&old).value(), true).unwrap();
    updater.sign::<()>(&manifest.digest, &manifest.sign(&SECRET)).unwrap();
    for (number, data) in (0..).zip(old.chunks(BLOCK)) {
        updater.block(&mut board.flash, number, block_crc(number, data), data).unwrap();
    }
    updater.install(&mut board.flash).unwrap();
    let mut unsigned = Board::<1, 256>::new();
    let mut updater = unsigned.start().unwrap();
    updater.begin::<()>("test-board", "0.0.9", 700, 0, false).unwrap();
    assert_eq!(updater.sign::<()>(&manifest.digest, &manifest.sign(&SECRET)), Err(UpdateError::NoKey));
    unsigned.install(&mut updater, &NEW, 1000).unwrap();
}

#[test]
fn the_boot_loader_gives_up_an_image_that_is_not_the_signed_one() {
    let parts = Board::<1, 256>::partitions();
    // a byte of the vectors and one at the end of the image, the key in the boot loader, the record of the signature
    for (what, at) in [
        ("a byte of the vectors", Some(parts.other.start + 1)),
        ("a byte at the end", Some(parts.other.start + 998)),
        ("the record", Some(parts.signature.start + 40)),
        ("the key", None),
    ] {
        let (mut board, mut updater) = signed_board();
        board.install(&mut updater, &NEW, 1000).unwrap();
        match at {
            // clears bits, as flash does
            Some(at) => NorFlash::write(&mut board.flash, at, &[0]).unwrap(),
            None => board.secret = Some([8; 32]),
        }
        for _ in 0..2 {
            board.boot().unwrap();
            let why = "test-board 0.1.0 confirmed; 0.2.0 was rolled back: the boot loader found no valid signature";
            assert_eq!(board.status(), why, "{what}");
        }
        // and accepts the next update
        board.secret = Some(SECRET);
        into_trial(&mut board).unwrap();
        assert_eq!(board.identity(), &NEW, "{what}");
    }
}
