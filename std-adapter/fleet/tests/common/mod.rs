//! Virtual controllers, fleets, subscribers and a proxy.

use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bcap_core::bcap::header::{Header, field};
use bcap_core::device::{Device, DeviceVariable};
use bcap_core::variant::Variant;
use bcap_fleet::{Config, Event, Fleet};
use bcap_sim::{Controller, Profile, VariableKind};
use bcap_std::server::Server;
use rumqttc::{AsyncClient, Event as Mqtt, MqttOptions, Packet, PublishOptions, QoS};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout};

/// A wait that is longer than this is a failure.
const LIMIT: Duration = Duration::from_secs(30);

pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// A virtual controller that can be killed and started again at the same address.
pub(crate) struct Robot {
    pub(crate) controller: Arc<Mutex<Controller>>,
    pub(crate) address: SocketAddr,
    server: Option<JoinHandle<()>>,
}

impl Robot {
    pub(crate) async fn start() -> Self {
        let config = bcap_sim::Config::new(Profile::Rc8);
        let controller = Arc::new(Mutex::new(Controller::new(config)));
        let address = SocketAddr::from(([127, 0, 0, 1], free_port()));
        let mut robot = Self { controller, address, server: None };
        robot.restart().await;
        robot
    }

    pub(crate) async fn restart(&mut self) {
        let server = loop {
            match Server::with_shared(Arc::clone(&self.controller)).bcap_tcp(self.address).await {
                Ok(server) => break server,
                // the port of the previous server may still be in use
                Err(_) => tokio::time::sleep(Duration::from_millis(1)).await,
            }
        };
        self.server = Some(tokio::spawn(async move { drop(server.run(std::future::pending()).await) }));
    }

    pub(crate) async fn kill(&mut self) {
        if let Some(server) = self.server.take() {
            server.abort();
            let _ = server.await;
        }
    }

    pub(crate) fn set(&self, index: u32, value: i32) {
        self.controller.lock().unwrap().set_variable(VariableKind::I, index, &Variant::I4(value)).unwrap();
    }

    pub(crate) fn get(&self, index: u32) -> i32 {
        let value = self.controller.lock().unwrap().variable::<16>(VariableKind::I, index).unwrap();
        value.as_variant().as_i32().unwrap()
    }
}

/// A controller whose I1 counts its own reads until it is frozen; returns its address.
pub(crate) async fn counter(last: &Arc<AtomicI32>, frozen: &Arc<AtomicBool>) -> SocketAddr {
    let counter = (Arc::clone(last), Arc::clone(frozen));
    let variable = DeviceVariable::new("I1", |(last, frozen): &(Arc<AtomicI32>, Arc<AtomicBool>), reply| {
        let more = i32::from(!frozen.load(Ordering::SeqCst));
        reply.set(&(last.fetch_add(more, Ordering::SeqCst) + more))
    });
    let server = Server::new(Device::new(counter, [variable])).bcap_tcp("127.0.0.1:0").await.unwrap();
    let address = server.addresses().bcap_tcp[0];
    tokio::spawn(async move { drop(server.run(std::future::pending()).await) });
    address
}

/// A fleet in this process.
pub(crate) struct Running {
    pub(crate) metrics: Option<SocketAddr>,
    pub(crate) events: Arc<Mutex<Vec<Event>>>,
    end: oneshot::Sender<()>,
    task: JoinHandle<()>,
    began: Instant,
}

impl Running {
    pub(crate) async fn start(config: &str) -> Self {
        let events: Arc<Mutex<Vec<Event>>> = Arc::default();
        let log = Arc::clone(&events);
        let config = Config::parse(config).unwrap();
        let fleet = Fleet::start(config, move |event| log.lock().unwrap().push(event.clone())).await.unwrap();
        let metrics = fleet.metrics_address();
        let (end, ended) = oneshot::channel();
        let task = tokio::spawn(fleet.run(async { drop(ended.await) }));
        Self { metrics, events, end, task, began: Instant::now() }
    }

    /// Waits until commands of Sparkplug cannot be commands of an earlier process.
    pub(crate) async fn accepts_commands(&self) {
        tokio::time::sleep_until(self.began + Duration::from_millis(1010)).await;
    }

    pub(crate) async fn stop(self) -> Vec<Event> {
        self.end.send(()).unwrap();
        timeout(LIMIT, self.task).await.unwrap().unwrap();
        self.events.lock().unwrap().clone()
    }

    /// Ends the fleet as a crash does.
    pub(crate) async fn abort(self) {
        self.task.abort();
        let _ = self.task.await;
    }

    /// Waits for an event that a function accepts.
    pub(crate) async fn event(&self, accept: impl Fn(&Event) -> bool) {
        let arrived = async {
            while !self.events.lock().unwrap().iter().any(&accept) {
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
        };
        timeout(LIMIT, arrived).await.expect("no event arrived in time");
    }

    /// Returns a number of the metrics.
    pub(crate) async fn metric(&self, name: &str) -> u64 {
        let text = http(self.metrics.unwrap(), "GET /metrics").await;
        let line = text.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap_or_else(|| panic!("{text}"));
        line.rsplit(' ').next().unwrap().parse().unwrap()
    }
}

/// Sends a request, such as `GET /metrics`, to the server of metrics.
pub(crate) async fn http(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(format!("{request} HTTP/1.1\r\nHost: x\r\n\r\n").as_bytes()).await.unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).await.unwrap();
    text
}

/// A received message.
pub(crate) struct Publish {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) retain: bool,
}

/// A subscriber whose session outlasts a restart of the broker.
pub(crate) struct Subscriber {
    pub(crate) client: AsyncClient,
    messages: mpsc::UnboundedReceiver<Publish>,
    task: JoinHandle<()>,
}

impl Drop for Subscriber {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Subscriber {
    /// Subscribes, and waits until the broker has confirmed it.
    pub(crate) async fn start(port: u16, topic: &str) -> Self {
        let mut options = MqttOptions::new(format!("subscriber-{}", free_port()), ("127.0.0.1", port));
        options.set_clean_session(false).set_max_packet_size(1 << 20, 8 << 20);
        let (client, mut events) = AsyncClient::builder(options).capacity(100).build();
        client.subscribe(topic, QoS::AtLeastOnce).await.unwrap();
        let (again, topic) = (client.clone(), topic.to_owned());
        let (sender, messages) = mpsc::unbounded_channel();
        let (confirm, confirmed) = oneshot::channel();
        let mut confirm = Some(confirm);
        let task = tokio::spawn(async move {
            loop {
                match events.poll().await {
                    Ok(Mqtt::Incoming(Packet::Publish(publish))) => {
                        let topic = String::from_utf8(publish.topic.to_vec()).unwrap();
                        let (payload, retain) = (publish.payload.to_vec(), publish.retain);
                        drop(sender.send(Publish { topic, payload, retain }));
                    }
                    // a broker that was killed has lost the session
                    Ok(Mqtt::Incoming(Packet::ConnAck(ack))) if !ack.session_present && confirm.is_none() => {
                        let _ = again.try_subscribe(topic.as_str(), QoS::AtLeastOnce);
                    }
                    Ok(Mqtt::Incoming(Packet::SubAck(_))) => drop(confirm.take().map(|confirm| confirm.send(()))),
                    Ok(_) => {}
                    // the broker is away
                    Err(_) => tokio::time::sleep(Duration::from_millis(5)).await,
                }
            }
        });
        timeout(LIMIT, confirmed).await.unwrap().unwrap();
        Self { client, messages, task }
    }

    pub(crate) async fn next(&mut self) -> Publish {
        timeout(LIMIT, self.messages.recv()).await.expect("no message arrived in time").unwrap()
    }

    /// Waits for a message that a function accepts, and returns its result.
    pub(crate) async fn find<T>(&mut self, mut accept: impl FnMut(&Publish) -> Option<T>) -> T {
        // other messages may arrive endlessly
        let found = async {
            loop {
                if let Some(found) = accept(&self.next().await) {
                    return found;
                }
            }
        };
        timeout(LIMIT * 4, found).await.expect("the message did not arrive in time")
    }

    /// Waits for a message on a topic whose JSON a function accepts.
    pub(crate) async fn json(&mut self, topic: &str, accept: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
        self.find(|publish| {
            let json = || serde_json::from_slice::<serde_json::Value>(&publish.payload).unwrap();
            (publish.topic == topic).then(json).filter(&accept)
        })
        .await
    }

    pub(crate) async fn publish(&self, topic: &str, payload: impl Into<Vec<u8>>) {
        self.client.publish(topic, payload.into(), PublishOptions::at_least_once()).await.unwrap();
    }

    pub(crate) async fn retain(&self, topic: &str, payload: impl Into<Vec<u8>>) {
        self.client.publish(topic, payload.into(), PublishOptions::at_least_once().retained()).await.unwrap();
    }
}

/// Forwards connections to a server of b-CAP, except requests with one of these texts while `muted`. Returns the port.
pub(crate) async fn muting_proxy(to: SocketAddr, texts: &[&str], muted: &Arc<AtomicBool>) -> u16 {
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let utf16 = |text: &&str| text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let (texts, muted): (Vec<Vec<u8>>, _) = (texts.iter().map(utf16).collect(), Arc::clone(muted));
    tokio::spawn(async move {
        loop {
            let (client, _) = listener.accept().await.unwrap();
            let (mut from_client, mut to_client) = client.into_split();
            let (mut from_server, mut to_server) = TcpStream::connect(to).await.unwrap().into_split();
            tokio::spawn(async move { tokio::io::copy(&mut from_server, &mut to_client).await });
            let (texts, muted) = (texts.clone(), Arc::clone(&muted));
            tokio::spawn(async move {
                // SOH and the length of the frame
                let mut frame = vec![0; field::LENGTH.end];
                while from_client.read_exact(&mut frame).await.is_ok() {
                    let length = Header::read_length(&frame).unwrap();
                    frame.resize(length.try_into().unwrap(), 0);
                    from_client.read_exact(&mut frame[field::LENGTH.end..]).await.unwrap();
                    let has = |text: &Vec<u8>| frame.windows(text.len()).any(|part| part == text);
                    if !(muted.load(Ordering::SeqCst) && texts.iter().any(has)) {
                        to_server.write_all(&frame).await.unwrap();
                    }
                    frame.truncate(5);
                }
            });
        }
    });
    port
}

/// Returns the time in milliseconds since 1970.
pub(crate) fn now_ms() -> u64 {
    let time = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    time.as_millis().try_into().unwrap()
}

/// A temporary folder, and its path.
pub(crate) fn folder() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_owned();
    (folder, path)
}
