//! The b-CAP and RAC protocols of DENSO robot controllers.
#![no_std]

#[cfg(feature = "alloc")]
extern crate alloc;

pub mod bcap;
pub mod error;
pub mod handler;
pub mod hresult;
pub mod io;
pub mod limits;
mod num;
pub mod rac;
pub mod storage;
pub mod time;
pub mod variant;
mod wire;
