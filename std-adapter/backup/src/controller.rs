//! Reads a controller.
//!
//! Before each call that Slave Mode does not allow, [`CheckedCalls`] checks whether a stream of Slave Mode runs.
//!
//! The variables of a kind are read through one handle of `I*`, whose PutID selects the variable. On a controller without Slave
//! Mode this takes two calls for each variable instead of three. A controller may accept PutID and ignore it. So the handle is
//! used only after two IDs have returned different values that agree with the values by name. Until then, and after a
//! disagreement, every variable is opened by name.

use std::collections::BTreeSet;
use std::iter::once;
use std::mem;
use std::ops::Range;

use bcap_core::bcap::{FunctionId, Object};
use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_std::ObjectPath;

use bcap_capture::value::named::Entry;
use bcap_capture::value::selection::is_user_variable;
use bcap_core::variant::OwnedVariant as Value;
use bcap_live::calls::{Calls, Failure};
use bcap_live::files as remote_files;
use bcap_live::stream::{CheckedCalls, StreamCheck};
use bcap_live::variables::{self as selection, get_one, list, read, short_type};

use crate::contents::{About, Contents, Omission, Part, UserVariable};

/// The usual system variables, for a controller that does not list its system variables, or not over UDP.
const CONTROLLER: &str = "\
    @MODE @LOCK @TIME @CURRENT_TIME @BUSY_STATUS @TSR_BUSY_STATUS @NORMAL_STATUS @ERROR_CODE @ERROR_CODE_HEX \
    @ERROR_DESCRIPTION @EMERGENCY_STOP @DEADMAN_SW @AUTO_ENABLE @PROTECTIVE_STOP @MAKER_NAME @TYPE @VERSION \
    @FIRMWARE @SERIAL_NO @IO_ALLOC_MODE @VAR_I_LEN @VAR_F_LEN @VAR_D_LEN @VAR_V_LEN @VAR_P_LEN @VAR_J_LEN \
    @VAR_T_LEN @VAR_S_LEN @VAR_IO_LEN";
const ROBOT: &str = "\
    @CURRENT_POSITION @CURRENT_ANGLE @CURRENT_TRANS @DEST_POSITION @DEST_ANGLE @DEST_TRANS @SERVO_ON @BUSY_STATUS \
    @TYPE_NAME @TYPE @CURRENT_TOOL @CURRENT_WORK @SPEED @ACCEL @DECEL @JSPEED @JACCEL @JDECEL \
    @HIGH_CURRENT_POSITION @HIGH_CURRENT_ANGLE @HIGH_CURRENT_TRANS @EXTSPEED @EXTACCEL @EXTDECEL";

/// Reads type, version and serial number: the first step of each command, which fails while a stream of Slave Mode runs.
///
/// # Errors
///
/// The error of a call that is more than a refusal.
pub fn about<C: Calls>(session: &mut C) -> Result<About, C::Error> {
    StreamCheck::default().require(session, FunctionId::CONTROLLER_GET_VARIABLE_NAMES, None)?;
    let mut text = |name: &str| match entry(get_one(session, &ObjectPath::variable(name)?))? {
        Entry::Value(value) => {
            let number = || value.convert::<i64>().map(|number| number.to_string());
            Ok(value.convert::<String>().or_else(|_| number()).unwrap_or_default().trim().to_owned())
        }
        Entry::Refused(_) => Ok::<_, C::Error>(String::new()),
    };
    Ok(About { kind: short_type(&text("@TYPE")?), version: text("@VERSION")?, serial: text("@SERIAL_NO")? })
}

/// The progress of a dump or a restore.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress<'a> {
    /// The current part: a kind of variables, `@` for system variables, `file`, or `folder` while the files are listed.
    pub part: &'a str,
    /// The number of completed items of this part.
    pub done: usize,
    /// How many there are.
    pub count: usize,
}

/// Reads everything. `watch` gets the progress before each item, object and folder; its error ends the work.
///
/// # Errors
///
/// The error of a call that is more than a refusal.
pub fn contents<C: Calls>(
    session: &mut C,
    mut watch: impl FnMut(Progress<'_>) -> Result<(), C::Error>,
) -> Result<Contents, C::Error> {
    let session = &mut CheckedCalls::new(session);
    let mut contents = Contents { about: about(session)?, ..Contents::default() };
    for kind in VariableKind::ALL {
        let Some(count) = count(session, kind, &mut contents.omitted)? else { continue };
        variables(session, kind, 0..count, |index, entry| {
            contents.variables.insert(UserVariable::new(kind, index), entry);
            watch(Progress { part: kind.name(), done: index as usize, count: count as usize })
        })?;
    }
    let names = system_names(session, &mut watch, &mut contents.omitted)?;
    let count = names.len();
    for (done, name) in names.into_iter().enumerate() {
        watch(Progress { part: "@", done, count })?;
        if let Some(entry) = system(session, &name)? {
            contents.system.insert(name, entry);
        }
    }
    let paths = files(session, &mut watch, &mut contents.omitted)?;
    let count = paths.len();
    for (done, path) in paths.into_iter().enumerate() {
        watch(Progress { part: "file", done, count })?;
        if let Some(bytes) = file(session, &path, &mut contents.omitted)? {
            contents.files.insert(path, bytes);
        }
    }
    Ok(contents)
}

/// Reads the number of variables of a kind; `None` after a refusal.
///
/// # Errors
///
/// The error of a call that is more than a refusal.
pub fn count<C: Calls>(
    session: &mut C,
    kind: VariableKind,
    omitted: &mut Vec<Omission>,
) -> Result<Option<u32>, C::Error> {
    unless_omitted(selection::count(session, kind), Part::Variables(kind), omitted)
}

/// Reads variables of a kind, in order.
///
/// # Errors
///
/// The error of a call that is more than a refusal.
pub fn variables<C: Calls>(
    session: &mut C,
    kind: VariableKind,
    indices: Range<u32>,
    mut each: impl FnMut(u32, Entry) -> Result<(), C::Error>,
) -> Result<(), C::Error> {
    let mut wildcard = Wildcard::open(session, kind, &indices)?;
    for index in indices {
        let value = match &mut wildcard {
            Some(wildcard) => wildcard.read(session, index)?,
            None => by_name(session, kind, index)?,
        };
        if let Some(wrong) = wildcard.take_if(|wildcard| wildcard.trust == Trust::Wrong) {
            wrong.close(session)?;
        }
        each(index, value)?;
    }
    wildcard.map_or(Ok(()), |wildcard| wildcard.close(session))
}

/// A handle of `I*`, through which PutID chooses the variable.
struct Wildcard {
    kind: VariableKind,
    handle: i32,
    trust: Trust,
}

/// Whether PutID has an effect.
#[derive(PartialEq)]
enum Trust {
    /// All IDs until now have returned this value, as with a handle that ignores PutID. `None` before the first ID.
    Unknown(Option<Entry>),
    Works,
    Wrong,
}

impl Trust {
    /// Compares the value of a variable through the handle with its value by name.
    fn compare(self, by_id: &Entry, by_name: Entry) -> Self {
        match self {
            _ if *by_id != by_name => Self::Wrong,
            Self::Unknown(only) if only.as_ref().is_none_or(|only| *only == by_name) => Self::Unknown(Some(by_name)),
            _ => Self::Works,
        }
    }
}

impl Wildcard {
    /// Opens `I*`, if the controller has it and samples have the same values through it as by name.
    fn open<C: Calls>(session: &mut C, kind: VariableKind, indices: &Range<u32>) -> Result<Option<Self>, C::Error> {
        if indices.is_empty() {
            return Ok(None);
        }
        let handle = match session.object(&ObjectPath::variable(&format!("{}*", kind.name()))?) {
            Err(refused) if refused.code().is_some() => return Ok(None),
            opened => opened?,
        };
        let mut wildcard = Self { kind, handle, trust: Trust::Unknown(None) };
        for index in samples(indices) {
            let value = by_name(session, kind, index)?;
            wildcard.compare(session, index, value)?;
            match wildcard.trust {
                Trust::Unknown(_) => {}
                Trust::Works => break,
                Trust::Wrong => {
                    wildcard.close(session)?;
                    return Ok(None);
                }
            }
        }
        Ok(Some(wildcard))
    }

    fn compare<C: Calls>(&mut self, session: &mut C, index: u32, by_name: Entry) -> Result<(), C::Error> {
        let by_id = entry(by_id(session, self.kind, self.handle, index))?;
        self.trust = mem::replace(&mut self.trust, Trust::Wrong).compare(&by_id, by_name);
        Ok(())
    }

    /// Reads a variable. Reads it by name while it is unknown whether PutID has an effect.
    fn read<C: Calls>(&mut self, session: &mut C, index: u32) -> Result<Entry, C::Error> {
        if self.trust == Trust::Works {
            return entry(by_id(session, self.kind, self.handle, index));
        }
        let value = by_name(session, self.kind, index)?;
        if matches!(&self.trust, Trust::Unknown(Some(only)) if *only != value) {
            self.compare(session, index, value.clone())?;
        }
        Ok(value)
    }

    fn close<C: Calls>(self, session: &mut C) -> Result<(), C::Error> {
        session.release(Object::Variable, self.handle)
    }
}

/// Returns the indices that are read both ways: the last, the first, and at least eight if there are as many. Their distance is
/// odd, so that values that alternate differ in the samples too.
fn samples(indices: &Range<u32>) -> impl Iterator<Item = u32> + use<> {
    let last = indices.end.saturating_sub(1);
    let distance = (indices.len() / 16).min(64) | 1;
    once(last).chain(indices.clone().step_by(distance).filter(move |index| *index != last))
}

fn by_id<C: Calls>(session: &mut C, kind: VariableKind, handle: i32, index: u32) -> Result<Value, C::Error> {
    // an index is at most 16 bits wide
    let id = Value::new(&i32::try_from(index).unwrap_or(i32::MAX))?;
    session.call(kind.name(), FunctionId::VARIABLE_PUT_ID, &[Value::new(&handle)?, id])?;
    let (_, value) = session.call(kind.name(), FunctionId::VARIABLE_GET_VALUE, &[Value::new(&handle)?])?;
    Ok(value.unwrap_or_default())
}

fn by_name<C: Calls>(session: &mut C, kind: VariableKind, index: u32) -> Result<Entry, C::Error> {
    entry(get_one(session, &ObjectPath::variable(&UserVariable::new(kind, index).name())?))
}

/// Turns a refusal into an entry.
fn entry<F: Failure>(value: Result<Value, F>) -> Result<Entry, F> {
    match value {
        Ok(value) => Ok(Entry::Value(value)),
        Err(failure) => failure.code().map(Entry::Refused).ok_or(failure),
    }
}

/// Reads a system variable; `None` if it does not exist.
///
/// # Errors
///
/// The error of a call that is more than a refusal.
pub fn system<C: Calls>(session: &mut C, name: &str) -> Result<Option<Entry>, C::Error> {
    let path = ObjectPath::variable(name)?;
    let variable = match session.object(&path) {
        Err(refused) if refused.code().is_some() => return Ok(None),
        opened => opened?,
    };
    let value = entry(read(session, &path, variable))?;
    session.release(Object::Variable, variable)?;
    Ok(Some(value))
}

/// Returns the names of all system variables: of the controller, of its robots and of its tasks. `watch` gets the progress before
/// each robot and task; its error ends the work.
///
/// # Errors
///
/// The error of a call that is more than a refusal, or of `watch`.
pub fn system_names<C: Calls>(
    session: &mut C,
    mut watch: impl FnMut(Progress<'_>) -> Result<(), C::Error>,
    omitted: &mut Vec<Omission>,
) -> Result<BTreeSet<String>, C::Error> {
    use FunctionId as F;
    let controller = ObjectPath::controller();
    let mut names = BTreeSet::new();
    let mut add = |owner: &ObjectPath, listed: Option<Vec<String>>, usual: &str| {
        let usual = || usual.split_whitespace().map(str::to_owned).collect();
        let own = listed.unwrap_or_else(usual).into_iter().filter(|name| !is_user_variable(name));
        names.extend(own.map(|name| owner.clone().join(Object::Variable, name).to_string()));
    };
    let listed = listed(session, &controller, F::CONTROLLER_GET_VARIABLE_NAMES)?;
    add(&controller, listed, CONTROLLER);
    let owners = [
        (Object::Robot, F::CONTROLLER_GET_ROBOT_NAMES, F::ROBOT_GET_VARIABLE_NAMES, ROBOT),
        (Object::Task, F::CONTROLLER_GET_TASK_NAMES, F::TASK_GET_VARIABLE_NAMES, "@STATUS @PRIORITY"),
    ];
    for (object, list_owners, list_variables, usual) in owners {
        let owners = match list(session, &controller, list_owners) {
            // a controller that does not implement the list has no such objects
            Err(refused) if refused.code() == Some(HResult::E_NOTIMPL) => Vec::new(),
            owners => unless_omitted(owners, Part::System, omitted)?.unwrap_or_default(),
        };
        let count = owners.len();
        for (done, name) in owners.into_iter().enumerate() {
            watch(Progress { part: "@", done, count })?;
            let owner = controller.clone().join(object, name);
            let listed = self::listed(session, &owner, list_variables)?;
            add(&owner, listed, usual);
        }
    }
    Ok(names)
}

/// Lists the variables of an object; `None` after a refusal, also because the list does not fit a datagram.
fn listed<C: Calls>(
    session: &mut C,
    owner: &ObjectPath,
    function: FunctionId,
) -> Result<Option<Vec<String>>, C::Error> {
    match list(session, owner, function) {
        Err(failure) if failure.omission().is_some() => Ok(None),
        names => names.map(Some),
    }
}

/// Returns the paths of all files. A folder that cannot be listed does not hide the others. `watch` gets the progress before each
/// folder; its error ends the work.
///
/// # Errors
///
/// The error of a call that is more than a refusal, or of `watch`.
pub fn files<C: Calls>(
    session: &mut C,
    mut watch: impl FnMut(Progress<'_>) -> Result<(), C::Error>,
    omitted: &mut Vec<Omission>,
) -> Result<Vec<String>, C::Error> {
    let watch = |done, count| watch(Progress { part: "folder", done, count });
    let items = remote_files::walk(session, "", watch, |path, failure: C::Error| match failure.code() {
        // a controller that does not implement the list has no files
        Some(HResult::E_NOTIMPL) if path.is_empty() => Ok(()),
        _ => omit(failure, Part::Files(path), omitted),
    })?;
    let mut files = Vec::new();
    for item in items {
        if item.is_unsafe {
            let failure: C::Error = remote_files::unsafe_names(std::slice::from_ref(&item));
            // with a leading `/` it cannot be the path of another file
            omit(failure, Part::Files(format!("/{}", item.path)), omitted)?;
        } else {
            files.push(item.path);
        }
    }
    Ok(files)
}

/// Reads a file; `None` if that is not possible.
///
/// # Errors
///
/// The error of a call that is more than a refusal.
pub fn file<C: Calls>(session: &mut C, path: &str, omitted: &mut Vec<Omission>) -> Result<Option<Vec<u8>>, C::Error> {
    unless_omitted(remote_files::read(session, path), Part::Files(path.to_owned()), omitted)
}

fn unless_omitted<T, F: Failure>(
    result: Result<T, F>,
    part: Part,
    omitted: &mut Vec<Omission>,
) -> Result<Option<T>, F> {
    match result {
        Err(failure) => omit(failure, part, omitted).map(|()| None),
        Ok(value) => Ok(Some(value)),
    }
}

/// Adds a part to the list of omissions; returns the failure if the session cannot continue after it.
fn omit<F: Failure>(failure: F, part: Part, omitted: &mut Vec<Omission>) -> Result<(), F> {
    let Some(reason) = failure.omission() else { return Err(failure) };
    omitted.push(Omission { part, reason });
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::rc::Rc;

    use bcap_live::link::Error;
    use bcap_std::TaskStatus;

    use super::*;

    /// A controller with one variable of each kind, and with folders and files. A call that would end its stream panics.
    struct Fake(Rc<Cell<bool>>);

    impl Calls for Fake {
        type Error = Error;

        fn object(&mut self, path: &ObjectPath) -> Result<i32, Error> {
            assert!(!self.0.get() || !path.to_string().contains("task"), "opening {path} ends the stream");
            Ok(1)
        }

        fn call(
            &mut self,
            subject: &str,
            function: FunctionId,
            arguments: &[Value],
        ) -> Result<(HResult, Option<Value>), Error> {
            use FunctionId as F;
            let is_question = function == F::ROBOT_EXECUTE && arguments[1] == Value::new("slvGetMode")?;
            let is_allowed = is_question || function.in_slave_mode().is_allowed();
            assert!(is_allowed || !self.0.get(), "{function} of {subject} ends the stream");
            let value = match function {
                F::ROBOT_EXECUTE => Value::new(&if self.0.get() { 0x202 } else { 0 })?,
                F::CONTROLLER_GET_FILE_NAMES | F::FILE_GET_FILE_NAMES if subject.len() < 6 => {
                    Value::new(["a.pcs", "sub\\"].as_slice())?
                }
                F::CONTROLLER_GET_ROBOT_NAMES => Value::new(["Arm0"].as_slice())?,
                F::CONTROLLER_GET_TASK_NAMES => Value::new(["Pro1"].as_slice())?,
                F::CONTROLLER_GET_FILE | F::VARIABLE_GET_VALUE => Value::new(&1)?,
                _ => Value::default(),
            };
            Ok((HResult::S_OK, Some(value)))
        }

        fn release(&mut self, _: Object, _: i32) -> Result<(), Error> {
            Ok(())
        }

        fn task_status(&mut self, _: &str) -> Result<TaskStatus, Error> {
            Err(Error::Invalid("not read".into()))
        }
    }

    /// Reads everything; another client begins a stream at the progress with this number. Returns each progress.
    fn read(begins: usize) -> (Vec<String>, Result<Contents, Error>) {
        let (streams, mut seen) = (Rc::<Cell<bool>>::default(), Vec::new());
        let read = contents(&mut Fake(Rc::clone(&streams)), |Progress { part, done, count }| {
            streams.set(seen.len() >= begins);
            seen.push(format!("{part} {done}/{count}"));
            Ok(())
        });
        (seen, read)
    }

    #[test]
    fn a_stream_that_begins_at_any_time_does_not_end() {
        let (seen, all) = read(usize::MAX);
        assert_eq!(all.unwrap().files.len(), 2);
        for progress in ["I 0/1", "@ 0/1", "folder 0/1", "folder 2/3", "file 1/2"] {
            assert!(seen.iter().any(|seen| seen == progress), "{progress}: {seen:?}");
        }
        for (begins, progress) in seen.iter().enumerate() {
            let (_, read) = read(begins);
            assert!(matches!(&read, Err(Error::Skipped(_))), "{progress}: {read:?}");
        }
    }
}
