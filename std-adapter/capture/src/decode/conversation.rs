//! The conversations of a capture: their packets, their protocol, and which end is the client.

use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;

use bcap_core::bcap::{self, Decoder, FunctionId, Header};
use bcap_core::limits::Strictness;
use bcap_core::rac;

use super::call::{Event, Link, Note};
use super::file::Packet;
use super::fragments::Fragments;
use super::line::RacLines;
use super::packet::{Segment, Skipped, Tcp, reassembled, segment};
use super::session::{Found, Session};
use super::stream::{Half, Piece};
use crate::role::Role;

/// The protocol of a conversation.
#[derive(Debug)]
enum Protocol {
    /// No packet with data yet, and no known port.
    Unknown,
    Bcap(Session),
    Rac(RacLines),
    Other,
}

/// A TCP connection, or the packets between two UDP ports.
#[derive(Debug)]
struct Conversation {
    strictness: Strictness,
    number: usize,
    began: u64,
    name: String,
    /// Whether its protocol and its ends have been reported.
    is_reported: bool,
    /// The two ends; the first is the sender of the first packet.
    ends: [SocketAddr; 2],
    /// Which end is the client.
    client: Option<usize>,
    is_tcp: bool,
    halves: [Half; 2],
    protocol: Protocol,
    last: u64,
    /// The first sequence number of the connection, if its start is captured.
    first: Option<u32>,
}

/// Whether it is TCP, and the two ends in ascending order.
type ConversationKey = (bool, SocketAddr, SocketAddr);

/// Returns the key of the conversation between two ends.
fn key(is_tcp: bool, one: SocketAddr, other: SocketAddr) -> ConversationKey {
    (is_tcp, one.min(other), one.max(other))
}

/// All conversations.
#[derive(Debug)]
pub(crate) struct Conversations {
    strictness: Strictness,
    by_ends: HashMap<ConversationKey, Conversation>,
    /// The number of conversations until now.
    count: usize,
    events: Vec<Event>,
    fragments: Fragments,
    /// Fragments that cannot be used.
    unusable: usize,
    /// The time of the first fragment.
    fragmented: Option<u64>,
    /// Packets that were skipped, with the time of the first of them.
    links: BTreeMap<i32, (u64, u64)>,
}

impl Conversations {
    pub(crate) fn new(strictness: Strictness) -> Self {
        Self {
            strictness,
            by_ends: HashMap::new(),
            count: 0,
            events: Vec::new(),
            fragments: Fragments::default(),
            unusable: 0,
            fragmented: None,
            links: BTreeMap::new(),
        }
    }

    /// Adds a packet.
    pub(crate) fn packet(&mut self, packet: Packet<'_>) {
        match segment(&packet) {
            Ok(segment) => self.segment(&segment),
            Err(Skipped::Fragment(fragment)) => {
                self.fragmented.get_or_insert(packet.at);
                let payload = self.fragments.add(&fragment, packet.at).unwrap_or_default();
                if let Ok(segment) = reassembled(packet.at, fragment.key, &payload) {
                    self.segment(&segment);
                }
            }
            Err(Skipped::Unusable) => {
                self.fragmented.get_or_insert(packet.at);
                self.unusable += 1;
            }
            Err(Skipped::Link(link)) => self.links.entry(link).or_insert((packet.at, 0)).1 += 1,
            Err(Skipped::Other) => {}
        }
    }

    fn segment(&mut self, segment: &Segment<'_>) {
        let key = key(segment.tcp.is_some(), segment.from, segment.to);
        if self.by_ends.get(&key).is_some_and(|found| !found.has(segment)) {
            // the ports of an ended connection are used again
            self.close(segment.tcp.is_some(), segment.from, segment.to);
        }
        let (count, strictness) = (&mut self.count, self.strictness);
        let conversation = self.by_ends.entry(key).or_insert_with(|| {
            *count += 1;
            Conversation::new(*count, segment, strictness)
        });
        conversation.segment(segment, &mut self.events);
    }

    /// Ends the conversation between two ends: no more packets of it follow.
    pub(crate) fn close(&mut self, is_tcp: bool, one: SocketAddr, other: SocketAddr) {
        if let Some(mut ended) = self.by_ends.remove(&key(is_tcp, one, other)) {
            ended.end(&mut self.events);
        }
    }

    /// Takes the results of all packets until now: connections, and calls with their replies.
    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Ends all conversations.
    pub(crate) fn end(&mut self) {
        let mut open: Vec<_> = self.by_ends.drain().map(|(_, conversation)| conversation).collect();
        open.sort_by_key(|conversation| conversation.number);
        open.iter_mut().for_each(|conversation| conversation.end(&mut self.events));
        let mut note = |at, text| self.events.push(Event::Note(Note { at, link: "capture".into(), text }));
        let skipped = self.fragments.incomplete() + self.unusable;
        if let Some(at) = self.fragmented.filter(|_| skipped > 0) {
            note(at, format!("skipped fragments of IP packets that are incomplete, or of IPv6: {skipped}"));
        }
        for (link, (at, count)) in &self.links {
            note(*at, format!("skipped packets of link type {link}, which is not supported: {count}"));
        }
    }
}

impl Conversation {
    fn new(number: usize, segment: &Segment<'_>, strictness: Strictness) -> Self {
        let is_tcp = segment.tcp.is_some();
        let name = format!("{}{number}", if is_tcp { "tcp" } else { "udp" });
        let ends = [segment.from, segment.to];
        let server_at = |port| match ends.map(|end| end.port() == port) {
            [true, false] => Some(0),
            [false, true] => Some(1),
            _ => None,
        };
        let (protocol, server) = match (server_at(bcap::PORT), server_at(rac::PORT)) {
            (Some(server), _) => (Protocol::Bcap(Session::new(name.clone(), strictness)), Some(server)),
            (None, Some(server)) if is_tcp => (Protocol::Rac(RacLines::new(name.clone())), Some(server)),
            _ => (Protocol::Unknown, None),
        };
        let opener = segment.tcp.filter(|tcp| tcp.syn).map(|tcp| usize::from(tcp.acknowledged.is_some()));
        Self {
            strictness,
            number,
            began: segment.at,
            name,
            is_reported: false,
            ends,
            client: server.map(|server| 1 - server).or(opener),
            is_tcp,
            halves: Default::default(),
            protocol,
            last: segment.at,
            first: segment.tcp.and_then(|tcp| tcp.opens()),
        }
    }

    /// Returns whether a segment belongs to this conversation, and not to a later connection between the same ports.
    fn has(&self, segment: &Segment<'_>) -> bool {
        segment.tcp.and_then(|tcp| tcp.opens()).is_none_or(|first| self.first == Some(first))
    }

    fn segment(&mut self, segment: &Segment<'_>, events: &mut Vec<Event>) {
        self.last = segment.at;
        let from = usize::from(segment.from != self.ends[0]);
        if let Some(tcp) = &segment.tcp {
            self.tcp(from, tcp, segment, events);
        } else if !segment.payload.is_empty() {
            self.bytes(from, segment.payload, segment.at, events);
        }
    }

    fn tcp(&mut self, from: usize, tcp: &Tcp, segment: &Segment<'_>, events: &mut Vec<Event>) {
        // a reply shows that its request arrived, so the bytes that it acknowledges are processed first
        if let Some(acknowledged) = tcp.acknowledged {
            let mut pieces = Vec::new();
            self.halves[1 - from].acknowledged(acknowledged, &mut pieces);
            self.pieces(1 - from, pieces, segment.at, events);
        }
        let mut pieces = Vec::new();
        self.halves[from].segment(tcp, segment.payload, &mut pieces);
        self.pieces(from, pieces, segment.at, events);
    }

    fn pieces(&mut self, from: usize, pieces: Vec<Piece>, at: u64, events: &mut Vec<Event>) {
        for piece in pieces {
            match piece {
                // bytes that waited for missing bytes get the arrival time of the missing bytes
                Piece::Bytes(bytes) => self.bytes(from, &bytes, at, events),
                Piece::Missing(count) => {
                    let role = self.role(from);
                    let mut found = Vec::new();
                    match &mut self.protocol {
                        Protocol::Bcap(session) => session.missing(role, count, at, &mut found),
                        Protocol::Rac(lines) => lines.missing(role, count, at, &mut found),
                        Protocol::Unknown | Protocol::Other => {}
                    }
                    self.add(found, events);
                }
                Piece::Retransmission => self.remark(at, "a segment was sent again (retransmission)", events),
                Piece::Reordered => self.remark(at, "a segment arrived before its predecessor", events),
            }
        }
    }

    fn remark(&mut self, at: u64, text: &str, events: &mut Vec<Event>) {
        if matches!(self.protocol, Protocol::Bcap(_) | Protocol::Rac(_)) {
            self.add(vec![Found::Note(at, text.into())], events);
        }
    }

    fn role(&self, from: usize) -> Role {
        if self.client == Some(from) { Role::Request } else { Role::Response }
    }

    /// Adds the next bytes of a stream, or a datagram.
    fn bytes(&mut self, from: usize, bytes: &[u8], at: u64, events: &mut Vec<Event>) {
        if matches!(self.protocol, Protocol::Unknown) {
            self.guess(from, bytes);
        }
        self.report(events);
        let role = self.role(from);
        let mut found = Vec::new();
        match &mut self.protocol {
            Protocol::Bcap(session) if self.is_tcp => session.bytes(role, bytes, at, &mut found),
            Protocol::Bcap(session) => session.datagram(role, bytes, at, &mut found),
            Protocol::Rac(lines) => lines.bytes(role, bytes, at, &mut found),
            Protocol::Unknown | Protocol::Other => {}
        }
        self.add(found, events);
    }

    /// Finds the protocol on another port from the first bytes, and the client if the connection's start is not captured.
    fn guess(&mut self, from: usize, bytes: &[u8]) {
        let start = bytes.get(..8).unwrap_or(bytes).to_ascii_uppercase();
        let frame = if self.is_tcp {
            bcap_frame(bytes, self.strictness)
        } else {
            Decoder::UDP.strictness(self.strictness).decode_datagram(bytes).ok().map(|frame| frame.function())
        };
        let is_request;
        (self.protocol, is_request) = match frame {
            Some(code) => (Protocol::Bcap(Session::new(self.name.clone(), self.strictness)), code.name().is_some()),
            None if self.is_tcp && (start == *b"GET:RC8:" || start == *b"PUT:RC8:") => {
                (Protocol::Rac(RacLines::new(self.name.clone())), true)
            }
            None => (Protocol::Other, false),
        };
        self.client.get_or_insert(if is_request { from } else { 1 - from });
    }

    fn add(&self, found: Vec<Found>, events: &mut Vec<Event>) {
        for found in found {
            events.push(match found {
                Found::Call(call) => Event::Call(*call),
                Found::Note(at, text) => Event::Note(Note { at, link: self.name.clone(), text }),
            });
        }
    }

    /// Reports the protocol and the ends once, when the protocol is known.
    fn report(&mut self, events: &mut Vec<Event>) {
        let protocol = match &self.protocol {
            Protocol::Bcap(_) => "b-CAP",
            Protocol::Rac(_) => "RAC",
            Protocol::Unknown | Protocol::Other => return,
        };
        if std::mem::replace(&mut self.is_reported, true) {
            return;
        }
        let client = self.client.unwrap_or(0);
        events.push(Event::Link(Link {
            at: self.began,
            name: self.name.clone(),
            protocol,
            client: self.ends[client].to_string(),
            server: self.ends[1 - client].to_string(),
        }));
    }

    /// Ends the conversation: calls without a reply are reported as such.
    fn end(&mut self, events: &mut Vec<Event>) {
        self.report(events);
        for from in [0, 1] {
            let mut pieces = Vec::new();
            self.halves[from].end(&mut pieces);
            self.pieces(from, pieces, self.last, events);
        }
        let mut found = Vec::new();
        match &mut self.protocol {
            Protocol::Bcap(session) => session.end(self.last, &mut found),
            Protocol::Rac(lines) => lines.end(&mut found),
            Protocol::Unknown | Protocol::Other => {}
        }
        self.add(found, events);
    }
}

/// Returns the code of a frame at the start of a stream, if the bytes can be one.
fn bcap_frame(bytes: &[u8], strictness: Strictness) -> Option<FunctionId> {
    let decoder = Decoder::TCP.strictness(strictness);
    let length = decoder.frame_length(bytes).ok()??;
    let code = Header::read(bytes)?.function();
    let is_whole = bytes.len() >= length;
    (!is_whole || decoder.decode(bytes).is_ok()).then_some(code)
}
