//! PLCs that write numbers, read them back and check each answer.

use std::collections::HashSet;
use std::fmt;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread::sleep;
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_qemu::{Plc, error};
use fastrand::Rng;

use super::Shared;

/// The time limit of a request is 10 s at the gateway.
const TIMEOUT: Duration = Duration::from_secs(15);
const PACE: Duration = Duration::from_millis(50);
/// Variables of each PLC.
const VARIABLES: i32 = 20;
/// The last numbers of a variable that may still be written by requests without an answer.
type Pending = HashSet<(i32, i32)>;

/// The protocol of a PLC.
#[derive(Clone, Copy)]
pub(super) enum Front {
    Rac,
    /// Two registers for each of its variables, from 0 on.
    Modbus,
}

/// The observations of a PLC.
#[derive(Default)]
pub(super) struct Seen {
    served: AtomicU32,
    not_connected: AtomicU32,
    no_slot: AtomicU32,
    lost: AtomicU32,
    lost_on_link: AtomicU32,
    wrong: Mutex<Vec<String>>,
    times: Mutex<Vec<Duration>>,
}

impl Seen {
    /// Returns how many numbers were read back.
    pub(super) fn served(&self) -> u32 {
        self.served.load(Ordering::Relaxed)
    }

    fn add_wrong(&self, what: String) {
        self.wrong.lock().unwrap_or_else(PoisonError::into_inner).push(what);
    }

    /// Returns the wrong answers.
    pub(super) fn wrong(&self) -> Vec<String> {
        self.wrong.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Counts of all PLCs.
pub(super) fn figures(seen: &[Seen]) -> impl fmt::Display {
    let sum = |of: fn(&Seen) -> &AtomicU32| seen.iter().map(|seen| of(seen).load(Ordering::Relaxed)).sum::<u32>();
    let mut times: Vec<Duration> = seen.iter().flat_map(|seen| seen.times.lock().unwrap().clone()).collect();
    times.sort_unstable();
    let micros = |percent: usize| times.get(times.len() * percent / 100).map_or(0, Duration::as_micros);
    let wrong = seen.iter().map(|seen| seen.wrong().len()).sum::<usize>();
    format!(
        "{} numbers came back, {wrong} wrong answers, p50 {} us, p99 {} us; {} answers without the robot, {} without a slot, \
         {} connections lost and {} more with a cut of the link",
        sum(|seen| &seen.served),
        micros(50),
        micros(99),
        sum(|seen| &seen.not_connected),
        sum(|seen| &seen.no_slot),
        sum(|seen| &seen.lost),
        sum(|seen| &seen.lost_on_link),
    )
}

/// An answer to a request.
enum Answer {
    Done,
    Value(i32),
    NoRobot,
    NoSlot,
    Other(String),
}

/// Writes unique numbers and reads them back until the test is over.
pub(super) fn run(front: Front, address: &str, plc: u8, mut rng: Rng, seen: &Seen, shared: &Shared) {
    let (plc, mut request, mut pending) = (plc.into(), 0, Pending::new());
    while !shared.is_over() {
        let links = shared.links.load(Ordering::Relaxed);
        let ended = Connection::open(front, address).and_then(|mut connection| {
            session(&mut connection, plc, &mut request, &mut pending, &mut rng, seen, shared)
        });
        let count = match ended {
            Ok(true) => {
                // its slot is free for other clients for some time
                sleep(Duration::from_millis(rng.u64(500..3000)));
                continue;
            }
            Ok(false) => &seen.no_slot,
            Err(_) if links == shared.links.load(Ordering::Relaxed) => &seen.lost,
            Err(_) => &seen.lost_on_link,
        };
        count.fetch_add(1, Ordering::Relaxed);
        sleep(Duration::from_millis(100));
    }
}

/// Performs some requests; returns false when there was no slot.
fn session(
    connection: &mut Connection,
    plc: i32,
    request: &mut i32,
    pending: &mut Pending,
    rng: &mut Rng,
    seen: &Seen,
    shared: &Shared,
) -> io::Result<bool> {
    for _ in 0..rng.u32(100..400) {
        if shared.is_over() {
            break;
        }
        *request += 1;
        let (index, number) = (plc * VARIABLES + *request % VARIABLES, plc * 100_000_000 + *request);
        let robots = shared.robots.load(Ordering::Relaxed);
        pending.insert((index, number));
        let since = Instant::now();
        let mut answer = connection.put(index, number)?;
        if matches!(answer, Answer::Done) {
            seen.times.lock().unwrap().push(since.elapsed());
            answer = connection.get(index)?;
        }
        match answer {
            Answer::Value(found) if found == number => {
                seen.served.fetch_add(1, Ordering::Relaxed);
                // this PLC writes no variable concurrently, so its earlier numbers do not reappear
                pending.retain(|(of, _)| *of != index);
            }
            // a robot that was started again has lost its variables
            Answer::Value(0) if robots != shared.robots.load(Ordering::Relaxed) => {}
            // the robot carried out an earlier request late, whose connection was lost
            Answer::Value(found) if pending.contains(&(index, found)) => {}
            Answer::NoRobot => drop(seen.not_connected.fetch_add(1, Ordering::Relaxed)),
            Answer::NoSlot => return Ok(false),
            Answer::Value(found) => seen.add_wrong(format!("I{index} is {found} after {number} was written")),
            Answer::Done => seen.add_wrong(format!("no value of I{index}")),
            Answer::Other(answer) => seen.add_wrong(format!("the answer for I{index} and {number} is {answer}")),
        }
        sleep(PACE);
    }
    Ok(true)
}

/// A connection to the board.
enum Connection {
    Rac(Plc),
    Modbus(TcpStream),
}

impl Connection {
    fn open(front: Front, address: &str) -> io::Result<Self> {
        Ok(match front {
            Front::Rac => Self::Rac(Plc::try_connect(address, TIMEOUT)?),
            Front::Modbus => {
                let stream = TcpStream::connect(address)?;
                stream.set_read_timeout(Some(TIMEOUT))?;
                stream.set_nodelay(true)?;
                Self::Modbus(stream)
            }
        })
    }

    fn put(&mut self, index: i32, number: i32) -> io::Result<Answer> {
        match self {
            Self::Rac(plc) => plc.try_ask(&format!("PUT:RC8:{index}:I:3,{number}\r")).map(|answer| rac(&answer)),
            Self::Modbus(stream) => {
                let [high, low] = register(index);
                let [a, b, c, d] = number.to_be_bytes();
                ask(stream, &[16, high, low, 0, 2, 4, a, b, c, d])
            }
        }
    }

    fn get(&mut self, index: i32) -> io::Result<Answer> {
        match self {
            Self::Rac(plc) => plc.try_ask(&format!("GET:RC8:{index}:I:\r")).map(|answer| rac(&answer)),
            Self::Modbus(stream) => {
                let [high, low] = register(index);
                ask(stream, &[3, high, low, 0, 2])
            }
        }
    }
}

/// Reads an answer of RAC.
fn rac(answer: &str) -> Answer {
    let value = answer.strip_prefix("0,3,").and_then(|value| value.strip_suffix('\r')?.parse().ok());
    match value {
        Some(value) => Answer::Value(value),
        None if answer == "0\r" => Answer::Done,
        None if [HResult::E_NOT_CONNECTED, HResult::E_TIMEOUT].map(error).iter().any(|error| error == answer) => {
            Answer::NoRobot
        }
        None if answer == error(HResult::E_MAX_CONNECT) => Answer::NoSlot,
        None => Answer::Other(format!("{answer:?}")),
    }
}

/// The address of the registers of a variable of the fourth PLC.
fn register(index: i32) -> [u8; 2] {
    u16::try_from((index % VARIABLES) * 2).unwrap().to_be_bytes()
}

/// Performs a request of Modbus.
fn ask(stream: &mut TcpStream, function: &[u8]) -> io::Result<Answer> {
    let length = u8::try_from(function.len() + 1).unwrap();
    stream.write_all(&[&[0x12, 0x34, 0, 0, 0, length, 1], function].concat())?;
    let mut head = [0; 7];
    stream.read_exact(&mut head)?;
    let mut response = vec![0; usize::from(head[5]).saturating_sub(1)];
    stream.read_exact(&mut response)?;
    Ok(match response[..] {
        _ if head[..5] != [0x12, 0x34, 0, 0, 0] => Answer::Other(format!("{head:?} {response:?}")),
        [3, 4, a, b, c, d] if function[0] == 3 => Answer::Value(i32::from_be_bytes([a, b, c, d])),
        [16, ..] if function[0] == 16 && response[1..] == function[1..5] => Answer::Done,
        [0x83 | 0x90, 0x0a | 0x0b] => Answer::NoRobot,
        [0x83 | 0x90, 6] => Answer::NoSlot,
        _ => Answer::Other(format!("{response:?}")),
    })
}
