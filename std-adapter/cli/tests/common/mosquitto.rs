//! A Mosquitto on a free port.

use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};

/// A broker; dropping this kills it.
pub(crate) struct Broker {
    child: Child,
    pub(crate) port: u16,
}

impl Drop for Broker {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Starts a broker; `None`, with a line that says so, where Mosquitto is not installed.
pub(crate) fn broker() -> Option<Broker> {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let start = |name| Command::new(name).args(["-p", &port.to_string()]).stderr(Stdio::null()).spawn();
    let Ok(child) = start("mosquitto").or_else(|_| start("/usr/sbin/mosquitto")) else {
        println!("skipped: mosquitto is not installed");
        return None;
    };
    while TcpStream::connect(("127.0.0.1", port)).is_err() {
        std::thread::yield_now();
    }
    Some(Broker { child, port })
}
