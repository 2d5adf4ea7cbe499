//! Updates of the gateway board in QEMU, with the boot loader and a flash whose power is cut in the middle of its operations.
//!
//! ```text
//!  A runs ─► download ─► install │ restart: the boot loader swaps A and B ─► B on trial ─► a request: confirmed
//!                                                                            └─► any reset: swaps back, A says why
//! ```
//!
//! A and B are the same image with different versions. A cut happens in an erase of a sector or in a write of a page. By
//! default the power is cut in a sample of these operations; `UPDATE_CUTS=500` makes the sample of the swap and the roll-back
//! that large. `UPDATE_CUTS=all` cuts it in each one of a swap, a confirmation and a roll-back, and of the download and
//! installation of a short image; of the download of the whole image in each seventeenth, about two in each sector. The images
//! are signed. `UPDATE_SEED` is the seed of the samples and of the moments at which QEMU is killed, 1.

// the sizes and the words of the flash, which the image also uses
#[allow(dead_code, reason = "the images use the rest")]
#[path = "../../../../embassy-adapter/firmware/src/flash/layout.rs"]
mod layout;
mod rig;

use std::io::{self, Write};
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use bcap_board::identity::{self, BLOCK, Identity};
use bcap_board::image;
use bcap_qemu::{Plc, bcap, run};
use fastrand::Rng;
use serialport::{SerialPort, TTYPort};

use self::layout::control;
use self::rig::{Contents, Cut, Rig, flatten, replace_received, wait};
use crate::line;

const A: &str = "0.1.0 confirmed";
const B: &str = "0.2.0 confirmed";
const B_ON_TRIAL: &str = "0.2.0 on trial";

/// Typical and longest times of the flash W25Q16JV, in milliseconds: the erase of a sector, the write of a page.
const ERASE: [f64; 2] = [45.0, 400.0];
const WRITE: [f64; 2] = [0.4, 3.0];

#[test]
fn bcap_updates_a_board_and_a_served_request_confirms_it() {
    let bcap = bcap();
    let (line, host) = TTYPort::pair().unwrap();
    let rig = Rig::new(&bcap);
    let new = rig.file("new.elf", &rig.version("0.2.0"));
    let device = host.name().unwrap();
    let board_command = |words: &[&str]| {
        let done = run(&bcap, &[&["board"], words, &["--timeout", "20000"]].concat());
        assert!(done.ok, "{done:?}");
        done.out
    };
    let mut board = rig.start();
    line::join(line, board.connect());
    assert!(board_command(&["status", &device]).ends_with(" 0.1.0 confirmed\n"));
    board.serve();
    // both images have settings
    let out = board_command(&["update", "--force", &device, new.to_str().unwrap(), "--key", &rig.key()]);
    assert!(out.contains(" 0.2.0: ") && out.ends_with(" bytes received and checked\n"), "{out}");
    // only a request confirms it; the gateway checks for one each second
    sleep(Duration::from_secs(2));
    assert!(board_command(&["status", &device]).ends_with(" 0.2.0 on trial\n"));
    board.serve();
    wait("the update is not confirmed", || {
        board_command(&["status", &device]).ends_with(" 0.2.0 confirmed\n").then_some(())
    });
    drop(board);
    // a confirmed image stays
    let mut board = rig.start();
    assert_eq!(board.status(), B);
    board.serve();
    check_model(&rig);
}

#[test]
fn bcap_updates_a_board_over_the_network() {
    let bcap = bcap();
    let (line, host) = TTYPort::pair().unwrap();
    let rig = Rig::new(&bcap);
    let (new, old) = (rig.file("new.elf", &rig.version("0.2.0")), rig.file("old.elf", &rig.version("0.0.9")));
    let (device, key) = (host.name().unwrap(), rig.key());
    let command = |words: &[&str]| run(&bcap, &[&["board"], words, &["--timeout", "20000"]].concat());
    let update = |image: &Path, key: &str| command(&["update", &rig.network, image.to_str().unwrap(), "--key", key]);
    let refused = |image: &Path, key: &str, why: &str| {
        let done = update(image, key);
        assert!(!done.ok && done.err.contains(why), "{why}: {done:?}");
    };
    let mut board = rig.start();
    line::join(line, board.connect());
    board.serve();
    // without the setting the port is closed, and then only for other hosts than this one
    let closed = "the board takes updates over the network if its image has a key";
    refused(&new, &key, closed);
    let settings = command(&["configure", &device]).out;
    let configure = |allowed: &str| {
        let lines: Vec<&str> = settings.lines().chain([allowed]).collect();
        let done = command(&[&["configure", &device], &lines[..], &["--restart"]].concat());
        assert!(done.ok, "{done:?}");
        wait("the board is not up again", || rig_answers(&rig));
    };
    configure("update=10.0.2.99");
    refused(&new, &key, closed);
    configure("update=10.0.2.0/24");
    let other_key = rig.file("other.key", "08".repeat(32).as_bytes());
    refused(&new, other_key.to_str().unwrap(), "the signature is not by the key of this board");
    refused(&old, &key, "the image is older than 0.1.0, which runs");
    let done = update(&new, &key);
    assert!(
        done.ok && done.out.contains(" 0.2.0: ") && done.out.ends_with(" bytes received and checked\n"),
        "{done:?}"
    );
    // the status is queried over both links; the console of `board` belongs to the serial line
    let until = |port: &str, expected: &str| {
        wait("the status does not change", || command(&["status", port]).out.ends_with(expected).then_some(()));
    };
    until(&device, " 0.2.0 on trial\n");
    board.serve();
    until(&rig.network, " 0.2.0 confirmed\n");
    check_model(&rig);
}

/// Returns whether the board answers a request over the network.
fn rig_answers(rig: &Rig) -> Option<()> {
    let mut plc = Plc::try_connect(&rig.rac, Duration::from_millis(300)).ok()?;
    plc.try_ask("GET:RC8:1:I:\r").ok().map(drop)
}

#[test]
fn the_boot_loader_refuses_an_image_that_is_not_the_signed_one() {
    let rig = Rig::new(&bcap());
    let image = flatten(&rig.version("0.2.0"));
    let mut flash = installed(&rig, &rig.contents(), &image);
    // a flipped bit in the middle of the received image
    flash[layout::OTHER.start as usize + image.len() / 2] ^= 1;
    rig.restore(&flash);
    let mut board = rig.start();
    assert_eq!(board.status(), "0.1.0 confirmed; 0.2.0 was rolled back: the boot loader found no valid signature");
    board.serve();
    repeat(&mut board, &image);
}

#[test]
fn an_image_that_serves_nothing_is_rolled_back_and_the_status_tells_why() {
    let bcap = bcap();
    let rig = Rig::new(&bcap);
    let good = rig.version("0.2.0");
    let installed = installed(&rig, &rig.contents(), &flatten(&good));
    let rolled_back = |elf: &[u8], end: &dyn Fn(&mut rig::Board<'_>), why: &str| {
        // one download for all of them: the boot loader takes the image that is there
        let mut flash = installed.clone();
        replace_received(&mut flash, &flatten(elf));
        rig.restore(&flash);
        let mut board = rig.start();
        end(&mut board);
        let status = wait("the update is not rolled back", || {
            // without frames the Ethernet controller would count as dead
            let _ = board.answer();
            Some(board.status()).filter(|status| status != B_ON_TRIAL)
        });
        let reason =
            status.strip_prefix("0.1.0 confirmed; 0.2.0 was rolled back: ").unwrap_or_else(|| panic!("{status}"));
        assert!(reason.contains(why), "{reason}");
        board.serve();
        say(&format!("update: rolled back: {reason}"));
    };
    let panic_on_trial = |board: &mut rig::Board<'_>| {
        board.until(B_ON_TRIAL);
        board.key(b'p');
    };
    rolled_back(&good, &panic_on_trial, "panic at ..");
    rolled_back(&rig::hanging(&good), &|_| (), "watchdog");
    // no robot: the gateway answers each request with an error, which does not confirm the image
    let mut alone = good.clone();
    let robot = format!("robot=tcp:10.0.2.2:{}", rig.sim.bcap.rsplit(':').next().unwrap());
    let settings = String::from_utf8(image::text(&good).unwrap().to_vec()).unwrap();
    assert!(settings.contains(&robot), "{settings}");
    image::write(&mut alone, settings.replace(&robot, "robot=tcp:10.0.2.2:9").as_bytes()).unwrap();
    let without_a_robot = |board: &mut rig::Board<'_>| {
        board.until(B_ON_TRIAL);
        let answer = wait("no answer", || board.answer());
        assert!(answer.starts_with('-'), "{answer}");
    };
    rolled_back(&alone, &without_a_robot, "the update served no request in time");
    assert_eq!(rig.word(control::REFUSED), 0, "writes to flash that was not erased");
}

#[test]
fn a_board_starts_again_after_a_power_cut_in_any_operation_of_the_flash() {
    let bcap = bcap();
    let rig = Rig::new(&bcap);
    let (mut rng, original, since) = (random(), rig.contents(), Instant::now());
    let image = flatten(&rig.version("0.2.0"));
    let installed = installed(&rig, &original, &image);
    let (swap, on_trial) = cut_swap(&rig, &mut rng, &installed, &image);
    let roll_back = cut_roll_back(&rig, &mut rng, &on_trial, &image);
    let download = cut_download(&rig, &mut rng, &original, &image);
    say(&format!(
        "update: {} power cuts ({download} in the download, {swap} in the swap and the confirmation, {roll_back} in the roll-back), \
         all recovered, {} s",
        download + swap + roll_back,
        since.elapsed().as_secs()
    ));
}

#[test]
fn a_board_whose_power_fails_during_a_swap_finishes_it() {
    let bcap = bcap();
    let rig = Rig::new(&bcap);
    let installed = installed(&rig, &rig.contents(), &flatten(&rig.version("0.2.0")));
    let (mut rng, mut kills, mut rounds) = (random(), 0, 0);
    while kills < 10 {
        rounds += 1;
        assert!(rounds <= 50, "{kills} of {} moments were in a swap", 2 * rounds);
        rig.restore(&installed);
        // the power fails twice, at random moments
        let moments = [rng.u32(1..1000), rng.u32(1100..2000)];
        for moment in moments {
            let board = rig.start();
            wait("the swap does not start", || (rig.operations() >= moment).then_some(()));
            drop(board);
            kills += u32::from(rig.operations() < swap_operations());
        }
        let mut board = rig.start();
        let status = board.status();
        // a swap that was finished before the power failed is rolled back
        assert!(status == B_ON_TRIAL || status == ROLLED_BACK, "{status}, {moments:?}");
        board.serve();
    }
    say(&format!("update: QEMU was killed {kills} times during a swap"));
}

const ROLLED_BACK: &str = "0.1.0 confirmed; 0.2.0 was rolled back: power-on";

/// Returns the sectors of an image's partition.
fn sectors() -> u32 {
    (layout::ACTIVE.end - layout::ACTIVE.start) / layout::SECTOR as u32
}

/// Returns the minimum number of operations of a swap: of each sector twice an erase, 16 pages and a word of progress.
fn swap_operations() -> u32 {
    sectors() * 2 * (1 + 16 + 1)
}

/// Returns the flash after an update was installed and before the restart.
fn installed(rig: &Rig, original: &Contents, image: &[u8]) -> Contents {
    rig.restore(original);
    let mut board = rig.start();
    assert_eq!(board.status(), A);
    board.install(image).unwrap();
    assert_eq!(board.status(), "0.1.0 runs; a restart swaps in 0.2.0");
    check_model(rig);
    let [erased, written] = [control::ERASED, control::WRITTEN].map(|number| rig.word(number));
    say(&format!("update: {} bytes received: {}", image.len(), times(erased, written)));
    drop(board);
    rig.contents()
}

/// Cuts the power in operations of the download and the installation. Returns the number of cuts.
fn cut_download(rig: &Rig, rng: &mut Rng, original: &Contents, image: &[u8]) -> u32 {
    let all = cut_all();
    let short = short(image);
    rig.restore(original);
    let mut board = rig.start();
    let (mut cuts, mut operation) = (0, 1);
    // the operations after the download record the version and mark the update
    let received = operations_of(short.len());
    loop {
        assert_eq!(board.status(), A);
        board.serve();
        rig.cut_at(operation);
        match board.install(&short) {
            Err(Cut) => cuts += 1,
            Ok(()) => break,
        }
        operation = if all || operation >= received { operation + 1 } else { received.min(operation + 15) };
    }
    assert!(operation > received + 1, "only {operation} operations");
    drop(board);
    // the same with the whole image, at about two places in each sector or at one; then a repeated update without a cut
    rig.restore(original);
    let mut board = rig.start();
    let last = operations_of(image.len());
    let first = if all { 1 } else { rng.u32(1..last) };
    for operation in (first..=last).step_by(if all { 17 } else { 10_000 }) {
        assert_eq!(board.status(), A);
        rig.cut_at(operation);
        assert!(board.install(image).is_err(), "operation {operation}");
        cuts += 1;
    }
    rig.cut_at(0);
    // the board has started again after the last cut
    assert_eq!(board.status(), A);
    repeat(&mut board, image);
    assert_eq!(rig.word(control::REFUSED), 0);
    cuts
}

/// Returns the operations in which an image is received: a write for each block and an erase for each sector.
fn operations_of(len: usize) -> u32 {
    u32::try_from(len.div_ceil(BLOCK) + len.div_ceil(layout::SECTOR)).unwrap()
}

/// Cuts the power in operations of the swap and the confirmation. Returns the number of cuts, and the flash with B on trial.
fn cut_swap(rig: &Rig, rng: &mut Rng, installed: &Contents, image: &[u8]) -> (u32, Contents) {
    rig.restore(installed);
    let mut board = rig.start();
    assert_eq!(board.status(), B_ON_TRIAL);
    let swap = rig.operations();
    let [erased, written] = [control::ERASED, control::WRITTEN].map(|number| rig.word(number));
    say(&format!("update: swap of {} sectors: {}", sectors(), times(erased, written)));
    assert!(swap >= swap_operations(), "{swap}");
    let on_trial = rig.contents();
    board.serve();
    board.until(B);
    let last = rig.operations();
    check_model(rig);
    drop(board);

    let cuts = cuts(1..swap + 1, 12, rng);
    for operation in &cuts {
        rig.restore(installed);
        rig.cut_at(*operation);
        let mut board = rig.start();
        rig.until_cut();
        let status = board.status();
        // the last operation records the end of the swap: if it counts as done, this was a power cut on trial
        let is_last = *operation == swap && status == ROLLED_BACK;
        assert!(status == B_ON_TRIAL || is_last, "cut in operation {operation} of the swap: {status}");
        board.serve();
        if operation % 16 == 0 && !is_last {
            board.until(B);
        }
        check_cut(rig, *operation);
    }
    say(&format!("update: {} power cuts in the swap", cuts.len()));
    for operation in swap + 1..=last {
        rig.restore(installed);
        rig.cut_at(operation);
        let mut board = rig.start();
        assert_eq!(board.status(), B_ON_TRIAL);
        board.serve();
        rig.until_cut();
        // the state was not written, so the reset counts as one on trial
        assert_eq!(board.status(), ROLLED_BACK, "cut in operation {operation}, in the confirmation");
        board.serve();
        check_cut(rig, operation);
        if cut_all() || operation == last {
            repeat(&mut board, image);
        }
    }
    (u32::try_from(cuts.len()).unwrap() + last - swap, on_trial)
}

/// Cuts the power in operations of the roll-back. Returns the number of cuts.
fn cut_roll_back(rig: &Rig, rng: &mut Rng, on_trial: &Contents, image: &[u8]) -> u32 {
    rig.restore(on_trial);
    let mut board = rig.start();
    assert_eq!(board.status(), ROLLED_BACK);
    board.serve();
    let last = rig.operations();
    check_model(rig);
    drop(board);
    let cuts = cuts(1..last + 1, 12, rng);
    for operation in &cuts {
        rig.restore(on_trial);
        rig.cut_at(*operation);
        let mut board = rig.start();
        rig.until_cut();
        assert_eq!(board.status(), ROLLED_BACK, "cut in operation {operation} of the roll-back");
        board.serve();
        check_cut(rig, *operation);
        if operation % 256 == 0 {
            repeat(&mut board, image);
        }
    }
    say(&format!("update: {} power cuts in the roll-back", cuts.len()));
    u32::try_from(cuts.len()).unwrap()
}

/// Updates a board with A to B.
fn repeat(board: &mut rig::Board<'_>, image: &[u8]) {
    board.install(image).unwrap();
    board.restart().unwrap();
    board.until(B_ON_TRIAL);
    board.serve();
    board.until(B);
}

/// Returns the random numbers of a test, and prints their seed.
fn random() -> Rng {
    let seed = std::env::var("UPDATE_SEED").map_or(1, |seed| seed.parse().unwrap());
    say(&format!("update: seed {seed}"));
    Rng::with_seed(seed)
}

fn cut_all() -> bool {
    std::env::var("UPDATE_CUTS").is_ok_and(|cuts| cuts == "all")
}

/// Returns the operations in which the power is cut: all, or about this number of them, from a random one on.
fn cuts(operations: std::ops::Range<u32>, count: u32, rng: &mut Rng) -> Vec<u32> {
    if cut_all() {
        return operations.collect();
    }
    let count = std::env::var("UPDATE_CUTS").map_or(count, |cuts| cuts.parse::<u32>().unwrap().div_ceil(2));
    let step = (operations.len() as u32 / count).max(1);
    let first = operations.start + rng.u32(0..step);
    (first..operations.end).step_by(step as usize).collect()
}

/// Returns an image that is received fast, and never started.
fn short(image: &[u8]) -> Vec<u8> {
    let found = identity::find(image).unwrap();
    let mut short = image[..9000].to_vec();
    let identity = Identity::new(found.board(), "0.3.0");
    short[1024..1024 + identity.as_bytes().len()].copy_from_slice(identity.as_bytes());
    short
}

/// Checks that the flash was used as one without power cuts must be: no word is written again without an erase.
fn check_model(rig: &Rig) {
    assert_eq!(rig.word(control::REFUSED), 0, "writes to flash that was not erased");
    assert_eq!(rig.word(control::WRITTEN_AGAIN), 0, "words written twice");
    assert_eq!(rig.word(control::CUTS), 0);
}

/// Checks that the power was cut once, and that only the interrupted word was written again.
fn check_cut(rig: &Rig, operation: u32) {
    assert_eq!(rig.word(control::CUTS), 1);
    assert_eq!(rig.word(control::REFUSED), 0, "cut in operation {operation}");
    assert!(rig.word(control::WRITTEN_AGAIN) <= 1, "cut in operation {operation}");
}

/// Describes how long operations take on the flash of a W5500-EVB-Pico.
fn times(erased: u32, written: u32) -> String {
    let seconds = [0, 1].map(|i| (f64::from(erased) * ERASE[i] + f64::from(written) * WRITE[i]) / 1000.0);
    format!("{erased} erases and {written} pages: {:.1} s, at most {:.0} s", seconds[0], seconds[1])
}

/// Prints a line that `test` shows; not with `println`, which cargo shows of failures only.
fn say(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}
