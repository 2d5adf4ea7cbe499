//! `bcap report`: how a controller answers reading calls, next to the answers of the virtual controller.
//!
//! The project has no robot, and its users have. A report is one text file that a person can read before sending it. Its calls
//! only read. A controller keeps a refusal as an error that stops the commands of other clients, so the first such refusal
//! ends the survey, and the report says so.

use std::fs::File;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use bcap_capture::duration;
use bcap_live::survey::{Limits, Survey, report as text};
use bcap_sim::Profile;
use bcap_std::Model;
use clap::Args;

use crate::commands::sim::args::{self, Source};
use crate::commands::sim::local::LocalController;
use crate::commands::sim::read_model;
use crate::failure::{Failure, cannot};
use crate::output::{note, print_block, print_json};
use crate::session::Session;

/// The time between two calls, so that the survey takes a small part of the controller's time.
const PAUSE: Duration = Duration::from_millis(10);

/// Reports how the controller answers reading calls, for the developers of this project
///
/// Makes some 100 calls that only read, in rounds, and writes the type and length of each answer, its times (p50 and p99) and
/// the codes of refusals, next to the answers of the virtual controller. The report has no host names, addresses and
/// serial numbers, and no values except the model, the version and the type of the robot. Read it before you send it.
///
/// Other clients may work meanwhile: while a stream of Slave Mode runs, calls that could end it are skipped. A controller may
/// keep a refusal as an error; the survey ends with the first one, and the report names it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap report --robot tcp:192.168.0.1 rc8.report
  bcap report --robot tcp:192.168.0.1 --provider CaoProv.DENSO.VRC9 --model cobotta-pro pro.report
  bcap report --within 30s")]
pub(crate) struct ReportArgs {
    /// The file of the report, which must not exist [default: the standard output]
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,

    /// The virtual controller to compare with, as for `bcap sim` [default: rc8, or rc9 if the controller has its provider]
    #[arg(long, value_name = "MODEL|FILE.toml", value_parser = args::model)]
    model: Option<Source<Profile>>,

    /// Ends the survey after this time
    #[arg(long, value_name = "TIME", default_value = "5min", value_parser = duration::parse)]
    within: Duration,

    /// How often each call is made
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,

    /// Writes the values too; variables and positions may tell about your product
    #[arg(long)]
    values: bool,
}

/// Runs `bcap report`.
pub(crate) fn report(args: &ReportArgs, session: &mut Session, json: bool) -> Result<(), Failure> {
    if let Some(path) = args.file.as_deref().filter(|path| path.exists()) {
        return Err(Failure::Input(format!("{} exists; name a new file", path.display())));
    }
    let source = match &args.model {
        Some(source) => source.clone(),
        None => Source::BuiltIn(model(session)?),
    };
    // first, because an interrupted command makes no more calls
    let virtual_one = survey_virtual(session, &source)?;
    let limits = Limits { rounds: args.rounds, within: args.within, pause: PAUSE };
    session.controller()?;
    let mut survey = Survey::default();
    let ended = survey.run(session, limits);
    let text = if json {
        text::json(&survey, &virtual_one, args.values)
    } else {
        text::table(&survey, &virtual_one, &session.provider, args.values)
    };
    if let Some(path) = &args.file {
        write(path, &text).map_err(cannot("write", path))?;
        note(&format!("{} is written; read it before you send it (CONTRIBUTING.md says where)", path.display()));
    } else if json {
        print_json(text.trim_end())?;
    } else {
        print_block(text.trim_end())?;
    }
    ended
}

/// Returns the model of the provider that the controller accepts.
fn model(session: &mut Session) -> Result<Profile, Failure> {
    session.controller()?;
    session.close();
    let is_rc9 = session.provider.eq_ignore_ascii_case(Model::Rc9.provider());
    Ok(if is_rc9 { Profile::Rc9 } else { Profile::Rc8 })
}

/// Writes a file that does not exist.
fn write(path: &Path, text: &str) -> io::Result<()> {
    let mut file = File::options().write(true).create_new(true).open(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

/// Makes the same calls once to a virtual controller in this process.
fn survey_virtual(session: &Session, source: &Source<Profile>) -> Result<Survey, Failure> {
    let (model, _) = read_model(source)?;
    let link = session.link();
    let provider = model.provider.clone();
    let local = LocalController::start(model)?;
    let mut session = Session::new(&link.for_virtual(&format!("tcp:{}", local.listening.bcap), &provider));
    let mut survey = Survey::default();
    let ended = survey.run(&mut session, Limits { rounds: 1, within: Duration::from_secs(60), pause: Duration::ZERO });
    drop(session);
    local.stop()?;
    ended.map(|()| survey)
}
