//! Mosquitto, a broker for MQTT, in a separate process that does not outlive the tests.

use std::fs;
use std::io;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::tools;

/// Maximum time until a new broker listens.
const LIMIT: Duration = Duration::from_secs(30);

/// A broker; dropping this ends it. If the process of the tests ends without a drop, a supervising shell kills the broker.
#[derive(Debug)]
pub struct Mosquitto {
    folder: TempDir,
    program: PathBuf,
    running: Option<Running>,
    /// The port on 127.0.0.1 where it listens.
    pub port: u16,
}

#[derive(Debug)]
struct Running {
    broker: Child,
    supervisor: Child,
}

impl Mosquitto {
    /// Starts a broker without passwords; `None` where Mosquitto is not installed.
    #[must_use]
    pub fn open() -> Option<Self> {
        Self::start(|_| "allow_anonymous true\n".into())
    }

    /// Starts a broker with more lines of configuration, made by a function that gets its folder, and waits until it listens.
    /// `None` where Mosquitto is not installed.
    ///
    /// # Panics
    ///
    /// If the broker cannot be started.
    #[must_use]
    pub fn start(more: impl FnOnce(&Path) -> String) -> Option<Self> {
        let program = tools::find("mosquitto")?;
        let folder = tempfile::tempdir().expect("a folder");
        let listener = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
        let port = listener.expect("a free port").port();
        // Debian's package changes to its own user, which cannot write here
        let text = format!(
            "listener {port} 127.0.0.1\nuser root\npersistence true\npersistence_location {}/\nmax_queued_messages 0\n{}",
            folder.path().display(),
            more(folder.path())
        );
        fs::write(folder.path().join("mosquitto.conf"), text).expect("a configuration");
        let mut broker = Self { folder, program, running: None, port };
        broker.restart();
        let until = Instant::now() + LIMIT;
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            assert!(Instant::now() < until, "the broker does not listen");
            thread::sleep(Duration::from_millis(1));
        }
        Some(broker)
    }

    /// Returns the folder of its configuration.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Starts it again.
    ///
    /// # Panics
    ///
    /// If the broker cannot be started.
    pub fn restart(&mut self) {
        let file = self.folder.path().join("mosquitto.conf");
        self.running = Some(Running::start(&self.program, &file).expect("a broker"));
    }

    /// Ends the broker as its service does; it writes its sessions to disk.
    pub fn stop(&mut self) {
        self.signal("-TERM");
    }

    /// Ends the broker as a crash does; it loses messages that it has acknowledged but not delivered.
    pub fn kill(&mut self) {
        self.signal("-KILL");
    }

    fn signal(&mut self, signal: &str) {
        if let Some(running) = self.running.take() {
            running.end(signal);
        }
    }
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Running {
    fn start(program: &Path, file: &Path) -> io::Result<Self> {
        let broker = Command::new(program).arg("-c").arg(file).stderr(Stdio::null()).spawn()?;
        // the end of this process, even by a signal, closes the pipe on which the shell waits
        let script = "read line; kill -KILL \"$1\"";
        let mut supervisor = Command::new("sh");
        supervisor.args(["-c", script, "sh", &broker.id().to_string()]).stdin(Stdio::piped());
        Ok(Self { supervisor: supervisor.spawn()?, broker })
    }

    fn end(mut self, signal: &str) {
        // before the broker is reaped: its number could be given to another process
        let _ = (self.supervisor.kill(), self.supervisor.wait());
        // Mosquitto loses a SIGTERM that arrives after it listens and before it serves
        while matches!(self.broker.try_wait(), Ok(None)) {
            let _ = Command::new("kill").args([signal, &self.broker.id().to_string()]).status();
            thread::sleep(Duration::from_millis(10));
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_broker_that_has_just_begun_to_listen_ends() {
        for _ in 0..20 {
            let Some(mut broker) = Mosquitto::open() else { return };
            broker.stop();
            assert!(broker.running.is_none());
        }
    }

    const CHILD: &str = "MOSQUITTO_CHILD";

    /// Started as a child of the next test: prints the number of a broker, and waits for its death.
    #[test]
    fn a_process_with_a_broker() {
        if std::env::var_os(CHILD).is_none() {
            return;
        }
        let Some(broker) = Mosquitto::open() else { return };
        println!("broker {}", broker.running.as_ref().unwrap().broker.id());
        thread::sleep(Duration::from_secs(60));
    }

    #[test]
    fn a_broker_does_not_outlive_a_killed_test() {
        use std::io::{BufRead as _, BufReader};
        if tools::find("mosquitto").is_none() {
            return;
        }
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "--nocapture", "mosquitto::tests::a_process_with_a_broker"]).env(CHILD, "1");
        let mut test = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(test.stdout.take().unwrap()).lines().map(Result::unwrap);
        let number = lines.find_map(|line| Some(line.split_once("broker ")?.1.to_owned())).unwrap();
        let folder = Path::new("/proc").join(number);
        assert!(folder.join("stat").exists());
        // SIGKILL: no drop runs
        test.kill().unwrap();
        test.wait().unwrap();
        // a zombie, which no process reaps in some containers, has ended
        let state =
            || fs::read_to_string(folder.join("stat")).ok()?.rsplit_once(") ").map(|(_, state)| state.to_owned());
        while state().is_some_and(|state| !state.starts_with('Z')) {
            thread::sleep(Duration::from_millis(1));
        }
    }
}
