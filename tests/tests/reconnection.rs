//! A controller that is killed and restarted under load: no write is executed twice, and no write is lost without an
//! error.
//!
//! `RESTARTS=100 cargo test -p bcap-tests reconnection:: -- --nocapture` is the long run.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bcap_core::device::{Device, DeviceVariable};
use bcap_core::hresult::HResult;
use bcap_std::asynch::Controller;
use bcap_std::server::Server;
use bcap_std::{Backoff, Error, Settings};
use bcap_testkit::network::Random;
use tokio::task::JoinHandle;

/// All values that were written, over all restarts of the controller.
type Log = Arc<Mutex<Vec<i32>>>;

fn device(log: &Log) -> Device<Log, 1> {
    let variable = DeviceVariable::new("I1", |log: &Log, reply| {
        let last = log.lock().unwrap().last().copied().unwrap_or(0);
        reply.set(&last)
    });
    let variable = variable.writable(|log: &mut Log, value| {
        log.lock().unwrap().push(value.convert().map_err(|_| HResult::E_INVALIDARGTYPE)?);
        Ok(())
    });
    Device::new(Arc::clone(log), [variable])
}

/// Starts the controller; aborting the task kills it.
async fn start(address: SocketAddr, log: &Log) -> JoinHandle<()> {
    let server = loop {
        match Server::new(device(log)).bcap_tcp(address).await {
            Ok(server) => break server,
            // the port of the life before may not be free yet
            Err(_) => tokio::time::sleep(Duration::from_millis(1)).await,
        }
    };
    tokio::spawn(async move { drop(server.run(std::future::pending()).await) })
}

/// The reported outcome of a write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Told {
    Written,
    NotSent,
    Unknown,
}

#[tokio::test]
async fn no_write_is_executed_twice_or_lost_without_an_error() {
    let restarts = std::env::var("RESTARTS").ok().and_then(|n| n.parse().ok()).unwrap_or(15_u32);
    let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let log = Log::default();
    let backoff = Backoff::default().min(Duration::from_millis(2)).max(Duration::from_millis(20));
    let cell = Controller::spawn(&format!("tcp:{address}"), &Settings::rc8().reconnect(backoff)).unwrap();
    let (stop, next) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicI32::new(1)));
    let writers: Vec<_> = (0..4)
        .map(|_| {
            let (cell, stop, next) = (cell.clone(), Arc::clone(&stop), Arc::clone(&next));
            tokio::spawn(async move {
                let mut told = Vec::new();
                while !stop.load(Ordering::Relaxed) {
                    let value = next.fetch_add(1, Ordering::Relaxed);
                    told.push((
                        value,
                        match cell.write("I1", value).await {
                            Ok(()) => Told::Written,
                            Err(Error::NotConnected { .. } | Error::Refused { .. }) => Told::NotSent,
                            Err(_) => Told::Unknown,
                        },
                    ));
                    tokio::time::sleep(Duration::from_micros(300)).await;
                }
                told
            })
        })
        .collect();

    let (mut random, mut delays) = (Random(3), Vec::new());
    for _ in 0..restarts {
        let server = start(address, &log).await;
        let up = Instant::now();
        while cell.read::<i32>("I1").await.is_err() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        delays.push(up.elapsed());
        tokio::time::sleep(Duration::from_micros(random.below(20_000))).await;
        server.abort();
        let _ = server.await;
        tokio::time::sleep(Duration::from_micros(random.below(20_000))).await;
    }
    stop.store(true, Ordering::Relaxed);
    let mut told = HashMap::new();
    for writer in writers {
        told.extend(writer.await.unwrap());
    }
    cell.close().await.unwrap();

    let mut executed = HashMap::<i32, u32>::new();
    for value in log.lock().unwrap().iter() {
        *executed.entry(*value).or_default() += 1;
    }
    for (value, told) in &told {
        let times = executed.get(value).copied().unwrap_or(0);
        let allowed = match told {
            Told::Written => times == 1,
            Told::NotSent => times == 0,
            Told::Unknown => times <= 1,
        };
        assert!(allowed, "the write of {value} was told as {told:?} and executed {times} times");
    }
    let count = |kind| told.values().filter(|told| **told == kind).count();
    assert!(count(Told::Written) > 0 && count(Told::NotSent) > 0, "there was no load, or no failure");
    delays.sort_unstable();
    println!(
        "{restarts} restarts: {} written, {} not sent, {} unknown; first good read after p50 {:.1?}, p99 {:.1?}",
        count(Told::Written),
        count(Told::NotSent),
        count(Told::Unknown),
        delays[delays.len() / 2],
        delays[delays.len() * 99 / 100]
    );
}
