#![doc = include_str!("../README.md")]

pub mod axis;
pub mod calls;
pub mod errors;
pub mod files;
pub mod history;
pub mod jog;
pub mod link;
pub mod log;
pub mod messages;
pub mod model;
pub mod reader;
pub mod recovery;
pub mod stream;
pub mod survey;
pub mod variables;
pub mod write;
