//! An echo server, to measure the round trip of the network and the board without the gateway.

use embassy_executor::{SpawnError, Spawner};
use embassy_net::Stack;
use embassy_net::tcp::{Error, TcpSocket};
use embassy_time::Timer;
use static_cell::ConstStaticCell;

/// Concurrent connections.
pub const ECHOES: usize = 4;

/// Starts the tasks that serve the port. Call it once.
///
/// # Errors
///
/// A [`SpawnError`] when they are already running.
pub fn start(spawner: Spawner, stack: Stack<'static>, port: u16) -> Result<(), SpawnError> {
    static MEMORY: ConstStaticCell<[[[u8; 512]; 2]; ECHOES]> = ConstStaticCell::new([[[0; 512]; 2]; ECHOES]);
    for memory in MEMORY.take() {
        spawner.spawn(serve(stack, port, memory)?);
    }
    Ok(())
}

#[embassy_executor::task(pool_size = ECHOES)]
async fn serve(stack: Stack<'static>, port: u16, memory: &'static mut [[u8; 512]; 2]) -> ! {
    let [rx, tx] = memory;
    let mut socket = TcpSocket::new(stack, rx, tx);
    socket.set_nagle_enabled(false);
    loop {
        socket.abort();
        match socket.accept(port).await {
            Ok(()) => {
                // the peer closed or reset the connection
                let _ = echo(&mut socket).await;
            }
            Err(_) => Timer::after_millis(100).await,
        }
    }
}

async fn echo(socket: &mut TcpSocket<'_>) -> Result<(), Error> {
    let mut bytes = [0; 256];
    loop {
        let count = socket.read(&mut bytes).await?;
        let mut rest = bytes.get(..count).unwrap_or_default();
        if rest.is_empty() {
            socket.close();
            return socket.flush().await;
        }
        while !rest.is_empty() {
            let sent = socket.write(rest).await?;
            rest = rest.get(sent..).unwrap_or_default();
        }
    }
}
