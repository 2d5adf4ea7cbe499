//! Tests the pages of the gateway board in QEMU, its messages of syslog, and its time from a server of SNTP.

use std::io::{Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::sync::mpsc::{self, Sender, TryRecvError};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

use bcap_qemu::{Board, Plc, Sim, TIMEOUT, bcap, free_port, run};

/// Sends a request and returns the head and the body of the response. The board resets connections while both listeners
/// close earlier ones, so it tries again.
fn get(port: u16, request: &str) -> (String, String) {
    let since = Instant::now();
    loop {
        if let Ok(response) = try_get(port, request)
            && let Some((head, body)) = response.split_once("\r\n\r\n")
        {
            return (head.to_owned(), body.to_owned());
        }
        assert!(since.elapsed() < TIMEOUT, "no response to {request}");
    }
}

fn try_get(port: u16, request: &str) -> std::io::Result<String> {
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.write_all(format!("{request} HTTP/1.1\r\nHost: board\r\n\r\n").as_bytes())?;
    let mut response = String::new();
    stream.read_to_string(&mut response)?;
    Ok(response)
}

/// Returns the number after a key of the JSON.
fn number(json: &str, key: &str) -> u64 {
    let (_, rest) = json.split_once(&format!("\"{key}\":")).unwrap_or_else(|| panic!("{key} in {json}"));
    let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap_or_else(|_| panic!("{key} in {json}"))
}

/// Starts a server of SNTP on this machine, and returns its port. Its first answers must be refused, and so must the last
/// answer, which it sends after a message that the clock is set.
fn time_server() -> (u16, Sender<()>, JoinHandle<()>) {
    let server = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = server.local_addr().unwrap().port();
    let (clock_is_set, is_set) = mpsc::channel();
    let thread = std::thread::spawn(move || {
        let mut request = [0; 128];
        let (count, board) = server.recv_from(&mut request).unwrap();
        assert_eq!((count, request[0]), (48, 0x23), "a request of version 4");
        let mut good = [0; 48];
        (good[0], good[1]) = (0x24, 2);
        good[24..32].copy_from_slice(&request[40..48]);
        // 2026-11-26T15:41:40Z
        good[40..44].copy_from_slice(&4_004_696_500_u32.to_be_bytes());
        let late = |time: u32, (at, byte): (usize, u8)| {
            let mut answer = good;
            answer[40..44].copy_from_slice(&time.to_be_bytes());
            answer[at] = byte;
            answer
        };
        let send = |answer: &[u8]| {
            server.send_to(answer, board).unwrap();
            // the board has room for one datagram
            sleep(Duration::from_millis(100));
        };
        // in 2027 would be wrong: not synchronised, a client, stratum 0, another request
        for change in [(0, 0xe4), (0, 0x23), (1, 0), (24, good[24] ^ 1)] {
            send(&late(4_036_232_500, change));
        }
        send(&good[..47]);
        // a board that stalls drops some
        while is_set.try_recv() == Err(TryRecvError::Empty) {
            send(&good);
        }
        send(&late(4_036_232_500, (0, good[0])));
    });
    (port, clock_is_set, thread)
}

/// Returns a message without its time, and whether it has one: of the right day.
fn without_time(message: &str) -> (String, bool) {
    let mut words = message.splitn(3, ' ');
    let [first, time, rest] = std::array::from_fn(|_| words.next().unwrap());
    assert!(time == "-" || time.starts_with("2026-11-26T15:") && time.ends_with('Z') && time.len() == 24, "{message}");
    (format!("{first} - {rest}"), time != "-")
}

#[test]
fn the_page_shows_the_state_and_syslog_tells_refusals_and_changes() {
    let bcap = bcap();
    let collector = UdpSocket::bind("127.0.0.1:0").unwrap();
    collector.set_read_timeout(Some(TIMEOUT)).unwrap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let port = free_port();
    let syslog = format!("syslog=10.0.2.2:{}", collector.local_addr().unwrap().port());
    let (time_port, clock_is_set, time_server) = time_server();
    let ntp = format!("ntp=10.0.2.2:{time_port}");
    let mut settings = vec!["provider=CaoProv.DENSO.VRC", "hostname=cell-7", "put=F/1=-0.5..2", &syslog, &ntp];
    // more rules than the page has room for
    settings.extend(["put@192.168.100.200=I/100000-100099=-1000000..1000000"; 31]);
    // the image of the test of Modbus, so that one build serves both
    let modbus = free_port().to_string();
    let mut board = Board::start(&sim.bcap, &["--health", &port.to_string(), "--modbus", &modbus], &settings).up();
    let message = || {
        let mut datagram = [0; 1024];
        let count = collector.recv(&mut datagram).unwrap();
        without_time(&String::from_utf8_lossy(&datagram[..count])).0
    };
    assert_eq!(message(), "<133>1 - cell-7 gateway - start - last reset: power-on");
    // the board may have tried to connect before the robot was there
    while message() != "<133>1 - cell-7 gateway - robot-up - connected" {}

    assert!(!run(&bcap, &["rac", "put", "I5", "7", "--robot", &board.rac]).ok);
    let refused = message();
    assert!(refused.starts_with("<132>1 - cell-7 gateway - refused - 10.0.2.2:"), "{refused}");
    assert!(refused.ends_with(": PUT:RC8:5:I:3,7"), "{refused}");

    let (head, json) = get(port, "GET /health.json");
    assert!(head.starts_with("HTTP/1.1 200 OK\r\n") && head.contains("application/json"), "{head}");
    assert!(json.starts_with("{\"image\":\"gateway\",\"version\":\"0.1.0\",\"uptime_s\":"), "{json}");
    assert!(json.contains("\"last_reset\":\"power-on\",\"robot\":{\"state\":\"up\",\"sessions\":1}"), "{json}");
    assert!(json.contains("\"slots\":4},\"requests\":{\"refused\":1,\"served\":{\"count\":"), "{json}");
    assert!((1..12_288).contains(&number(&json, "stack\":{\"most")), "{json}");
    // a refused line, its answer, and the handshake with the robot
    for (buffer, size) in [
        ("log", 4096),
        ("PLC receive buffer", 512),
        ("PLC send buffer", 512),
        ("robot receive buffer", 1024),
        ("robot send buffer", 1024),
    ] {
        assert!((1..=size).contains(&number(&json, &format!("{buffer}\":{{\"most"))), "{json}");
    }
    assert!(number(&json, "frames received") > 10, "{json}");
    assert_eq!(number(&json, "syslog messages lost"), 0, "{json}");

    let (head, page) = get(port, "GET /");
    assert!(head.contains("text/html") && page.starts_with("<!DOCTYPE html>"), "{head} {page}");
    assert!(page.contains("<tr><td>robot<td>up<tr>") && page.contains("<tr><td>last reset<td>power-on<tr>"), "{page}");
    assert!(get(port, "PUT /").0.starts_with("HTTP/1.1 405 "));
    assert!(get(port, "GET /settings").0.starts_with("HTTP/1.1 404 "));
    let rules = get(port, "GET /rules").1;
    assert!(rules.contains("<tr><td>PUT<td>F/1-1<td>-0.5..2 <td>"), "{rules}");
    let end = "</table><p>Clients: all<p>The page has no room for the others.<p><a href=/>State</a>";
    assert!(rules.ends_with(end), "{rules}");
    let since = Instant::now();
    // the times of earlier messages are known as well then
    while !get(port, "GET /log").1.contains("<tr><td>2026-11-26T15:4") {
        assert!(since.elapsed() < TIMEOUT, "the clock is not set: {}", board.log());
    }
    clock_is_set.send(()).unwrap();
    time_server.join().unwrap();
    let log = get(port, "GET /log").1;
    assert!(!log.contains("2027-"), "{log}");
    assert!(log.contains("<td>refused<td>10.0.2.2:") && log.contains("PUT:RC8:5:I:3,7"), "{log}");
    // the page escapes these lines, and has no room for all of them; one a second is a message
    let mut plc = Plc::connect_when_free(&board.rac);
    for _ in 0..4 {
        sleep(Duration::from_millis(1100));
        assert!(plc.ask(&format!("{}\r", "&".repeat(200))).starts_with('-'));
        assert!(message().ends_with("&&&"));
    }
    let log = get(port, "GET /log").1;
    assert!(log.contains("&amp;&amp;") && log.ends_with("</table><p><a href=/>State</a>"), "{log}");

    sim.end("-KILL");
    let mut datagram = [0; 1024];
    let count = collector.recv(&mut datagram).unwrap();
    let (down, has_time) = without_time(&String::from_utf8_lossy(&datagram[..count]));
    assert!(has_time, "the clock was set by then");
    assert!(down.starts_with("<132>1 - cell-7 gateway - robot-down - "), "{down}");
    assert!(get(port, "GET /health.json").1.contains("\"state\":\"down\""));
    assert!(board.is_running(), "{}", board.log());
}

#[test]
fn a_message_that_a_search_for_boards_replaces_is_counted_as_lost() {
    let bcap = bcap();
    let sim = Sim::start(&bcap, "127.0.0.1:0");
    let [page, modbus, find] = [(); 3].map(|()| free_port());
    let [pages, modbus, found] = [page, modbus, find].map(|port| port.to_string());
    // a collector that does not exist; the image of the test above
    let options = ["--health", &pages, "--modbus", &modbus, "--find", &found];
    let board = Board::start(&sim.bcap, &options, &["provider=CaoProv.DENSO.VRC", "syslog=10.0.2.99"]).up();
    let lost = || number(&get(page, "GET /health.json").1, "syslog messages lost");
    // the messages of the start, and then none for longer than a message waits
    let since = Instant::now();
    let before = loop {
        let before = lost();
        sleep(Duration::from_secs(4));
        if before >= 2 && lost() == before {
            break before;
        }
        assert!(since.elapsed() < TIMEOUT, "{before} messages lost: {}", board.log());
    };
    assert!(!run(&bcap, &["rac", "put", "I5", "7", "--robot", &board.rac]).ok);
    let search = run(&bcap, &["board", "find", &format!("127.0.0.1:{find}"), "--timeout", "20000"]);
    assert!(search.ok, "{search:?}");
    let since = Instant::now();
    while lost() == before {
        assert!(since.elapsed() < TIMEOUT, "the message was not counted: {}", board.log());
    }
}
