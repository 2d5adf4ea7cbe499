//! Tests of the page against a virtual controller of this process.

mod alarms;
mod backup;
mod browser;
mod chromium;
mod firefox;
mod jog;
mod load;
mod pages;
mod panel;
mod raw;
mod record;
#[cfg(feature = "tls")]
mod remote;
mod safety;
mod screens;
mod states;
mod support;
mod work;
