//! Lets PLCs read and write variables of a robot over RAC.
//!
//! ```text
//! bcap sim --rac 127.0.0.1:5008
//! cargo run -p bcap-std --features gateway --example gateway -- 127.0.0.1
//! bcap rac --port 5006 put I1 5
//! ```

use std::future::pending;
use std::io;

use bcap_gateway::{Allow, Config, Gateway, Memory, Rules};
use bcap_std::core::rac::VariableKind;
use bcap_std::gateway::Driver;
use tokio::net::TcpListener;

#[tokio::main(flavor = "current_thread")]
async fn main() -> io::Result<()> {
    let robot = std::env::args().nth(1).unwrap_or_else(|| "192.168.0.1".into());
    run(TcpListener::bind("0.0.0.0:5006").await?, (robot, 5007), pending()).await
}

/// Serves PLCs of `listener` with the variables of `robot` until `end` is ready.
pub(crate) async fn run(listener: TcpListener, robot: (String, u16), end: impl Future<Output = ()>) -> io::Result<()> {
    // PLCs read everything, and write I0 to I99
    let rules = Rules { put: const { &[Allow::range(VariableKind::I, 0, 99)] }, ..Rules::READ_ONLY };
    let memory: &'static mut Memory<8, 256> = Box::leak(Box::new(Memory::new()));
    let gateway = Gateway::new(Config { rules, ..Config::RC8 }, memory);
    let counters = Driver::new(gateway, robot, |report| println!("{report:?}")).run(listener, end).await;
    println!("{counters:?}");
    Ok(())
}
