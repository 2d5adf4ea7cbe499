//! The tests of this package, as one program. `cargo test -p bcap-cli NAME::` runs one module.

mod arguments;
#[cfg(target_os = "linux")]
mod attacks;
mod backup;
#[cfg(unix)]
mod board;
mod board_install;
#[cfg(unix)]
mod book;
mod captures;
mod codec;
mod common;
mod completion;
#[cfg(unix)]
mod conform;
mod doctor;
#[cfg(unix)]
mod examples;
mod explain;
mod files;
mod fuzz;
mod gateway;
mod help;
#[cfg(unix)]
mod jobs;
#[cfg(unix)]
mod jog;
mod manual;
#[cfg(unix)]
mod mcap;
#[cfg(unix)]
mod monitor;
#[cfg(unix)]
mod monitors;
#[cfg(unix)]
mod outputs;
mod partial;
mod peers;
#[cfg(unix)]
mod plant;
mod profiles;
mod proxy;
mod proxy_load;
mod rac;
mod ranges;
#[cfg(unix)]
mod raw;
#[cfg(unix)]
mod recover;
mod reference;
mod replay;
#[cfg(unix)]
mod report;
#[cfg(unix)]
mod scan;
mod screens;
#[cfg(unix)]
mod serial;
mod session;
#[cfg(unix)]
mod shell;
#[cfg(unix)]
mod signals;
mod sim;
mod slave;
mod slave_formats;
#[cfg(unix)]
mod terminal;
#[cfg(unix)]
mod tester;
mod text;
#[cfg(all(unix, feature = "web"))]
mod web;
mod wireshark;
