//! `bcap demo`: a session with a virtual controller over TCP, UDP and RAC, with each frame decoded next to its bytes.

use std::io;
use std::net::SocketAddr;
use std::sync::mpsc::{Receiver, channel};

use bcap_capture::Role;
use bcap_capture::trace::{Level, Packets, Traced, Wire, with_arrow};
use bcap_core::bcap::call::{self, Call, Reply, VariableHandle};
use bcap_core::hresult::HResult;
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::{Encode, Variant};
use bcap_sim::Profile;
use bcap_std::blocking::{self, Connection, RacConnection, Transport};
use bcap_std::{CallError, ConnectError, Options};
use clap::Args;

use crate::commands::sim::Listening;
use crate::commands::sim::local::LocalController;
use crate::failure::Failure;
use crate::output::print_block;
use crate::values::Value;

/// Shows a session with a virtual controller: each frame with its bytes and their meaning
///
/// Starts the controller in this process, on free ports of this machine, and connects to it over TCP, UDP and RAC.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap demo
  bcap demo | less")]
pub(crate) struct Demo {}

const POSE: [f32; 7] = [400.0, 0.0, 300.5, 180.0, 0.0, 180.0, 5.0];

/// Runs `bcap demo`.
pub(crate) fn demo() -> Result<(), Failure> {
    let robot = LocalController::start(Profile::Rc8.model().clone())?;
    print_block(&format!(
        "A virtual controller is running in this process: {}.\n\
         It is the controller of `bcap sim`. Below, -> marks requests of the client and <- replies of the controller.",
        robot.listening.to_string().trim_start_matches("ready ")
    ))?;
    over_tcp(&robot.listening)?;
    over_udp(&robot.listening)?;
    if let Some(address) = robot.listening.rac {
        over_rac(address)?;
    }
    robot.stop()?;
    print_block(
        "\nThe three links read and wrote the same variables. What to try next:\n  \
         bcap sim                  starts a virtual controller for other programs\n  \
         bcap names                lists its variables, robots and tasks\n  \
         bcap watch I1 --changed   prints each change of a variable\n  \
         bcap decode HEX           decodes a frame field by field",
    )?;
    Ok(())
}

fn over_tcp(listening: &Listening) -> Result<(), Failure> {
    print_block(&format!("\n== b-CAP over TCP, {} ==", listening.bcap))?;
    let connected = blocking::connect_tcp(listening.bcap, &Options::default())
        .map_err(|error| unreached(&error, listening.bcap))?;
    let mut link = TracedClient::tapping(connected, Wire::Stream);

    link.run("Start the service, with a keep-alive every 100 ms during long calls", call::service_start("WDT=100"))?;
    let connect = call::controller_connect("demo", "CaoProv.DENSO.VRC", "localhost", "");
    let controller = link.call("Connect to the controller; the reply is its handle", connect, |handle| handle)?;
    let i1 =
        link.call("Get the integer variable I1", call::controller_get_variable(controller, "I1", ""), |handle| handle)?;
    link.run("Write 42 to it", call::variable_put_value(i1, 42_i32))?;
    link.expect("Read it back", i1, &42_i32)?;
    let p1 = link.call("Get the position P1", call::controller_get_variable(controller, "P1", ""), |handle| handle)?;
    link.run("Write a pose: X Y Z in mm, RX RY RZ in degrees, FIG", call::variable_put_value(p1, POSE))?;
    link.refused("Write a string to the integer: the controller refuses", call::variable_put_value(i1, "forty-two"))?;
    let robot = link.call("Get the robot", call::controller_get_robot(controller, "Arm0", ""), |handle| handle)?;
    link.run("Read its joint angles: eight doubles", call::robot_execute(robot, "CurJnt", ()))?;
    link.run("Take the arm", call::robot_execute(robot, "TakeArm", [0_i32, 0]))?;
    link.run(
        "Switch the motor on; this takes a while, and the controller sends S_EXECUTING meanwhile",
        call::robot_execute(robot, "Motor", [1_i32, 0]),
    )?;
    link.run("Switch it off again", call::robot_execute(robot, "Motor", [0_i32, 0]))?;
    link.run("Release the arm", call::robot_execute(robot, "GiveArm", ()))?;
    link.run("Release the objects in reverse order", call::robot_release(robot))?;
    link.run("", call::variable_release(p1))?;
    link.run("", call::variable_release(i1))?;
    link.run("", call::controller_disconnect(controller))?;
    link.run("Stop the service", call::service_stop())
}

fn over_udp(listening: &Listening) -> Result<(), Failure> {
    print_block(&format!(
        "\n== b-CAP over UDP, {}: the reserved field has the serial of the first attempt ==",
        listening.udp
    ))?;
    let connected =
        blocking::connect_udp(listening.udp, &Options::default()).map_err(|error| unreached(&error, listening.udp))?;
    let mut link = TracedClient::tapping(connected, Wire::Datagrams);

    link.run("Start the service", call::service_start(""))?;
    let connect = call::controller_connect("demo", "CaoProv.DENSO.VRC", "localhost", "");
    let controller = link.call("Connect to the controller", connect, |handle| handle)?;
    let i1 = link.call(
        "Get I1, which was written over TCP",
        call::controller_get_variable(controller, "I1", ""),
        |handle| handle,
    )?;
    link.expect("Read it", i1, &42_i32)?;
    link.run("Write 43 to it", call::variable_put_value(i1, 43_i32))?;
    link.run("Release it", call::variable_release(i1))?;
    link.run("Disconnect", call::controller_disconnect(controller))?;
    link.run(
        "Stop the service: without it a UDP server cannot detect that its client disconnected",
        call::service_stop(),
    )
}

fn over_rac(address: SocketAddr) -> Result<(), Failure> {
    print_block(&format!("\n== RAC, text over TCP, {address} =="))?;
    let connected = blocking::connect_rac(address, &Options::default());
    let (transport, client) = connected.map_err(|error| unreached(&error, address))?.into_parts();
    let (transcript, transport) = Transcript::of(transport, Wire::Lines);
    let mut robot = RacConnection::new(transport, client);
    let (i1, p1) = (Variable::new(VariableKind::I, 1), Variable::new(VariableKind::P, 1));

    let read = robot.get(i1).map_err(|error| disagreement(error.to_string())).and_then(|value| agrees(value, &43_i32));
    transcript.show("Read I1, written over UDP")?;
    read?;
    let read = robot.get(p1).map_err(|error| disagreement(error.to_string())).and_then(|value| agrees(value, &POSE));
    transcript.show("Read the pose, written over TCP")?;
    read?;
    let written = robot.put(i1, Variant::I4(44));
    transcript.show("Write 44 to I1")?;
    written.map_err(|error| disagreement(error.to_string()))
}

/// The packets of a link since they were last shown.
struct Transcript(Receiver<(Role, String)>);

impl Transcript {
    /// Wraps a transport, whose packets are recorded.
    fn of<X>(transport: X, wire: Wire) -> (Self, Traced<X>) {
        let (watcher, packets) = channel();
        let mut watched = Packets::new();
        watched.watch(Level::Bytes, move |role, text| {
            // without a receiver the demo is ending
            let _ = watcher.send((role, text.to_owned()));
        });
        (Self(packets), watched.tap(transport, wire))
    }

    /// Prints a purpose, and the packets that served it.
    fn show(&self, purpose: &str) -> Result<(), Failure> {
        if !purpose.is_empty() {
            print_block(&format!("\n{purpose}"))?;
        }
        for (role, text) in self.0.try_iter() {
            let packet = with_arrow(role.arrow(), &text);
            print_block(&format!("  {}", packet.replace('\n', "\n  ")))?;
        }
        Ok(())
    }
}

/// A client whose packets are printed.
struct TracedClient<X> {
    connection: Connection<Traced<X>, Vec<u8>>,
    transcript: Transcript,
}

impl<X: Transport<Error = io::Error>> TracedClient<X> {
    /// Puts a transcript between a client and its transport.
    fn tapping(connection: Connection<X, Vec<u8>>, wire: Wire) -> Self {
        let (transport, client) = connection.into_parts();
        let (transcript, transport) = Transcript::of(transport, wire);
        Self { connection: Connection::new(transport, client), transcript }
    }

    /// Makes a call, prints its purpose and its frames, and returns the reply as converted by `convert`.
    fn call<C: Call, T>(
        &mut self,
        purpose: &str,
        call: C,
        convert: impl FnOnce(<C::Reply as Reply>::Value<'_>) -> T,
    ) -> Result<T, Failure> {
        let doing = call.function().to_string();
        let reply = self.connection.call(call).map(convert);
        self.transcript.show(purpose)?;
        reply.map_err(|error| failed(&doing, &error))
    }

    /// Makes a call whose reply is not used, and prints its purpose and its frames.
    fn run<C: Call>(&mut self, purpose: &str, call: C) -> Result<(), Failure> {
        self.call(purpose, call, |_| ())
    }

    /// Reads a variable and checks that it has the written value.
    fn expect(&mut self, purpose: &str, variable: VariableHandle, written: &impl Encode) -> Result<(), Failure> {
        self.call(purpose, call::variable_get_value(variable), |value| agrees(value, written))?
    }

    /// Makes a call that the controller refuses, and prints the meaning of the code.
    fn refused<C: Call>(&mut self, purpose: &str, call: C) -> Result<(), Failure> {
        let doing = call.function().to_string();
        let code = match self.connection.call(call) {
            Err(CallError::Refused(code)) => Ok(code),
            Err(error) => Err(failed(&doing, &error)),
            Ok(_) => Err(disagreement(format!("{doing} should have been refused"))),
        };
        self.transcript.show(purpose)?;
        Ok(print_block(&format!("     {}", explained(code?)))?)
    }
}

/// Checks that a read value equals the written one.
fn agrees(found: Variant<'_>, written: &impl Encode) -> Result<(), Failure> {
    let written = Value::new(written)?;
    if found == written.as_variant() {
        Ok(())
    } else {
        Err(disagreement(format!("{:?} was written, but {found:?} was read", written.as_variant())))
    }
}

fn disagreement(message: String) -> Failure {
    Failure::Connection { message, hint: "this is a bug in the virtual controller; please report it".into() }
}

fn explained(code: HResult) -> String {
    let hint = code.hint().map(|hint| format!(" To do: {hint}.")).unwrap_or_default();
    format!("{code}: {}{hint}", code.meaning().unwrap_or("unknown."))
}

fn failed(doing: &str, error: &CallError) -> Failure {
    match error {
        CallError::Refused(code) => Failure::Refused { doing: doing.to_owned(), code: *code },
        error => disagreement(format!("{doing}: {error}")),
    }
}

fn unreached(error: &ConnectError, address: SocketAddr) -> Failure {
    disagreement(format!("{address}: {error}"))
}
