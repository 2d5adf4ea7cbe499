//! `bcap rac`: the lines that it sends, and the output for each answer.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::thread;

use crate::common;
use crate::common::bcap;

/// A RAC server that answers every line with `answer(line)`; returns its address and the received lines.
fn server(answer: impl Fn(&str) -> &'static str + Send + 'static) -> (String, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let seen = Arc::new(Mutex::new(Vec::new()));
    let lines = Arc::clone(&seen);
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            let mut line = Vec::new();
            while let Ok(1..) = reader.read_until(b'\r', &mut line) {
                let text = String::from_utf8(std::mem::take(&mut line)).unwrap();
                let reply = answer(&text);
                lines.lock().unwrap().push(text);
                stream.write_all(reply.as_bytes()).unwrap();
            }
        }
    });
    (address, seen)
}

#[test]
fn values_are_printed_as_by_get() {
    let (address, seen) = server(|line| if line.contains(":P:") { "0, 8196, 1, 2.5, 3\r" } else { "0,3,-7\r" });
    let run = bcap(&["rac", "--robot", &address, "get", "I1", "P[2]"]);
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("I1 = -7\nP[2] = 1,2.5,3\n", "", 0));
    assert_eq!(*seen.lock().unwrap(), ["GET:RC8:1:I:\r", "GET:RC8:2:P:\r"]);
    let run = bcap(&["rac", "get", "--json", "--robot", &address, "I1"]);
    assert_eq!(run.out, "{\"name\":\"I1\",\"vt\":3,\"v\":-7}\n");
}

#[test]
fn a_reply_without_the_value_is_an_error_of_the_peer() {
    let (address, _) = server(|_| "0\r");
    let run = bcap(&["rac", "get", "I10", "--robot", &address]);
    assert_eq!((run.out.as_str(), run.code), ("", 3), "{run:?}");
    assert!(run.err.contains("GET I[10]: the reply has no value"), "{}", run.err);
}

#[test]
fn values_are_written_with_the_type_of_their_variable() {
    let (address, seen) = server(|_| "0\r");
    for (name, value) in
        [("I1", "-5"), ("F1", "1.5"), ("D1", "2.5"), ("S1", "a,b"), ("V1", "-1,2,3"), ("IO128", "true")]
    {
        let run = bcap(&["rac", "put", name, value, "--robot", &address]);
        assert_eq!(run.code, 0, "{run:?}");
    }
    assert_eq!(
        *seen.lock().unwrap(),
        [
            "PUT:RC8:1:I:3,-5\r",
            "PUT:RC8:1:F:4,1.5\r",
            "PUT:RC8:1:D:5,2.5\r",
            "PUT:RC8:1:S:8,a,b\r",
            "PUT:RC8:1:V:8196,-1,2,3\r",
            "PUT:RC8:128:IO:11,-1\r",
        ]
    );
}

#[test]
fn raw_lines_are_sent_as_they_are() {
    let (address, seen) = server(|line| if line.contains("\u{e9}") { "-2147024809,\u{1b}[31m\r\n" } else { "0,3,7\r" });
    let run = bcap(&["rac", "raw", "\u{e9} :", "GET:RC8:1:I:", "--robot", &address]);
    assert_eq!((run.out.as_str(), run.err.as_str(), run.code), ("-2147024809,\\u{1b}[31m\n0,3,7\n", "", 0));
    assert_eq!(*seen.lock().unwrap(), ["\u{e9} :\r", "GET:RC8:1:I:\r"]);
    let run = bcap(&["rac", "raw", "--json", "x", "--robot", &address]);
    assert_eq!(run.out, "{\"answer\":\"0,3,7\",\"line\":\"x\"}\n");
    for line in ["", "a\rb", "a\n"] {
        let run = bcap(&["rac", "raw", "x", line, "--robot", &address]);
        assert!(run.code == 2 && run.out.is_empty() && run.err.contains("is not one line"), "{run:?}");
    }
    assert_eq!(seen.lock().unwrap().len(), 3);
    // nothing listens there, and no other test will
    assert_eq!(bcap(&["rac", "raw", "x", "--robot", "127.0.0.1:1"]).code, 3);
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap().to_string();
    let run = bcap(&["rac", "raw", "x", "--timeout", "500", "--robot", &address]);
    assert!(run.code == 4 && run.err.contains("did not answer x within"), "{run:?}");
}

#[test]
fn failures_have_their_exit_codes() {
    let (address, _) = server(|_| "-2147024809\r");
    let run = bcap(&["rac", "get", "I1", "--robot", &address]);
    assert_eq!(run.code, 1);
    assert!(run.err.contains("GET I[1]: the controller refused with 0x80070057 (E_INVALIDARG)"), "{}", run.err);

    let run = bcap(&["rac", "put", "I1", "x", "--robot", &address]);
    assert!(run.code == 2 && run.err.contains("the variable holds VT_I4"), "{run:?}");
    let run = bcap(&["rac", "get", "@MODE", "--robot", &address]);
    assert!(run.code == 2 && run.err.contains("I F D V P J T S IO"), "{run:?}");

    let (address, _) = server(|_| "what?\r");
    let run = bcap(&["rac", "get", "I1", "--robot", &address]);
    assert!(run.code == 3 && run.err.contains("cannot be read"), "{run:?}");

    assert_eq!(bcap(&["rac", "get", "I1", "--robot", "127.0.0.1:1"]).code, 3);

    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap().to_string();
    let run = bcap(&["rac", "get", "I1", "--timeout", "500", "--robot", &address]);
    assert!(run.code == 4 && run.err.contains("time limit of 500 ms (--timeout)"), "{run:?}");
}

#[test]
fn only_the_host_of_the_environment_variable_is_used() {
    let (address, seen) = server(|_| "0,3,1\r");
    let run = |robot: &str| common::command(&["rac", "get", "I1"]).env("BCAP_ROBOT", robot).output().unwrap();
    // without a scheme the variable is a RAC address
    assert_eq!(run(&address).status.code(), Some(0));
    assert_eq!(seen.lock().unwrap().len(), 1);
    // with a scheme its port is the port of b-CAP and is ignored; the command fails at port 5006 of an unknown host
    let output = run("udp:no-such-host.invalid:5007");
    assert_eq!(output.status.code(), Some(3));
}
