//! A connection with large or many requests yields to other tasks. The tests check counts and threads, not times.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::{self, ThreadId};
use std::time::Duration;

use bcap_core::bcap::FunctionId;
use bcap_core::bcap::call::{self, ControllerHandle, VariableHandle};
use bcap_core::bcap::server::{Handler, Request};
use bcap_core::handler::{Outcome, PeerId, ReplyValue};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::served::{Served, frame};

/// A handler that opens any object and accepts any value. For each value it records the thread, and the number of turns of a
/// second task.
struct Recorder {
    puts: Vec<Put>,
    /// The turns of a task that only counts.
    turns: Arc<AtomicUsize>,
    /// Received before the first value is recorded, so that further requests are in the server's socket by then.
    begin: mpsc::Receiver<()>,
}

#[derive(Clone, Copy)]
struct Put {
    thread: ThreadId,
    turn: usize,
}

impl Handler for Recorder {
    fn call(&mut self, _: PeerId, request: &Request<'_>, reply: &mut ReplyValue<'_>, _: Instant) -> Outcome {
        if request.function == FunctionId::VARIABLE_PUT_VALUE {
            if self.puts.is_empty() {
                let _ = self.begin.recv_timeout(Duration::from_millis(500));
            }
            let turn = self.turns.load(Ordering::Relaxed);
            self.puts.push(Put { thread: thread::current().id(), turn });
        } else if request.function.opens().is_some() && request.function != FunctionId::SERVICE_START {
            return reply.set(&1_i32).map_or(HResult::E_FAIL, |()| HResult::S_OK).into();
        }
        HResult::S_OK.into()
    }
}

/// Sends `count` values of `bytes` bytes without waiting for a reply; returns the recording, and the server's thread.
fn puts(count: usize, bytes: usize) -> (Vec<Put>, ThreadId) {
    let (begin, begun) = mpsc::channel();
    let turns = Arc::<AtomicUsize>::default();
    let handler = Recorder { puts: Vec::new(), turns: Arc::clone(&turns), begin: begun };
    let mut server = Served::start(handler, async |server| {
        tokio::spawn(async move {
            loop {
                turns.fetch_add(1, Ordering::Relaxed);
                tokio::task::yield_now().await;
            }
        });
        server.bcap_tcp("127.0.0.1:0").await
    });
    let thread = server.thread();
    flood(server.tcp(), count, bytes, begin);
    server.stop();
    let puts = server.handler().puts.clone();
    (puts, thread)
}

fn flood(address: SocketAddr, count: usize, bytes: usize, begin: mpsc::Sender<()>) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(&frame(call::service_start(""))).unwrap();
    stream.write_all(&frame(call::controller_connect("", "", "", ""))).unwrap();
    stream.write_all(&frame(call::controller_get_variable(ControllerHandle(1), "I1", ""))).unwrap();
    let mut replies = stream.try_clone().unwrap();
    let put = frame(call::variable_put_value(VariableHandle(1), &vec![7_u8; bytes][..]));
    let writer = thread::spawn(move || {
        for _ in 0..count {
            stream.write_all(&put).unwrap();
        }
        let _ = begin.send(());
        stream
    });
    // replies without and with a handle
    let mut all = vec![0; 16 + 2 * 30 + count * 16];
    replies.read_exact(&mut all).unwrap();
    drop(writer.join().unwrap());
}

/// Checks that another task had a turn within any `count` consecutive values. Tokio's scheduler may give a task two turns in
/// a row, so `count` is the number of values in three turns.
#[track_caller]
fn assert_turns(puts: &[Put], count: usize) {
    for window in puts.windows(count) {
        assert!(window[count - 1].turn > window[0].turn, "{count} values in one turn");
    }
}

#[test]
fn a_turn_ends_after_256_kib() {
    // 2 MiB, in requests of half a turn
    let (puts, server) = puts(16, 128 << 10);
    assert_eq!(puts.len(), 16);
    assert!(puts.iter().all(|put| put.thread == server), "requests below 256 KiB run on the server's thread");
    assert_turns(&puts, 3 * 2 + 1);
}

#[test]
fn a_turn_ends_after_32_small_requests() {
    let (puts, _) = puts(300, 4);
    assert_eq!(puts.len(), 300);
    assert_turns(&puts, 3 * 32 + 1);
}

#[test]
fn a_large_request_runs_on_another_thread() {
    let (puts, server) = puts(3, 15 << 20);
    assert_eq!(puts.len(), 3);
    assert!(puts.iter().all(|put| put.thread != server), "requests of 256 KiB or more run on another thread");
}
