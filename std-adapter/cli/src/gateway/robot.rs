//! The robot's side of the gateway: one connection, which is opened and closed as the gateway wants it.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use bcap_core::time::Instant;
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::task::coop::consume_budget;
use tokio::time::{sleep, timeout};

use super::{Shared, must_wait};
use crate::target::Target;

/// Keeps the connection and the gateway's time, until the command ends.
pub(super) async fn run(shared: Arc<Shared>, target: Target, limit: Duration, mut stopped: watch::Receiver<()>) {
    let mut stream = None;
    loop {
        // a robot that sends without a pause shall not have the thread to itself
        consume_budget().await;
        shared.step();
        let wanted = shared.lock().gateway.robot_wanted();
        stream = match stream.take() {
            None if wanted => tokio::select! {
                stream = connect(&shared, &target, limit) => stream,
                _ = stopped.changed() => return,
            },
            Some(_) if !wanted => {
                // closed as it is dropped
                shared.lock().gateway.robot_closed(bcap_std::now());
                None
            }
            stream => tokio::select! {
                stream = wait(&shared, stream) => stream,
                _ = stopped.changed() => return,
            },
        };
    }
}

/// Opens the connection, and tells the gateway how it went.
async fn connect(shared: &Shared, target: &Target, limit: Duration) -> Option<TcpStream> {
    let connected = match timeout(limit, TcpStream::connect((target.host.as_str(), target.port))).await {
        Ok(connected) => connected.and_then(|stream| stream.set_nodelay(true).map(|()| stream)),
        Err(_) => Err(io::Error::new(io::ErrorKind::TimedOut, "no connection within the timeout")),
    };
    match connected {
        Ok(stream) => {
            shared.lock().gateway.robot_opened(bcap_std::now());
            Some(stream)
        }
        Err(error) => {
            shared.lock().robot_lost(&error);
            None
        }
    }
}

/// Waits until something can be done, and moves the bytes that can be moved.
async fn wait(shared: &Shared, stream: Option<TcpStream>) -> Option<TcpStream> {
    let (due, sends) = {
        let gateway = &shared.lock().gateway;
        (gateway.poll_timeout(), !gateway.robot_transmit().is_empty())
    };
    let until = due.unwrap_or(Instant::ZERO).saturating_since(bcap_std::now());
    let moved = tokio::select! {
        moved = transfer(shared, stream.as_ref(), sends) => moved,
        () = sleep(until), if due.is_some() => Ok(()),
        () = shared.robot.notified() => Ok(()),
    };
    match moved {
        Ok(()) => stream,
        Err(error) => {
            shared.lock().robot_lost(&error);
            None
        }
    }
}

/// Moves bytes as soon as some can be moved; an error is the end of the connection. For ever, when there is none.
async fn transfer(shared: &Shared, stream: Option<&TcpStream>, sends: bool) -> io::Result<()> {
    let Some(stream) = stream else { return std::future::pending().await };
    loop {
        tokio::select! {
            ready = stream.writable(), if sends => {
                ready?;
                let gateway = &mut shared.lock().gateway;
                let sent = stream.try_write(gateway.robot_transmit());
                if !must_wait(&sent) {
                    gateway.robot_transmitted(sent?);
                    return Ok(());
                }
            }
            ready = stream.readable() => {
                ready?;
                let gateway = &mut shared.lock().gateway;
                let received = stream.try_read(gateway.robot_receive_buffer());
                if !must_wait(&received) {
                    return match received? {
                        0 => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the robot has closed the connection")),
                        count => {
                            gateway.robot_received(count);
                            Ok(())
                        }
                    };
                }
            }
        }
    }
}
