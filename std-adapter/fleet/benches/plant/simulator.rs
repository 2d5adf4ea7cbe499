//! Many virtual controllers in one process, whose variables all change at a fixed rate.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use bcap_core::variant::Variant;
use bcap_sim::{Config, Controller, Profile, VariableKind};
use bcap_std::server::Server;

use crate::{Failure, clock};

/// Serves `count` controllers and prints the port of each. I1 to `values` of each controller are set `hz` times a second to
/// the time of the change. It ends when it is killed.
pub(crate) fn run(count: u32, values: u32, hz: u32) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut controllers = Vec::new();
    runtime.block_on(async {
        for _ in 0..count {
            let controller = Arc::new(Mutex::new(Controller::new(Config::new(Profile::Rc8))));
            let server = Server::with_shared(Arc::clone(&controller)).bcap_tcp("127.0.0.1:0").await?;
            let address = server.addresses().bcap_tcp.first().copied().ok_or("no address")?;
            println!("{}", address.port());
            tokio::spawn(async move { drop(server.run(std::future::pending()).await) });
            controllers.push(controller);
        }
        Ok::<_, Failure>(())
    })?;
    thread::spawn(move || change(&controllers, values, hz));
    runtime.block_on(std::future::pending())
}

/// A prime number. It makes the order of changes differ from the order of the scans, so that a change waits for its
/// scan between 0 and a whole interval.
const STEP: usize = 7919;

/// Changes one controller after another, spread over the interval.
fn change(controllers: &[Arc<Mutex<Controller>>], values: u32, hz: u32) {
    let pause = Duration::from_secs(1) / hz / u32::try_from(controllers.len()).unwrap_or(1);
    let mut deadline = Instant::now();
    let order = (0..controllers.len()).map(|number| number * STEP % controllers.len());
    for controller in order.cycle().filter_map(|number| controllers.get(number)) {
        deadline += pause;
        thread::sleep(deadline.saturating_duration_since(Instant::now()));
        let mut controller = controller.lock().unwrap_or_else(PoisonError::into_inner);
        for index in 1..=values {
            // the kind and the index exist
            let _ = controller.set_variable(VariableKind::I, index, &Variant::I4(clock()));
        }
    }
}
