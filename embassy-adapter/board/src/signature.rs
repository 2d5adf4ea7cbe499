//! Signatures of images: Ed25519 over the board, the version, the length and the SHA-512 of an image.
//!
//! ```text
//!  host, once:       a key pair ([`public_of`])  ─► the public key is built into the image and its boot loader ([`KEY`])
//!  host, per image:  Manifest ─► sign ─► signature, sent before the image
//!  board:            verifies it before a sector is erased, compares the digest before the swap; the boot loader does both again
//! ```
//!
//! The signature covers the name of the board and the version, so an image cannot be passed off as one for another board or as
//! a newer one.

use core::fmt;

use ed25519_dalek::{Signature as Ed25519, Signer, SigningKey, VerifyingKey};
pub use sha2::{Digest, Sha512};

use crate::identity::{Identity, NAME, VERSION};

/// The size of a signature, and of a digest, in bytes.
pub const SIGNATURE: usize = 64;
/// The size of a key in bytes.
pub const KEY_SIZE: usize = 32;
/// The first bytes of each signed message, so that a signature of something else is never valid.
const CONTEXT: &[u8; 16] = b"bcap-board image";
const MESSAGE: usize = CONTEXT.len() + NAME + VERSION + 4 + SIGNATURE;

/// The public key of this image: the variable `BCAP_BOARD_KEY` of the build, 64 hexadecimal digits.
pub const KEY: Option<PublicKey> = match option_env!("BCAP_BOARD_KEY") {
    Some(digits) => Some(PublicKey::of_digits(digits)),
    None => None,
};

/// Whether signatures can be checked: an image without a key has no code for it, on a board.
pub(crate) const CAN_CHECK: bool = KEY.is_some() || !cfg!(target_os = "none");

/// The key that images are checked with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublicKey(pub [u8; KEY_SIZE]);

impl PublicKey {
    /// Parses 64 hexadecimal digits while an image is compiled.
    const fn of_digits(digits: &str) -> Self {
        let (pairs, rest) = digits.as_bytes().as_chunks::<2>();
        assert!(pairs.len() == KEY_SIZE && rest.is_empty(), "BCAP_BOARD_KEY needs 64 hexadecimal digits");
        let (mut key, mut at) = ([0; KEY_SIZE], 0);
        while at < KEY_SIZE {
            key[at] = digit(pairs[at][0]) << 4 | digit(pairs[at][1]);
            at += 1;
        }
        Self(key)
    }

    /// Returns whether a signature was made by the signer of an image. A key or signature of small order is invalid.
    #[must_use]
    pub fn accepts(&self, manifest: &Manifest<'_>, signature: &[u8; SIGNATURE]) -> bool {
        let signature = Ed25519::from_bytes(signature);
        CAN_CHECK
            && VerifyingKey::from_bytes(&self.0)
                .is_ok_and(|key| key.verify_strict(&manifest.message(), &signature).is_ok())
    }
}

impl fmt::Display for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

const fn digit(digit: u8) -> u8 {
    match digit {
        b'0'..=b'9' => digit - b'0',
        b'a'..=b'f' => digit - b'a' + 10,
        b'A'..=b'F' => digit - b'A' + 10,
        _ => panic!("BCAP_BOARD_KEY needs 64 hexadecimal digits"),
    }
}

/// The signed facts about an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Manifest<'a> {
    /// The board that the image is for.
    pub board: &'a str,
    /// Its version.
    pub version: &'a str,
    /// Its length in bytes.
    pub len: u32,
    /// Its SHA-512.
    pub digest: [u8; SIGNATURE],
}

impl<'a> Manifest<'a> {
    /// Returns the facts about an image in memory, on a host; `None` if it has 4 GiB or more.
    #[must_use]
    pub fn of(image: &[u8], identity: &'a Identity) -> Option<Self> {
        let (board, version, len) = (identity.board(), identity.version(), u32::try_from(image.len()).ok()?);
        Some(Self { board, version, len, digest: Sha512::digest(image).into() })
    }

    /// Signs with a secret key.
    #[must_use]
    pub fn sign(&self, secret: &[u8; KEY_SIZE]) -> [u8; SIGNATURE] {
        SigningKey::from_bytes(secret).sign(&self.message()).to_bytes()
    }

    /// Returns the signed message. The texts are padded, so no two manifests have one message.
    fn message(&self) -> [u8; MESSAGE] {
        let mut message = [0; MESSAGE];
        let fields: [(usize, &[u8]); 5] = [
            (CONTEXT.len(), CONTEXT),
            (NAME, self.board.as_bytes()),
            (VERSION, self.version.as_bytes()),
            (4, &self.len.to_le_bytes()),
            (SIGNATURE, &self.digest),
        ];
        let mut rest = message.as_mut_slice();
        for (size, bytes) in fields {
            let (field, after) = rest.split_at_mut_checked(size).unwrap_or_default();
            field.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
            rest = after;
        }
        message
    }
}

/// Returns the public key of a secret one.
#[must_use]
pub fn public_of(secret: &[u8; KEY_SIZE]) -> PublicKey {
    PublicKey(SigningKey::from_bytes(secret).verifying_key().to_bytes())
}

/// Returns whether a version is older than another: numbers between dots count, then a suffix such as `-rc1` is older than
/// none, and `-rc9` is older than `-rc10`. A version that is not of this form counts as older, so it is refused.
#[must_use]
pub fn is_older(version: &str, than: &str) -> bool {
    match (parts(version), parts(than)) {
        (Some((numbers, suffix)), Some((others, other))) => {
            // no suffix is the newest
            let order = (numbers, suffix.is_empty()).cmp(&(others, other.is_empty()));
            order.then_with(|| keys(suffix).cmp(keys(other))).is_lt()
        }
        (None, _) => true,
        (Some(_), None) => false,
    }
}

/// Returns up to four numbers of a version, and its suffix; build metadata after `+` does not count.
fn parts(version: &str) -> Option<([u32; 4], &str)> {
    let version = version.split('+').next().unwrap_or_default();
    let (numbers, suffix) = version.split_once('-').unwrap_or((version, ""));
    let mut found = [0; 4];
    let mut places = found.iter_mut();
    for number in numbers.split('.') {
        *places.next()? = number.parse().ok()?;
    }
    Some((found, suffix))
}

/// Returns the sort keys of a suffix: runs of digits as numbers (their length without leading zeros, their digits), other bytes
/// as bytes.
fn keys(suffix: &str) -> impl Iterator<Item = (u8, usize, &[u8])> {
    let parts = suffix.as_bytes().chunk_by(|byte, next| byte.is_ascii_digit() && next.is_ascii_digit());
    parts.map(|part| {
        let zeros = part.iter().take_while(|byte| **byte == b'0').count();
        let rest = part.get(zeros..).unwrap_or_default();
        // all digits have one place among the other bytes
        let first = part.first().map_or(0, |byte| if byte.is_ascii_digit() { b'0' } else { *byte });
        (first, rest.len(), rest)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECRET: [u8; 32] = [7; 32];

    #[test]
    fn a_signature_covers_every_fact() {
        let manifest = Manifest { board: "pico", version: "0.2.0", len: 1000, digest: [3; 64] };
        let (signature, key) = (manifest.sign(&SECRET), public_of(&SECRET));
        assert!(key.accepts(&manifest, &signature));
        for other in [
            Manifest { board: "pico2", ..manifest },
            Manifest { board: "pic", version: "o0.2.0", ..manifest },
            Manifest { version: "0.3.0", ..manifest },
            Manifest { len: 1001, ..manifest },
            Manifest { digest: [4; 64], ..manifest },
        ] {
            assert!(!key.accepts(&other, &signature), "{other:?}");
        }
        assert!(!public_of(&[8; 32]).accepts(&manifest, &signature), "another key");
        for bit in 0..SIGNATURE * 8 {
            let mut damaged = signature;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(!key.accepts(&manifest, &damaged), "bit {bit}");
        }
        assert!(!key.accepts(&manifest, &[0; 64]) && !PublicKey([0; 32]).accepts(&manifest, &[0; 64]), "small order");
    }

    #[test]
    fn a_key_is_parsed_from_its_digits() {
        let key = public_of(&SECRET);
        assert_eq!(PublicKey::of_digits(&std::format!("{key}")), key);
        assert_eq!(PublicKey::of_digits(&std::format!("{key}").to_uppercase()), key);
        for digits in ["", "00", &"0".repeat(63), &"g".repeat(64)] {
            assert!(std::panic::catch_unwind(|| PublicKey::of_digits(digits)).is_err(), "{digits:?}");
        }
    }

    #[test]
    fn versions_are_ordered_by_their_numbers() {
        let ascending = [
            "0.1.0-rc",
            "0.1.0-rc.9",
            "0.1.0-rc.10",
            "0.1.0-rc1",
            "0.1.0-rc2",
            "0.1.0-rc9",
            "0.1.0-rc10",
            "0.1.0-rc10a",
            "0.1.0",
            "0.1.1",
            "0.2",
            "0.10.0",
            "1.0.0-beta",
            "1.0.0-beta99999999999999999999",
            "1.0.0-rc1",
            "1.0.0",
            "1.0.0.1",
        ];
        for (at, version) in ascending.iter().enumerate() {
            for (than_at, than) in ascending.iter().enumerate() {
                assert_eq!(is_older(version, than), at < than_at, "{version} {than}");
            }
        }
        for (version, equal) in [("0.2.0", "0.2"), ("0.2.0+b", "0.2.0+a"), ("0.2.0-rc01", "0.2.0-rc1")] {
            assert!(!is_older(version, equal) && !is_older(equal, version), "{version} {equal}");
        }
        for invalid in ["", "new", "1.x", "1.2.3.4.5", "99999999999"] {
            assert!(is_older(invalid, "0.1.0") && !is_older("0.1.0", invalid), "{invalid}");
        }
    }
}
