//! Saves a controller in a folder.

use std::collections::BTreeMap;

use bcap_core::rac::VariableKind;
use bcap_live::calls::Calls;
use bcap_live::stream::CheckedCalls;

use crate::contents::{Contents, Omission, UserVariable};
use crate::controller::{self, Progress};
use crate::error::Error;
use crate::folder::Folder;

/// Saves all variables and files, or after an interrupted dump the rest of them. `watch` gets the progress before each item,
/// object and folder. Its error ends the dump; a later call continues it.
///
/// # Errors
///
/// The error of a call, of the folder, or of `watch`.
pub fn dump<C: Calls>(
    session: &mut C,
    folder: &Folder,
    watch: impl FnMut(Progress<'_>) -> Result<(), C::Error>,
) -> Result<Contents, C::Error>
where
    C::Error: From<Error>,
{
    let mut dumping = Dumping { session: &mut CheckedCalls::new(session), folder, watch };
    let mut omitted = Vec::new();
    for kind in VariableKind::ALL {
        dumping.kind(kind, &mut omitted)?;
    }
    dumping.system(&mut omitted)?;
    dumping.files(&mut omitted)?;
    Ok(folder.finish(omitted)?)
}

struct Dumping<'a, C, W> {
    session: &'a mut C,
    folder: &'a Folder,
    watch: W,
}

impl<C: Calls, W: FnMut(Progress<'_>) -> Result<(), C::Error>> Dumping<'_, C, W>
where
    C::Error: From<Error>,
{
    /// Saves the variables of a kind, from the first variable that an earlier dump did not save.
    fn kind(&mut self, kind: VariableKind, omitted: &mut Vec<Omission>) -> Result<(), C::Error> {
        let Some(count) = controller::count(self.session, kind, omitted)? else { return Ok(()) };
        let Some((mut part, done)) = self.folder.partial_file(kind)? else { return Ok(()) };
        controller::variables(self.session, kind, done..count, |index, entry| {
            (self.watch)(Progress { part: kind.name(), done: index as usize, count: count as usize })?;
            Ok(part.push(UserVariable::new(kind, index).name(), entry)?)
        })?;
        Ok(part.finish()?)
    }

    fn system(&mut self, omitted: &mut Vec<Omission>) -> Result<(), C::Error> {
        let names = controller::system_names(self.session, &mut self.watch, omitted)?;
        let (count, mut system) = (names.len(), BTreeMap::new());
        for (done, name) in names.into_iter().enumerate() {
            (self.watch)(Progress { part: "@", done, count })?;
            if let Some(entry) = controller::system(self.session, &name)? {
                system.insert(name, entry);
            }
        }
        Ok(self.folder.write_system(&system)?)
    }

    fn files(&mut self, omitted: &mut Vec<Omission>) -> Result<(), C::Error> {
        let paths = controller::files(self.session, &mut self.watch, omitted)?;
        let count = paths.len();
        for (done, path) in paths.into_iter().enumerate() {
            (self.watch)(Progress { part: "file", done, count })?;
            if self.folder.has_file(&path) {
                continue;
            }
            if let Some(bytes) = controller::file(self.session, &path, omitted)? {
                self.folder.write_file(&path, &bytes)?;
            }
        }
        Ok(())
    }
}
