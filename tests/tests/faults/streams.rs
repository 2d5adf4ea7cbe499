//! Tests with streams whose bytes are split, delayed, corrupted, repeated or lost.

use std::time::Duration;

use bcap_core::bcap::call::{self, ControllerHandle};
use bcap_core::bcap::client::{ClientError, Timeout};
use bcap_core::hresult::HResult;
use bcap_core::io::CallError;
use bcap_std::server::Limits;
use bcap_std::{Options, asynch, blocking};
use bcap_testkit::network::{Random, answer_to};
use bcap_tests::proxy::{Script, Step, StreamFault, TcpProxy};
use bcap_tests::served::Served;

/// How a call has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Timeout,
    Lost,
    Malformed,
    Refused(HResult),
}

impl From<CallError<std::io::Error>> for Outcome {
    fn from(error: CallError<std::io::Error>) -> Self {
        match error {
            CallError::Io(_) | CallError::Disconnected => Self::Lost,
            CallError::Refused(code) => Self::Refused(code),
            CallError::Client(ClientError::Timeout(Timeout::Attempt)) => Self::Timeout,
            CallError::Client(ClientError::Malformed(_) | ClientError::Closed | ClientError::Reply(_)) => {
                Self::Malformed
            }
            error => panic!("{error}"),
        }
    }
}

/// Options of a client with this timeout of its calls.
fn options(timeout: Duration) -> Options {
    Options::default().timeout(timeout).connect_timeout(Duration::from_secs(30))
}

/// A timeout that is long enough for every event, on any machine.
const PATIENT: Duration = Duration::from_secs(30);

/// A session of a blocking client: it starts, sends this number of tokens and disconnects without ending the service.
fn blocking_session(proxy: &TcpProxy, options: &Options, tokens: i32) -> Result<i32, Outcome> {
    let mut client = blocking::connect_tcp(proxy.address, options).map_err(|_| Outcome::Lost)?;
    client.call(call::service_start(""))?;
    let controller = client.call(call::controller_connect("", "", "", ""))?;
    for token in 0..tokens {
        let answer = client.call(call::controller_execute(controller, "token", [token, 0]))?.as_i32();
        assert_eq!(answer, Some(answer_to(token)), "the value is the call's own");
    }
    Ok(tokens)
}

/// The same by a client of tokio.
async fn tokio_session(proxy: &TcpProxy, options: &Options, tokens: i32) -> Result<i32, Outcome> {
    let mut client = asynch::connect_tcp(proxy.address, options).await.map_err(|_| Outcome::Lost)?;
    client.call(call::service_start("")).await?;
    let controller = client.call(call::controller_connect("", "", "", "")).await?;
    for token in 0..tokens {
        let answer = client.call(call::controller_execute(controller, "token", [token, 0])).await?.as_i32();
        assert_eq!(answer, Some(answer_to(token)), "the value is the call's own");
    }
    Ok(tokens)
}

/// A session by each kind of client; both must have the same result.
fn sessions(proxy: &TcpProxy, options: &Options, tokens: i32) -> Result<i32, Outcome> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let tokio = runtime.block_on(tokio_session(proxy, options, tokens));
    let blocking = blocking_session(proxy, options, tokens);
    assert_eq!(blocking, tokio, "both kinds of clients");
    blocking
}

#[test]
fn a_stream_in_any_pieces_carries_every_call() {
    let server = Served::start(Limits::default());
    let millis = Duration::from_millis;
    for fault in [StreamFault::Plain, StreamFault::Split, StreamFault::Merge(millis(3)), StreamFault::Stall(millis(50))]
    {
        let proxy = TcpProxy::start(server.tcp, move |_| Script::always(fault));
        assert_eq!(sessions(&proxy, &options(PATIENT), 30), Ok(30), "{fault:?}");
    }
    server.stop_empty();
}

/// Less than a session of ten tokens has, either way.
const BYTES: u64 = 220;

#[test]
fn a_connection_that_ends_at_every_third_byte_ends_its_call_and_leaves_nothing() {
    let server = Served::start(Limits::default());
    for fault in [StreamFault::Cut, StreamFault::Reset] {
        for at in (0..BYTES).step_by(3) {
            let step = vec![Step { at, fault }];
            let to_server = Script { to_server: step.clone(), ..Script::default() };
            let to_client = Script { to_client: step, ..Script::default() };
            for script in [to_server, to_client] {
                let proxy = TcpProxy::start(server.tcp, move |_| script.clone());
                let outcome = blocking_session(&proxy, &options(PATIENT), 10);
                assert_eq!(outcome, Err(Outcome::Lost), "{fault:?} at {at}");
            }
        }
    }
    server.stop_empty();
}

#[test]
fn a_stall_beyond_the_timeout_costs_its_call_and_not_the_next() {
    let server = Served::start(Limits::default());
    let stall = |at| vec![Step { at, fault: StreamFault::Stall(Duration::from_secs(2)) }];
    // in the middle of the third request, and of the fourth reply
    for script in
        [Script { to_server: stall(190), ..Script::default() }, Script { to_client: stall(90), ..Script::default() }]
    {
        let proxy = TcpProxy::start(server.tcp, move |_| script.clone());
        let mut client = blocking::connect_tcp(proxy.address, &options(Duration::from_millis(800))).unwrap();
        let outcomes: Vec<bool> = (0..200)
            .map(|token| match client.call(call::controller_execute(ControllerHandle(1), "token", [token, 0])) {
                // the server has not issued this handle; the refusal is also an answer
                Err(CallError::Refused(HResult::E_HANDLE)) => true,
                Err(CallError::Client(ClientError::Timeout(Timeout::Attempt))) => false,
                other => panic!("{other:?}"),
            })
            .collect();
        let lost = outcomes.iter().filter(|is_answered| !**is_answered).count();
        assert!((1..=3).contains(&lost), "of 200 calls {lost} have waited for 2 s in pieces of 800 ms");
        assert_eq!(outcomes.last(), Some(&true));
    }
    server.stop_empty();
}

#[test]
fn every_call_ends_on_a_faulty_stream() {
    let server = Served::start(Limits::default());
    let (mut whole, mut ended) = (0, 0);
    for seed in 0..150 {
        let script = Script::random(&mut Random(seed), 2000, false);
        let proxy = TcpProxy::start(server.tcp, move |_| script.clone());
        match blocking_session(&proxy, &options(PATIENT), 20) {
            Ok(_) => whole += 1,
            Err(Outcome::Lost) => ended += 1,
            // delayed bytes were not lost, and no byte was changed
            Err(other) => panic!("seed {seed}: {other:?}"),
        }
    }
    assert!(whole > 10 && ended > 10, "{whole} sessions to their end, {ended} cut");
    server.stop_empty();
}

#[test]
fn bytes_that_are_changed_or_doubled_end_the_call_or_the_connection_and_nothing_else() {
    let server = Served::start(Limits::default().receive(Duration::from_millis(500)));
    let mut seen = [0; 3];
    for seed in 1000..1100 {
        let at = Random(seed).below(700);
        let fault = if seed % 2 == 0 {
            StreamFault::Corrupt(1 << (seed / 2 % 8))
        } else {
            StreamFault::Repeat(1 + seed as usize % 40)
        };
        let step = vec![Step { at, fault }];
        let script = match seed % 4 < 2 {
            true => Script { to_server: step, ..Script::default() },
            false => Script { to_client: step, ..Script::default() },
        };
        let proxy = TcpProxy::start(server.tcp, move |_| script.clone());
        let mut client = blocking::connect_tcp(proxy.address, &options(Duration::from_millis(700))).unwrap();
        let mut step = || -> Result<(), Outcome> {
            client.call(call::service_start(""))?;
            let controller = client.call(call::controller_connect("", "", "", ""))?;
            for token in 0..10 {
                // a stream has no checksum of ours: a changed value inside of a whole frame cannot be seen
                client.call(call::controller_execute(controller, "token", [token, 0]))?;
            }
            Ok(())
        };
        match step() {
            Ok(()) => seen[0] += 1,
            Err(Outcome::Lost | Outcome::Malformed | Outcome::Timeout) => seen[1] += 1,
            Err(Outcome::Refused(_)) => seen[2] += 1,
        }
    }
    let mut direct = blocking::connect_tcp(server.tcp, &Options::default()).unwrap();
    direct.call(call::service_start("")).unwrap();
    direct.call(call::service_stop()).unwrap();
    drop(direct);
    assert!(seen[1] > 20 && seen.iter().all(|count| *count > 0), "{seen:?}");
    server.stop_empty();
}
