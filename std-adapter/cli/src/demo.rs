//! `bcap demo`: a session with a virtual controller over TCP, UDP and RAC, every frame decoded beside its bytes.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::thread::{self, JoinHandle};

use bcap_core::bcap::call::{self, Call, Reply, VariableHandle};
use bcap_core::hresult::HResult;
use bcap_core::rac::{Variable, VariableKind};
use bcap_core::variant::{Encode, Variant};
use bcap_sim::Profile;
use bcap_std::blocking::{self, Connection, RacConnection, Transport};
use bcap_std::{CallError, ConnectError, Options};
use tokio::sync::oneshot;

use crate::error::Failure;
use crate::listen::runtime;
use crate::output::print_block;
use crate::sim::{self, Listening};
use crate::tap::{Protocol, Tap};
use crate::value::Value;

const POSE: [f32; 7] = [400.0, 0.0, 300.5, 180.0, 0.0, 180.0, 5.0];

/// Runs `bcap demo`.
pub(crate) fn demo() -> Result<(), Failure> {
    let robot = Robot::start()?;
    print_block(&format!(
        "A virtual controller is running in this process: {}.\n\
         It has what `bcap sim` has. Below, -> is what the client sends and <- what the controller answers.",
        robot.listening.to_string().trim_start_matches("ready ")
    ))?;
    over_tcp(&robot.listening)?;
    over_udp(&robot.listening)?;
    over_rac(&robot.listening)?;
    robot.stop()?;
    print_block(
        "\nThe three links saw the same variables. What to try next:\n  \
         bcap sim                  a virtual controller for other programs\n  \
         bcap names                what it has\n  \
         bcap watch I1 --changed   what happens to it\n  \
         bcap decode HEX           a frame of your own, field by field",
    )?;
    Ok(())
}

fn over_tcp(listening: &Listening) -> Result<(), Failure> {
    print_block(&format!("\n== b-CAP over TCP, {} ==", listening.bcap))?;
    let connected = blocking::connect_tcp(listening.bcap, &Options::default())
        .map_err(|error| unreached(&error, listening.bcap))?;
    let mut link = Link::tapping(connected);

    link.run(
        "Start the service; the controller shall show every 100 ms that it is alive",
        call::service_start("WDT=100"),
    )?;
    let connect = call::controller_connect("demo", "CaoProv.DENSO.VRC", "localhost", "");
    let controller = link.call("Connect to the controller; the reply is its handle", connect, |handle| handle)?;
    let i1 =
        link.call("Get the integer variable I1", call::controller_get_variable(controller, "I1", ""), |handle| handle)?;
    link.run("Write 42 to it", call::variable_put_value(i1, 42_i32))?;
    link.expect("Read it back", i1, &42_i32)?;
    let p1 = link.call("Get the position P1", call::controller_get_variable(controller, "P1", ""), |handle| handle)?;
    link.run("Write a pose: x y z in mm, rx ry rz in degrees, the figure", call::variable_put_value(p1, POSE))?;
    link.refused("Write a text to the integer: the controller refuses", call::variable_put_value(i1, "forty-two"))?;
    let robot = link.call("Get the robot", call::controller_get_robot(controller, "Arm0", ""), |handle| handle)?;
    link.run("Where is it? Eight doubles", call::robot_execute(robot, "CurJnt", ()))?;
    link.run("Take the arm", call::robot_execute(robot, "TakeArm", [0_i32, 0]))?;
    link.run(
        "Switch the motor on; that takes its time, and S_EXECUTING tells of it",
        call::robot_execute(robot, "Motor", [1_i32, 0]),
    )?;
    link.run("Switch it off again", call::robot_execute(robot, "Motor", [0_i32, 0]))?;
    link.run("Give the arm back", call::robot_execute(robot, "GiveArm", ()))?;
    link.run("Release what was opened, newest first", call::robot_release(robot))?;
    link.run("", call::variable_release(p1))?;
    link.run("", call::variable_release(i1))?;
    link.run("", call::controller_disconnect(controller))?;
    link.run("Stop the service", call::service_stop())
}

fn over_udp(listening: &Listening) -> Result<(), Failure> {
    print_block(&format!(
        "\n== b-CAP over UDP, {}: the reserved field says which attempt was the first ==",
        listening.udp
    ))?;
    let connected =
        blocking::connect_udp(listening.udp, &Options::default()).map_err(|error| unreached(&error, listening.udp))?;
    let mut link = Link::tapping(connected);

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
    link.run("Stop the service: a server on UDP has no other way to learn that its client goes", call::service_stop())
}

fn over_rac(listening: &Listening) -> Result<(), Failure> {
    print_block(&format!("\n== RAC, text over TCP, {} ==", listening.rac))?;
    let connected = blocking::connect_rac(listening.rac, &Options::default());
    let (transport, client) = connected.map_err(|error| unreached(&error, listening.rac))?.into_parts();
    let mut robot = RacConnection::new(Tap::new(transport, Protocol::Rac), client);
    let (i1, p1) = (Variable::new(VariableKind::I, 1), Variable::new(VariableKind::P, 1));

    let read = robot.get(i1).map_err(|error| disagreement(error.to_string())).and_then(|value| agrees(value, &43_i32));
    show("Read I1, which was written over UDP", robot.transport())?;
    read?;
    let read = robot.get(p1).map_err(|error| disagreement(error.to_string())).and_then(|value| agrees(value, &POSE));
    show("Read the pose that was written over TCP", robot.transport())?;
    read?;
    let written = robot.put(i1, Variant::I4(44));
    show("Write 44 to I1", robot.transport())?;
    written.map_err(|error| disagreement(error.to_string()))
}

/// Prints what has passed a tap, and what it was for.
fn show<X>(purpose: &str, tap: &mut Tap<X>) -> Result<(), Failure> {
    let purpose = if purpose.is_empty() { String::new() } else { format!("\n{purpose}\n") };
    Ok(print_block(&format!("{purpose}{}", tap.take().trim_end()))?)
}

/// A client whose frames are printed.
struct Link<X> {
    connection: Connection<Tap<X>, Vec<u8>>,
}

impl<X: Transport<Error = io::Error>> Link<X> {
    /// Puts a tap between a client and its transport.
    fn tapping(connection: Connection<X, Vec<u8>>) -> Self {
        let (transport, client) = connection.into_parts();
        Self { connection: Connection::new(Tap::new(transport, Protocol::Bcap), client) }
    }

    /// Makes a call, prints what it is for and its frames, and returns what `keep` keeps of the reply.
    fn call<C: Call, T>(
        &mut self,
        purpose: &str,
        call: C,
        keep: impl FnOnce(<C::Reply as Reply>::Value<'_>) -> T,
    ) -> Result<T, Failure> {
        let doing = call.function().to_string();
        let kept = self.connection.call(call).map(keep);
        show(purpose, self.connection.transport())?;
        kept.map_err(|error| failed(&doing, &error))
    }

    /// Makes a call whose reply is of no further use, and prints what it is for and its frames.
    fn run<C: Call>(&mut self, purpose: &str, call: C) -> Result<(), Failure> {
        self.call(purpose, call, |_| ())
    }

    /// Reads a variable, and checks that it is what was written.
    fn expect(&mut self, purpose: &str, variable: VariableHandle, written: &impl Encode) -> Result<(), Failure> {
        self.call(purpose, call::variable_get_value(variable), |value| agrees(value, written))?
    }

    /// Makes a call that the controller refuses, and says what the code means.
    fn refused<C: Call>(&mut self, purpose: &str, call: C) -> Result<(), Failure> {
        let doing = call.function().to_string();
        let code = match self.connection.call(call) {
            Err(CallError::Refused(code)) => Ok(code),
            Err(error) => Err(failed(&doing, &error)),
            Ok(_) => Err(disagreement(format!("{doing} should have been refused"))),
        };
        show(purpose, self.connection.transport())?;
        Ok(print_block(&format!("     {}", explained(code?)))?)
    }
}

/// Checks that a value that was read is the one that was written.
fn agrees(found: Variant<'_>, written: &impl Encode) -> Result<(), Failure> {
    let written = Value::new(written)?;
    if found == written.as_variant() {
        Ok(())
    } else {
        Err(disagreement(format!("{:?} was written, but {found:?} was read", written.as_variant())))
    }
}

fn disagreement(message: String) -> Failure {
    Failure::Connection { message, hint: "this is an error in the virtual controller; please report it".into() }
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

/// The virtual controller, on a thread of its own.
struct Robot {
    listening: Listening,
    stop: oneshot::Sender<()>,
    thread: JoinHandle<io::Result<()>>,
}

impl Robot {
    fn start() -> Result<Self, Failure> {
        let free = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let wanted = Listening { bcap: free, udp: free, rac: free };
        let runtime = runtime()?;
        let (server, listening) = runtime.block_on(sim::listen(sim::controller(Profile::Rc8), &wanted))?;
        let (stop, stopped) = oneshot::channel();
        let thread = thread::Builder::new().name("controller".into()).spawn(move || {
            // it also ends when the demo is gone
            runtime.block_on(server.run(async { stopped.await.unwrap_or(()) }))
        })?;
        Ok(Self { listening, stop, thread })
    }

    fn stop(self) -> Result<(), Failure> {
        // a controller that has ended already says why
        let _ = self.stop.send(());
        match self.thread.join() {
            Ok(result) => Ok(result?),
            Err(_) => Err(disagreement("the virtual controller has panicked".into())),
        }
    }
}
