//! The well-behaved clients: consecutive sessions, each with calls as fast as they are answered.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::variant::Variant;
use bcap_std::asynch::{self, TcpClient};
use bcap_std::{Options, blocking};
use tokio::time::sleep;

use crate::server::Addresses;
use crate::{Plan, run_clients};

/// The provider of an RC8.
pub(crate) const PROVIDER: &str = "CaoProv.DENSO.VRC";
/// Calls of a session between its beginning and its end.
const CALLS: i32 = 500;

/// Starts a client for each of the variables I of these numbers, in a separate thread that ends when all clients have ended.
pub(crate) fn start(server: Addresses, variables: Range<usize>, plan: Arc<Plan>) -> JoinHandle<()> {
    let first = variables.start;
    run_clients(variables.len(), move |number| client(server, format!("I{}", first + number), Arc::clone(&plan)))
}

/// Runs sessions until the end of the measurement, and counts those whose calls are not all answered.
async fn client(server: Addresses, name: String, plan: Arc<Plan>) {
    // the server is busy on purpose; what counts here is that it answers, and how much in a second
    let options = Options::default().timeout(Duration::from_secs(30));
    while !plan.is_over.load(Ordering::Relaxed) {
        let ended = match asynch::connect_tcp(server.tcp, &options).await {
            Ok(mut client) => session(&mut client, &name, &plan).await,
            Err(error) => Err(error.into()),
        };
        plan.count(&name, ended).await;
    }
}

/// How a session has ended.
pub(crate) type Session = Result<(), Box<dyn std::error::Error + Send + Sync>>;

impl Plan {
    /// Counts a session that has failed, and pauses before the next session.
    pub(crate) async fn count(&self, client: &str, ended: Session) {
        if let Err(error) = ended {
            eprintln!("{client}: {error}");
            self.failures.fetch_add(1, Ordering::Relaxed);
            sleep(Duration::from_millis(100)).await;
        }
    }
}

async fn session(client: &mut TcpClient, name: &str, plan: &Plan) -> Session {
    client.call(call::service_start("WDT=400")).await?;
    let controller = client.call(call::controller_connect("", PROVIDER, "", "")).await?;
    let variable = client.call(call::controller_get_variable(controller, name, "")).await?;
    for number in 0..CALLS / 2 {
        client.call(call::variable_put_value(variable, number)).await?;
        let value = client.call(call::variable_get_value(variable)).await?;
        assert_eq!(value, Variant::I4(number), "a value is its writer's own");
        plan.calls.fetch_add(2, Ordering::Relaxed);
        if !plan.pace.is_zero() {
            sleep(plan.pace).await;
        }
        if plan.is_over.load(Ordering::Relaxed) {
            break;
        }
    }
    client.call(call::variable_release(variable)).await?;
    client.call(call::controller_disconnect(controller)).await?;
    client.call(call::service_stop()).await?;
    Ok(())
}

/// Connects clients that begin a session and then send nothing.
pub(crate) fn silent(server: Addresses, clients: usize) -> Vec<blocking::TcpClient> {
    (0..clients)
        .map(|_| {
            let mut client = blocking::connect_tcp(server.tcp, &Options::default()).expect("there is a place");
            client.call(call::service_start("WDT=400")).expect("every call is answered");
            client.call(call::controller_connect("", PROVIDER, "", "")).expect("every call is answered");
            client
        })
        .collect()
}
