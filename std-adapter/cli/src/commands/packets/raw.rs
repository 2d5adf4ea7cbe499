//! `bcap raw`: sends packets as they are written, and shows each reply.

use std::io::{self, BufRead, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::Duration;

use bcap_capture::trace::{self, Level, Wire};
use bcap_capture::{Role, frame, hex};
use bcap_core::bcap::Decoder;
use bcap_core::hresult::HResult;
use bcap_std::{Address, Protocol, blocking};
use clap::Args;

use crate::failure::{Failure, item_to_json};
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;
use crate::listen::{self, taken};
use crate::output::{print_block, print_json, print_line};
use crate::session::Session;
use crate::session::budget::Budget;
use crate::session::connect::{broken, not_connected};

/// Sends packets as they are written, and shows each reply
///
/// It opens a separate connection, in the shell and in scripts too, so the handles of their session are not valid in it. It starts
/// no service and changes no byte: serial numbers, handles and errors are the writer's. PACKET is hexadecimal
/// digits, as for `bcap decode`, or JSON, as for `bcap decode --reverse`; one PACKET may hold several frames of hexadecimal digits.
/// Without PACKET, or with `-`, each line of the standard input is one. After each packet the command waits for its reply, at
/// most for --timeout. Keep-alives (S_EXECUTING) are shown; without --timeout each of them allows another 3 s.
///
/// It undoes nothing at its end, not even after Ctrl-C: an arm that a packet takes stays taken, a motor stays on, a robot goes on
/// moving. `bcap halt`, `bcap call` and `bcap exec` end safely.
///
/// With --listen it is the server: it waits for a client, and answers each request with the next packet.
#[derive(Debug, Args)]
#[command(after_help = r#"Examples:
  bcap raw '{"name":"ServiceStart","args":[{"vt":8,"v":""}]}' '{"name":"ServiceStop","serial":2}'
  bcap raw 01100000000100000002000000000004 --robot udp:192.168.0.1 --loop 10
  bcap raw --listen udp:127.0.0.1:5007 '{"code":0}'"#)]
pub(crate) struct Raw {
    /// The packets
    #[arg(value_name = "PACKET")]
    pub(crate) packets: Vec<String>,

    /// Sends all packets this number of times; Ctrl-C ends that
    #[arg(long = "loop", value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) rounds: u64,

    /// Waits for a client at tcp:ADDRESS:PORT or udp:ADDRESS:PORT instead of connecting; port 0 takes a free one. Prints
    /// `ready` and the address
    #[arg(long, value_name = "ADDRESS", value_parser = listen::address)]
    pub(crate) listen: Option<(Protocol, SocketAddr)>,

    /// Prints only the reply to the last packet of each round
    #[arg(long)]
    pub(crate) last: bool,
}

/// The longest wait between two looks for a signal.
const STEP: Duration = Duration::from_millis(50);
/// The longest wait for a peer that reads nothing.
const SEND: Duration = Duration::from_secs(10);
/// The largest datagram.
const DATAGRAM: usize = 65_535;

/// Runs `bcap raw`.
pub(crate) fn raw(args: &Raw, session: &mut Session, json: bool) -> Result<(), Failure> {
    let listens = args.listen.is_some();
    let own = if listens { Role::Response } else { Role::Request };
    let packets = packets(&args.packets, own)?;
    let interrupt = session.handle_signals()?;
    let link = session.link();
    let peer = match &args.listen {
        Some((protocol, local)) => Peer::listen(*protocol, *local, &interrupt)?,
        None => Peer::connect(link)?,
    };
    let mut talk = Talk { peer, received: Vec::new(), interrupt, budget: Budget::start(link), json };
    for _ in 0..args.rounds {
        for (index, packet) in packets.iter().enumerate() {
            talk.check()?;
            let shows = !args.last || index + 1 == packets.len();
            if listens { talk.answer(packet, shows)? } else { talk.ask(index + 1, packet, shows)? }
        }
    }
    Ok(())
}

/// Parses the packets of the command line or of the lines of the standard input.
fn packets(words: &[String], role: Role) -> Result<Vec<Vec<u8>>, Failure> {
    let lines;
    let words = if words.is_empty() || words == ["-"] {
        lines = io::stdin().lock().lines().collect::<Result<Vec<_>, _>>()?;
        &lines
    } else {
        words
    };
    let mut packets = Vec::new();
    for word in words.iter().filter(|word| !word.trim().is_empty()) {
        if word.trim_start().starts_with('{') {
            packets.push(frame::from_json(word, role, false).map_err(Failure::Item)?);
        } else {
            let mut rest = hex::parse(word.as_bytes()).map_err(Failure::Item)?;
            // bytes that are not a frame are sent as they are
            while let Some(length) = trace::packet_length(&rest, Wire::Stream).filter(|length| *length < rest.len()) {
                let after = rest.split_off(length);
                packets.push(std::mem::replace(&mut rest, after));
            }
            packets.push(rest);
        }
    }
    if packets.is_empty() { Err(Failure::Input("there is no packet to send".into())) } else { Ok(packets) }
}

/// The other end.
enum Peer {
    Tcp(TcpStream),
    Udp(UdpSocket),
    /// A socket that listens; the client is known from its first datagram on.
    UdpServer(UdpSocket, Option<SocketAddr>),
}

impl Peer {
    fn connect(link: &LinkArgs) -> Result<Self, Failure> {
        let (server, budget) = (link.network_target()?, Budget::start(link));
        let target = Address::Network(server.clone());
        let addresses = blocking::resolve(&server, budget.left()).map_err(|error| not_connected(&error, &target))?;
        let failed = |error| broken(&error, &target);
        let mut last = io::Error::from(io::ErrorKind::NotFound);
        for address in addresses {
            let peer = match server.protocol {
                Protocol::Tcp => TcpStream::connect_timeout(&address, link.timeout())
                    .and_then(|stream| stream.set_nodelay(true).map(|()| Self::Tcp(stream))),
                Protocol::Udp => {
                    let any = if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
                    UdpSocket::bind(any).and_then(|socket| socket.connect(address).map(|()| Self::Udp(socket)))
                }
            };
            match peer {
                Ok(peer) => return peer.with_steps().map_err(failed),
                Err(error) => last = error,
            }
        }
        Err(failed(last))
    }

    /// Listens, and waits for a TCP client.
    fn listen(protocol: Protocol, local: SocketAddr, interrupt: &Interrupt) -> Result<Self, Failure> {
        let failed = |error| taken("--listen", local, &error);
        match protocol {
            Protocol::Udp => {
                let socket = UdpSocket::bind(local).map_err(failed)?;
                print_line(&format!("ready udp:{}", socket.local_addr().map_err(failed)?))?;
                Self::UdpServer(socket, None).with_steps().map_err(failed)
            }
            Protocol::Tcp => {
                let listener = TcpListener::bind(local).map_err(failed)?;
                print_line(&format!("ready tcp:{}", listener.local_addr().map_err(failed)?))?;
                listener.set_nonblocking(true).map_err(failed)?;
                loop {
                    match listener.accept() {
                        Ok((stream, _)) => {
                            stream.set_nonblocking(false).map_err(failed)?;
                            return Self::Tcp(stream).with_steps().map_err(failed);
                        }
                        Err(error) if error.kind() == io::ErrorKind::WouldBlock => interrupt.sleep(STEP)?,
                        Err(error) => return Err(failed(error)),
                    }
                }
            }
        }
    }

    /// Limits each wait, so that signals are noticed.
    fn with_steps(self) -> io::Result<Self> {
        match &self {
            Self::Tcp(stream) => {
                stream.set_read_timeout(Some(STEP)).and_then(|()| stream.set_write_timeout(Some(SEND)))
            }
            Self::Udp(socket) | Self::UdpServer(socket, _) => socket.set_read_timeout(Some(STEP)),
        }?;
        Ok(self)
    }

    const fn wire(&self) -> Wire {
        match self {
            Self::Tcp(_) => Wire::Stream,
            Self::Udp(_) | Self::UdpServer(..) => Wire::Datagrams,
        }
    }

    fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => stream.write_all(packet),
            Self::Udp(socket) => socket.send(packet).map(drop),
            Self::UdpServer(socket, Some(client)) => socket.send_to(packet, *client).map(drop),
            Self::UdpServer(_, None) => Ok(()),
        }
    }

    /// Receives bytes; 0 at the end of a TCP connection.
    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.read(buffer),
            Self::Udp(socket) => socket.recv(buffer),
            Self::UdpServer(socket, client) => {
                let (length, from) = socket.recv_from(buffer)?;
                *client = Some(from);
                Ok(length)
            }
        }
    }
}

/// The exchange of packets with the other end.
struct Talk {
    peer: Peer,
    /// Received bytes that are not a packet yet.
    received: Vec<u8>,
    interrupt: Interrupt,
    budget: Budget,
    json: bool,
}

impl Talk {
    /// Sends a packet and waits for its reply.
    fn ask(&mut self, number: usize, packet: &[u8], shows: bool) -> Result<(), Failure> {
        self.show(Role::Request, packet, shows)?;
        self.budget.restart();
        self.peer.send(packet).map_err(lost)?;
        let mut only = "";
        loop {
            let limit = self.budget.left().unwrap_or(self.budget.answer());
            let Some(reply) = self.receive(Some(limit))? else {
                let limit = self.budget.answer().as_millis();
                return Err(Failure::Timeout {
                    message: format!("no reply to packet {number} within {limit} ms{only}"),
                    hint: "a server drops packets that are not frames; allow more time with --timeout".into(),
                });
            };
            self.show(Role::Response, &reply, shows)?;
            let code = Decoder::TCP.decode_datagram(&reply).map(|frame| frame.hresult());
            if code != Ok(HResult::S_EXECUTING) {
                return Ok(());
            }
            only = ", only keep-alives (S_EXECUTING)";
        }
    }

    /// Waits for a request and sends a packet.
    fn answer(&mut self, packet: &[u8], shows: bool) -> Result<(), Failure> {
        if let Some(request) = self.receive(None)? {
            self.show(Role::Request, &request, shows)?;
            self.show(Role::Response, packet, shows)?;
            self.peer.send(packet).map_err(lost)?;
        }
        Ok(())
    }

    /// Receives a packet; `None` after the time limit.
    fn receive(&mut self, limit: Option<Duration>) -> Result<Option<Vec<u8>>, Failure> {
        let began = std::time::Instant::now();
        let mut buffer = vec![0; DATAGRAM];
        loop {
            // first, because a peer can send packets without end
            self.check()?;
            if limit.is_some_and(|limit| began.elapsed() >= limit) {
                return Ok(None);
            }
            if let Some(length) = trace::packet_length(&self.received, self.peer.wire()) {
                let rest = self.received.split_off(length);
                return Ok(Some(std::mem::replace(&mut self.received, rest)));
            }
            match self.peer.receive(&mut buffer) {
                Ok(0) if self.peer.wire() == Wire::Stream => {
                    return Err(lost(io::ErrorKind::ConnectionAborted.into()));
                }
                Ok(length) => self.received.extend_from_slice(buffer.get(..length).unwrap_or_default()),
                Err(error) if is_timeout(&error) => {}
                Err(error) => return Err(lost(error)),
            }
        }
    }

    fn check(&self) -> Result<(), Failure> {
        self.interrupt.check("interrupted")
    }

    /// Prints a packet: with its bytes, or as `bcap decode --json` does.
    fn show(&self, role: Role, packet: &[u8], shows: bool) -> Result<(), Failure> {
        if !shows {
            return Ok(());
        }
        if self.json {
            let line = match Decoder::TCP.decode_datagram(packet) {
                Ok(frame) => frame::to_json(&frame, role),
                Err(error) => item_to_json(&error.into()),
            };
            return Ok(print_json(&line)?);
        }
        let text = trace::shown(role, self.peer.wire(), packet, Level::Bytes);
        Ok(print_block(&trace::with_arrow(role.arrow(), &text))?)
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted)
}

fn lost(error: io::Error) -> Failure {
    Failure::Connection {
        message: format!("the connection failed: {error}"),
        hint: "a b-CAP server closes a connection after an invalid packet".into(),
    }
}
