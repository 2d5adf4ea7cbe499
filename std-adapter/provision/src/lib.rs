//! The computer's side of the gateway boards of `bcap-board`: their addresses, settings, keys and images.
//!
//! | module        | contents                                                             |
//! |---------------|----------------------------------------------------------------------|
//! | [`search`]    | finds the boards of a network by broadcasts                          |
//! | [`console`]   | requests to a board over a serial port or TCP                        |
//! | [`settings`]  | checked settings, and their replacement                              |
//! | [`image`]     | the images that a board accepts as updates                           |
//! | [`signature`] | the keys and signatures of images                                    |
//! | [`update`]    | sends an image to a board                                            |
//! | [`elf`]       | the bytes that an ELF file puts into the flash                       |
//! | [`uf2`]       | the files that the boot ROMs of the RP2040 and the RP2350 take       |
//! | [`drive`]     | a board in boot mode, which is a drive                               |
//!
//! All functions block. Nothing is sent before files and settings are checked.
//!
//! # Examples
//!
#![doc = include_str!("../README.md")]

pub mod console;
pub mod drive;
pub mod elf;
mod error;
pub mod image;
pub mod search;
pub mod settings;
pub mod signature;
pub mod uf2;
pub mod update;

pub use self::console::{Answer, Console};
pub use self::error::Error;
