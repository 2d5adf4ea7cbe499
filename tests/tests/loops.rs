//! Tests that blocking, tokio and core loops behave the same: one script of calls gives the same record over each of them,
//! on TCP, on UDP and without sockets.

use bcap_core::bcap::call::{self, Call, RawCall, VariableHandle};
use bcap_core::bcap::client::{Client, Config};
use bcap_core::bcap::header::field;
use bcap_core::bcap::server::{self, Session};
use bcap_core::bcap::{FunctionId, Link};
use bcap_core::endpoint::{Endpoint, Serve};
use bcap_core::handler::PeerId;
use bcap_core::io::{CallError, asynch, blocking};
use bcap_core::time::Instant;
use bcap_std::server::Limits;
use bcap_std::{Options, asynch as tokio_clients, blocking as std_clients};
use bcap_testkit::network::Random;
use bcap_tests::served::{Application, Served};

/// Makes the calls of the script and returns the outcome of each; `$wait` is `.await` or empty.
macro_rules! script {
    ($client:expr, $name:literal $(, $wait:tt)?) => {{
        let client = &mut $client;
        let mut record = Vec::new();
        macro_rules! note {
            ($call:expr) => {{
                let result = client.call($call)$(.$wait)?;
                record.push(format!("{:?}", result.as_ref().map_err(without_io)));
                record.push(format!("{:?}", client.last_result()));
            }};
        }
        note!(call::service_start("WDT=79"));
        note!(call::service_start("WDT=100"));
        let controller = client.call(call::controller_connect("", "", "", ""))$(.$wait)?.unwrap();
        let variable = client.call(call::controller_get_variable(controller, $name, ""))$(.$wait)?.unwrap();
        note!(call::variable_get_value(variable));
        note!(call::variable_put_value(variable, ([1.5_f64; 8], "naïve 😀", true, ())));
        note!(call::variable_get_value(variable));
        // refused by the session, refused by the handler, no such function
        note!(call::variable_get_value(VariableHandle(9999)));
        note!(call::controller_get_tag(controller));
        note!(RawCall { function: FunctionId(138), arguments: &[] });
        note!(RawCall { function: FunctionId::VARIABLE_PUT_VALUE, arguments: &[&"no handle", &1_i32] });
        note!(RawCall { function: FunctionId::VARIABLE_PUT_VALUE, arguments: &[] });
        // a value of another type than the function gives
        note!(call::controller_get_name(controller));
        // one that runs for longer than the interval of S_EXECUTING
        note!(call::controller_execute(controller, "Sleep", 250_i32));
        note!(call::variable_release(variable));
        note!(call::variable_release(variable));
        note!(call::controller_disconnect(controller));
        note!(call::service_stop());
        record
    }};
}

/// Errors of the transport differ between transports, all others must not.
fn without_io<E>(error: &CallError<E>) -> String {
    match error {
        CallError::Io(_) => "Io".to_owned(),
        CallError::Disconnected => "Disconnected".to_owned(),
        CallError::Client(error) => format!("{error:?}"),
        CallError::Refused(code) => format!("{code:?}"),
        _ => panic!("another kind of error"),
    }
}

/// A transport without sockets: it contains the server, and bytes arrive in pieces.
struct Direct {
    session: Session<[u8; 1024]>,
    application: Application,
    now: Instant,
    random: Random,
}

impl Direct {
    fn new(config: server::Config) -> Self {
        let session = Session::new(config, [0; 1024], [0; 1024]);
        Self { session, application: Application::default(), now: Instant::from_millis(1), random: Random(9) }
    }

    /// Delivers a datagram or a piece of a stream to the server.
    fn put(&mut self, bytes: &[u8], link: Link) -> usize {
        let count =
            if link == Link::Datagram { bytes.len() } else { 1 + self.random.below(bytes.len() as u64) as usize };
        self.session.receive_buffer()[..count].copy_from_slice(&bytes[..count]);
        self.session.received(count);
        count
    }

    /// Receives a datagram or a piece of a stream from the server; lets time pass until one arrives.
    fn take(&mut self, buffer: &mut [u8], until: Instant, link: Link) -> Option<usize> {
        loop {
            while self.session.run(&mut self.application, PeerId(1), self.now).is_some() {}
            let bytes = self.session.transmit();
            if !bytes.is_empty() {
                let all = bytes.len().min(buffer.len());
                let count = if link == Link::Datagram { all } else { 1 + self.random.below(all as u64) as usize };
                buffer[..count].copy_from_slice(&bytes[..count]);
                self.session.transmitted(count);
                return Some(count);
            }
            // time passes until the server's or the client's next timeout
            match self.session.poll_timeout().filter(|deadline| *deadline < until) {
                Some(deadline) => self.now = deadline,
                None => {
                    self.now = self.now.max(until);
                    return None;
                }
            }
        }
    }
}

/// The transport with its link, for both loops.
struct Wire(Direct, Link);

impl blocking::Transport for Wire {
    type Error = std::convert::Infallible;

    fn now(&self) -> Instant {
        self.0.now
    }

    fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Self::Error> {
        Ok(Some(self.0.put(bytes, self.1)))
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error> {
        Ok(self.0.take(buffer, until, self.1))
    }

    fn sleep_until(&mut self, at: Instant) {
        self.0.now = self.0.now.max(at);
    }
}

impl asynch::Transport for Wire {
    type Error = std::convert::Infallible;

    fn now(&self) -> Instant {
        self.0.now
    }

    async fn send(&mut self, bytes: &[u8], _: Instant) -> Result<Option<usize>, Self::Error> {
        Ok(Some(self.0.put(bytes, self.1)))
    }

    async fn receive(&mut self, buffer: &mut [u8], until: Instant) -> Result<Option<usize>, Self::Error> {
        Ok(self.0.take(buffer, until, self.1))
    }

    async fn sleep_until(&mut self, at: Instant) {
        self.0.now = self.0.now.max(at);
    }
}

fn client(config: Config) -> Client<[u8; 512]> {
    Client::new(config, [0; 512], [0; 512])
}

#[tokio::test]
async fn one_script_gives_one_record_over_every_loop() {
    let expected = {
        let wire = Wire(Direct::new(server::Config::TCP), Link::Stream);
        script!(blocking::Connection::new(wire, client(Config::TCP)), "A")
    };
    // the expected content of the record, in a few places
    let all = expected.join("\n");
    for part in ["E_INVALIDARG", "E_HANDLE", "E_NOTIMPL", "E_INVALIDARGTYPE", "R8[1.5, 1.5,", "naïve 😀", "ReplyError"]
    {
        assert!(all.contains(part), "no {part} in\n{all}");
    }
    assert_eq!(expected.len(), 32);

    let wire = Wire(Direct::new(server::Config::UDP), Link::Datagram);
    assert_eq!(
        script!(blocking::Connection::new(wire, client(Config::UDP)), "A"),
        expected,
        "core, blocking, datagrams"
    );
    let wire = Wire(Direct::new(server::Config::TCP), Link::Stream);
    assert_eq!(
        script!(asynch::Connection::new(wire, client(Config::TCP)), "A", await),
        expected,
        "core, asynch, stream"
    );
    let wire = Wire(Direct::new(server::Config::UDP), Link::Datagram);
    assert_eq!(
        script!(asynch::Connection::new(wire, client(Config::UDP)), "A", await),
        expected,
        "core, asynch, datagrams"
    );

    // each loop over sockets uses a separate variable, because the server keeps the values
    let (server, options) = (Served::start(Limits::default()), Options::default());
    let mut tcp = tokio_clients::connect_tcp(server.tcp, &options).await.unwrap();
    assert_eq!(script!(tcp, "A", await), expected, "tokio, TCP");
    let mut udp = tokio_clients::connect_udp(server.udp, &options).await.unwrap();
    assert_eq!(script!(udp, "B", await), expected, "tokio, UDP");
    let blocking = tokio::task::spawn_blocking(move || {
        let mut tcp = std_clients::connect_tcp(server.tcp, &options).unwrap();
        let mut udp = std_clients::connect_udp(server.udp, &options).unwrap();
        [script!(tcp, "C"), script!(udp, "D")]
    });
    let [tcp, udp] = blocking.await.unwrap();
    assert_eq!(tcp, expected, "blocking, TCP");
    assert_eq!(udp, expected, "blocking, UDP");
}

#[test]
fn a_call_is_the_same_bytes_from_every_client() {
    let call = call::variable_put_value(VariableHandle(3), [1.0_f64; 8]);
    let bytes = |config: Config| {
        let mut client = client(config);
        client.start(&call, client.timing(), Instant::ZERO).unwrap();
        client.transmit().to_vec()
    };
    let (tcp, mut udp) = (bytes(Config::TCP), bytes(Config::UDP));
    assert_eq!(udp[field::RESERVED], [1, 0], "the marker of a first attempt");
    udp[field::RESERVED].fill(0);
    assert_eq!(tcp, udp);
    assert_eq!(call.function(), FunctionId::VARIABLE_PUT_VALUE);
}
