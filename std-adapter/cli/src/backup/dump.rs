//! `bcap dump`: saves a controller in a folder.

use std::collections::BTreeMap;
use std::sync::mpsc::Receiver;

use bcap_core::rac::VariableKind;
use indicatif::{ProgressBar, ProgressStyle};

use super::contents::{Contents, UserVariable};
use super::folder::Folder;
use super::live;
use crate::args::{Dump, LinkArgs};
use crate::error::Failure;
use crate::output::print_line;
use crate::session::{Session, with_session};
use crate::signal;

/// Runs `bcap dump`.
pub(crate) fn dump(args: &Dump, link: &LinkArgs) -> Result<(), Failure> {
    let ended = signal::ended()?;
    let shown = args.dir.display().to_string();
    let contents = with_session(link, |session| {
        let folder = Folder::begin(&args.dir, live::about(session)?)?;
        if folder.is_resumed {
            print_line(&format!("{shown}: the interrupted dump goes on"))?;
        }
        let bar = ProgressBar::new(0);
        // the template is a constant, and a wrong one only changes the look
        if let Ok(style) = ProgressStyle::with_template("{msg:4} {bar:30} {pos}/{len} {elapsed}") {
            bar.set_style(style);
        }
        let contents = Dumping { session, folder: &folder, ended: &ended, shown: &shown, bar: &bar }.run();
        bar.finish_and_clear();
        contents
    })?;
    print_line(&format!(
        "{shown}: {} variables, {} system variables and {} files of {}",
        contents.variables.len(),
        contents.system.len(),
        contents.files.len(),
        contents.about.describe()
    ))?;
    match contents.refused() + contents.omitted.len() {
        0 => Ok(()),
        missing => Err(Failure::Unfit {
            message: format!("{shown}: the controller refused {missing} parts, which the backup does not have"),
            code: None,
            hint: Some(missing_parts(&contents)),
        }),
    }
}

fn missing_parts(contents: &Contents) -> String {
    let first = contents.omitted.first().map(|first| format!("the first of them is {first}; ")).unwrap_or_default();
    format!("{first}lines with \"refused\" and \"omitted\" in backup.json have their codes; over UDP, use TCP instead")
}

struct Dumping<'a> {
    session: &'a mut Session,
    folder: &'a Folder,
    ended: &'a Receiver<()>,
    shown: &'a str,
    bar: &'a ProgressBar,
}

impl Dumping<'_> {
    fn run(mut self) -> Result<Contents, Failure> {
        let mut omitted = Vec::new();
        for kind in VariableKind::ALL {
            self.kind(kind, &mut omitted)?;
        }
        self.system(&mut omitted)?;
        self.files(&mut omitted)?;
        self.folder.finish(omitted)
    }

    /// Saves the variables of a kind, from the first one that an earlier dump did not save.
    fn kind(&mut self, kind: VariableKind, omitted: &mut Vec<String>) -> Result<(), Failure> {
        let Some(count) = live::count(self.session, kind, omitted)? else { return Ok(()) };
        let Some((mut part, done)) = self.folder.part(kind)? else { return Ok(()) };
        self.begin(kind.name(), count.into());
        self.bar.set_position(done.into());
        let Self { session, ended, shown, bar, .. } = self;
        live::variables(session, kind, done..count, |index, entry| {
            check_signal(ended, shown)?;
            bar.inc(1);
            part.push(UserVariable::new(kind, index).name(), entry)
        })?;
        part.finish()
    }

    fn system(&mut self, omitted: &mut Vec<String>) -> Result<(), Failure> {
        let names = live::system_names(self.session, omitted)?;
        self.begin("@", names.len() as u64);
        let mut system = BTreeMap::new();
        for name in names {
            check_signal(self.ended, self.shown)?;
            self.bar.inc(1);
            if let Some(entry) = live::system(self.session, &name)? {
                system.insert(name, entry);
            }
        }
        self.folder.write_system(&system)
    }

    fn files(&mut self, omitted: &mut Vec<String>) -> Result<(), Failure> {
        let paths = live::files(self.session, omitted)?;
        self.begin("file", paths.len() as u64);
        for path in paths {
            check_signal(self.ended, self.shown)?;
            self.bar.inc(1);
            if self.folder.has_file(&path) {
                continue;
            }
            if let Some(bytes) = live::file(self.session, &path, omitted)? {
                self.folder.write_file(&path, &bytes)?;
            }
        }
        Ok(())
    }

    fn begin(&self, part: &'static str, count: u64) {
        self.bar.reset();
        self.bar.set_length(count);
        self.bar.set_message(part);
    }
}

/// Ends the dump after a signal.
fn check_signal(ended: &Receiver<()>, shown: &str) -> Result<(), Failure> {
    match ended.try_recv() {
        Ok(()) => Err(Failure::Interrupted(format!("interrupted; run `bcap dump {shown}` again to go on"))),
        Err(_) => Ok(()),
    }
}
