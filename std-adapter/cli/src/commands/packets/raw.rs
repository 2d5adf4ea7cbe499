//! `bcap raw`: sends packets as they are written, and shows each reply.

use std::io::{self, BufReader};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::time::Duration;

use bcap_capture::trace::{self, Level, Wire};
use bcap_capture::value::to_json;
use bcap_capture::{Role, frame, hex};
use bcap_core::bcap::{Decoder, Frame};
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;
use bcap_std::Protocol;
use bcap_std::blocking::{self, TcpTransport, Transport};
use clap::Args;

use crate::failure::{Failure, item_to_json};
use crate::input::Lines;
use crate::interrupt::Interrupt;
use crate::link::LinkArgs;
use crate::listen::{self, taken};
use crate::output::{print_block, print_json, print_line};
use crate::session::Session;
use crate::session::budget::Budget;
use crate::session::connect::connect;

/// Sends packets as they are written, and shows each reply
///
/// It opens a separate connection, in the shell and in scripts too, so the handles of their session are not valid in it. It starts
/// no service and changes no byte: serial numbers, handles and errors are the writer's. PACKET is hexadecimal
/// digits, as for `bcap decode`, or JSON, as for `bcap decode --reverse`; one PACKET may hold several frames of hexadecimal digits.
/// Without PACKET, or with `-`, each line of the standard input is one, sent as soon as it is there. After each packet the command
/// waits for its reply, at most for --timeout. Keep-alives (S_EXECUTING) are shown; without --timeout each of them allows another
/// 3 s.
///
/// In a PACKET $2 is the value of the reply to packet 2, such as a handle: as JSON has it, or its I4 as four bytes.
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

/// Maximum wait between two checks for a signal.
const STEP: Duration = Duration::from_millis(50);
/// Maximum wait for a peer that does not read.
const SEND: Duration = Duration::from_secs(10);
/// The largest datagram.
const DATAGRAM: usize = 65_535;

/// Runs `bcap raw`.
pub(crate) fn raw(args: &Raw, session: &mut Session, json: bool) -> Result<(), Failure> {
    let interrupt = session.handle_signals()?;
    let lines = (args.packets.is_empty() || args.packets == ["-"]).then(|| Lines::read(BufReader::new(io::stdin())));
    let lines = lines.transpose()?;
    // otherwise the input is read to its end, to find its last line, and to repeat it
    let is_live = args.listen.is_none() && !args.last && args.rounds == 1;
    let mut words = if lines.is_some() { Vec::new() } else { args.packets.clone() };
    while let Some(line) =
        lines.as_ref().filter(|_| !is_live || words.is_empty()).map_or(Ok(None), |l| l.next(&interrupt))?
    {
        words.extend(Some(line).filter(|line| !line.trim().is_empty()));
    }
    if words.is_empty() {
        return Err(Failure::Input("there is no packet to send".into()));
    }
    let role = if args.listen.is_some() { Role::Response } else { Role::Request };
    words.iter().try_for_each(|word| packets(&filled(word, None)?, role).map(drop))?;
    let link = session.link();
    let peer = match &args.listen {
        Some((protocol, local)) => Peer::listen(*protocol, *local, &interrupt)?,
        None => Peer::connect(link)?,
    };
    let (received, replies) = (Vec::new(), Vec::new());
    let mut talk = Talk { peer, role, received, replies, interrupt, budget: Budget::start(link), json };
    for _ in 0..args.rounds {
        talk.replies.clear();
        for (index, word) in words.iter().enumerate() {
            talk.word(word, !args.last, index + 1 == words.len())?;
        }
    }
    while let Some(line) = lines.as_ref().map_or(Ok(None), |lines| lines.next(&talk.interrupt))? {
        if !line.trim().is_empty() {
            talk.word(&line, true, true)?;
        }
    }
    Ok(())
}

/// Replaces `$N` by the value of the reply to packet N, or by a zero before there are replies.
fn filled(text: &str, replies: Option<&[Option<String>]>) -> Result<String, Failure> {
    let mut parts = text.split('$');
    let mut filled = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let digits = part.len() - part.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let (number, rest) = part.split_at(digits);
        let Ok(number) = number.parse::<usize>() else {
            filled += &format!("${part}");
            continue;
        };
        let value = match (number.checked_sub(1), replies) {
            (Some(_), None) => Some("0"),
            (Some(at), Some(replies)) => replies.get(at).and_then(Option::as_deref),
            (None, _) => None,
        };
        let value = value.ok_or_else(|| Failure::Input(format!("${number}: reply {number} has no value")))?;
        let is_json = text.trim_start().starts_with('{');
        match (is_json, value.parse::<i32>()) {
            (true, _) => filled += value,
            (false, Ok(handle)) => filled += &hex::spaced(&handle.to_le_bytes()),
            (false, Err(_)) => return Err(Failure::Input(format!("${number}: {value} is not an I4"))),
        }
        filled += rest;
    }
    Ok(filled)
}

/// Returns the `v` of a value in JSON.
fn data_of(value: Variant<'_>) -> String {
    let json = serde_json::from_str(&to_json(value));
    json.map_or_else(|_| String::new(), |json: serde_json::Value| json["v"].to_string())
}

/// Parses a PACKET: one of JSON, or several of hexadecimal digits.
fn packets(word: &str, role: Role) -> Result<Vec<Vec<u8>>, Failure> {
    if word.trim_start().starts_with('{') {
        return Ok(vec![frame::from_json(word, role, false).map_err(Failure::Item)?]);
    }
    let mut packets = Vec::new();
    let mut rest = hex::parse(word.as_bytes()).map_err(Failure::Item)?;
    // bytes that are not a frame are sent as they are
    while let Some(length) = trace::packet_length(&rest, Wire::Stream).filter(|length| *length < rest.len()) {
        let after = rest.split_off(length);
        packets.push(std::mem::replace(&mut rest, after));
    }
    packets.push(rest);
    Ok(packets)
}

/// The other end.
enum Peer {
    Connected(Box<dyn Transport<Error = io::Error>>, Wire),
    /// A socket that listens; the client is known from its first datagram on.
    UdpServer(UdpSocket, Option<SocketAddr>),
}

impl Peer {
    fn connect(link: &LinkArgs) -> Result<Self, Failure> {
        let server = link.network_target()?;
        connect(&server, &Budget::start(link), |peer, options| match server.protocol {
            Protocol::Tcp => {
                let transport = blocking::connect_tcp(peer, options)?.into_parts().0;
                Ok(Self::Connected(Box::new(transport), Wire::Stream))
            }
            Protocol::Udp => {
                let transport = blocking::connect_udp(peer, options)?.into_parts().0;
                Ok(Self::Connected(Box::new(transport), Wire::Datagrams))
            }
        })
    }

    /// Listens, and waits for a TCP client.
    fn listen(protocol: Protocol, local: SocketAddr, interrupt: &Interrupt) -> Result<Self, Failure> {
        let failed = |error| taken("--listen", local, &error);
        if protocol == Protocol::Udp {
            let socket = UdpSocket::bind(local).map_err(failed)?;
            print_line(&format!("ready udp:{}", socket.local_addr().map_err(failed)?))?;
            // signals are checked between two waits
            socket.set_read_timeout(Some(STEP)).map_err(failed)?;
            return Ok(Self::UdpServer(socket, None));
        }
        let listener = TcpListener::bind(local).map_err(failed)?;
        print_line(&format!("ready tcp:{}", listener.local_addr().map_err(failed)?))?;
        listener.set_nonblocking(true).map_err(failed)?;
        loop {
            match listener.accept() {
                Ok((stream, _)) => {
                    stream.set_nonblocking(false).map_err(failed)?;
                    return Ok(Self::Connected(Box::new(TcpTransport::new(stream)), Wire::Stream));
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => interrupt.sleep(STEP)?,
                Err(error) => return Err(failed(error)),
            }
        }
    }

    const fn wire(&self) -> Wire {
        match self {
            Self::Connected(_, wire) => *wire,
            Self::UdpServer(..) => Wire::Datagrams,
        }
    }

    fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        let (until, mut rest) = (bcap_std::now() + SEND, packet);
        match self {
            Self::Connected(transport, _) => {
                while !rest.is_empty() {
                    let sent = transport.send(rest, until)?.ok_or(io::ErrorKind::TimedOut)?;
                    rest = rest.get(sent..).unwrap_or_default();
                }
                Ok(())
            }
            Self::UdpServer(socket, Some(client)) => socket.send_to(packet, *client).map(drop),
            Self::UdpServer(_, None) => Ok(()),
        }
    }

    /// Receives bytes; 0 at the end of a TCP connection, `None` after a moment without any.
    fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        match self {
            Self::Connected(transport, _) => transport.receive(buffer, bcap_std::now() + STEP),
            Self::UdpServer(socket, client) => match socket.recv_from(buffer) {
                Ok((length, from)) => {
                    *client = Some(from);
                    Ok(Some(length))
                }
                Err(error) if is_timeout(&error) => Ok(None),
                Err(error) => Err(error),
            },
        }
    }
}

/// The exchange of packets with the other end.
struct Talk {
    peer: Peer,
    /// The role of this end: it sends requests or responses.
    role: Role,
    /// Received bytes that are not a packet yet.
    received: Vec<u8>,
    interrupt: Interrupt,
    budget: Budget,
    json: bool,
    /// The value of each reply, as JSON.
    replies: Vec<Option<String>>,
}

impl Talk {
    /// Sends the packets of a word. Shows all if `shows_all`, otherwise only the last packet of the last word.
    fn word(&mut self, word: &str, shows_all: bool, is_last: bool) -> Result<(), Failure> {
        let packets = packets(&filled(word, Some(&self.replies))?, self.role)?;
        for (index, packet) in packets.iter().enumerate() {
            self.interrupt.check("interrupted")?;
            let shows = shows_all || is_last && index + 1 == packets.len();
            if self.role == Role::Response { self.answer(packet, shows)? } else { self.ask(packet, shows)? }
        }
        Ok(())
    }

    /// Sends a packet and waits for its reply.
    fn ask(&mut self, packet: &[u8], shows: bool) -> Result<(), Failure> {
        self.show(Role::Request, packet, shows)?;
        self.budget.restart();
        self.peer.send(packet).map_err(lost)?;
        let mut only = "";
        loop {
            let limit = self.budget.left().unwrap_or(self.budget.answer());
            let Some(reply) = self.receive(Some(limit))? else {
                let (number, limit) = (self.replies.len() + 1, self.budget.answer().as_millis());
                return Err(Failure::Timeout {
                    message: format!("no reply to packet {number} within {limit} ms{only}"),
                    hint: "a server drops packets that are not frames; allow more time with --timeout".into(),
                });
            };
            self.show(Role::Response, &reply, shows)?;
            let frame = Decoder::TCP.decode_datagram(&reply);
            if frame.as_ref().map(Frame::hresult) != Ok(HResult::S_EXECUTING) {
                let value = frame.ok().and_then(|frame| frame.args.get(0));
                self.replies.push(value.map(data_of));
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
            // first, because a peer can send packets endlessly
            self.interrupt.check("interrupted")?;
            if limit.is_some_and(|limit| began.elapsed() >= limit) {
                return Ok(None);
            }
            if let Some(length) = trace::packet_length(&self.received, self.peer.wire()) {
                let rest = self.received.split_off(length);
                return Ok(Some(std::mem::replace(&mut self.received, rest)));
            }
            match self.peer.receive(&mut buffer) {
                Ok(None) => {}
                Ok(Some(0)) if self.peer.wire() == Wire::Stream => {
                    return Err(lost(io::ErrorKind::ConnectionAborted.into()));
                }
                Ok(Some(length)) => self.received.extend_from_slice(buffer.get(..length).unwrap_or_default()),
                Err(error) => return Err(lost(error)),
            }
        }
    }

    /// Prints a packet: with its bytes, or as `bcap decode --json` does.
    fn show(&self, role: Role, packet: &[u8], shows: bool) -> Result<(), Failure> {
        if !shows {
            return Ok(());
        }
        if self.json {
            let line = match Decoder::TCP.decode_datagram(packet) {
                Ok(frame) => frame::to_json(&frame, role),
                Err(error) => item_to_json(error.into()),
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
