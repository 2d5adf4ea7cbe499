//! The common part of boards: settings, a console for them, faults, watchdog, log, LED, and the tasks of a gateway.
//!
//! | module       | feature    | content                                                                       |
//! |--------------|------------|-------------------------------------------------------------------------------|
//! | [`Settings`] |            | lines `KEY=VALUE`                                                             |
//! | [`mod@image`] |           | the settings in an image, seen from a host                                    |
//! | [`identity`] |            | the board and the version of an image, seen from a host                       |
//! | [`slots`]    |            | the settings in flash                                                         |
//! | [`console`]  |            | changes the settings over a serial line                                       |
//! | [`find`]     |            | the request and the answer of `bcap board find`                               |
//! | [`mac`]      |            | a MAC address from the id of a chip                                           |
//! | [`record`]   |            | the cause of the last reset, kept over the reset                              |
//! | [`ring`], [`limiter`] |   | the buffer and the limits of a log                                            |
//! | `gateway`    | `embassy`  | the tasks of a gateway                                                        |
//! | `report`     | `embassy`  | the log of a gateway, and its status line                                     |
//! | `address`    | `embassy`  | the board's address: DHCP or configured                                       |
//! | `network`    | `embassy`  | embassy-net for valid leases and packets that can be answered; detects a silent Ethernet controller |
//! | `watchdog`   | `embassy`  | feeds a watchdog while all tasks run                                          |
//! | `led`        |            | the patterns of an LED; its task with `embassy`                               |
//! | `health`, `syslog`, `sntp` | `health` | the page of the state, the format of messages, the time                |
//! | `page`       | `embassy` and `health` | the pages                                                         |
//! | `sizes`      | `embassy`  | the sizes of the memory, which variables of the build change                 |
//! | `parts`      | `embassy`  | the shared state of the tasks, and board-specific data                        |
//! | `config`     | `embassy`  | reads the settings at the start                                               |
//! | `memory`     | `embassy`  | the block of settings in the image itself                                     |
//! | `log`        | `log`      | defmt's logger, into a ring buffer                                            |
//! | `port`       | `port`     | the console and the log over any serial port                                  |
//! | `update`     | `update`   | updates of the image, over embassy-boot                                       |
//! | `remote`     | `update` and `port` | updates over TCP                                                     |
//! | `signature`  | `signature` | signatures of images, seen from a host and from the board                    |
//! | `usb`        | `usb`      | the console and the log as two serial ports over USB                          |
//! | `w5500`      | `w5500`    | a driver of the Ethernet controller W5500                                     |
//! | `stack`, `fault` | `cortex-m` | the stack with its guard, and the handler of faults; on ARM only          |
//!
//! An image needs no `unsafe` for these. The crate itself has unsafe code in `memory`, `log`, `stack` and `fault` only; each
//! says why.
//!
//! # Settings
//!
//! The settings in the image are a text block, which a host can change without rebuilding the image. Settings in flash
//! ([`slots`]) replace them; a host changes those over a serial line ([`console`]).
//!
//! ```text
//!  "BCAPCONF"  key=value LF  key=value LF  ...  NUL up to 2048 bytes
//! ```
//!
//! The block is stored unencoded in ELF and binary images, so a tool such as [`write`](image::write) can search for the
//! eight letters and write after them. Both sides parse it with [`Settings::read`]. A host accepts the keys of all
//! features; an image without a feature refuses its keys.
//!
//! | key        | value                                | default                  |
//! |------------|--------------------------------------|--------------------------|
//! | `robot`    | `[tcp:\|udp:]ADDRESS:PORT`           | `tcp:192.168.0.1:5007`   |
//! | `provider` | the provider to connect to           | `CaoProv.DENSO.VRC9`     |
//! | `machine`  | the machine that the provider runs on | `localhost`             |
//! | `option`   | the option of Controller_Connect     | empty                    |
//! | `service`  | the option of Service_Start          | `WDT=400`                |
//! | `variable` | the variable that the images `bare` and `node` read | `I1`      |
//! | `dhcp`     | `yes`, `no`: request an address by DHCP; always without an `address` | `yes` |
//! | `address`  | `ADDRESS/PREFIX`: the board's address without DHCP, or when no server gives a valid lease for 5 s | none |
//! | `gateway`  | the default gateway, used with `address` | none                 |
//! | `mac`      | `02:00:00:bc:a9:03`: the MAC address | derived from the chip's id |
//! | `hostname` | the name sent with DHCP: at most 32 letters, digits and hyphens | none |
//! | `ssid`     | the name of the Wi-Fi network; for images with the feature `wifi` | none |
//! | `passphrase` | its passphrase of WPA2, of 8 to 63 characters; empty for an open network | empty |
//! | `find`     | `yes`, `no`: answer `bcap board find` on UDP port 5011, and send LLDP frames to the switch | `yes` |
//! | `get`      | `KIND[/FIRST[-LAST]]`: what PLCs may read; can be repeated | everything |
//! | `put`      | `KIND[/FIRST[-LAST]][=MIN..MAX[,MIN..MAX]...]`: what PLCs may write, and the accepted values; can be repeated | nothing |
//! | `put@CLIENT` | as `put`, for the clients of a network only: `put@192.168.0.7=I/0-99`, `put@192.168.0.0/24=F` | |
//! | `allow`    | `ADDRESS[/PREFIX]`: a network whose clients may connect; can be repeated | every client |
//! | `idle`     | `SECONDS`: closes a PLC's connection after that idle time; one of Modbus after `evict` at the latest | never |
//! | `evict`    | `SECONDS`: the idle time after which a PLC's connection may be closed to make room for another PLC | 10 |
//! | `keepalive` | `SECONDS`: the idle time after which a TCP keep-alive is sent to a PLC; one without an answer for 15 s, or three times this, is gone | 5 |
//! | `convert`  | `yes`, `no`: convert a PUT of another type where the conversion is lossless | `no` |
//! | `rate`     | `PER_SECOND[/BURST]`: token bucket per PLC, in requests | no limit |
//! | `modbus`   | the port of Modbus TCP, usually 502; for images with the feature `modbus` | no Modbus |
//! | `register` | `ADDRESS=KIND[/FIRST[-LAST]][:FORMAT][:low]`: variables in holding registers from this address on ([`bcap_gateway::modbus::Entry`]); can be repeated | none |
//! | `coil`     | `ADDRESS=IO[/FIRST[-LAST]]`: coils from this address on; can be repeated | none |
//! | `health`   | the port of a page of the board's state, usually 80; for images with the feature `health` | no page |
//! | `password` | 8 to 63 ASCII characters without blanks: the password of a page that changes the settings; only the console sets it; for images with the feature `health` and a console | none, and no page changes anything |
//! | `syslog`   | `ADDRESS[:PORT]`: where refusals and changes of the state are sent, usually to port 514; for images with the feature `health` | not sent |
//! | `ntp`      | `ADDRESS[:PORT]`: a server of SNTP, usually at port 123, for the time in syslog and on the page; for images with the feature `health` | no time |
//! | `update`   | `ADDRESS[/PREFIX]`: hosts that may send signed updates to TCP port 5010; can be repeated up to four times; for images with the feature `update` and a key | none, and the port is closed |
//! | `echo`     | the port of an echo server, to compare round trips; for images with the feature `echo` | no echo server |
//!
//! A key of a feature that the image does not have is invalid, as an unknown one is. Two services cannot have one port.
//!
//! An invalid line is skipped and reported. The board then refuses every PUT, whatever the other lines allow.
#![no_std]

#[cfg(test)]
extern crate std;

#[cfg(feature = "health")]
#[cfg_attr(
    not(any(test, all(feature = "embassy", feature = "port"))),
    expect(dead_code, reason = "only a board has the page")
)]
mod access;
#[cfg(feature = "embassy")]
pub mod address;
mod answer;
#[cfg(feature = "embassy")]
pub mod config;
pub mod console;
pub mod crc;
#[cfg(feature = "embassy")]
mod datagrams;
mod error;
#[cfg(all(feature = "health", any(feature = "embassy", test)))]
mod events;
#[cfg(all(feature = "cortex-m", target_arch = "arm"))]
pub mod fault;
pub mod find;
#[cfg(feature = "embassy")]
pub mod gateway;
#[cfg(feature = "health")]
pub mod health;
mod host;
pub mod identity;
pub mod image;
#[cfg(any(feature = "embassy", test))]
mod lease;
pub mod led;
pub mod limiter;
#[cfg(any(feature = "embassy", test))]
mod lldp;
#[cfg(feature = "log")]
pub mod log;
pub mod mac;
#[cfg(any(feature = "cortex-m", feature = "embassy"))]
pub mod memory;
#[cfg(all(feature = "embassy", feature = "health"))]
mod messages;
#[cfg(feature = "modbus")]
mod modbus_map;
#[cfg(any(feature = "embassy", test))]
mod neighbors;
#[cfg(feature = "embassy")]
pub mod network;
#[cfg(feature = "usb")]
mod packets;
#[cfg(all(feature = "embassy", feature = "health"))]
pub mod page;
#[cfg(feature = "embassy")]
pub mod parts;
#[cfg(feature = "port")]
pub mod port;
pub mod record;
#[cfg(all(feature = "update", feature = "port"))]
pub mod remote;
#[cfg(feature = "embassy")]
pub mod report;
pub mod ring;
mod rules;
#[cfg(all(feature = "port", feature = "health"))]
mod saving;
mod settings;
#[cfg(all(feature = "port", feature = "health"))]
mod settings_page;
#[cfg(feature = "signature")]
pub mod signature;
#[cfg(any(feature = "embassy", feature = "log"))]
pub mod sizes;
pub mod slots;
#[cfg(feature = "health")]
pub mod sntp;
#[cfg(all(feature = "cortex-m", target_arch = "arm"))]
pub mod stack;
#[cfg(feature = "health")]
pub mod syslog;
#[cfg(all(feature = "update", feature = "embassy"))]
mod trial;
#[cfg(feature = "update")]
pub mod update;
#[cfg(feature = "usb")]
pub mod usb;
pub mod vectors;
#[cfg(any(feature = "w5500", test))]
pub mod w5500;
#[cfg(feature = "embassy")]
pub mod watchdog;

pub use self::error::{InvalidLine, SettingError};
pub use self::rules::RuleMemory;
#[cfg(feature = "signature")]
pub use self::settings::UPDATE_PORT;
pub use self::settings::{Robot, Settings, Transport};

/// The eight letters at the start of the block.
pub const MAGIC: &[u8; 8] = b"BCAPCONF";

/// The size of the block in bytes, including [`MAGIC`].
pub const BLOCK: usize = 2048;
