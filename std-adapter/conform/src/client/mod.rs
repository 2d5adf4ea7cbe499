//! Cases for clients: a virtual controller that watches its client, and sometimes answers in an unusual way.
//!
//! ```text
//!  rules     the rules for every request
//!  judge     serves sessions; unusual replies to calls of Variable_GetValue, one kind after the other
//! ```

mod judge;
mod rules;

pub use judge::ClientJudge;
pub use rules::client_cases;
