//! The requests of the [`console`](crate::console) for updates.

use embedded_io::Write;
use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;

use super::error::UpdateError;
use super::updater::Updater;
use crate::answer::{answer, result};
use crate::identity::BLOCK;

/// Does a request and answers it.
pub(crate) fn perform<F: NorFlash, W: Write>(
    updater: &mut Updater,
    flash: &mut F,
    verb: &str,
    argument: &str,
    port: &mut W,
) -> Result<(), W::Error> {
    match verb {
        "status" => match updater.status(flash) {
            Ok(status) => answer(port, format_args!("ok {status}")),
            Err(error) => answer(port, format_args!("error {error}")),
        },
        "update" => match begin::<F::Error>(updater, argument) {
            Some(begun) => result(port, begun),
            None => answer(port, format_args!("error update needs BOARD VERSION LENGTH CRC32")),
        },
        "block" => match block(argument) {
            Some((number, crc, data)) => match updater.block(flash, number, crc, &data) {
                Ok(()) => answer(port, format_args!("ok {number}")),
                Err(error) => answer(port, format_args!("error {error}")),
            },
            None => answer(port, format_args!("error block needs NUMBER CRC32 and up to {BLOCK} bytes in hexadecimal")),
        },
        _ => {
            let installed = updater.install(flash);
            #[cfg(all(feature = "embassy", feature = "health"))]
            super::shown::show(updater, flash);
            result(port, installed)
        }
    }
}

/// Begins an update; `None` if the argument is invalid.
fn begin<E>(updater: &mut Updater, argument: &str) -> Option<Result<(), UpdateError<E>>> {
    let mut words = argument.split(' ');
    let (board, version) = (words.next()?, words.next()?);
    let (len, crc) = (words.next()?.parse().ok()?, u32::from_str_radix(words.next()?, 16).ok()?);
    words.next().is_none().then(|| updater.begin(board, version, len, crc))
}

/// Returns the number, the CRC and the data of a block.
fn block(argument: &str) -> Option<(u32, u32, Vec<u8, BLOCK>)> {
    let mut words = argument.split(' ');
    let (number, crc) = (words.next()?.parse().ok()?, u32::from_str_radix(words.next()?, 16).ok()?);
    let (digits, []) = words.next()?.as_bytes().as_chunks::<2>() else { return None };
    let mut data = Vec::new();
    for [high, low] in digits {
        let digit = |byte: u8| char::from(byte).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
        data.push(digit(*high)? << 4 | digit(*low)?).ok()?;
    }
    words.next().is_none().then_some((number, crc, data))
}
