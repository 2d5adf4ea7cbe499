//! The form of the tables of commands and of system variables: one entry for each name, with its handler.
//!
//! The tables also provide the lists of names that clients can query, and the text of [`explain`](crate::explain) about a
//! parameter.

use bcap_core::hresult::HResult;

use crate::model::Functions;

/// A command of an Execute function. `R` is the type of its handler, a function pointer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Command<R> {
    pub(crate) name: &'static str,
    /// `None` for a command that real controllers have and this one does not.
    run: Option<R>,
    /// Makes the answer of a call that has waited, for commands that answer a value then.
    resume: Option<R>,
    is_of: fn(Functions) -> bool,
    /// The values that its parameter may have, for commands that check it.
    pub(crate) accepts: Option<&'static str>,
}

impl<R: Copy> Command<R> {
    pub(crate) const fn new(name: &'static str, run: R) -> Self {
        Self { name, run: Some(run), resume: None, is_of: |_| true, accepts: None }
    }

    /// Declares a command that answers `E_NOTIMPL`.
    pub(crate) const fn missing(name: &'static str) -> Self {
        Self { name, run: None, resume: None, is_of: |_| true, accepts: None }
    }

    pub(crate) const fn resumes(mut self, resume: R) -> Self {
        self.resume = Some(resume);
        self
    }

    pub(crate) const fn accepts(mut self, values: &'static str) -> Self {
        self.accepts = Some(values);
        self
    }

    /// Restricts the command to some models; on other models it does not exist.
    pub(crate) const fn of(mut self, is_of: fn(Functions) -> bool) -> Self {
        self.is_of = is_of;
        self
    }

    /// Returns whether a model executes this command.
    pub(crate) fn exists(&self, functions: Functions) -> bool {
        self.run.is_some() && (self.is_of)(functions)
    }

    /// Returns the handler that makes the answer of a call that has waited.
    pub(crate) fn resumed(&self) -> Option<R> {
        self.resume
    }

    /// Finds a command by its name, ignoring case and surrounding blanks.
    pub(crate) fn find(table: &'static [Self], name: &str) -> Option<&'static Self> {
        table.iter().find(|command| command.name.eq_ignore_ascii_case(name.trim()))
    }

    /// Returns the handler of a command.
    ///
    /// # Errors
    ///
    /// `E_NOTIMPL` for a command that this crate does not implement, `E_INVALID_CMD_NAME` for a command that the model does not
    /// have.
    pub(crate) fn handler(table: &'static [Self], name: &str, functions: Functions) -> Result<R, HResult> {
        let command = Self::find(table, name).filter(|command| (command.is_of)(functions));
        command.ok_or(HResult::E_INVALID_CMD_NAME)?.run.ok_or(HResult::E_NOTIMPL)
    }
}

/// A system variable. `G` and `P` are the types of its getter and its setter, function pointers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Property<G, P> {
    pub(crate) name: &'static str,
    get: Option<G>,
    put: Option<P>,
    /// The values that can be written to it.
    pub(crate) accepts: Option<&'static str>,
}

impl<G: Copy, P: Copy> Property<G, P> {
    pub(crate) const fn read(name: &'static str, get: G) -> Self {
        Self { name, get: Some(get), put: None, accepts: None }
    }

    /// Declares a variable that can be neither read nor written.
    pub(crate) const fn unsupported(name: &'static str) -> Self {
        Self { name, get: None, put: None, accepts: None }
    }

    pub(crate) const fn write(name: &'static str, put: P, accepts: &'static str) -> Self {
        Self { name, get: None, put: Some(put), accepts: Some(accepts) }
    }

    /// Makes a readable variable writable.
    pub(crate) const fn and_write(mut self, put: P, accepts: &'static str) -> Self {
        self.put = Some(put);
        self.accepts = Some(accepts);
        self
    }

    /// Returns the place of a variable in its table, ignoring case and surrounding blanks.
    pub(crate) fn position(table: &[Self], name: &str) -> Option<usize> {
        table.iter().position(|property| property.name.eq_ignore_ascii_case(name.trim()))
    }

    /// # Errors
    ///
    /// `E_ACCESSDENIED` for a variable that can only be written.
    pub(crate) fn getter(&self) -> Result<G, HResult> {
        self.get.ok_or(HResult::E_ACCESSDENIED)
    }

    /// # Errors
    ///
    /// `E_CAO_NOT_WRITABLE` for a variable that can only be read.
    pub(crate) fn setter(&self) -> Result<P, HResult> {
        self.put.ok_or(HResult::E_CAO_NOT_WRITABLE)
    }
}

/// Asserts that the module headers of these sources name every command of a table that a model executes, and that
/// `docs/virtual-controller.md` has a row for every command.
#[cfg(test)]
pub(crate) fn assert_documented<R: Copy>(table: &[Command<R>], sources: &[&str]) {
    let rows = include_str!("../../../docs/virtual-controller.md").lines().filter_map(|line| line.split('|').nth(2));
    let names: Vec<_> = rows.map(str::trim).collect();
    for command in table {
        assert!(names.contains(&command.name), "{} has no row in docs/virtual-controller.md", command.name);
    }
    let lines = sources.iter().flat_map(|source| source.lines()).filter(|line| line.starts_with("//!"));
    let words: Vec<_> = lines.flat_map(|line| line.split(|c: char| !c.is_ascii_alphanumeric())).collect();
    for command in table.iter().filter(|command| command.run.is_some()) {
        assert!(words.contains(&command.name), "{} is not documented", command.name);
    }
}
