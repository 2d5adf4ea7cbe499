//! Tests that `bcap board configure` changes the settings of the gateway board in QEMU, over its second serial port, and that a
//! page also does, with the password, which only the console sets.
//!
//! ```text
//!  bcap ─► pseudo-terminals ─► this test ─► Unix socket ─► QEMU: serial port ─► console ─► flash
//! ```

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::time::Instant;
use std::{env, process};

use crate::line::{connect, join};
use bcap_qemu::{Board, Sim, TIMEOUT, bcap, free_port, run};
use serialport::{SerialPort, TTYPort};

const PROVIDER: &str = "provider=CaoProv.DENSO.VRC";

/// A board with a console.
struct Rig {
    bcap: PathBuf,
    board: Board,
    /// The port of its pages.
    pages: u16,
    /// The pseudo-terminal of its console.
    device: String,
    _sim: Sim,
    _host: TTYPort,
}

impl Rig {
    fn start(name: &str) -> Self {
        let bcap = bcap();
        let (line, host) = TTYPort::pair().unwrap();
        let sim = Sim::start(&bcap, "127.0.0.1:0");
        let socket = env::temp_dir().join(format!("bcap-{name}-{}", process::id()));
        // the image with all features must also fit the board
        let [pages, modbus] = [free_port(), free_port()];
        let [health, modbus] = [pages, modbus].map(|port| port.to_string());
        let options = ["--faults", "--health", &health, "--modbus", &modbus, "--console", path(&socket)];
        let mut board = Board::start(&sim.bcap, &options, &[PROVIDER]).up();
        join(line, connect(&mut board, &socket));
        Self { bcap, board, pages, device: host.name().unwrap(), _sim: sim, _host: host }
    }

    fn configure(&self, arguments: &[&str]) -> String {
        let done = run(&self.bcap, &[&["board", "configure", &self.device, "--timeout", "20000"], arguments].concat());
        assert!(done.ok, "{done:?}");
        done.out
    }

    fn put(&self) -> (String, String) {
        let done = run(&self.bcap, &["rac", "put", "I5", "7", "--robot", &self.board.rac]);
        (done.out, done.err)
    }

    /// Waits until the board serves again after a restart.
    fn up(self) -> Self {
        Self { board: self.board.up(), ..self }
    }

    /// Sends a request to the pages and returns the response. Both listeners may close earlier connections, so it tries again.
    fn request(&self, request: &str) -> String {
        let since = Instant::now();
        loop {
            if let Ok(response) = self.try_request(request)
                && response.starts_with("HTTP/1.1 ")
            {
                return response;
            }
            assert!(since.elapsed() < TIMEOUT, "no response to {request}: {}", self.board.log());
        }
    }

    fn try_request(&self, request: &str) -> std::io::Result<String> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.pages))?;
        stream.set_read_timeout(Some(TIMEOUT))?;
        stream.write_all(request.as_bytes())?;
        let mut response = String::new();
        stream.read_to_string(&mut response)?;
        Ok(response)
    }
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn settings_are_used_after_a_restart_until_they_are_removed() {
    let mut rig = Rig::start("console");

    // the image has no rule for PUT
    assert!(rig.put().1.contains("E_ACCESSDENIED"));
    let of_image = rig.configure(&[]);
    assert!(of_image.contains(PROVIDER) && !of_image.contains("put="), "{of_image}");
    let robot = of_image.lines().find(|line| line.starts_with("robot=")).unwrap();
    let new = [robot, PROVIDER, "put=I/0-99=-10..10", "hostname=cell-7"];
    let answers = rig.configure(&[&new[..], &["--restart"]].concat());
    assert!(answers.ends_with(": ok\nrestart: ok\n"), "{answers}");
    rig = rig.up();
    assert_eq!(rig.put().0, "I5 = 7\n", "{}", rig.board.log());
    assert_eq!(rig.configure(&[]), new.join("\n") + "\n");

    assert_eq!(rig.configure(&["--factory", "--restart"]), "factory: ok\nrestart: ok\n");
    rig = rig.up();
    assert!(rig.put().1.contains("E_ACCESSDENIED"));
    assert_eq!(rig.configure(&[]), of_image);
}

/// `:correct-horse` and `:wrong-horse` in base64.
const RIGHT: &str = "Authorization: Basic OmNvcnJlY3QtaG9yc2U=";
const WRONG: &str = "Authorization: Basic Ondyb25nLWhvcnNl";
/// The address of the board in its own network.
const HOST: &str = "Host: 10.0.2.15";
const ORIGIN: &str = "Origin: http://10.0.2.15";
const PLAIN: &str = "Content-Type: text/plain";

fn get(path: &str, headers: &[&str]) -> String {
    format!("GET {path} HTTP/1.1\r\n{}\r\n\r\n", headers.join("\r\n"))
}

fn post(headers: &[&str], body: &str) -> String {
    format!("POST /settings HTTP/1.1\r\n{}\r\nContent-Length: {}\r\n\r\n{body}", headers.join("\r\n"), body.len())
}

#[test]
fn a_page_changes_the_settings_with_the_password_that_the_console_sets() {
    let mut rig = Rig::start("page");
    let off = rig.request(&get("/settings", &[HOST, RIGHT]));
    assert!(off.starts_with("HTTP/1.1 404 ") && off.contains("bcap board configure PORT"), "{off}");

    let of_image = rig.configure(&[]);
    let mut new: Vec<_> = of_image.lines().collect();
    new.extend(["hostname=cell-7", "password=correct-horse"]);
    rig.configure(&[&new[..], &["--restart"]].concat());
    rig = rig.up();

    let expect = |rig: &Rig, request: &str, status: &str, text: &str| {
        let response = rig.request(request);
        assert!(
            response.starts_with(&format!("HTTP/1.1 {status} ")) && response.contains(text),
            "{request}: {response}"
        );
    };
    expect(&rig, &get("/settings", &[HOST]), "401", "WWW-Authenticate: Basic realm=\"board\"");
    expect(&rig, &get("/settings", &["Host: rebound.example", RIGHT]), "403", "by the address");
    expect(&rig, &get("/settings", &[HOST, RIGHT, "Origin: http://evil.example"]), "403", "Origin");
    expect(&rig, &get("/settings", &[HOST, WRONG]), "401", "wrong password");
    expect(&rig, &get("/health.json", &[HOST]), "200", "\"wrong passwords\":1,");
    expect(&rig, &get("/log", &[HOST]), "200", "<td>password<td>10.0.2.2:");
    let since = Instant::now();
    while rig.request(&get("/settings", &[HOST, RIGHT])).starts_with("HTTP/1.1 429 ") {
        assert!(since.elapsed() < TIMEOUT, "the pause does not end");
    }
    expect(&rig, &get("/settings", &[HOST, RIGHT]), "200", "hostname=cell-7\n</textarea>");
    let text = rig.request(&get("/settings.txt", &[HOST, RIGHT]));
    let lines = text.split_once("\r\n\r\n").unwrap().1;
    assert_eq!(lines, new[..new.len() - 1].join("\n") + "\n", "all lines but the password");

    let all = &[HOST, ORIGIN, PLAIN, RIGHT];
    // as a form sends it
    let changed = format!("settings={}put=I/0-99=-10..10\r\n", lines.replace('\n', "\r\n"));
    for (request, status, text) in [
        (post(&[HOST, PLAIN, RIGHT], &changed), "403", "Origin"),
        (post(&[HOST, "Origin: http://evil.example", PLAIN, RIGHT], &changed), "403", "Origin"),
        (post(&[HOST, ORIGIN, PLAIN], &changed), "401", "password"),
        (post(&[HOST, ORIGIN, "Content-Type: application/x-www-form-urlencoded", RIGHT], ""), "415", "text/plain"),
        (post(all, "").replace("Content-Length: 0", "Content-Length: 5000"), "413", ""),
        (post(all, &changed.replace("put=I/", "put=X/")), "400", "column 5: unknown kind of variable"),
        (post(all, &(changed.clone() + "password=abcdefgh\r\n")), "400", "over the console only"),
        (post(all, &(changed.clone() + "mac=02:00:00:bc:a9:04\r\n")), "409", "reach=yes"),
    ] {
        expect(&rig, &request, status, text);
    }
    // the settings were parsed several times, on the stack of 12 KiB
    let health = rig.request(&get("/health.json", &[HOST]));
    let stack = health.split_once("\"stack\":{\"most\":").and_then(|(_, rest)| rest.split_once(',')).unwrap().0;
    println!("stack of the board with a page of settings: {stack} bytes");
    assert!(stack.parse::<u32>().unwrap() <= 11_776, "{stack} bytes of the stack were in use");

    // a PLC that is connected stays connected
    let mut plc = TcpStream::connect(&rig.board.rac).unwrap();
    plc.set_read_timeout(Some(TIMEOUT)).unwrap();
    plc.write_all(b"GET:RC8:1:I:\r").unwrap();
    assert!(plc.read(&mut [0; 64]).unwrap() > 0);
    expect(&rig, &post(all, &changed), "409", "1 PLCs are connected");
    assert!(rig.put().1.contains("E_ACCESSDENIED"));
    drop(plc);
    // until the board has detected the end of the connections
    let since = Instant::now();
    let saved = loop {
        let response = rig.request(&post(all, &changed));
        if !response.starts_with("HTTP/1.1 409 ") {
            break response;
        }
        assert!(since.elapsed() < TIMEOUT, "{response}");
    };
    assert!(saved.starts_with("HTTP/1.1 200 ") && saved.ends_with("saved; the board restarts\n"), "{saved}");
    // the rules are those of the page after the restart
    let since = Instant::now();
    while rig.put().0 != "I5 = 7\n" {
        assert!(since.elapsed() < TIMEOUT, "{}", rig.board.log());
    }
    rig = rig.up();
    new.insert(0, "password=correct-horse");
    new.pop();
    new.push("put=I/0-99=-10..10");
    assert_eq!(rig.configure(&[]), new.join("\n") + "\n");
    expect(&rig, &get("/settings.txt", &[HOST, RIGHT]), "200", "\nput=I/0-99=-10..10\n");
}
