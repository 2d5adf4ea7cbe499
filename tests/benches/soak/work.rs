//! The well-behaved clients: consecutive sessions, each with calls as fast as they are answered.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_core::variant::Variant;
use bcap_std::asynch::{self, TcpClient};
use bcap_std::{Options, blocking};
use tokio::task::JoinSet;

use crate::Plan;
use crate::server::Addresses;

/// Calls of a session between its beginning and its end.
const CALLS: i32 = 500;

/// Starts clients in a separate thread, which ends when all clients have ended.
pub(crate) fn start(server: Addresses, clients: usize, plan: Arc<Plan>) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(async {
            let mut tasks = JoinSet::new();
            for number in 0..clients {
                tasks.spawn(client(server, format!("V{number}"), Arc::clone(&plan)));
            }
            while let Some(ended) = tasks.join_next().await {
                ended.expect("a client has not got what is its own");
            }
        });
    })
}

/// Runs sessions until the end of the measurement, and asserts that their calls are answered.
async fn client(server: Addresses, name: String, plan: Arc<Plan>) {
    // the server is busy on purpose; what counts here is that it answers, and how much in a second
    let options = Options::default().timeout(Duration::from_secs(30));
    while !plan.is_over.load(Ordering::Relaxed) {
        let mut client = asynch::connect_tcp(server.tcp, &options).await.expect("there is a place");
        session(&mut client, &name, &plan).await.expect("every call is answered");
    }
}

async fn session(
    client: &mut TcpClient,
    name: &str,
    plan: &Plan,
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    client.call(call::service_start("WDT=400")).await?;
    let controller = client.call(call::controller_connect("", "", "", "")).await?;
    let variable = client.call(call::controller_get_variable(controller, name, "")).await?;
    for number in 0..CALLS / 2 {
        client.call(call::variable_put_value(variable, number)).await?;
        let value = client.call(call::variable_get_value(variable)).await?;
        assert_eq!(value, Variant::I4(number), "a value is its writer's own");
        plan.calls.fetch_add(2, Ordering::Relaxed);
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
            client.call(call::controller_connect("", "", "", "")).expect("every call is answered");
            client
        })
        .collect()
}
