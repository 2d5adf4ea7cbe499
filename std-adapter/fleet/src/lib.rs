//! Publishes the variables of many robot controllers to an MQTT broker, as plain JSON or Sparkplug B.
//!
//! ```no_run
//! # async fn example() -> Result<(), bcap_fleet::Error> {
//! let config = bcap_fleet::Config::read("fleet.toml".as_ref())?;
//! let fleet = bcap_fleet::Fleet::start(config, |event| println!("{event:?}")).await?;
//! fleet.run(std::future::pending()).await;
//! # Ok(())
//! # }
//! ```
//!
//! | module                  | purpose                                                                  |
//! |-------------------------|--------------------------------------------------------------------------|
//! | `config`                | the file of the user, checked                                            |
//! | `point`                 | the variables to publish                                                 |
//! | `scan`                  | reads the variables of one controller                                    |
//! | `queue`                 | readings between the scans and the publisher                             |
//! | `store`                 | readings on disk while the broker is disconnected                        |
//! | `broker`                | one connection to the broker, with TLS                                   |
//! | `publisher`             | moves readings to the broker, and commands from it                       |
//! | `standby`               | determines which process of a node is active                             |
//! | `encoder`               | the interface of the two formats                                         |
//! | `json`, `sparkplug`     | topics and payloads                                                      |
//! | `command`               | rules, expiry and at-most-once execution of commands                     |
//! | `metrics`, `http`       | counters, and the server that shows them                                 |
//! | `status`                | the same counters for a screen                                           |
//! | `check`                 | tries everything once                                                    |

mod broker;
mod check;
mod command;
mod config;
mod encoder;
mod error;
mod event;
mod fleet;
mod http;
mod json;
mod message;
mod metrics;
mod point;
mod publisher;
mod queue;
mod reading;
mod scan;
mod shorten;
mod sparkplug;
mod standby;
mod status;
mod store;
mod stream;
mod units;

pub use self::check::{Row, check, check_offline};
pub use self::config::Config;
pub use self::error::Error;
pub use self::event::{CommandResult, Event};
pub use self::fleet::Fleet;
pub use self::status::{ControllerStatus, Monitor, Status};
