//! Reads variables and lists of names over a session.

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::variant::OwnedVariant as Value;
use bcap_live::calls::Calls;
pub(crate) use bcap_live::variables::{expand, get_one, list, read, short_type, shown, state_words};
use bcap_std::{ObjectPath, TaskStatus};

use crate::failure::Failure;
use crate::session::Session;

/// Parses the names of variables.
pub(crate) fn paths(names: &[String]) -> Result<Vec<ObjectPath>, Failure> {
    names.iter().map(|name| Ok(ObjectPath::variable(name)?)).collect()
}

impl Calls for Session {
    type Error = Failure;

    fn object(&mut self, path: &ObjectPath) -> Result<i32, Failure> {
        Self::object(self, path)
    }

    fn is_open(&self, path: &ObjectPath) -> bool {
        self.objects.contains_key(&path.to_string())
    }

    fn call(
        &mut self,
        subject: &str,
        function: FunctionId,
        arguments: &[Value],
    ) -> Result<(HResult, Option<Value>), Failure> {
        Self::call(self, subject, function, arguments)
    }

    fn release(&mut self, object: Object, handle: i32) -> Result<(), Failure> {
        Self::release(self, object, handle)
    }

    fn task_status(&mut self, name: &str) -> Result<TaskStatus, Failure> {
        self.with(|controller| controller.task(name)?.status())
    }

    fn restart_limit(&mut self) {
        self.restart_budget();
    }
}
