//! The reasons why a fleet cannot start or continue.

use std::net::SocketAddr;
use std::path::PathBuf;

/// The reason why a fleet cannot start or continue.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The configuration is invalid; the text says where and why.
    #[error("{0}")]
    Config(String),
    /// The buffer on disk cannot be used.
    #[error("cannot use the buffer in {}: {source}", path.display())]
    Buffer {
        /// The directory.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Listening on the address for metrics failed.
    #[error("cannot listen on {address} for metrics: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// A certificate or key cannot be used.
    #[error("TLS: {0}")]
    Tls(String),
}
