//! `bcap web`: a page for a browser of this computer.

use std::io::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use bcap_terminal::signal;
use bcap_web::{Config, Recordings, Remote, Server};
use clap::{Args, value_parser};
use tempfile::NamedTempFile;

use crate::commands::variables::labels;
use crate::failure::{Failure, of_file};
use crate::link::LinkArgs;
use crate::listen::{runtime, taken};
use crate::output::{Printer, note, print_line};

/// Serves a page that shows controllers in a browser: their state, variables and alarms, and HALT
///
/// It prints the address of the page with its token; anyone who has it may use the page. Only this computer can open it, unless
/// there are a certificate and a password: then a user logs in with the password, over TLS. The page
/// reads; while another client streams in Slave Mode it sends nothing that would end the stream. With --allow-write a user who has
/// taken the control of a robot, under a name, writes variables, restores backups, clears errors and makes calls that write; each
/// action is confirmed and printed as a line. With --allow-motion the same user jogs the robot by short steps while a button is held,
/// starts tasks, recovers the robot, and makes calls that can move it at any speed. HALT always works, over a separate connection. It
/// is not an emergency stop.
///
/// Without PROFILE it shows the controller of --robot or --profile. A lost connection is shown, and tried again every second. A
/// signal ends it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap web
  bcap web --open --robot tcp:192.168.0.1
  bcap web press welder --allow-write
  bcap web press --allow-write --allow-motion
  bcap web press --allow-write --backups backups
  bcap web press --recordings recordings
  bcap web --listen 192.168.0.9:8011 --certificate cert.pem --key key.pem --password-file password --name cell9.example")]
pub(crate) struct Web {
    /// The profiles to show, one tile each
    #[arg(value_name = "PROFILE")]
    pub(crate) profiles: Vec<String>,

    /// The address to listen on; port 0 takes a free one. One that other computers can reach needs --certificate, --key and
    /// --password-file
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:8011")]
    pub(crate) listen: SocketAddr,

    /// Lets pages write variables, restore backups, clear errors, and make calls that write
    #[arg(long)]
    pub(crate) allow_write: bool,

    /// Lets pages move a robot: jog it, start tasks, recover it, and make any call that can move it
    #[arg(long)]
    pub(crate) allow_motion: bool,

    /// The file of labels, as for `bcap io`; a unit may be at the end: `F1 = pressure [bar]`
    #[arg(long, value_name = "FILE")]
    pub(crate) labels: Option<PathBuf>,

    /// The folder of backups, which the page dumps and, with --allow-write, restores
    #[arg(long, value_name = "DIR")]
    pub(crate) backups: Option<PathBuf>,

    /// The folder of recordings: the page records all packets to pcapng files there, which `bcap sim --replay FILE --web` shows
    #[arg(long, value_name = "DIR")]
    pub(crate) recordings: Option<PathBuf>,

    /// The size at which a file of a recording ends, in MB
    #[arg(long, value_name = "MB", default_value_t = 1000, value_parser = value_parser!(u32).range(1..))]
    #[arg(requires = "recordings")]
    pub(crate) recording_size: u32,

    /// The certificate of this server and its chain, in PEM
    #[arg(long, value_name = "FILE.pem", requires_all = ["key", "password_file"])]
    pub(crate) certificate: Option<PathBuf>,

    /// The private key of the certificate, in PEM
    #[arg(long, value_name = "FILE.pem", requires = "certificate")]
    pub(crate) key: Option<PathBuf>,

    /// A file with the password of the page, of at least 12 characters
    #[arg(long, value_name = "FILE", requires = "certificate")]
    pub(crate) password_file: Option<PathBuf>,

    /// A name of this server in its certificate, as browsers use it; may be given several times
    #[arg(long = "name", value_name = "HOST", requires = "certificate")]
    pub(crate) names: Vec<String>,

    /// Opens the page in the browser
    #[arg(long)]
    pub(crate) open: bool,
}

/// Runs `bcap web` until a signal ends it.
pub(crate) fn web(args: &Web, link: &LinkArgs) -> Result<(), Failure> {
    if link.untraced()?.write.is_some() {
        return Err(Failure::Input(
            "`web` has no --write; give --recordings DIR, and start a recording on the page".into(),
        ));
    }
    let robots = if args.profiles.is_empty() {
        let name =
            link.profile().map_or_else(|| link.target().map(|target| target.to_string()), |name| Ok(name.into()));
        vec![(name?, link.access()?)]
    } else {
        let access = |name: &String| Ok((name.clone(), link.for_profile(name)?.access()?));
        args.profiles.iter().map(access).collect::<Result<_, Failure>>()?
    };
    let labels = args.labels.as_deref().map(labels::read).transpose()?.unwrap_or_default().into_iter().collect();
    let config = Config {
        allow_write: args.allow_write,
        allow_motion: args.allow_motion,
        labels,
        backups: args.backups.clone(),
        recordings: args
            .recordings
            .clone()
            .map(|folder| Recordings { folder, limit: u64::from(args.recording_size) * 1_000_000 }),
        remote: remote(args)?,
        ..Config::new(args.listen, robots)
    };
    let runtime = runtime()?;
    let served = runtime.block_on(async {
        let ended = signal::wait()?;
        let printer = Printer::start(false)?;
        let server = bind(config, "--listen", &printer).await?;
        print_line(&server.url())?;
        let page = if args.open { open(&server.url()) } else { None };
        server.run(ended).await;
        drop(page);
        printer.finish();
        Ok(())
    });
    // a disk that hangs does not keep the program
    runtime.shutdown_background();
    served
}

/// Returns the certificate and the password, if they are given.
fn remote(args: &Web) -> Result<Option<Remote>, Failure> {
    let (Some(certificate), Some(key), Some(file)) = (&args.certificate, &args.key, &args.password_file) else {
        return Ok(None);
    };
    let password = std::fs::read_to_string(file).map_err(of_file(file))?.trim_end_matches(['\r', '\n']).to_owned();
    let (certificate, key, names) = (certificate.clone(), key.clone(), args.names.clone());
    Ok(Some(Remote { certificate, key, password, names }))
}

/// Listens for pages, and prints their actions; `option` is the argument with the address.
pub(crate) async fn bind(config: Config, option: &str, printer: &Printer) -> Result<Server, Failure> {
    let (listen, queue) = (config.listen, printer.queue());
    Server::bind(config, move |line| queue.put(line.to_owned())).await.map_err(|error| match error {
        bcap_web::Error::Io(error) => taken(option, listen, &error),
        error => Failure::Input(error.to_string()),
    })
}

/// Opens the page in the browser. The address is in a file that only this user can read, because other users can see the
/// arguments of a program.
fn open(url: &str) -> Option<NamedTempFile> {
    let write = || {
        let mut file = tempfile::Builder::new().prefix("bcap-").suffix(".html").tempfile()?;
        write!(file, "<!doctype html><meta http-equiv=\"refresh\" content=\"0;url={url}\">")?;
        file.flush()?;
        let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
        let mut command = if cfg!(windows) { Command::new("explorer") } else { Command::new(program) };
        command.arg(file.path()).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        Ok::<_, std::io::Error>(file)
    };
    write().map_err(|error| note(&format!("no browser was opened: {error}; open the address above"))).ok()
}
