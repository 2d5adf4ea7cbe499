//! A session with a virtual controller over TCP, UDP and RAC, with each packet decoded next to its bytes.
//!
//! ```text
//! cargo run -p bcap-capture --example demo
//! ```

use std::error::Error;
use std::io;
use std::net::SocketAddr;
use std::thread;

use bcap_capture::trace::{Level, Packets, Traced, Wire, with_arrow};
use bcap_core::bcap::call::{self, Call, Reply, VariableHandle};
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::{Encode, OwnedVariant, Variant};
use bcap_sim::{Config, Controller, Profile};
use bcap_std::blocking::{self, Connection, RacConnection, Transport};
use bcap_std::server::{Addresses, Server};
use bcap_std::{CallError, Options};

const POSE: [f32; 7] = [400.0, 0.0, 300.5, 180.0, 0.0, 180.0, 5.0];

fn main() -> Result<(), Box<dyn Error>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let server = Server::new(Controller::new(Config::new(Profile::Rc8))).on_connect(Controller::connected);
    let server = runtime.block_on(async {
        server.bcap_tcp("127.0.0.1:0").await?.bcap_udp("127.0.0.1:0").await?.rac_tcp("127.0.0.1:0").await
    })?;
    let Addresses { bcap_tcp, bcap_udp, rac_tcp, .. } = server.addresses();
    // it ends with the program
    thread::spawn(move || runtime.block_on(server.run(std::future::pending())));
    println!("-> marks requests of the client and <- replies of the controller.");
    over_tcp(bcap_tcp[0])?;
    over_udp(bcap_udp[0])?;
    over_rac(rac_tcp[0])?;
    println!("\nThe three links read and wrote the same variables.");
    Ok(())
}

fn over_tcp(address: SocketAddr) -> Result<(), Box<dyn Error>> {
    println!("\n== b-CAP over TCP, {address} ==");
    let mut client = TracedClient::new(blocking::connect_tcp(address, &Options::default())?, Wire::Stream);
    client
        .run("Start the service, with a keep-alive every 100 ms during long calls", call::service_start("WDT=100"))?;
    let connect = call::controller_connect("demo", "CaoProv.DENSO.VRC", "localhost", "");
    let controller = client.call("Connect to the controller; the reply is its handle", connect, |handle| handle)?;
    let i1 =
        client.call("Get the variable I1", call::controller_get_variable(controller, "I1", ""), |handle| handle)?;
    client.run("Write 42 to it", call::variable_put_value(i1, 42_i32))?;
    client.expect("Read it back", i1, &42_i32)?;
    let p1 =
        client.call("Get the position P1", call::controller_get_variable(controller, "P1", ""), |handle| handle)?;
    client.run("Write a pose: X Y Z in mm, RX RY RZ in degrees, FIG", call::variable_put_value(p1, POSE))?;
    println!("\nWrite a string to the integer: the controller refuses");
    match client.0.call(call::variable_put_value(i1, "forty-two")) {
        Err(CallError::Refused(code)) => println!("     {code}: {}", code.meaning().unwrap_or("unknown")),
        _ => return Err("a string in I1 was not refused".into()),
    }
    let robot = client.call("Get the robot", call::controller_get_robot(controller, "Arm0", ""), |handle| handle)?;
    client.run("Read its joint angles: eight doubles", call::robot_execute(robot, "CurJnt", ()))?;
    client.run("Take the arm", call::robot_execute(robot, "TakeArm", [0_i32, 0]))?;
    let motor = call::robot_execute(robot, "Motor", [1_i32, 0]);
    client.run("Switch the motor on; this takes a while, and the controller sends S_EXECUTING meanwhile", motor)?;
    client.run("Switch it off again", call::robot_execute(robot, "Motor", [0_i32, 0]))?;
    client.run("Release the arm", call::robot_execute(robot, "GiveArm", ()))?;
    client.run("Release the robot", call::robot_release(robot))?;
    client.run("Disconnect, which releases the variables", call::controller_disconnect(controller))?;
    client.run("Stop the service", call::service_stop())
}

fn over_udp(address: SocketAddr) -> Result<(), Box<dyn Error>> {
    println!("\n== b-CAP over UDP, {address}: the reserved field has the serial of the first attempt ==");
    let mut client = TracedClient::new(blocking::connect_udp(address, &Options::default())?, Wire::Datagrams);
    client.run("Start the service", call::service_start(""))?;
    let connect = call::controller_connect("demo", "CaoProv.DENSO.VRC", "localhost", "");
    let controller = client.call("Connect to the controller", connect, |handle| handle)?;
    let i1 = client.call("Get I1", call::controller_get_variable(controller, "I1", ""), |handle| handle)?;
    client.expect("Read it, which was written over TCP", i1, &42_i32)?;
    client.run("Write 43 to it", call::variable_put_value(i1, 43_i32))?;
    client.run("Disconnect", call::controller_disconnect(controller))?;
    client.run("Stop the service: a UDP server cannot detect otherwise that its client has left", call::service_stop())
}

fn over_rac(address: SocketAddr) -> Result<(), Box<dyn Error>> {
    println!("\n== RAC, text over TCP, {address} ==");
    let (transport, client) = blocking::connect_rac(address, &Options::default())?.into_parts();
    let mut robot = RacConnection::new(packets().tap(transport, Wire::Lines), client);
    println!("\nRead I1, written over UDP");
    agrees(robot.get(Variable::new(VariableKind::I, 1))?, &43_i32)?;
    println!("\nRead the pose, written over TCP");
    agrees(robot.get(Variable::new(VariableKind::P, 1))?, &POSE)?;
    println!("\nWrite 44 to I1");
    Ok(robot.put(Variable::new(VariableKind::I, 1), Variant::I4(44))?)
}

/// Prints every packet with its bytes.
fn packets() -> Packets {
    let mut packets = Packets::new();
    let print = |role: bcap_capture::Role, text: &str| {
        println!("  {}", with_arrow(role.arrow(), text).replace('\n', "\n  "));
    };
    packets.watch(Level::Bytes, print);
    packets
}

/// A client whose packets are printed.
struct TracedClient<X>(Connection<Traced<X>, Vec<u8>>);

impl<X: Transport<Error = io::Error>> TracedClient<X> {
    fn new(connection: Connection<X, Vec<u8>>, wire: Wire) -> Self {
        let (transport, client) = connection.into_parts();
        Self(Connection::new(packets().tap(transport, wire), client))
    }

    /// Prints the purpose of a call, makes it, and returns the reply as converted by `convert`.
    fn call<C: Call, T>(
        &mut self,
        purpose: &str,
        call: C,
        convert: impl FnOnce(<C::Reply as Reply>::Value<'_>) -> T,
    ) -> Result<T, Box<dyn Error>> {
        println!("\n{purpose}");
        Ok(self.0.call(call).map(convert)?)
    }

    fn run<C: Call>(&mut self, purpose: &str, call: C) -> Result<(), Box<dyn Error>> {
        self.call(purpose, call, |_| ())
    }

    /// Reads a variable, which must have the written value.
    fn expect(&mut self, purpose: &str, variable: VariableHandle, written: &impl Encode) -> Result<(), Box<dyn Error>> {
        self.call(purpose, call::variable_get_value(variable), |value| agrees(value, written))?
    }
}

fn agrees(found: Variant<'_>, written: &impl Encode) -> Result<(), Box<dyn Error>> {
    let written = OwnedVariant::new(written)?;
    if found == written.as_variant() { Ok(()) } else { Err(format!("{written:?} was written, {found:?} read").into()) }
}
