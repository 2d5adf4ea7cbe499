//! The processes of the bench, and their cost.

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};

use crate::Failure;

/// A child process; dropping it kills it.
pub(crate) struct Process {
    child: Child,
    lines: std::io::Lines<BufReader<ChildStdout>>,
}

impl Process {
    pub(crate) fn start(command: &mut Command) -> Result<Self, Failure> {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::inherit()).spawn()?;
        let lines = BufReader::new(child.stdout.take().ok_or("no output")?).lines();
        Ok(Self { child, lines })
    }

    /// Starts a Mosquitto on a free port.
    pub(crate) fn broker(folder: &Path) -> Result<(Self, u16), Failure> {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let file = folder.join("mosquitto.conf");
        let config = format!("listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\nlog_dest none\n");
        fs::write(&file, config)?;
        let broker = Self::start(Command::new("/usr/sbin/mosquitto").arg("-c").arg(&file))?;
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            std::thread::yield_now();
        }
        Ok((broker, port))
    }

    /// Waits for a line of the output.
    pub(crate) fn line(&mut self) -> Result<String, Failure> {
        Ok(self.lines.next().ok_or("a process has ended")??)
    }

    pub(crate) fn usage(&self) -> Result<Usage, Failure> {
        Usage::of(&self.child.id().to_string())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The processor time and the memory of a process.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Usage {
    /// In hundredths of a second.
    pub(crate) ticks: u64,
    pub(crate) kib: u64,
}

impl Usage {
    /// Reads the figures of a process; `self` is this one.
    pub(crate) fn of(process: &str) -> Result<Self, Failure> {
        let stat = fs::read_to_string(format!("/proc/{process}/stat"))?;
        // the name of the program may have spaces
        let (_, stat) = stat.rsplit_once(')').ok_or("no name in stat")?;
        let mut ticks = 0;
        for field in stat.split_whitespace().skip(11).take(2) {
            ticks += field.parse::<u64>()?;
        }
        let status = fs::read_to_string(format!("/proc/{process}/status"))?;
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("no VmRSS")?;
        let kib = resident.trim().trim_end_matches(" kB").parse()?;
        Ok(Self { ticks, kib })
    }
}
