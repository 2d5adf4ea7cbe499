//! Packets and captures: `bcap decode`, `bcap raw`, `bcap proxy` and `bcap replay`.

pub(crate) mod decode;
mod items;
pub(crate) mod proxy;
pub(crate) mod raw;
pub(crate) mod replay;
