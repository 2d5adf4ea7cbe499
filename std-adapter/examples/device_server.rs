//! A conveyor that clients of both protocols read and write as a controller.
//!
//! ```text
//! cargo run -p bcap-std --features server --example device_server
//! bcap put F1 0.5 && bcap rac get F1
//! ```

use bcap_std::core::device::{Device, DeviceVariable, assign};
use bcap_std::server::Server;

/// The state of the conveyor.
#[derive(Default)]
pub(crate) struct Conveyor {
    parts: i32,
    speed: f32,
}

/// The variables of the conveyor.
pub(crate) fn device() -> Device<Conveyor, 2> {
    let parts = DeviceVariable::new("I1", |conveyor: &Conveyor, reply| reply.set(&conveyor.parts));
    let speed = DeviceVariable::new("F1", |conveyor: &Conveyor, reply| reply.set(&conveyor.speed));
    Device::new(Conveyor::default(), [parts, speed.writable(|conveyor, value| assign(&mut conveyor.speed, value))])
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> std::io::Result<()> {
    let server = Server::new(device()).bcap_tcp("127.0.0.1:5007").await?;
    let server = server.rac_tcp("127.0.0.1:5006").await?;
    server.run(std::future::pending()).await
}
