//! Packets and captures: `bcap decode`, `bcap encode`, `bcap text`, `bcap raw`, `bcap proxy`, `bcap replay` and
//! `bcap wireshark`.

pub(crate) mod decode;
pub(crate) mod encode;
mod items;
pub(crate) mod proxy;
pub(crate) mod raw;
pub(crate) mod replay;
pub(crate) mod text;
pub(crate) mod wireshark;
