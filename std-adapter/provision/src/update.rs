//! Sends an image to a board: announced, optionally signed, sent in blocks, and installed at the next start.

use bcap_board::crc::Crc32;
use bcap_board::identity::{BLOCK, Identity};

use crate::console::{Answer, Console};
use crate::error::Error;
use crate::signature::{Signature, digits};

/// The maximum number of times that a block is sent; then the update ends.
const ATTEMPTS: u32 = 5;
/// The hint after a refused update.
const IMAGE_REMAINS: &str = "the board runs its earlier image";

/// Returns the version of a board and the outcome of its last update, in the words of the board.
///
/// # Errors
///
/// [`Error::Refused`] if its image was built without updates; the errors of the connection.
pub fn status(console: &mut Console) -> Result<String, Error> {
    let text = ask(console, "status")?.text;
    Ok(text.strip_prefix("ok ").map_or_else(|| text.clone(), str::to_owned))
}

/// Checks that the settings of the board are not a part of its image, which an update replaces.
/// [`settings::replace`](crate::settings::replace) stores them in the flash.
///
/// # Errors
///
/// [`Error::Refused`] if they are.
pub fn check_settings(console: &mut Console) -> Result<(), Error> {
    let answer = console.ask("show")?;
    if answer.settings.is_empty() || answer.text != "ok image" {
        return Ok(());
    }
    Err(Error::refused(
        "the settings of the board are those of its image, which the new one replaces",
        "store them in the flash first",
    ))
}

/// Announces an image; a board with a key needs a signature. With `older` the image may be older than the board's.
///
/// # Errors
///
/// [`Error::Refused`] if the board does not accept it: another board, an older version, a missing or another key.
pub fn announce(
    console: &mut Console,
    image: &[u8],
    identity: &Identity,
    signature: Option<&Signature>,
    older: bool,
) -> Result<(), Error> {
    let crc = Crc32::new().and(image).value();
    let older = if older { " older" } else { "" };
    ask(console, &format!("update {} {} {} {crc:08x}{older}", identity.board(), identity.version(), image.len()))?;
    if let Some(signature) = signature {
        ask(console, &format!("sign {}", signature.text()))?;
    }
    Ok(())
}

/// Sends the image in blocks, calls `sent` with the number of sent bytes, and returns the number of repeated blocks.
///
/// # Errors
///
/// [`Error::Refused`] if a block fails five times; the errors of the connection.
pub fn send(console: &mut Console, image: &[u8], mut sent: impl FnMut(usize)) -> Result<u32, Error> {
    let mut repeated = 0;
    for (number, data) in (0..).zip(image.chunks(BLOCK)) {
        let crc = Crc32::new().and(&u32::to_le_bytes(number)).and(data).value();
        let request = format!("block {number} {crc:08x} {}", digits(data));
        let mut attempts = 0;
        while let Some(reason) = console.send_block(&request, number)? {
            attempts += 1;
            if attempts == ATTEMPTS {
                let message = format!("block {number} failed {ATTEMPTS} times: {reason}");
                return Err(Error::refused(message, IMAGE_REMAINS));
            }
            repeated += 1;
        }
        sent((number as usize * BLOCK + data.len()).min(image.len()));
    }
    Ok(repeated)
}

/// Makes the board check the whole image, and swap the images at its next start.
///
/// # Errors
///
/// [`Error::Refused`] if the image is not complete or its signature was not made with the board's key.
pub fn install(console: &mut Console) -> Result<(), Error> {
    // answers to blocks that were sent twice
    console.skip_answers()?;
    ask(console, "install").map(drop)
}

/// Restarts the board.
///
/// # Errors
///
/// The errors of the connection.
pub fn restart(console: &mut Console) -> Result<(), Error> {
    ask(console, "restart").map(drop)
}

/// Sends a request; fails if the board refuses it.
fn ask(console: &mut Console, request: &str) -> Result<Answer, Error> {
    let answer = console.ask(request)?;
    // an image that predates updates, or was built without them
    if answer.text.starts_with("error unknown request") {
        return Err(Error::refused(
            "the board cannot be updated: its image was built without updates",
            "flash the boot loader and an image with updates once, as the README of the board says",
        ));
    }
    answer.accepted(request, IMAGE_REMAINS)?;
    Ok(answer)
}
