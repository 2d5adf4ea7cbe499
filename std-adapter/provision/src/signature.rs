//! The keys and signatures of images.

use std::fmt;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;

use bcap_board::identity::Identity;
use bcap_board::signature::{KEY_SIZE, Manifest, PublicKey, SIGNATURE, public_of};

use crate::error::Error;

/// A secret key.
pub struct Key([u8; KEY_SIZE]);

impl fmt::Debug for Key {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Key").finish_non_exhaustive()
    }
}

impl Key {
    /// Creates a key, and writes it to a new file that only its owner can read.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if the file exists or cannot be written, or if the system has no random numbers.
    pub fn make(path: &Path) -> Result<Self, Error> {
        let mut secret = [0; KEY_SIZE];
        getrandom::fill(&mut secret).map_err(|error| Error::at(path, error))?;
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let written = options.open(path).and_then(|mut file| {
            writeln!(file, "{}", digits(&secret))?;
            file.sync_all()
        });
        written.map_err(|error| Error::at(path, error))?;
        Ok(Self(secret))
    }

    /// Reads the file of a key.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if the file cannot be read, or has no key.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = fs::read_to_string(path).map_err(|error| Error::at(path, error))?;
        bytes(text.trim()).map(Self).ok_or_else(|| Error::at(path, "not a secret key, which is 64 hexadecimal digits"))
    }

    /// Returns the public key, which the image and the boot loader of the board have.
    #[must_use]
    pub fn public(&self) -> PublicKey {
        public_of(&self.0)
    }
}

/// The signature of an image: its SHA-512, and the signature of that hash and the image's name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signature {
    digest: [u8; SIGNATURE],
    signature: [u8; SIGNATURE],
}

impl Signature {
    /// Signs an image.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if the image is too long.
    pub fn by_key(image: &[u8], identity: &Identity, key: &Key) -> Result<Self, Error> {
        let manifest = manifest(image, identity)?;
        Ok(Self { digest: manifest.digest, signature: manifest.sign(&key.0) })
    }

    /// Reads the file with the [text](Self::text) of a signature, which must be for this image.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if the file cannot be read, has no signature, or has the signature of another image.
    pub fn of_file(image: &[u8], identity: &Identity, path: &Path) -> Result<Self, Error> {
        let text = fs::read_to_string(path).map_err(|error| Error::at(path, error))?;
        let parts =
            text.trim().split_once(' ').and_then(|(digest, signature)| Some((bytes(digest)?, bytes(signature)?)));
        let Some((digest, signature)) = parts else {
            return Err(Error::at(path, "not a signature, which is two numbers of 128 hexadecimal digits"));
        };
        if digest != manifest(image, identity)?.digest {
            return Err(Error::at(path, "the signature is for another image"));
        }
        Ok(Self { digest, signature })
    }

    /// Returns both parts in hexadecimal, as the board and the file have them.
    #[must_use]
    pub fn text(&self) -> String {
        format!("{} {}", digits(&self.digest), digits(&self.signature))
    }
}

/// Returns the signed facts about an image.
fn manifest<'a>(image: &[u8], identity: &'a Identity) -> Result<Manifest<'a>, Error> {
    Manifest::of(image, identity).ok_or_else(|| Error::Invalid("the image is too long".into()))
}

/// Writes bytes in hexadecimal.
pub(crate) fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes<const N: usize>(digits: &str) -> Option<[u8; N]> {
    let (pairs, []) = digits.as_bytes().as_chunks::<2>() else { return None };
    let byte = |pair: &[u8; 2]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    pairs.iter().map(byte).collect::<Option<Vec<u8>>>()?.try_into().ok()
}
