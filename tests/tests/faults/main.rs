//! Real clients and a real server on links that do what networks do at their worst: behind a proxy that does it by a script
//! or by chance, and behind netem where the kernel has that.
//!
//! What is asserted of every call: it ends; a value is its own; over UDP it was executed exactly once if it was reported as
//! done, and at most once if not. When the clients have gone nothing of them is left in the server.

mod datagrams;
mod netem;
mod streams;
