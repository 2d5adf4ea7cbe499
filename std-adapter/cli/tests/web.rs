//! `bcap web` as a process; the page itself is tested in `std-adapter/web`.

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use crate::common::running::Running;
use crate::common::{bare, bcap};
use bcap_tests::process::{Signal, send};

/// A running `bcap web`.
struct Web {
    process: Child,
    lines: BufReader<std::process::ChildStdout>,
    url: String,
}

impl Web {
    fn start(mut command: Command) -> Self {
        let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap());
        let mut url = String::new();
        lines.read_line(&mut url).unwrap();
        Self { process, lines, url: url.trim().to_owned() }
    }

    /// Sends a request, and returns the response.
    fn request(&self, first: &str) -> String {
        let (host, token) = self.url.strip_prefix("http://").unwrap().split_once("/#token=").unwrap();
        let mut stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        write!(
            stream,
            "{first} HTTP/1.1\r\nhost: {host}\r\norigin: http://{host}\r\nx-bcap-token: {token}\r\ncontent-length: 0\r\n\
             connection: close\r\n\r\n"
        )
        .unwrap();
        let mut response = Vec::new();
        stream.read_to_end(&mut response).unwrap();
        // a file of packets is not text
        String::from_utf8_lossy(&response).into_owned()
    }

    /// Ends it as Ctrl-C does, and returns its last lines and its exit code.
    fn end(mut self) -> (String, Option<i32>) {
        send(Signal::INT, &self.process);
        let mut rest = String::new();
        self.lines.read_to_string(&mut rest).unwrap();
        (rest, self.process.wait().unwrap().code())
    }
}

impl Drop for Web {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The pipe is full after some hundred lines; no line is lost.
#[test]
fn an_output_that_nobody_reads_delays_no_halt() {
    let web = Web::start(bare(&["web", "--listen", "127.0.0.1:0", "--robot", "tcp:127.0.0.1:1"]));
    for _ in 0..700 {
        assert!(web.request("POST /halt/0").contains("NOT HALTED, use the emergency stop"));
    }
    let (lines, code) = web.end();
    assert_eq!((lines.matches(": a page: HALT: NOT HALTED").count(), code), (700, Some(0)));
    assert!(lines.len() > 70_000, "{} bytes fit into a pipe", lines.len());
}

/// A file of labels with a wrong line is refused before anything is opened.
#[test]
fn a_wrong_line_of_the_labels_is_named() {
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), "F1 = pressure [bar]\nIO128 gripper\n").unwrap();
    let labels = file.path().to_str().unwrap();
    let run =
        bare(&["web", "--listen", "127.0.0.1:0", "--robot", "tcp:127.0.0.1:1", "--labels", labels]).output().unwrap();
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    let error = String::from_utf8(run.stderr).unwrap();
    assert!(error.contains("line 2: write IO130 = LABEL"), "{error}");
}

/// The profiles are the tiles; a halt of a controller that is not there fails, and is a line of the output.
#[test]
fn it_prints_its_address_serves_the_profiles_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("bcap")).unwrap();
    let text = "[profile.press]\naddress = \"tcp:127.0.0.1:1\"\n[profile.welder]\nmodel = \"rc9\"\n";
    fs::write(folder.path().join("bcap/config.toml"), text).unwrap();
    let with = |args: &[&str]| {
        let mut command = bare(args);
        command.env("XDG_CONFIG_HOME", folder.path());
        command
    };
    let web = Web::start(with(&["web", "press", "--listen", "127.0.0.1:0"]));
    assert!(web.url.starts_with("http://127.0.0.1:") && web.url.len() > 70, "{}", web.url);
    assert!(web.request("GET /").contains("<title>bcap</title>"));
    let halted = web.request("POST /halt/0");
    assert!(halted.contains("NOT HALTED, use the emergency stop: "), "{halted}");
    let (rest, code) = web.end();
    assert!(rest.contains(" press: a page: HALT: NOT HALTED, use the emergency stop: "), "{rest}");
    assert_eq!(code, Some(0));
    let missing = with(&["web", "welder"]).output().unwrap();
    let error = String::from_utf8(missing.stderr).unwrap();
    assert!(missing.status.code() == Some(2) && error.contains("the profile welder has no address"), "{error}");
}

/// The line `ready` contains the address of the page. Pages and other clients use the same controller.
#[test]
fn a_virtual_controller_serves_its_page_and_its_panel() {
    let any = "127.0.0.1:0";
    let mut web = Web::start(bare(&["sim", "--bcap", any, "--udp", any, "--rac", any, "--web", any]));
    let line = std::mem::take(&mut web.url);
    let (ready, url) = line.split_once(" web=").unwrap();
    let address = ready.split(' ').find_map(|word| word.strip_prefix("bcap=")).unwrap();
    web.url = url.to_owned();
    assert!(web.request("GET /panel.js").contains("Emergency stop"));
    let put = bcap(&["--robot", &format!("tcp:{address}"), "put", "I1=5"]);
    assert_eq!(put.code, 0, "{put:?}");
    let halted = web.request("POST /halt/0");
    assert!(halted.contains("the robot was at rest"), "{halted}");
    let (rest, code) = web.end();
    assert!(rest.contains(" virtual RC8: a page: HALT, the robot was at rest; nothing was moving: done"), "{rest}");
    assert_eq!(code, Some(0));
}

/// A page of a replay opens the recorded session again, with its provider and machine.
#[test]
fn a_replay_has_a_page() {
    let (any, folder) = ("127.0.0.1:0", tempfile::tempdir().unwrap());
    let capture = folder.path().join("session.pcapng");
    let capture = capture.to_str().unwrap();
    let page = |args: &[&str]| {
        let mut web = Web::start(bare(&[&["sim", "--bcap", any, "--udp", any, "--web", any], args].concat()));
        web.url = web.url.split_once(" web=").unwrap().1.to_owned();
        // a file with the packets of its session
        let end = Instant::now() + Duration::from_secs(30);
        while !web.request("POST /packets/0").starts_with("HTTP/1.1 200") {
            assert!(Instant::now() < end, "the page is not connected");
            thread::sleep(Duration::from_millis(20));
        }
        web
    };
    assert_eq!(page(&["--model", "rc9", "--write", capture]).end().1, Some(0));
    // the end of a recording whose program was killed is cut off
    let recorded = fs::read(capture).unwrap();
    fs::write(capture, &recorded[..recorded.len() - 7]).unwrap();
    let web = page(&["--replay", capture]);
    let halted = web.request("POST /halt/0");
    assert!(halted.contains("NOT HALTED, use the emergency stop: "), "the capture has no halt: {halted}");
    let (rest, code) = web.end();
    assert!(rest.contains(" replay: a page: HALT: NOT HALTED") && code == Some(0), "{rest}");
    // a capture without a session of b-CAP
    let rac = folder.path().join("rac.pcapng");
    let rac = rac.to_str().unwrap();
    let sim = Running::sim(&["--write", rac]);
    assert_eq!(bcap(&["rac", "get", "I1", "--robot", &sim.rac]).code, 0);
    assert_eq!(sim.interrupt().code, 0);
    let run = bare(&["sim", "--bcap", any, "--udp", any, "--web", any, "--replay", rac]).output().unwrap();
    let error = String::from_utf8(run.stderr).unwrap();
    assert!(error.contains("the capture has no Controller_Connect, which a page needs"), "{error}");
}

#[test]
fn other_computers_serial_lines_and_recordings_are_refused() {
    for (args, error) in [
        (&["--listen", "0.0.0.0:0"][..], "0.0.0.0:0 can be reached by other computers, which needs TLS and a password"),
        (&["--robot", "serial:/dev/ttyUSB0"], "a serial line carries one session, so HALT would have no connection"),
        (&["--trace"], "this command has no --trace"),
        (&["--certificate", "cert.pem"], "the following required arguments were not provided"),
        (&["--certificate", "c.pem", "--key", "k.pem", "--password-file", "/no/such"], "/no/such: No such file"),
    ] {
        let run = bcap(&[&["web"], args].concat());
        assert!(run.code == 2 && run.err.contains(error), "{run:?}");
    }
}
