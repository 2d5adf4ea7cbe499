//! A TCP proxy that splits, delays, repeats, corrupts and drops bytes.

use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{ReadHalf, WriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Instant, sleep, timeout_at};

use crate::background::{Background, until};
use bcap_testkit::network::Random;

/// A fault in one direction of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamFault {
    /// From here on, delivers bytes one at a time.
    Split,
    /// From here on, merges bytes that arrive within this time.
    Merge(Duration),
    /// From here on, delivers bytes unchanged.
    Plain,
    /// Stalls for this time.
    Stall(Duration),
    /// Repeats this number of the last bytes.
    Repeat(usize),
    /// Flips these bits of the next byte.
    Corrupt(u8),
    /// Closes the connection.
    Cut,
    /// Resets the connection.
    Reset,
}

/// A fault and its position in the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The number of bytes of this direction before it.
    pub at: u64,
    /// The fault at this position.
    pub fault: StreamFault,
}

/// The faults of a connection, in the order of the bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Script {
    /// From the client to the server.
    pub to_server: Vec<Step>,
    /// From the server to the client.
    pub to_client: Vec<Step>,
}

impl Script {
    /// Returns a script with one fault, from the first byte on, both ways.
    #[must_use]
    pub fn always(fault: StreamFault) -> Self {
        let steps = vec![Step { at: 0, fault }];
        Self { to_server: steps.clone(), to_client: steps }
    }

    /// Returns a script of up to six faults each way within the first `bytes`; without [`Corrupt`](StreamFault::Corrupt) and
    /// [`Repeat`](StreamFault::Repeat) unless `lies`, so that every delivered byte is correct.
    #[must_use]
    pub fn random(random: &mut Random, bytes: u64, lies: bool) -> Self {
        Self { to_server: random_steps(random, bytes, lies), to_client: random_steps(random, bytes, lies) }
    }
}

fn random_steps(random: &mut Random, bytes: u64, lies: bool) -> Vec<Step> {
    let mut steps: Vec<Step> = (0..random.below(7))
        .map(|_| {
            let time = Duration::from_millis(random.below(30));
            let fault = match random.below(if lies { 10 } else { 8 }) {
                0 | 1 => StreamFault::Split,
                2 => StreamFault::Merge(time),
                3 => StreamFault::Plain,
                4 | 5 => StreamFault::Stall(time),
                6 => StreamFault::Cut,
                7 => StreamFault::Reset,
                8 => StreamFault::Repeat(1 + random.below(40) as usize),
                _ => StreamFault::Corrupt(1 << random.below(8)),
            };
            Step { at: random.below(bytes), fault }
        })
        .collect();
    steps.sort_by_key(|step| step.at);
    steps
}

/// A proxy in front of a server; each connection has a script.
#[derive(Debug)]
pub struct TcpProxy {
    /// The address to which clients connect.
    pub address: SocketAddr,
    _background: Background,
}

impl TcpProxy {
    /// Starts a proxy; `script` is called for each connection, numbered from 0.
    #[must_use]
    pub fn start(server: SocketAddr, script: impl FnMut(u64) -> Script + Send + 'static) -> Self {
        let (background, address) = Background::start(async move |stopped| {
            let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
            let address = listener.local_addr().expect("it has an address");
            (address, until(stopped, accept(listener, server, script)))
        });
        Self { address, _background: background }
    }
}

async fn accept(listener: TcpListener, server: SocketAddr, mut script: impl FnMut(u64) -> Script) {
    for connection in 0.. {
        let Ok((client, _)) = listener.accept().await else { continue };
        let script = script(connection);
        tokio::spawn(async move {
            if let Ok(server) = TcpStream::connect(server).await {
                let _ = carry(client, server, script).await;
            }
        });
    }
}

/// Carries a connection to its end.
async fn carry(mut client: TcpStream, mut server: TcpStream, script: Script) -> io::Result<()> {
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let end = {
        let ((from_client, to_client), (from_server, to_server)) = (client.split(), server.split());
        let mut up = std::pin::pin!(Pump::new(from_client, to_server, script.to_server).run());
        let mut down = std::pin::pin!(Pump::new(from_server, to_client, script.to_client).run());
        // that one direction has ended in order does not end the other
        tokio::select! {
            end = &mut up => if end == End::Eof { down.await } else { end },
            end = &mut down => if end == End::Eof { up.await } else { end },
        }
    };
    if end == End::Reset {
        for stream in [&client, &server] {
            SockRef::from(stream).set_linger(Some(Duration::ZERO))?;
        }
    }
    Ok(())
}

/// How a direction has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Eof,
    Cut,
    Reset,
}

/// One direction of a connection.
struct Pump<'a> {
    from: ReadHalf<'a>,
    to: WriteHalf<'a>,
    steps: VecDeque<Step>,
    passed: u64,
    pieces: StreamFault,
    turned: u8,
    /// The last bytes that were sent.
    last: Vec<u8>,
}

impl<'a> Pump<'a> {
    fn new(from: ReadHalf<'a>, to: WriteHalf<'a>, steps: Vec<Step>) -> Self {
        Self { from, to, steps: steps.into(), passed: 0, pieces: StreamFault::Plain, turned: 0, last: Vec::new() }
    }

    async fn run(mut self) -> End {
        match self.pump().await {
            Ok(end) => end,
            // when one side disconnects, disconnect the other
            Err(_) => End::Cut,
        }
    }

    async fn pump(&mut self) -> io::Result<End> {
        loop {
            if let Some(end) = self.faults().await? {
                return Ok(end);
            }
            let bytes = self.read().await?;
            if bytes.is_empty() {
                self.to.shutdown().await?;
                return Ok(End::Eof);
            }
            let mut rest = &bytes[..];
            while !rest.is_empty() {
                if let Some(end) = self.faults().await? {
                    return Ok(end);
                }
                let until = self.steps.front().map_or(u64::MAX, |step| step.at - self.passed);
                let count = rest.len().min(usize::try_from(until).unwrap_or(usize::MAX));
                let (now, later) = rest.split_at(count);
                self.write(now).await?;
                rest = later;
            }
        }
    }

    /// Applies the faults at this byte.
    async fn faults(&mut self) -> io::Result<Option<End>> {
        while let Some(step) = self.steps.front().copied().filter(|step| step.at <= self.passed) {
            self.steps.pop_front();
            match step.fault {
                StreamFault::Split | StreamFault::Merge(_) | StreamFault::Plain => self.pieces = step.fault,
                StreamFault::Stall(time) => sleep(time).await,
                StreamFault::Repeat(count) => {
                    let from = self.last.len().saturating_sub(count);
                    self.to.write_all(&self.last[from..]).await?;
                }
                StreamFault::Corrupt(bits) => self.turned ^= bits,
                StreamFault::Cut => return Ok(Some(End::Cut)),
                StreamFault::Reset => return Ok(Some(End::Reset)),
            }
        }
        Ok(None)
    }

    async fn read(&mut self) -> io::Result<Vec<u8>> {
        let mut buffer = vec![0; 4096];
        let mut len = self.from.read(&mut buffer).await?;
        if let StreamFault::Merge(time) = self.pieces {
            let until = Instant::now() + time;
            while 0 < len && len < buffer.len() {
                match timeout_at(until, self.from.read(&mut buffer[len..])).await {
                    Ok(Ok(count)) if count > 0 => len += count,
                    // the end is found again by the next read
                    _ => break,
                }
            }
        }
        buffer.truncate(len);
        Ok(buffer)
    }

    async fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut bytes = bytes.to_vec();
        if let Some(first) = bytes.first_mut() {
            *first ^= std::mem::take(&mut self.turned);
        }
        if self.pieces == StreamFault::Split {
            for byte in &bytes {
                self.to.write_all(&[*byte]).await?;
                tokio::task::yield_now().await;
            }
        } else {
            self.to.write_all(&bytes).await?;
        }
        self.passed += bytes.len() as u64;
        self.last.extend(&bytes);
        self.last.drain(..self.last.len().saturating_sub(64));
        Ok(())
    }
}
