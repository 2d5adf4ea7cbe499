//! Tests with lost, duplicated, reordered and corrupted datagrams.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicI32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bcap_core::bcap::call;
use bcap_core::bcap::client::{ClientError, Config, Timing};
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_std::server::Limits;
use bcap_std::{Options, asynch, blocking};
use bcap_testkit::network::{Faults, answer_to};
use bcap_tests::proxy::UdpProxy;
use bcap_tests::served::Served;

/// Calls over UDP, shared by all clients that make them.
struct Calls {
    address: SocketAddr,
    options: Options,
    next: AtomicI32,
    /// The duration of one call in ten, in milliseconds: longer than its first attempt.
    slow: i32,
    /// By token: whether the call was reported as done.
    reported: Mutex<Vec<Option<bool>>>,
}

impl Calls {
    /// Makes calls until all tokens are used; retries from another port when a session cannot be started.
    async fn client(self: Arc<Self>) {
        while !self.session().await {}
    }

    /// Makes calls in one session; `false` when it did not begin, because five times in a row something was lost.
    async fn session(&self) -> bool {
        let mut client = asynch::connect_udp(self.address, &self.options).await.unwrap();
        let Ok(()) = client.call(call::service_start("")).await else { return false };
        let Ok(controller) = client.call(call::controller_connect("", "", "", "")).await else { return false };
        loop {
            let token = self.next.fetch_add(1, Ordering::Relaxed);
            let Ok(index) = usize::try_from(token) else { return true };
            if index >= self.reported.lock().unwrap().len() {
                return true;
            }
            let millis = if token % 10 == 0 { self.slow } else { 0 };
            let is_done = match client.call(call::controller_execute(controller, "token", [token, millis])).await {
                Ok(value) => {
                    assert_eq!(value.as_i32(), Some(answer_to(token)), "the reply is this call's");
                    true
                }
                Err(CallError::Client(ClientError::Timeout(_)) | CallError::Refused(HResult::E_BUSY_PROC)) => false,
                Err(other) => panic!("token {token}: {other}"),
            };
            self.reported.lock().unwrap()[index] = Some(is_done);
        }
    }
}

/// Slots for all clients, and for clients that connect again from another port.
pub(crate) fn limits() -> Limits {
    Limits::default().udp_peers(1000).udp_peers_per_address(1000)
}

/// Makes calls by a hundred concurrent clients, each with a separate token, and checks the number of executions of each call.
/// Returns how many were reported as done, and how many as failed.
pub(crate) fn call_over_udp(server: Served, address: SocketAddr, calls: usize, attempt: Duration) -> (usize, usize) {
    let timing = Timing { attempt_timeout: attempt, deadline: Duration::from_secs(10), ..Timing::UDP };
    let udp = Config { timing, ..Config::UDP };
    let options = Options::default().udp(udp);
    let reported = Mutex::new(vec![None; calls]);
    let slow = 2 * i32::try_from(attempt.as_millis()).unwrap();
    let all = Arc::new(Calls { address, options, next: AtomicI32::new(0), slow, reported });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut tasks = tokio::task::JoinSet::new();
        for _ in 0..100 {
            tasks.spawn(Arc::clone(&all).client());
        }
        while let Some(ended) = tasks.join_next().await {
            ended.expect("no client has panicked");
        }
    });
    let application = server.stop();
    let reported = all.reported.lock().unwrap();
    for (token, reported) in (0..).zip(reported.iter()) {
        let executed = application.executed.get(&token).copied().unwrap_or(0);
        match reported {
            Some(true) => assert_eq!(executed, 1, "token {token} was reported as done"),
            Some(false) => assert!(executed <= 1, "token {token} was executed {executed} times"),
            None => panic!("token {token} did not end"),
        }
    }
    let done = reported.iter().filter(|reported| **reported == Some(true)).count();
    (done, calls - done)
}

#[test]
fn datagrams_are_lost_doubled_and_reordered_and_every_call_is_executed_once() {
    // `just lossy` makes a hundred thousand
    let calls = std::env::var("UDP_CALLS").map_or(3000, |calls| calls.parse().expect("UDP_CALLS is a number"));
    let server = Served::start(limits());
    let faults = Faults { loss: 100, repeat: 100, delay: Duration::from_millis(50), ..Faults::default() };
    let proxy = UdpProxy::start(server.udp, faults, 20_261_121);
    let begun = Instant::now();
    // several times the delay, because 100 clients, the server and the proxy may share a busy processor
    let (done, failed) = call_over_udp(server, proxy.address, calls, Duration::from_millis(250));
    let time = begun.elapsed();
    let count = |count: &AtomicU64| count.load(Ordering::Relaxed);
    let counts = &proxy.counts;
    let [sent, lost, repeated, overtaken] =
        [&counts.datagrams, &counts.lost, &counts.repeated, &counts.overtaken].map(count);
    println!(
        "{done} calls done and executed once, {failed} given up and executed at most once, in {:.1} s; of {sent} datagrams \
         {lost} were lost, {repeated} doubled, {overtaken} overtaken",
        time.as_secs_f64()
    );
    assert_eq!(done + failed, calls);
    // five attempts; each is lost one time in five
    assert!(failed <= 5 + done / 100, "{failed} given up");
    assert!(lost > sent / 12 && repeated > sent / 15 && overtaken > 0);
}

#[test]
fn garbled_datagrams_end_no_service() {
    let server = Served::start(limits());
    // a flipped bit in a value or a marker cannot be detected, so the number of executions is not checked
    let faults = Faults { loss: 50, garble: 5, delay: Duration::from_millis(5), ..Faults::default() };
    let proxy = UdpProxy::start(server.udp, faults, 7);
    let timing =
        Timing { attempt_timeout: Duration::from_millis(50), deadline: Duration::from_secs(10), ..Timing::UDP };
    let udp = Config { timing, ..Config::UDP };
    let mut client = blocking::connect_udp(proxy.address, &Options::default().udp(udp)).unwrap();
    let mut done = 0;
    for _ in 0..300 {
        match client.call(call::service_start("")) {
            Ok(()) => done += 1,
            Err(CallError::Client(_) | CallError::Refused(_)) => {}
            Err(other) => panic!("{other}"),
        }
    }
    assert!(done > 200, "{done} of 300");
    let mut direct = blocking::connect_udp(server.udp, &Options::default()).unwrap();
    direct.call(call::service_start("")).unwrap();
    direct.call(call::service_stop()).unwrap();
    drop(server.stop());
}
