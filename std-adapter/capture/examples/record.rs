//! Records a session, and prints its packets: `cargo run -p bcap-capture --example record -- 127.0.0.1:5007 session.pcapng`

use std::error::Error;
use std::path::Path;

use bcap_capture::record::{Recording, Taped};
use bcap_capture::trace::{Level, Packets, Wire, with_arrow};
use bcap_core::bcap::call;
use bcap_std::Options;
use bcap_std::blocking::{Connection, connect_tcp};

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [robot, file] = &words[..] else { return Err("name the address of a controller and a file".into()) };

    let recording = Recording::start(Some(Path::new(file)), |_| {})?;
    let connection = Taped::connection(connect_tcp(robot, &Options::default())?, Some(recording.recorder()));

    let mut packets = Packets::new();
    packets.watch(Level::Bytes, |role, text| println!("{}", with_arrow(role.arrow(), text)));
    let (transport, client) = connection.into_parts();
    let mut connection = Connection::new(packets.tap(transport, Wire::Stream), client);

    connection.call(call::service_start(""))?;
    connection.call(call::service_stop())?;
    drop(connection);
    Ok(recording.finish()?)
}
