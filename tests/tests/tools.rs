//! The functions of `Controller` for tools: calls and objects that are known only at run time, and the deadline.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_core::variant::OwnedVariant;
use bcap_sim::{Config, Controller as Simulated, Profile, TaskStatus};
use bcap_std::blocking::{Connection, Controller, TcpTransport, Transport, connect_tcp};
use bcap_std::server::Limits;
use bcap_std::{Error, Options, TaskStart};
use bcap_tests::served::Served;

fn simulated() -> Served<Simulated> {
    Served::of(Simulated::new(Config::new(Profile::Rc8)), Limits::default())
}

fn tool(sim: &Served<Simulated>) -> Controller {
    Controller::unopened(connect_tcp(sim.tcp, &Options::default()).unwrap())
}

fn texts(texts: &[&str]) -> Vec<OwnedVariant> {
    texts.iter().map(|text| OwnedVariant::new(*text).unwrap()).collect()
}

fn connect(tool: &mut Controller) {
    tool.call_any("", FunctionId::SERVICE_START, &texts(&["WDT=400"])).unwrap();
    assert!(!tool.is_connected());
    let arguments = texts(&["", "CaoProv.DENSO.VRC", "localhost", ""]);
    tool.call_any("", FunctionId::CONTROLLER_CONNECT, &arguments).unwrap();
    assert!(tool.is_connected());
}

#[test]
fn what_calls_open_is_recorded_and_released() {
    let sim = simulated();
    let mut tool = tool(&sim);
    connect(&mut tool);
    assert_eq!(tool.read::<i32>("I1").unwrap(), 0);
    let controller = OwnedVariant::new(&tool.handle().0).unwrap();
    let arguments = [vec![controller], texts(&["I2", ""])].concat();
    let (code, variable) = tool.call_any("I2", FunctionId::CONTROLLER_GET_VARIABLE, &arguments).unwrap();
    assert_eq!((code, sim.application().open_objects()), (HResult::S_OK, 3));
    tool.call_any("I2", FunctionId::VARIABLE_RELEASE, &[variable.unwrap()]).unwrap();
    assert_eq!(sim.application().open_objects(), 2);
    tool.close().unwrap();
    assert_eq!(sim.application().open_objects(), 0);
}

#[test]
fn objects_are_opened_by_their_path() {
    let sim = simulated();
    let mut tool = tool(&sim);
    connect(&mut tool);
    let status = tool.open(&"robot/variable:@SERVO_ON".parse().unwrap()).unwrap();
    assert_eq!(sim.application().open_objects(), 3, "controller, robot and variable");
    tool.release(Object::Variable, status).unwrap();
    tool.release(Object::Variable, status).unwrap();
    assert_eq!(sim.application().open_objects(), 2);
    let refused = tool.open(&"task:NoSuchTask".parse().unwrap()).unwrap_err();
    assert!(
        refused.to_string().starts_with("Controller_GetTask of task:NoSuchTask: the controller refused"),
        "{refused}"
    );
    tool.close().unwrap();
    assert_eq!(sim.application().open_objects(), 0);
}

#[test]
fn a_handle_of_an_ended_service_is_not_that_of_another_task() {
    let sim = simulated();
    let mut tool = tool(&sim);
    connect(&mut tool);
    tool.task("Pro1").unwrap().status().unwrap();
    tool.call_any("", FunctionId::SERVICE_STOP, &[]).unwrap();
    connect(&mut tool);
    tool.task("Pro2").unwrap().status().unwrap();
    tool.task("Pro1").unwrap().start(TaskStart::OneCycle).unwrap();
    let status = |name| sim.application().task(name).unwrap().0;
    assert_eq!((status("Pro1"), status("Pro2")), (TaskStatus::Running, TaskStatus::Ready));
    tool.close().unwrap();
}

#[test]
fn a_variable_is_opened_again_after_its_service_has_ended() {
    let sim = simulated();
    let mut tool = tool(&sim);
    connect(&mut tool);
    tool.write("I1", 5).unwrap();
    tool.write("I2", 6).unwrap();
    for _ in 0..2 {
        assert_eq!((tool.read::<i32>("I1").unwrap(), tool.read::<i32>("I2").unwrap()), (5, 6));
    }
    tool.call_any("", FunctionId::SERVICE_STOP, &[]).unwrap();
    connect(&mut tool);
    // in the other order, so that the controller gives the old handles to the other variables
    assert_eq!((tool.read::<i32>("I2").unwrap(), tool.read::<i32>("I1").unwrap()), (6, 5));
    tool.close().unwrap();
}

#[test]
fn nothing_is_sent_after_the_deadline() {
    let sim = simulated();
    let sends = Arc::new(AtomicUsize::new(0));
    let (inner, client) = connect_tcp(sim.tcp, &Options::default()).unwrap().into_parts();
    let mut tool = Controller::unopened(Connection::new(Counting { inner, sends: Arc::clone(&sends) }, client));
    connect(&mut tool);
    let before = sends.load(Ordering::SeqCst);
    tool.set_deadline(Some(bcap_std::now()));
    let error = tool.read::<i32>("I1").unwrap_err();
    assert!(matches!(&error, Error::NotConnected { reason } if reason.ends_with("timed out")), "{error}");
    tool.set_deadline(None);
    tool.close().unwrap();
    assert_eq!(sends.load(Ordering::SeqCst), before, "a lost connection is left to the controller");
}

/// A transport that counts sent bytes.
struct Counting {
    inner: TcpTransport,
    sends: Arc<AtomicUsize>,
}

impl Transport for Counting {
    type Error = io::Error;

    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&mut self, bytes: &[u8], until: Instant) -> io::Result<Option<usize>> {
        let sent = self.inner.send(bytes, until)?;
        if sent.is_some_and(|count| count > 0) {
            self.sends.fetch_add(1, Ordering::SeqCst);
        }
        Ok(sent)
    }

    fn receive(&mut self, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
        self.inner.receive(buffer, until)
    }

    fn sleep_until(&mut self, at: Instant) {
        self.inner.sleep_until(at);
    }
}
