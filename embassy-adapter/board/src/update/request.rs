//! The requests of the [`console`](crate::console) for updates.

use embedded_io::Write;
use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;

use super::error::UpdateError;
use super::updater::Updater;
use crate::answer::{answer, result};
use crate::identity::BLOCK;
use crate::signature::SIGNATURE;

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
            None => answer(
                port,
                format_args!("error update needs BOARD VERSION LENGTH CRC32, and `older` if it may be older"),
            ),
        },
        "sign" => match signature(argument) {
            Some((digest, signature)) => result(port, updater.sign::<F::Error>(&digest, &signature)),
            None => answer(port, format_args!("error sign needs the SHA-512 and the signature in hexadecimal")),
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
    let may_be_older = match words.next() {
        None => false,
        Some("older") => true,
        Some(_) => return None,
    };
    words.next().is_none().then(|| updater.begin(board, version, len, crc, may_be_older))
}

/// Returns the number, the CRC and the data of a block.
fn block(argument: &str) -> Option<(u32, u32, Vec<u8, BLOCK>)> {
    let mut words = argument.split(' ');
    let (number, crc) = (words.next()?.parse().ok()?, u32::from_str_radix(words.next()?, 16).ok()?);
    let data = bytes(words.next()?)?;
    words.next().is_none().then_some((number, crc, data))
}

/// Returns the digest and the signature of an image.
fn signature(argument: &str) -> Option<([u8; SIGNATURE], [u8; SIGNATURE])> {
    let (digest, signature) = argument.split_once(' ')?;
    let [digest, signature] = [digest, signature].map(bytes::<SIGNATURE>);
    Some((digest?.into_array().ok()?, signature?.into_array().ok()?))
}

/// Returns the bytes of hexadecimal digits.
fn bytes<const N: usize>(digits: &str) -> Option<Vec<u8, N>> {
    let (digits, []) = digits.as_bytes().as_chunks::<2>() else { return None };
    let mut bytes = Vec::new();
    for [high, low] in digits {
        let digit = |byte: u8| char::from(byte).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
        bytes.push(digit(*high)? << 4 | digit(*low)?).ok()?;
    }
    Some(bytes)
}
