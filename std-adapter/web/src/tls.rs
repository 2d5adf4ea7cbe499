//! TLS of a server that other computers can reach, with the feature `tls`.

#[cfg(feature = "tls")]
mod with_rustls {
    use std::fmt::Display;
    use std::path::Path;
    use std::sync::Arc;
    use std::time::Duration;

    use tokio::net::TcpStream;
    use tokio::time::timeout;
    /// Accepts connections with a certificate.
    pub(crate) use tokio_rustls::TlsAcceptor as Acceptor;
    use tokio_rustls::rustls::ServerConfig;
    use tokio_rustls::rustls::crypto::ring::default_provider;
    use tokio_rustls::rustls::pki_types::pem::PemObject as _;
    use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
    use tokio_rustls::server::TlsStream;

    /// Maximum time of a handshake.
    const HANDSHAKE: Duration = Duration::from_secs(10);

    /// Reads the certificate and its key, both in PEM.
    pub(crate) fn acceptor(certificate: &Path, key: &Path) -> Result<Acceptor, String> {
        let wrong = |path: &Path, error: &dyn Display| format!("{}: {error}", path.display());
        let chain = CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        let chain = chain.map_err(|error| wrong(certificate, &error))?;
        if chain.is_empty() {
            return Err(wrong(certificate, &"there is no certificate in PEM"));
        }
        let private = PrivateKeyDer::from_pem_file(key).map_err(|error| wrong(key, &error))?;
        let config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|error| error.to_string())?
            .with_no_client_auth()
            .with_single_cert(chain, private)
            .map_err(|error| wrong(certificate, &error))?;
        Ok(Arc::new(config).into())
    }

    /// Makes the handshake; `None` if it fails.
    pub(crate) async fn accept(acceptor: &Acceptor, stream: TcpStream) -> Option<TlsStream<TcpStream>> {
        timeout(HANDSHAKE, acceptor.accept(stream)).await.ok()?.ok()
    }
}

#[cfg(not(feature = "tls"))]
mod without {
    use std::path::Path;

    use tokio::net::TcpStream;

    /// Never made: this program was built without TLS.
    pub(crate) type Acceptor = std::convert::Infallible;

    pub(crate) fn acceptor(_: &Path, _: &Path) -> Result<Acceptor, String> {
        Err("this program was built without TLS; build it with the feature `tls` of bcap-web (`web-tls` of bcap-cli)"
            .into())
    }

    pub(crate) async fn accept(acceptor: &Acceptor, _: TcpStream) -> Option<TcpStream> {
        match *acceptor {}
    }
}

#[cfg(feature = "tls")]
pub(crate) use with_rustls::{Acceptor, accept, acceptor};
#[cfg(not(feature = "tls"))]
pub(crate) use without::{Acceptor, accept, acceptor};
