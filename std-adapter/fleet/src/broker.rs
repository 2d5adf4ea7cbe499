//! One connection to the broker. After a loss it is replaced by a new one, so that only the publisher sends messages again.

use std::io;

use rumqttc::{AsyncClient, Event, LastWill, MqttOptions, NetworkOptions, default_socket_connect};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use crate::config::{self, Config};
use crate::error::Error;
use crate::message::Message;
use crate::shorten::{LARGEST, Shortened};

/// The maximum number of messages that the broker has not acknowledged.
pub(crate) const WINDOW: u16 = 100;

/// The maximum number of events that wait for the publisher.
const EVENTS: usize = 256;

/// The largest message to the broker in bytes: a birth may be long.
const LARGEST_SENT: usize = 16 << 20;

/// The maximum size of a header in bytes: the fixed header, a topic, and the identifier of a packet.
const HEADER: usize = 5 + (2 + 0xffff) + 2;

/// How to connect, with secrets and certificates that were read once.
pub(crate) struct Connector {
    options: MqttOptions,
}

/// An event on a connection; an error ends the connection.
pub(crate) type LinkEvent = Result<Event, String>;

/// A connection, whose task ends with it.
pub(crate) struct Link {
    pub(crate) client: AsyncClient,
    pub(crate) events: mpsc::Receiver<LinkEvent>,
    task: JoinHandle<()>,
}

impl Drop for Link {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Connector {
    /// Reads secrets and certificates.
    pub(crate) fn new(config: &Config) -> Result<Self, Error> {
        let broker = &config.broker;
        let port = broker.port.unwrap_or(if broker.tls.is_some() { 8883 } else { 1883 });
        let id = broker.client_id.clone().unwrap_or_else(|| format!("bcap-{}-{}", config.group, config.node));
        let mut options = MqttOptions::new(id, (broker.host.as_str(), port));
        options.set_keep_alive(broker.keep_alive_seconds);
        options.set_clean_session(true).set_inflight(WINDOW);
        options.set_max_packet_size(LARGEST + HEADER, LARGEST_SENT);
        if let Some(user) = &broker.user {
            options.set_credentials(user, password(broker)?);
        }
        match &broker.tls {
            Some(tls) => connect_with_tls(&mut options, &broker.host, tls)?,
            None => {
                options
                    .set_socket_connector(async |address, network| Ok(Shortened::new(socket(address, network).await?)));
            }
        }
        options.validate().map_err(|error| Error::Config(format!("[broker]: {error}")))?;
        Ok(Self { options })
    }

    /// Returns the same with another client id, for a check while a fleet runs.
    pub(crate) fn with_suffix(mut self, suffix: &str) -> Self {
        let id = self.options.client_id() + suffix;
        self.options.set_client_id(id);
        self
    }

    /// Begins to connect, to watch the active process of this node.
    pub(crate) fn watch(&self, instance: &str) -> Link {
        let mut options = self.options.clone();
        options.set_client_id(format!("{}-{instance}", self.options.client_id()));
        Self::open(options)
    }

    /// Begins to connect.
    pub(crate) fn connect(&self, will: Option<Message>) -> Link {
        let mut options = self.options.clone();
        if let Some(Message { topic, payload, qos, retain, .. }) = will {
            options.set_last_will(LastWill::new(topic, payload, qos, retain));
        }
        Self::open(options)
    }

    fn open(options: MqttOptions) -> Link {
        let (client, mut events) = AsyncClient::builder(options).capacity(usize::from(WINDOW) * 2).build();
        let (sender, receiver) = mpsc::channel(EVENTS);
        let task = tokio::spawn(async move {
            loop {
                let event = events.poll().await.map_err(|error| error.to_string());
                let ended = event.is_err();
                if sender.send(event).await.is_err() || ended {
                    return;
                }
            }
        });
        Link { client, events: receiver, task }
    }
}

/// Connects a socket that sends without delay. With Nagle's algorithm the answer to a command would wait until the broker's
/// kernel has acknowledged the preceding PUBACK, which takes up to 40 ms.
async fn socket(address: String, mut network: NetworkOptions) -> io::Result<TcpStream> {
    network.set_tcp_nodelay(true);
    default_socket_connect(address, network).await
}

fn password(broker: &config::Broker) -> Result<String, Error> {
    if let Some(path) = &broker.password_file {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Read { path: path.clone(), source })?;
        return Ok(text.trim_end_matches(['\r', '\n']).to_owned());
    }
    match &broker.password_env {
        Some(name) => std::env::var(name).map_err(|_| {
            Error::Config(format!("[broker]: the environment variable {name} of password_env is not set"))
        }),
        None => Ok(String::new()),
    }
}

#[cfg(not(feature = "tls"))]
fn connect_with_tls(_: &mut MqttOptions, _: &str, _: &config::Tls) -> Result<(), Error> {
    Err(Error::Tls("this program was built without TLS".into()))
}

#[cfg(feature = "tls")]
fn connect_with_tls(options: &mut MqttOptions, host: &str, tls: &config::Tls) -> Result<(), Error> {
    use std::path::Path;
    use std::sync::Arc;

    use tokio_rustls::TlsConnector;
    use tokio_rustls::rustls::crypto::ring::default_provider;
    use tokio_rustls::rustls::pki_types::pem::PemObject as _;
    use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
    use tokio_rustls::rustls::{ClientConfig, RootCertStore};

    let wrong = |path: &Path, error: &dyn std::fmt::Display| Error::Tls(format!("{}: {error}", path.display()));
    let certificates = |path: &Path| {
        let certificates = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        match certificates {
            Ok(certificates) if certificates.is_empty() => Err(wrong(path, &"there is no certificate in PEM")),
            Ok(certificates) => Ok(certificates),
            Err(error) => Err(wrong(path, &error)),
        }
    };
    let mut roots = RootCertStore::empty();
    if let Some(ca) = &tls.ca {
        for certificate in certificates(ca)? {
            roots.add(certificate).map_err(|error| wrong(ca, &error))?;
        }
    } else {
        // some of them may have a form that rustls does not support
        roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        if roots.is_empty() {
            return Err(Error::Tls("this system has no certificates of authorities: give ca in [broker.tls]".into()));
        }
    }
    let builder = ClientConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| Error::Tls(error.to_string()))?
        .with_root_certificates(roots);
    let config = match (&tls.certificate, &tls.key) {
        (Some(certificate), Some(key)) => {
            let private = PrivateKeyDer::from_pem_file(key).map_err(|error| wrong(key, &error))?;
            let chain = certificates(certificate)?;
            builder.with_client_auth_cert(chain, private).map_err(|error| wrong(certificate, &error))?
        }
        _ => builder.with_no_client_auth(),
    };
    let name = ServerName::try_from(host.to_owned()).map_err(|error| Error::Tls(format!("{host}: {error}")))?;
    let connector = TlsConnector::from(Arc::new(config));
    options.set_socket_connector(move |address, network| {
        let (connector, name) = (connector.clone(), name.clone());
        async move {
            let stream = socket(address, network).await?;
            Ok(Shortened::new(connector.connect(name, stream).await?))
        }
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_socket_to_the_broker_sends_at_once() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let stream = socket(address, NetworkOptions::new()).await.unwrap();
        assert!(stream.nodelay().unwrap());
    }
}
