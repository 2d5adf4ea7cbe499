//! Serves clients with a virtual controller, and judges them.

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
use crate::reply::{describe, oracle, reason};
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
    Loss,
    Foreign,
}

impl Provocation {
    /// Returns the case that the reaction decides.
    const fn case(self) -> &'static str {
        match self {
            Self::Executing => "waits-while-executing",
            Self::OtherSerial => "other-serial-ignored",
            Self::Pieces => "reply-in-pieces",
            Self::TwoInOne => "two-replies-in-a-segment",
            Self::Twice => "reply-twice",
            Self::Refusal => "refusal-survived",
            Self::Loss => "retry-after-loss",
            Self::Foreign => "foreign-datagram-ignored",
        }
    }
}

const OVER_TCP: &[Provocation] = &[
    Provocation::Executing,
    Provocation::OtherSerial,
    Provocation::Pieces,
    Provocation::TwoInOne,
    Provocation::Twice,
    Provocation::Refusal,
];
const OVER_UDP: &[Provocation] = &[
    Provocation::Executing,
    Provocation::OtherSerial,
    Provocation::Twice,
    Provocation::Refusal,
    Provocation::Loss,
    Provocation::Foreign,
];

/// How long a client must not send while it waits for a reply.
const WAIT: Duration = Duration::from_millis(120);

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
    /// The provocations that are left.
    left: Vec<Provocation>,
    /// The case that the next request decides.
    pending: Option<&'static str>,
}

impl ClientJudge {
    /// Listens; port 0 takes a free one.
    ///
    /// # Errors
    ///
    /// When the address cannot be listened on.
    pub fn bind(link: Link, address: SocketAddr) -> io::Result<Self> {
        Ok(Self { link, listener: Listener::bind(link, address)? })
    }

    /// Returns the address that it listens on.
    ///
    /// # Errors
    ///
    /// When the operating system does not tell it.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.address()
    }

    /// Serves this number of sessions, one after the other, and returns the results of all cases. It waits at most `limit`
    /// for a client, and for each of its requests.
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
        };
        for number in 0..sessions {
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
        while let Received::Packet(bytes) = socket.receive(limit) {
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
        self.rules.end();
        let now = self.now();
        self.session.close(&mut self.controller, peer, now);
    }

    /// Judges and answers a request.
    fn request(&mut self, socket: &mut Wire, peer: PeerId, bytes: &[u8], frame: &TestFrame) -> io::Result<()> {
        let text = describe(bytes);
        self.rules.log.push(format!("<- {text}"));
        self.rules.request(frame, bytes.len(), &text);
        if let Some(case) = self.pending.take() {
            self.rules.judge(case, true, "", "");
        }
        let Some(reply) = self.execute(socket, peer, bytes)? else { return Ok(()) };
        let is_read = FunctionId(frame.code) == FunctionId::VARIABLE_GET_VALUE;
        match if is_read { self.left.pop() } else { None } {
            Some(provocation) => self.provoke(provocation, socket, peer, bytes, &reply)?,
            None => socket.send(&reply)?,
        }
        if let Some(reply) = oracle(self.link).decode_packet(&reply) {
            self.rules.log.push(format!("-> #{} {}", reply.serial, HResult(reply.code)));
            self.rules.reply(frame, &reply);
        }
        Ok(())
    }

    /// Executes a request, and returns the reply. Keep-alives of the session are sent at once.
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

    /// The client must send nothing for a while.
    fn waits(&mut self, socket: &mut Wire, case: &'static str) {
        let came = match socket.receive(WAIT) {
            Received::Silence => return,
            Received::Packet(bytes) => {
                self.rules.judge("one-at-a-time", false, "silence until the reply", describe(&bytes));
                describe(&bytes)
            }
            Received::Closed => "the end of the connection".into(),
        };
        self.rules.judge(case, false, "silence until the reply", came);
    }

    fn provoke(
        &mut self,
        provocation: Provocation,
        socket: &mut Wire,
        peer: PeerId,
        request: &[u8],
        reply: &[u8],
    ) -> io::Result<()> {
        let serial = field::serial(reply).unwrap_or(0);
        let stale = coded(serial.wrapping_sub(1), HResult::E_FAIL);
        let case = provocation.case();
        // the next request decides, even when the client ends the connection at once
        self.pending = Some(case);
        match provocation {
            Provocation::Executing => {
                for _ in 0..3 {
                    socket.send(&coded(serial, HResult::S_EXECUTING))?;
                    self.waits(socket, case);
                }
                self.rules.judge("one-at-a-time", true, "", "");
                socket.send(reply)
            }
            Provocation::OtherSerial => {
                socket.send(&stale)?;
                self.waits(socket, case);
                socket.send(reply)
            }
            Provocation::Pieces => reply.iter().try_for_each(|byte| {
                std::thread::sleep(Duration::from_millis(2));
                socket.send(&[*byte])
            }),
            Provocation::TwoInOne => socket.send(&[&stale, reply].concat()),
            Provocation::Twice => {
                socket.send(reply)?;
                socket.send(reply)
            }
            Provocation::Refusal => socket.send(&coded(serial, HResult::E_FAIL)),
            Provocation::Loss => self.lose(socket, peer, request),
            Provocation::Foreign => {
                socket.send_from_elsewhere(&coded(serial, HResult::E_FAIL))?;
                self.waits(socket, case);
                socket.send(reply)
            }
        }
    }

    /// Sends no reply, and judges the retry.
    fn lose(&mut self, socket: &mut Wire, peer: PeerId, request: &[u8]) -> io::Result<()> {
        let retry = match socket.receive(Duration::from_secs(10)) {
            Received::Packet(bytes) => bytes,
            other => {
                let came = if other == Received::Closed { "the end of the connection" } else { "no retry" };
                self.rules.judge("retry-after-loss", false, "the same call again", came);
                return Ok(());
            }
        };
        let text = describe(&retry);
        self.rules.log.push(format!("<- {text}, after a lost reply"));
        let oracle = oracle(self.link);
        let (Some(first), Some(again)) = (oracle.decode_packet(request), oracle.decode_packet(&retry)) else {
            return Ok(());
        };
        self.rules.judge("retry-after-loss", true, "", "");
        let next = first.serial.checked_add(1).unwrap_or(1);
        self.rules.judge("retry-has-a-new-serial", again.serial == next, &format!("the serial {next}"), &text);
        self.rules.judge("marker", again.reserved == first.serial, &format!("{}", first.serial), &text);
        let is_same = first.code == again.code && first.args == again.args;
        self.rules.judge("retry-is-the-same-call", is_same, &describe(request), &text);
        self.rules.retried(again.serial);
        if let Some(reply) = self.execute(socket, peer, &retry)? {
            socket.send(&reply)?;
        }
        Ok(())
    }
}

/// Encodes a reply without a value.
fn coded(serial: u16, code: HResult) -> Vec<u8> {
    TestFrame { serial, reserved: 0, code: code.0, args: Vec::new() }.to_wire(false)
}
