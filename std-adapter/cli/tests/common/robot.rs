//! A virtual controller of this process on real sockets.

use bcap_core::rac::VariableKind;
use bcap_core::variant::Variant;
use bcap_sim::{Config, Controller, Profile};
use bcap_std::server::Limits;
use bcap_tests::served::Served;

use crate::common::{Run, bcap, bcap_with};

pub(crate) struct Robot {
    pub(crate) served: Served<Controller>,
    pub(crate) tcp: String,
    pub(crate) udp: String,
}

impl Robot {
    pub(crate) fn start() -> Self {
        Self::with(Config::new(Profile::Rc8))
    }

    pub(crate) fn with(config: Config) -> Self {
        let served = Served::of(Controller::new(config), Limits::default());
        let (tcp, udp) = (format!("tcp:{}", served.tcp), format!("udp:{}", served.udp));
        Self { served, tcp, udp }
    }

    pub(crate) fn run(&self, args: &[&str]) -> Run {
        bcap(&[args, &["--robot", &self.tcp]].concat())
    }

    pub(crate) fn run_with(&self, args: &[&str], input: &str) -> Run {
        bcap_with(&[args, &["--robot", &self.tcp]].concat(), input.as_bytes())
    }

    pub(crate) fn set(&self, kind: VariableKind, index: u32, value: &Variant<'_>) {
        self.served.application().set_variable(kind, index, value).unwrap();
    }

    /// Returns an I variable.
    pub(crate) fn i(&self, index: u32) -> i32 {
        self.served.application().variable::<16>(VariableKind::I, index).unwrap().as_variant().as_i32().unwrap()
    }
}
