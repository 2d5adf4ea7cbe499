//! TLS of a server that other computers can reach, with the feature `tls`.

#[cfg(feature = "tls")]
mod with_rustls {
    use std::fmt::Display;
    use std::path::Path;
    use std::sync::Arc;
    use std::time::Duration;

    use tokio::net::TcpStream;
    use tokio::time::timeout;
    use tokio_rustls::TlsAcceptor;
    use tokio_rustls::rustls::ServerConfig;
    use tokio_rustls::rustls::crypto::ring::default_provider;
    use tokio_rustls::rustls::pki_types::pem::PemObject as _;
    use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
    use tokio_rustls::server::TlsStream;

    /// The longest time of a handshake.
    const HANDSHAKE: Duration = Duration::from_secs(10);

    /// Accepts connections with a certificate.
    #[derive(Clone)]
    pub(crate) struct Acceptor(TlsAcceptor);

    impl Acceptor {
        /// Reads the certificate and its key, both in PEM.
        pub(crate) fn new(certificate: &Path, key: &Path) -> Result<Self, String> {
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
            Ok(Self(TlsAcceptor::from(Arc::new(config))))
        }

        /// Makes the handshake; `None` if it fails.
        pub(crate) async fn accept(&self, stream: TcpStream) -> Option<TlsStream<TcpStream>> {
            timeout(HANDSHAKE, self.0.accept(stream)).await.ok()?.ok()
        }
    }
}

#[cfg(not(feature = "tls"))]
mod without {
    use std::path::Path;

    use tokio::net::TcpStream;

    /// Never made: this program was built without TLS.
    #[derive(Clone)]
    pub(crate) enum Acceptor {}

    impl Acceptor {
        pub(crate) fn new(_: &Path, _: &Path) -> Result<Self, String> {
            Err("this program was built without TLS; build it with the feature `tls` of bcap-web (`web-tls` of bcap-cli)".into())
        }

        #[expect(clippy::unused_async, reason = "as with TLS")]
        pub(crate) async fn accept(&self, _: TcpStream) -> Option<TcpStream> {
            match *self {}
        }
    }
}

#[cfg(feature = "tls")]
pub(crate) use with_rustls::Acceptor;
#[cfg(not(feature = "tls"))]
pub(crate) use without::Acceptor;

impl std::fmt::Debug for Acceptor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Acceptor")
    }
}
