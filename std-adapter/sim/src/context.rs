//! The view that a part of the controller has of the other parts during one call.

use std::net::IpAddr;

use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;

use crate::codes::{EMERGENCY_STOP, FAULT_PRESENT, MANUAL_MODE};
use crate::config::{Config, Mode, Permission, Token};
use crate::errors::Errors;
use crate::operations::Operations;
use crate::rules::Rule;
use crate::variables::Variables;
use crate::waits::Waits;

/// The switches that a person sets, which determine the calls that are refused, and the warnings that a scenario sets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Panel {
    pub(crate) mode: Mode,
    pub(crate) token: Token,
    pub(crate) emergency_stop: bool,
    pub(crate) battery_low: bool,
    pub(crate) warning: bool,
    pub(crate) protective_stop: bool,
}

impl Panel {
    pub(crate) const fn new(mode: Mode, token: Token) -> Self {
        Self { mode, token, emergency_stop: false, battery_low: false, warning: false, protective_stop: false }
    }

    pub(crate) fn is_auto(self) -> bool {
        self.mode == Mode::Auto
    }
}

/// A client's call, and the state of the other parts that it may need.
#[derive(Debug)]
pub(crate) struct Context<'a> {
    /// The client.
    pub(crate) peer: PeerId,
    /// Its address, if it is known.
    pub(crate) address: Option<IpAddr>,
    pub(crate) now: Instant,
    pub(crate) config: &'a Config,
    pub(crate) panel: Panel,
    pub(crate) variables: &'a mut Variables,
    pub(crate) waits: &'a mut Waits,
    pub(crate) errors: &'a Errors,
    pub(crate) operations: &'a mut Operations,
}

impl Context<'_> {
    /// Checks the conditions of a rule that do not concern the arm: the emergency stop, the mode, the executable token, no
    /// error.
    pub(crate) fn may(&self, rule: &Rule) -> Result<(), HResult> {
        if rule.no_error && self.panel.emergency_stop {
            return Err(EMERGENCY_STOP);
        }
        if rule.auto && !self.panel.is_auto() {
            return Err(MANUAL_MODE);
        }
        if rule.token && (rule.token_of_cobotta || !self.config.model.functions.preparation) {
            self.has_token()?;
        }
        if rule.no_error && self.errors.code().is_err() {
            return Err(if self.errors.lasting().is_some() { FAULT_PRESENT } else { HResult::E_ERROR_PRESENT });
        }
        Ok(())
    }

    fn has_token(&self) -> Result<(), HResult> {
        match self.panel.token {
            Token::TeachPendant => Err(HResult::E_TOKEN_NOT_ETHERNET),
            Token::Client(owner) if owner != self.peer => Err(HResult::E_TOKEN_ADDRESS),
            Token::Address(address) if self.address != Some(address.to_canonical()) => Err(HResult::E_TOKEN_ADDRESS),
            _ => Ok(()),
        }
    }

    /// Checks the communication permission.
    pub(crate) fn may_write(&self) -> Result<(), HResult> {
        match self.config.permission {
            Permission::ReadWrite => Ok(()),
            Permission::ReadOnly => Err(HResult::E_CAO_NOT_WRITABLE),
            Permission::None => Err(HResult::E_ACCESSDENIED),
        }
    }

    /// Enters the call into the log of operations.
    pub(crate) fn record(&mut self, text: &str) {
        self.operations.record(text, self.now);
    }
}
