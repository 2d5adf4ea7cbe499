//! The environment of the commands of a page: a folder, a virtual controller, and the servers that they start.

use std::env;
use std::fs;
use std::io::{BufRead, BufReader};
use std::net::{TcpListener, UdpSocket};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, Command as Process, Stdio};
use std::thread;
use std::time::Duration;

use bcap_sim::{Config, Controller, Profile, Scenario};
use bcap_std::server::Limits;
use bcap_tests::served::Served;
use bcap_tests::stepped::Stepped;
use tempfile::TempDir;

use crate::book::page::Command;
use crate::book::pattern::{matches, replace};

/// The address of the virtual controller in the pages.
const ROBOT: &str = "192.168.0.1";

/// Runs a command; a command that waits forever must not hang the test.
const LIMITED: &str = "exec timeout 60 sh -c \"$COMMAND\" 2>&1";

/// An option of a server that names where it listens.
struct Listening {
    option: &'static str,
    /// The keys of these addresses in the `ready` line.
    keys: &'static [&'static str],
    /// Empty if it does not listen without the option.
    default: &'static str,
}

const fn listening(option: &'static str, keys: &'static [&'static str], default: &'static str) -> Listening {
    Listening { option, keys, default }
}

const SIM: &[Listening] = &[
    listening("--bcap", &["bcap"], "127.0.0.1:5007"),
    listening("--udp", &["udp"], "127.0.0.1:5007"),
    listening("--rac", &["rac"], "127.0.0.1:5006"),
];
const GATEWAY: &[Listening] = &[listening("--rac", &["rac"], "127.0.0.1:5006"), listening("--modbus", &["modbus"], "")];
const PROXY: &[Listening] =
    &[listening("--listen", &["bcap", "udp"], "127.0.0.1:5007"), listening("--listen-rac", &["rac"], "")];

pub(crate) struct World {
    folder: TempDir,
    servers: Vec<Child>,
    /// The addresses of the page, and the addresses of this run.
    to_actual: Vec<(String, String)>,
    to_page: Vec<(String, String)>,
    /// The environment variables of the current controller.
    robot: Option<[(&'static str, String); 2]>,
    /// A virtual controller in this process, for pages about Slave Mode.
    stepped: Option<Served<Stepped>>,
}

impl World {
    /// An empty folder, with a link to the folder of the pages.
    pub(crate) fn new(docs: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        symlink(docs.canonicalize().unwrap(), folder.path().join("docs")).unwrap();
        Self { folder, servers: Vec::new(), to_actual: Vec::new(), to_page: Vec::new(), robot: None, stepped: None }
    }

    pub(crate) fn write(&mut self, name: &str, content: &str) {
        let content = replace(content, &self.to_actual);
        fs::write(self.folder.path().join(name), content).unwrap();
    }

    /// Starts a virtual controller, whose address on the pages is [`ROBOT`].
    pub(crate) fn start_sim(&mut self, options: &str) {
        if let Some(options) = options.strip_prefix("stepped") {
            let config = Config { motor_on_delay: Duration::from_millis(1), ..Config::new(Profile::Rc8) };
            let mut controller = Controller::new(config);
            if let Some(file) = options.strip_prefix(" --scenario ") {
                let text = fs::read_to_string(self.folder.path().join(file)).unwrap();
                controller.play(Scenario::parse(&text).unwrap());
            }
            let sim = Served::of(Stepped::new(controller), Limits::default());
            self.know(sim.tcp.to_string(), sim.udp.to_string(), None);
            self.stepped = Some(sim);
            return;
        }
        let ready = self.start(&format!("bcap sim {options}")).unwrap_or_else(|output| panic!("{output}"));
        let [tcp, udp, rac] = ["bcap", "udp", "rac"].map(|key| address(&ready, key));
        self.know(tcp.unwrap(), udp.unwrap(), rac);
    }

    /// Translates the addresses of [`ROBOT`] from now on.
    fn know(&mut self, tcp: String, udp: String, rac: Option<String>) {
        self.robot = Some(variables(&tcp, rac.as_deref()));
        for (page, actual) in [
            (ROBOT.to_owned(), tcp.clone()),
            (format!("tcp:{ROBOT}"), format!("tcp:{tcp}")),
            (format!("udp:{ROBOT}"), format!("udp:{udp}")),
            (format!("{ROBOT}:5007"), tcp.clone()),
            (format!("tcp:{ROBOT}:5007"), format!("tcp:{tcp}")),
            (format!("udp:{ROBOT}:5007"), format!("udp:{udp}")),
        ] {
            self.translate(page, actual);
        }
        if let Some(rac) = &rac {
            self.translate(format!("{ROBOT}:5006"), rac.clone());
        }
        for (actual, port) in [(Some(tcp), 5007), (Some(udp), 5007), (rac, 5006)] {
            let Some(actual) = actual else { continue };
            self.to_page.retain(|(known, _)| *known != actual);
            self.to_page.push((actual, format!("{ROBOT}:{port}")));
        }
    }

    /// Runs a command, and compares its exit code and output.
    pub(crate) fn run(&mut self, command: &Command) -> Result<(), String> {
        let fail = |what: &str, output: &str| Err(format!("{}: $ {}\n{what}\n{output}", command.place, command.text));
        if let Some(server) = command.text.strip_suffix('&') {
            if self.robot.is_none() && !server.starts_with("bcap sim") {
                self.start_sim("");
            }
            return match self.start(server.trim_end()).map(|line| replace(&line, &self.to_page)) {
                Ok(line) if command.output.is_empty() || matches(&command.output, std::slice::from_ref(&line)) => {
                    Ok(())
                }
                Ok(output) => fail("the server prints:", &output),
                Err(output) => fail("the server ends:", &output),
            };
        }
        if self.robot.is_none() {
            self.start_sim("");
        }
        let output = self
            .shell(LIMITED)
            .env("COMMAND", replace(&command.text, &self.to_actual))
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let shown = replace(&String::from_utf8_lossy(&output.stdout), &self.to_page);
        if output.status.code() != Some(command.exit) {
            return fail(&format!("ends with {:?}:", output.status), &shown);
        }
        let lines: Vec<String> = shown.lines().map(|line| line.trim_end().to_owned()).collect();
        if command.output.is_empty() || matches(&command.output, &lines) { Ok(()) } else { fail("prints:", &shown) }
    }

    /// Starts a server on free ports, and returns its first line. Another process may take such a port first, so it tries again.
    fn start(&mut self, text: &str) -> Result<String, String> {
        let mut result = self.try_start(text);
        for _ in 0..4 {
            if result.is_ok() {
                break;
            }
            result = self.try_start(text);
        }
        result
    }

    fn try_start(&mut self, text: &str) -> Result<String, String> {
        let options = match text.split_whitespace().nth(1) {
            Some("sim") => SIM,
            Some("gateway") => GATEWAY,
            Some("proxy") => PROXY,
            _ => return Err(format!("{text}: an unknown server")),
        };
        let mut words: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
        let mut addresses = Vec::new();
        let both = free_port();
        for &Listening { option, keys, default } in options {
            let known = words.iter().position(|word| word == option);
            if known.is_none() && default.is_empty() {
                continue;
            }
            let page = known.map_or_else(|| default.to_owned(), |at| words.drain(at..at + 2).next_back().unwrap());
            addresses.extend(keys.iter().map(|key| (*key, page.clone())));
            // a real controller has one port for TCP and UDP
            let port = if matches!(option, "--bcap" | "--udp") { both } else { 0 };
            words.extend([option.to_owned(), format!("127.0.0.1:{port}")]);
        }
        let text = format!("exec {}", replace(&words.join(" "), &self.to_actual));
        let mut child = self.shell(&text).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        self.servers.push(child);
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        if !line.starts_with("ready ") {
            return Err(format!("{text}: {line}"));
        }
        // the rest of its output must not fill the pipe
        thread::spawn(move || std::io::copy(&mut output, &mut std::io::sink()));
        for (key, page) in addresses {
            self.serve(&line, key, &page);
        }
        if words[1] == "sim" {
            let [tcp, rac] = ["bcap", "rac"].map(|key| address(&line, key));
            self.robot = Some(variables(&tcp.unwrap(), rac.as_deref()));
        }
        Ok(line.trim_end().to_owned())
    }

    /// Translates the address of a server from now on.
    fn serve(&mut self, ready: &str, key: &str, page: &str) {
        let Some(actual) = address(ready, key) else { return };
        let prefix = if key == "udp" { "udp:" } else { "tcp:" };
        self.translate(format!("{prefix}{page}"), format!("{prefix}{actual}"));
        if key != "udp" {
            self.translate(page.to_owned(), actual.clone());
        }
        self.to_page.push((actual, page.to_owned()));
    }

    fn translate(&mut self, page: String, actual: String) {
        self.to_actual.retain(|(known, _)| *known != page);
        self.to_actual.push((page, actual));
    }

    fn shell(&self, text: &str) -> Process {
        let own = Path::new(env!("CARGO_BIN_EXE_bcap")).parent().unwrap().to_owned();
        let path = env::join_paths([own].into_iter().chain(env::split_paths(&env::var_os("PATH").unwrap()))).unwrap();
        let mut shell = Process::new("sh");
        for name in ["TIMEOUT", "PROVIDER", "MACHINE", "OPTION", "ATTEMPTS", "PROFILE"] {
            shell.env_remove(format!("BCAP_{name}"));
        }
        shell.args(["-c", text]).current_dir(self.folder.path()).env("PATH", path).env("HOME", self.folder.path());
        shell.env_remove("XDG_CONFIG_HOME").env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE");
        shell.envs(self.robot.clone().into_iter().flatten());
        shell
    }
}

impl Drop for World {
    fn drop(&mut self) {
        for server in &mut self.servers {
            let _ = server.kill();
            let _ = server.wait();
        }
    }
}

/// The environment variables of a controller.
fn variables(tcp: &str, rac: Option<&str>) -> [(&'static str, String); 2] {
    let port = rac.and_then(|rac| rac.rsplit(':').next()).unwrap_or("5006");
    [("BCAP_ROBOT", format!("tcp:{tcp}")), ("BCAP_RAC_PORT", port.to_owned())]
}

/// Returns a port that is free for TCP and UDP.
fn free_port() -> u16 {
    loop {
        let tcp = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        if UdpSocket::bind(tcp).is_ok() {
            return tcp.port();
        }
    }
}

/// Returns an address of a line `ready bcap=IP:PORT udp=IP:PORT rac=IP:PORT`.
fn address(ready: &str, key: &str) -> Option<String> {
    ready.split_whitespace().find_map(|word| Some(word.strip_prefix(key)?.strip_prefix('=')?.to_owned()))
}
