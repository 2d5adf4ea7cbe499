//! Attacks on blocking and tokio RAC clients: the server sends invalid answers, too many answers, or none.

use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::io::RacError;
use bcap_core::rac::client::{ClientError, Config, Timeout};
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::Variant;
use bcap_std::{Options, asynch, blocking};

use crate::Case;
use crate::script::{Connection, runtime, serve};
use crate::target::{Target, long_timeouts};

pub(crate) const CASES: &[Case] = crate::cases! {
    rac_clients:
        a_rac_server_that_does_not_answer
        a_rac_server_that_closes
        answers_that_are_invalid
        an_answer_that_never_ends
        an_answer_at_a_byte_a_time
        unsolicited_answers
        a_late_answer_does_not_end_the_next_request
        results_of_every_notation
        values_that_cannot_be_sent
};

const VARIABLE: Variable = Variable::new(VariableKind::I, 1);

/// How a request has ended.
#[derive(Debug, PartialEq)]
enum Outcome {
    Number(i32),
    Text(String),
    Refused(HResult),
    Client(ClientError),
    Disconnected,
    Io,
}

impl From<Result<Variant<'_>, RacError<std::io::Error>>> for Outcome {
    fn from(result: Result<Variant<'_>, RacError<std::io::Error>>) -> Self {
        match result {
            Ok(value) => match value.as_i32() {
                Some(number) => Self::Number(number),
                None => Self::Text(value.as_bstr().map(|text| text.to_string()).unwrap_or_default()),
            },
            Err(RacError::Refused(code)) => Self::Refused(code),
            Err(RacError::Client(error)) => Self::Client(error),
            Err(RacError::Disconnected) => Self::Disconnected,
            Err(RacError::Io(_)) => Self::Io,
            Err(error) => panic!("{error}"),
        }
    }
}

/// Reads a variable `count` times, with each kind of client from a separate server. Returns the outcomes, which are the
/// same for all kinds.
fn gets(options: &Options, count: usize, script: fn(&mut Connection)) -> Vec<Outcome> {
    gets_told(options, count, move |connection, _| script(connection))
}

/// The same; the script gets a message when a request of the client has ended.
fn gets_told(
    options: &Options,
    count: usize,
    script: impl Fn(&mut Connection, &Receiver<()>) + Copy + Send + 'static,
) -> Vec<Outcome> {
    let server = || {
        let (ended, receiver) = mpsc::channel();
        (ended, serve(move |connection| script(connection, &receiver)))
    };
    let (ended, address) = server();
    let mut client = blocking::connect_rac(address, options).unwrap();
    let mut blocking: Vec<Outcome> = Vec::new();
    for _ in 0..count {
        blocking.push(client.get(VARIABLE).into());
        let _ = ended.send(());
    }
    let (ended, address) = server();
    let tokio = runtime().block_on(async {
        let mut client = asynch::connect_rac(address, options).await.unwrap();
        let mut outcomes: Vec<Outcome> = Vec::new();
        for _ in 0..count {
            outcomes.push(client.get(VARIABLE).await.into());
            let _ = ended.send(());
        }
        outcomes
    });
    assert_eq!(blocking, tokio, "both kinds of clients");
    blocking
}

/// Reads a request.
fn request(connection: &mut Connection) {
    let mut byte = [0];
    while std::io::Read::read(&mut connection.0, &mut byte).is_ok_and(|count| count == 1) && byte != *b"\r" {}
}

fn brief() -> Options {
    long_timeouts().rac(Config { timeout: Duration::from_millis(200) })
}

const LATE: Outcome = Outcome::Client(ClientError::Timeout(Timeout::Reply));
const OUTSTANDING: Outcome = Outcome::Client(ClientError::Timeout(Timeout::Outstanding));

fn a_rac_server_that_does_not_answer(_: &mut Target) {
    assert_eq!(gets(&brief(), 2, Connection::hold), [LATE, OUTSTANDING]);
}

fn a_rac_server_that_closes(_: &mut Target) {
    assert_eq!(gets(&long_timeouts(), 1, request), [Outcome::Disconnected]);
    let cut = |connection: &mut Connection| {
        request(connection);
        connection.send(b"0,3,4");
    };
    assert_eq!(gets(&long_timeouts(), 1, cut), [Outcome::Disconnected]);
    let reset = |connection: &mut Connection| {
        request(connection);
        connection.reset();
    };
    assert_eq!(gets(&long_timeouts(), 1, reset), [Outcome::Io]);
}

/// An invalid answer ends only its request.
fn answers_that_are_invalid(_: &mut Target) {
    let outcomes = gets(&long_timeouts(), 12, |connection| {
        let wrong: [&[u8]; 6] = [b"", b"OK", b"0,9,1", b"0,3,99999999999", b"0,8,\xff", b"\xff\0\x01"];
        for answer in wrong {
            request(connection);
            connection.send(&[answer, b"\r"].concat());
            request(connection);
            connection.send(b"0,3,42\r");
        }
        connection.hold();
    });
    for pair in outcomes.chunks(2) {
        assert!(matches!(pair[0], Outcome::Client(ClientError::Reply(_))), "{pair:?}");
        assert_eq!(pair[1], Outcome::Number(42));
    }
}

fn an_answer_that_never_ends(_: &mut Target) {
    let outcomes = gets(&long_timeouts(), 1, |connection| {
        request(connection);
        while connection.send(&[b'7'; 4096]) {}
    });
    assert!(matches!(outcomes[0], Outcome::Client(ClientError::Reply(_))), "{outcomes:?}");
}

fn an_answer_at_a_byte_a_time(_: &mut Target) {
    let outcomes = gets(&long_timeouts(), 3, |connection| {
        for _ in 0..3 {
            request(connection);
            for byte in b"0, 3, 42\r\n" {
                connection.send(&[*byte]);
            }
        }
        connection.hold();
    });
    assert_eq!(outcomes, [Outcome::Number(42), Outcome::Number(42), Outcome::Number(42)]);
}

/// RAC has no serials, so an unsolicited answer ends the session; otherwise the next request would get it.
fn unsolicited_answers(_: &mut Target) {
    let outcomes = gets(&long_timeouts(), 2, |connection| {
        request(connection);
        connection.send(b"0,3,42\r0,3,43\r");
        connection.hold();
    });
    assert_eq!(outcomes[0], Outcome::Number(42));
    let unsolicited = [ClientError::Unsolicited, ClientError::Closed].map(Outcome::Client);
    assert!(unsolicited.contains(&outcomes[1]), "{outcomes:?}");
}

fn a_late_answer_does_not_end_the_next_request(_: &mut Target) {
    let options = long_timeouts().rac(Config { timeout: Duration::from_secs(3) });
    let outcomes = gets_told(&options, 2, |connection, ended| {
        request(connection);
        ended.recv().unwrap();
        // the next request waits for the late answer by then
        std::thread::sleep(Duration::from_millis(200));
        connection.send(b"0,3,41\r");
        request(connection);
        connection.send(b"0,3,42\r");
        connection.hold();
    });
    assert_eq!(outcomes, [LATE, Outcome::Number(42)]);
}

fn results_of_every_notation(_: &mut Target) {
    let outcomes = gets(&long_timeouts(), 5, |connection| {
        for answer in ["0x80070057\r", "2147942487\r", "-2147024809\r", "1,3,42\r", "-1,8,left out\r"] {
            request(connection);
            connection.send(answer.as_bytes());
        }
        connection.hold();
    });
    let invalid = || Outcome::Refused(HResult::E_INVALIDARG);
    assert_eq!(outcomes[..4], [invalid(), invalid(), invalid(), Outcome::Number(42)]);
    assert_eq!(outcomes[4], Outcome::Refused(HResult(-1)));
}

/// A value without a text is refused before any byte is sent.
fn values_that_cannot_be_sent(target: &mut Target) {
    use bcap_core::variant::VariantBuf;

    let mut client = blocking::connect_rac(target.rac, &long_timeouts()).unwrap();
    let long = "x".repeat(300);
    for text in ["a\rPUT:RC8:1:I:3,666", "a\nb", " leading", &long] {
        let value = VariantBuf::<1024>::new(text).unwrap();
        let error = client.put(Variable::new(VariableKind::S, 1), value.as_variant()).unwrap_err();
        assert!(matches!(error, RacError::Client(ClientError::Request(_))), "{text:?}: {error}");
    }
    client.put(VARIABLE, Variant::I4(7)).unwrap();
    assert_eq!(client.get(VARIABLE).unwrap(), Variant::I4(7));
}
