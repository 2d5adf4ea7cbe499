//! A case: its name, its rule and its steps.

use std::borrow::Cow;

use crate::bench::{Bench, Stop};
pub(crate) use crate::language::{Arg, Edit, LineWant, Model, Reaction, Setup, Slot, Step, Want};
pub use crate::language::{Group, Level};
use bcap_testkit::wire::Link;

/// A case for a device.
#[derive(Clone, Debug)]
pub struct Case {
    /// Its name within the group.
    pub(crate) name: Cow<'static, str>,
    pub(crate) group: Group,
    pub(crate) level: Level,
    /// The lines of the specification, or where the answer was observed.
    pub(crate) source: &'static str,
    /// The rule in one sentence.
    pub(crate) rule: &'static str,
    /// The only link to which the case applies.
    pub(crate) only: Option<Link>,
    /// The models on which the answer was observed; none for a case of the specification.
    pub(crate) models: Vec<Model>,
    pub(crate) setup: Setup,
    pub(crate) body: Body,
}

impl Case {
    /// Returns the name with the group, such as `frames/wrong-eot`.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}/{}", self.group, self.name)
    }

    /// Returns the group.
    #[must_use]
    pub const fn group(&self) -> Group {
        self.group
    }

    /// Returns the minimum level at which the case runs.
    #[must_use]
    pub const fn level(&self) -> Level {
        self.level
    }

    /// Returns the lines of the specification that the case tests; for an answer of a real controller, where it was observed.
    #[must_use]
    pub const fn source(&self) -> &'static str {
        self.source
    }

    /// Returns the tested rule as a sentence.
    #[must_use]
    pub const fn rule(&self) -> &'static str {
        self.rule
    }
}

/// A case in Rust.
pub(crate) type Run = fn(&mut Bench<'_>) -> Result<(), Stop>;

/// The body of a case.
#[derive(Clone, Debug)]
pub(crate) enum Body {
    Steps(Cow<'static, [Step]>),
    Run(Run),
}
