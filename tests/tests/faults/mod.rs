//! Tests real clients and a real server on faulty links: through a proxy that injects scripted or random faults, and
//! through netem where the kernel has it.
//!
//! Every call must end and must get its own value. Over UDP it is executed exactly once if it was reported as done, and at
//! most once if not. After the clients disconnect, the server holds none of their resources.

mod datagrams;
mod netem;
mod streams;
