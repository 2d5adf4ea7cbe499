//! The tokio server of `bcap-std` with a device of one variable, while a client in another process reads it.

#![allow(clippy::expect_used, reason = "a program of the developer may panic")]

use std::error::Error;
use std::net::SocketAddr;

use bcap_core::bcap::call::variable_get_value;
use bcap_core::bcap::call::{
    ControllerHandle, VariableHandle, controller_connect, controller_get_variable, service_start,
};
use bcap_core::device::{Device, DeviceVariable};
use bcap_std::server::Server;

/// Repetitions of the two runs.
const FEW: u64 = 500;
const MANY: u64 = 2_500;

/// The connections of a run, and the bar for the instructions of one request, 5 % above the measured ones.
const CASES: &[(usize, u64)] = &[(1, 4_036), (100, 4_040)];

fn main() -> Result<(), Box<dyn Error>> {
    match bcap_instructions::arguments() {
        Some((case, times, more)) => match more.first() {
            Some(address) => read(address.parse()?, CASES[case].0, times),
            None => serve(case, times),
        },
        None => {
            bcap_instructions::print_head();
            let mut within = true;
            for (case, (connections, bar)) in CASES.iter().enumerate() {
                let name = format!("a request on the server, {connections} connections");
                let measured = bcap_instructions::count(case, FEW, MANY, &[])?;
                within &= bcap_instructions::print(&name, measured, Some(*bar));
            }
            if within { Ok(()) } else { Err("a figure is over its bar".into()) }
        }
    }
}

/// Serves until the client's process has ended; what callgrind watches.
fn serve(case: usize, times: u64) -> Result<(), Box<dyn Error>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let count = DeviceVariable::new("I1", |count: &i32, reply| reply.set(count));
        let server = Server::new(Device::new(7, [count])).bcap_tcp("127.0.0.1:0").await?;
        let address = server.addresses().bcap_tcp[0].to_string();
        let program = std::env::current_exe()?;
        let mut client =
            tokio::process::Command::new(program).args([case.to_string(), times.to_string(), address]).spawn()?;
        server.run(async { drop(client.wait().await) }).await?;
        Ok(())
    })
}

/// Reads the variable in turn over some connections.
fn read(address: SocketAddr, connections: usize, times: u64) -> Result<(), Box<dyn Error>> {
    let mut clients = Vec::new();
    for _ in 0..connections {
        let mut client = bcap_std::blocking::connect_tcp(address, &bcap_std::Options::default())?;
        client.call(service_start(""))?;
        let controller: ControllerHandle = client.call(controller_connect("", "", "", ""))?;
        let variable: VariableHandle = client.call(controller_get_variable(controller, "I1", ""))?;
        clients.push((client, variable));
    }
    for turn in 0..usize::try_from(times)? {
        let (client, variable) = &mut clients[turn % connections];
        client.call(variable_get_value(*variable))?;
    }
    Ok(())
}
