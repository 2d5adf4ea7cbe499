//! Serves clients with a virtual controller, and judges them.

use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::time::{Duration, Instant as Clock};

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::server::{Config, Session};
use bcap_core::endpoint::{Endpoint, Serve, ServerEndpoint};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_sim::{Controller, Profile};
use bcap_testkit::frame::{TestFrame, field};
use bcap_testkit::wire::{Link, Listener, Received, Wire};

use super::rules::Rules;
use crate::reply::{describe, oracle, reason, request_text};
use crate::report::Report;

/// An unusual way to answer; each is used once, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Provocation {
    Executing,
    OtherSerial,
    Pieces,
    TwoInOne,
    Twice,
    Refusal,
    Part,
    Loss,
    Foreign,
    Late,
    Close,
}

impl Provocation {
    /// Returns the case that the reaction determines.
    const fn case(self) -> &'static str {
        match self {
            Self::Executing => "waits-while-executing",
            Self::OtherSerial => "other-serial-ignored",
            Self::Pieces => "reply-in-pieces",
            Self::TwoInOne => "two-replies-in-a-segment",
            Self::Twice => "reply-twice",
            Self::Refusal => "refusal-survived",
            Self::Part => "keep-alive-and-a-part",
            Self::Loss => "retry-after-loss",
            Self::Foreign => "foreign-datagram-ignored",
            Self::Late => "late-reply-dropped",
            Self::Close => "close-noticed",
        }
    }

    /// Returns whether the client may end its connection, so that only a later session can show whether it continues to work.
    const fn may_end_the_session(self, link: Link) -> bool {
        matches!((self, link), (Self::Close, _) | (Self::Late, Link::Tcp))
    }
}

const OVER_TCP: &[Provocation] = &[
    Provocation::Executing,
    Provocation::OtherSerial,
    Provocation::Pieces,
    Provocation::TwoInOne,
    Provocation::Twice,
    Provocation::Refusal,
    Provocation::Part,
    Provocation::Late,
    Provocation::Close,
];
const OVER_UDP: &[Provocation] = &[
    Provocation::Executing,
    Provocation::OtherSerial,
    Provocation::Twice,
    Provocation::Refusal,
    Provocation::Loss,
    Provocation::Foreign,
    Provocation::Late,
];

/// The time during which a client must not send while it waits for a reply.
const WAIT: Duration = Duration::from_millis(120);

/// The time limit for a client to repeat a call, to abandon it, or to detect the end of its connection.
const CLIENT_TIMEOUT: Duration = Duration::from_secs(10);

/// A controller that judges its clients.
///
/// # Examples
///
/// ```no_run
/// use std::time::Duration;
///
/// use bcap_conform::{ClientJudge, Link, Verdict};
///
/// let judge = ClientJudge::bind(Link::Tcp, "127.0.0.1:5007".parse()?)?;
/// println!("connect to {}", judge.address()?);
/// let report = judge.run(1, Duration::from_secs(60))?;
/// assert_eq!(report.count(Verdict::Fail), 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ClientJudge {
    link: Link,
    listener: Listener,
}

/// The needs of a client's session.
struct Play {
    link: Link,
    rules: Rules,
    controller: Controller,
    session: Session<Vec<u8>, Vec<u8>>,
    began: Clock,
    /// The remaining provocations.
    left: Vec<Provocation>,
    /// The case that the next request determines.
    pending: Option<&'static str>,
    /// The last request that was not a retransmission.
    last: Option<TestFrame>,
    /// Requests that arrived before the reply to the last request.
    early: VecDeque<Vec<u8>>,
    /// A late reply to an earlier call, which is sent before the next reply.
    late: Option<Vec<u8>>,
    /// Whether another session follows.
    has_next: bool,
    /// Whether the client was given a reason to end its session early.
    is_excused: bool,
}

impl ClientJudge {
    /// Listens; port 0 takes a free one.
    ///
    /// # Errors
    ///
    /// When listening on the address fails.
    pub fn bind(link: Link, address: SocketAddr) -> io::Result<Self> {
        Ok(Self { link, listener: Listener::bind(link, address)? })
    }

    /// Returns the listening address.
    ///
    /// # Errors
    ///
    /// If the operating system does not return the address.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.address()
    }

    /// Serves this number of sessions sequentially, and returns the results of all cases. It waits at most `limit` for a
    /// client, and for each of its requests.
    ///
    /// # Errors
    ///
    /// When the listening socket fails.
    pub fn run(&self, sessions: usize, limit: Duration) -> io::Result<Report> {
        let (config, provocations) = match self.link {
            Link::Tcp | Link::Serial => (Config::TCP, OVER_TCP),
            Link::Udp => (Config::UDP, OVER_UDP),
        };
        let mut play = Play {
            link: self.link,
            rules: Rules::new(self.link),
            controller: Controller::new(bcap_sim::Config::new(Profile::Rc8)),
            session: Session::new(config, vec![0; 1024], vec![0; 1024]),
            began: Clock::now(),
            left: provocations.iter().rev().copied().collect(),
            pending: None,
            last: None,
            early: VecDeque::new(),
            late: None,
            has_next: false,
            is_excused: false,
        };
        for number in 0..sessions {
            play.has_next = number + 1 < sessions;
            let Some(mut socket) = self.listener.accept(limit)? else { break };
            let peer = PeerId(u32::try_from(number).unwrap_or(u32::MAX));
            play.session = Session::new(config, vec![0; 1024], vec![0; 1024]);
            play.serve(&mut socket, peer, limit);
        }
        Ok(Report { results: play.rules.results(), ..Report::default() })
    }
}

impl Play {
    fn now(&self) -> Instant {
        Instant::from_millis(u64::try_from(self.began.elapsed().as_millis()).unwrap_or(u64::MAX))
    }

    /// Serves one session, to its end.
    fn serve(&mut self, socket: &mut Wire, peer: PeerId, limit: Duration) {
        self.rules.begin();
        (self.last, self.late, self.is_excused) = (None, None, false);
        self.early.clear();
        while let Some(bytes) = self.next(socket, limit) {
            let Some(frame) = oracle(self.link).decode_packet(&bytes) else {
                self.rules.judge("valid-frames", false, "a valid frame", reason(&bytes));
                break;
            };
            // over UDP only Service_Stop ends a session
            let is_last = self.link == Link::Udp && FunctionId(frame.code) == FunctionId::SERVICE_STOP;
            if self.request(socket, peer, &bytes, &frame).is_err() || is_last {
                break;
            }
        }
        if let Some(case) = self.pending.take() {
            self.rules.judge(case, false, "another request", "the end of the session");
        }
        if !self.is_excused {
            self.rules.end();
        }
        let now = self.now();
        self.session.close(&mut self.controller, peer, now);
    }

    /// Returns the next request; `None` at the end of the session.
    fn next(&mut self, socket: &mut Wire, limit: Duration) -> Option<Vec<u8>> {
        match self.early.pop_front() {
            Some(bytes) => Some(bytes),
            None if self.is_excused => None,
            None => match socket.receive(limit) {
                Received::Packet(bytes) => Some(bytes),
                Received::Silence | Received::Closed => None,
            },
        }
    }

    /// Judges and answers a request.
    fn request(&mut self, socket: &mut Wire, peer: PeerId, bytes: &[u8], frame: &TestFrame) -> io::Result<()> {
        if self.is_retry(frame) {
            // it has crossed the reply
            return self.retry(socket, peer, bytes, frame)?.map_or(Ok(()), |reply| socket.send(&reply));
        }
        let text = describe(bytes);
        self.rules.log.push(format!("<- {text}"));
        self.rules.request(frame, bytes.len(), &text);
        self.last = Some(frame.clone());
        if let Some(case) = self.pending.take() {
            self.rules.judge(case, true, "", "");
        }
        let Some(mut reply) = self.execute(socket, peer, bytes)? else { return Ok(()) };
        if let Some(late) = self.late.take() {
            socket.send(&late)?;
            self.waits(socket, peer, Provocation::Late.case(), &mut reply)?;
            self.rules.judge(Provocation::Late.case(), true, "", "");
        }
        let is_read = FunctionId(frame.code) == FunctionId::VARIABLE_GET_VALUE;
        match if is_read { self.provocation() } else { None } {
            Some(provocation) => self.provoke(provocation, socket, peer, &mut reply)?,
            None => socket.send(&reply)?,
        }
        if let Some(reply) = oracle(self.link).decode_packet(&reply) {
            self.rules.log.push(format!("-> {}", reply.text()));
            self.rules.reply(frame, &reply);
        }
        Ok(())
    }

    /// Returns the next provocation that is possible in this session.
    fn provocation(&mut self) -> Option<Provocation> {
        let next = *self.left.last()?;
        if next.may_end_the_session(self.link) && !self.has_next { None } else { self.left.pop() }
    }

    /// Returns whether a request is a retransmission of the last request: its reserved field has the serial of the first
    /// attempt.
    fn is_retry(&self, frame: &TestFrame) -> bool {
        let is_of = |last: &TestFrame| frame.reserved == last.serial && frame.serial != last.serial;
        self.link.repeats() && self.last.as_ref().is_some_and(is_of)
    }

    /// Returns whether a request has the serial of the last request: a retransmission that needs a new serial.
    fn is_duplicate(&self, frame: &TestFrame) -> bool {
        self.last.as_ref().is_some_and(|last| frame.serial == last.serial)
    }

    /// Judges a retransmission of the last request, and returns the reply to it.
    fn retry(
        &mut self,
        socket: &mut Wire,
        peer: PeerId,
        bytes: &[u8],
        again: &TestFrame,
    ) -> io::Result<Option<Vec<u8>>> {
        let text = describe(bytes);
        self.rules.log.push(format!("<- {text}, again"));
        let Some(first) = self.last.clone() else { return Ok(None) };
        self.rules.judge("retry-after-loss", true, "", "");
        let next = self.rules.next_serial();
        self.rules.judge("retry-has-a-new-serial", again.serial == next, &format!("the serial {next}"), &text);
        self.rules.judge("marker", again.reserved == first.serial, &format!("{}", first.serial), &text);
        let is_same = first.code == again.code && first.args == again.args;
        let expected = request_text(first.serial, FunctionId(first.code), &first.args);
        self.rules.judge("retry-is-the-same-call", is_same, &expected, &text);
        self.rules.retried(again.serial);
        self.execute(socket, peer, bytes)
    }

    /// Executes a request, and returns the reply. Keep-alives of the session are sent immediately.
    fn execute(&mut self, socket: &mut Wire, peer: PeerId, bytes: &[u8]) -> io::Result<Option<Vec<u8>>> {
        let mut rest = bytes;
        while !rest.is_empty() {
            let room = self.session.receive_buffer();
            let count = room.len().min(rest.len());
            room[..count].copy_from_slice(&rest[..count]);
            rest = &rest[count..];
            self.session.received(count);
            let now = self.now();
            let _ = self.session.run(&mut self.controller, peer, now);
        }
        loop {
            let sent = self.session.transmit().to_vec();
            if !sent.is_empty() {
                self.session.transmitted(sent.len());
                if field::code(&sent) != Some(HResult::S_EXECUTING.0) {
                    return Ok(Some(sent));
                }
                socket.send(&sent)?;
            } else if !self.session.is_running() {
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(1));
            let now = self.now();
            self.controller.advance(now);
            let _ = self.session.run(&mut self.controller, peer, now);
        }
    }

    /// Checks that the client sends nothing for a while, except a retransmission; `reply` then becomes the reply to the
    /// retransmission.
    fn waits(&mut self, socket: &mut Wire, peer: PeerId, case: &'static str, reply: &mut Vec<u8>) -> io::Result<()> {
        let until = Clock::now() + WAIT;
        let came = loop {
            let bytes = match socket.receive(until.saturating_duration_since(Clock::now())) {
                Received::Silence => return Ok(()),
                Received::Closed => break "the end of the connection".into(),
                Received::Packet(bytes) => bytes,
            };
            match oracle(self.link).decode_packet(&bytes).filter(|frame| self.is_retry(frame)) {
                Some(again) => {
                    if let Some(latest) = self.retry(socket, peer, &bytes, &again)? {
                        *reply = latest;
                    }
                }
                None => {
                    let text = describe(&bytes);
                    self.rules.judge("one-at-a-time", false, "silence until the reply", text.clone());
                    // it is served after the reply, so that the client fails only this case
                    self.early.push_back(bytes);
                    break text;
                }
            }
        };
        self.rules.judge(case, false, "silence until the reply", came);
        Ok(())
    }

    fn provoke(
        &mut self,
        provocation: Provocation,
        socket: &mut Wire,
        peer: PeerId,
        reply: &mut Vec<u8>,
    ) -> io::Result<()> {
        let serial = field::serial(reply).unwrap_or(0);
        let (executing, stale) = (coded(serial, HResult::S_EXECUTING), coded(serial.wrapping_sub(1), HResult::E_FAIL));
        let case = provocation.case();
        // the next request determines the result, even when the client ends the connection immediately
        self.pending = Some(case);
        match provocation {
            Provocation::Executing => {
                for _ in 0..3 {
                    socket.send(&executing)?;
                    self.waits(socket, peer, case, reply)?;
                }
                self.rules.judge("one-at-a-time", true, "", "");
                socket.send(reply)
            }
            Provocation::OtherSerial => {
                socket.send(&stale)?;
                self.waits(socket, peer, case, reply)?;
                socket.send(reply)
            }
            Provocation::Pieces => reply.iter().try_for_each(|byte| {
                std::thread::sleep(Duration::from_millis(2));
                socket.send(&[*byte])
            }),
            Provocation::TwoInOne => socket.send(&[&stale, reply.as_slice()].concat()),
            Provocation::Twice => {
                socket.send(reply)?;
                socket.send(reply)
            }
            Provocation::Refusal => socket.send(&coded(serial, HResult::E_FAIL)),
            Provocation::Part => {
                let (part, rest) = reply.split_at(reply.len() / 2);
                let (part, rest) = ([&executing, part].concat(), rest.to_vec());
                socket.send(&part)?;
                self.waits(socket, peer, case, reply)?;
                socket.send(&rest)
            }
            Provocation::Loss => self.lose(socket, peer),
            Provocation::Foreign => {
                socket.send_from_elsewhere(&coded(serial, HResult::E_FAIL))?;
                self.waits(socket, peer, case, reply)?;
                socket.send(reply)
            }
            Provocation::Late => self.delay(socket, peer, reply),
            Provocation::Close => self.close(socket),
        }
    }

    /// Sends no reply, and judges the retry.
    fn lose(&mut self, socket: &mut Wire, peer: PeerId) -> io::Result<()> {
        let retry = match socket.receive(CLIENT_TIMEOUT) {
            Received::Packet(bytes) => bytes,
            other => {
                let came = if other == Received::Closed { "the end of the connection" } else { "no retry" };
                self.rules.judge("retry-after-loss", false, "the same call again", came);
                return Ok(());
            }
        };
        match oracle(self.link).decode_packet(&retry).filter(|frame| self.is_retry(frame) || self.is_duplicate(frame)) {
            Some(again) => self.retry(socket, peer, &retry, &again)?.map_or(Ok(()), |reply| socket.send(&reply)),
            None => {
                self.rules.judge("retry-after-loss", false, "the same call again", describe(&retry));
                self.early.push_back(retry);
                Ok(())
            }
        }
    }

    /// Sends no reply until the client abandons the attempt. The late reply then precedes the reply to its next call.
    fn delay(&mut self, socket: &mut Wire, peer: PeerId, reply: &[u8]) -> io::Result<()> {
        // without a late reply there is nothing to judge
        self.pending = None;
        let next = match socket.receive(CLIENT_TIMEOUT) {
            Received::Packet(bytes) => bytes,
            // the client waits longer than this
            Received::Silence => return socket.send(reply),
            Received::Closed => {
                self.is_excused = true;
                return Ok(());
            }
        };
        match oracle(self.link).decode_packet(&next).filter(|frame| self.is_retry(frame)) {
            // over UDP the reply to the first attempt is also a valid reply to the second
            Some(again) => {
                self.late = self.retry(socket, peer, &next, &again)?;
                socket.send(reply)
            }
            None => {
                self.early.push_back(next);
                self.late = Some(reply.to_vec());
                Ok(())
            }
        }
    }

    /// Ends the connection instead of replying. The client must end it too, and send nothing more.
    fn close(&mut self, socket: &mut Wire) -> io::Result<()> {
        (self.pending, self.is_excused) = (None, true);
        socket.finish()?;
        let came = match socket.receive(CLIENT_TIMEOUT) {
            Received::Closed => None,
            Received::Packet(bytes) => Some(describe(&bytes)),
            Received::Silence => Some(format!("an open connection after {} s", CLIENT_TIMEOUT.as_secs())),
        };
        let expected = "the end of the client's connection";
        self.rules.judge(Provocation::Close.case(), came.is_none(), expected, came.unwrap_or_default());
        Ok(())
    }
}

/// Encodes a reply without a value.
fn coded(serial: u16, code: HResult) -> Vec<u8> {
    TestFrame { serial, reserved: 0, code: code.0, args: Vec::new() }.to_wire(false)
}
