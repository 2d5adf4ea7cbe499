//! `bcap sim`: serves a virtual controller on sockets and serial lines.

pub(crate) mod args;
mod delivery;
#[cfg(feature = "screens")]
mod live_screen;
pub(crate) mod local;
#[cfg(feature = "web")]
mod web_panel;

use std::io::{self, Write as _};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::mpsc;
use std::time::{SystemTime, UNIX_EPOCH};
use std::{fmt, fs, thread};

use bcap_capture::playback::Playback;
use bcap_capture::proxy::Robot;
use bcap_core::hresult::HResult;
use bcap_core::{bcap, rac};
use bcap_sim::explain::Observer;
use bcap_sim::files::{Executor, Job, write_sources};
use bcap_sim::pace::Paced;
use bcap_sim::scenario::Effect;
use bcap_sim::trace::{Recorder, TracePoint};
use bcap_sim::{ArmModel, ArmProfile, Config, Controller, Model, Profile, Scenario, Token};
use bcap_std::SerialLine;
use bcap_std::server::{LineEvent, Server};
use bcap_stream::trajectory::{Point, Trajectory};
use bcap_terminal::{escape, signal};
use tokio::sync::oneshot;

use crate::commands::packets::proxy::Front;
use crate::commands::sim::args::{Sim, Source};
use crate::failure::Failure;
use crate::listen::{Listening, runtime, taken};
use crate::output::{note, print_block, print_line};

/// The address for RAC, on a model that has it.
const RAC: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 5006);

/// The maximum number of queued file jobs.
const FILE_JOBS: usize = 64;

/// The maximum number of queued explanations.
const EXPLANATIONS: usize = 64;

/// Runs `bcap sim`, until a signal ends it; its clients are recorded to `file`.
pub(crate) fn sim(args: &Sim, file: Option<&Path>) -> Result<(), Failure> {
    let (model, text) = read_model(&args.model)?;
    if args.print_model {
        return Ok(print_block(text.trim_end())?);
    }
    let serving = Serving { args, rac: args.rac.or_else(|| model.rac.then_some(RAC)), file };
    let arm = args.arm.as_ref().map(read_arm).transpose()?;
    if let (true, Some((_, text))) = (args.print_arm, &arm) {
        return Ok(print_block(text.trim_end())?);
    }
    #[cfg(feature = "screens")]
    if args.screen {
        bcap_terminal::screen::require("leave --screen out").map_err(Failure::Input)?;
    }
    runtime()?.block_on(async {
        // install the signal handlers before the `ready` line: a reader of that line may send a signal immediately
        let ended = signal::wait()?;
        if let Some(capture) = &args.replay {
            return replay(capture, serving, ended).await;
        }
        // dropped, and thereby deleted, after the controller has ended
        let temporary = tempfile::tempdir()?;
        let files = args.files.as_deref().unwrap_or(temporary.path());
        let mut config = configured(args, model, arm.as_ref().map(|(arm, _)| arm), files)?;
        #[cfg(feature = "screens")]
        let refused = args.screen.then(live_screen::Refused::shown);
        #[cfg(feature = "screens")]
        if let Some(refused) = &refused {
            config.observer = refused.observer();
        }
        let trajectory = args.record.as_deref().map(|path| record(path, &mut config)).transpose()?;
        let mut controller = Controller::new(config);
        if let Some(path) = &args.scenario {
            let scenario = read_scenario(path, controller.config())?;
            if file.is_some() && has_token_of_address(&scenario) {
                return Err(no_addresses("the token of the scenario"));
            }
            controller.play(scenario);
        }
        if args.files.is_none() {
            write_sources(temporary.path(), controller.tasks().map(|(name, ..)| name))?;
        }
        #[cfg(feature = "screens")]
        if let Some(refused) = refused {
            let watched = live_screen::Watched::shared(controller, refused);
            let served = Served::bind(live_screen::Watched::server(&watched), serving).await?;
            on_screen(served, watched, ended).await?;
            return Ok(trajectory.map_or(Ok(()), |trajectory| trajectory.end())?);
        }
        let shared = delivery::shared(controller);
        let served = Served::bind(delivery::server(&shared), serving).await?;
        #[cfg(feature = "web")]
        let served = served.with_page(args.web, |bcap, listen| web_panel::start(bcap, listen, shared)).await?;
        print_line(&served.ready())?;
        served.run(ended).await?;
        Ok(trajectory.map_or(Ok(()), |trajectory| trajectory.end())?)
    })
}

/// How a controller serves.
#[derive(Clone, Copy)]
struct Serving<'a> {
    args: &'a Sim,
    /// The address for RAC; `None` without it.
    rac: Option<SocketAddr>,
    /// The file to which the clients are recorded.
    file: Option<&'a Path>,
}

/// Serves a capture, and its page.
async fn replay(capture: &Path, serving: Serving<'_>, ended: impl Future<Output = ()>) -> Result<(), Failure> {
    #[cfg(feature = "web")]
    let lacking = bcap_web::Replay::default();
    #[cfg(feature = "web")]
    let shown = lacking.clone();
    let playback = Playback::read(capture, move |request| {
        print_unknown(request);
        #[cfg(feature = "web")]
        shown.lacks(request);
    })?;
    #[cfg(feature = "web")]
    let session = playback.session();
    let served = Served::bind(Server::new(playback), serving).await?;
    #[cfg(feature = "web")]
    let served =
        served.with_page(serving.args.web, |bcap, listen| web_panel::replay(bcap, listen, session, lacking)).await?;
    print_line(&served.ready())?;
    served.run(ended).await
}

/// Prints a request that the capture does not have.
fn print_unknown(request: &str) {
    // an error of the standard error cannot be reported
    let _ = writeln!(io::stderr(), "not in the capture: {}", escape::line(request));
}

/// Returns whether a scenario gives the executable token to an address.
fn has_token_of_address(scenario: &Scenario) -> bool {
    let later = scenario.faults.iter().filter_map(|fault| match fault.then {
        Effect::Token(token) => Some(token),
        _ => None,
    });
    scenario.controller.token.into_iter().chain(later).any(|token| matches!(token, Token::Address(_)))
}

fn no_addresses(place: &str) -> Failure {
    Failure::Input(format!(
        "clients have no address of their own while they are recorded; leave out --write or the address of {place}"
    ))
}

#[cfg(feature = "screens")]
/// Serves, and shows the controller, until `ended` or until the user quits.
async fn on_screen(
    served: Served<live_screen::Watched>,
    watched: live_screen::SharedController,
    ended: impl Future<Output = ()>,
) -> Result<(), Failure> {
    let (quit, quits) = oneshot::channel::<()>();
    let ended = async {
        tokio::select! {
            () = ended => {}
            // the sender is dropped
            _ = quits => {}
        }
    };
    let ready = served.ready();
    let addresses = ready.strip_prefix("ready ").unwrap_or(&ready);
    let live = bcap_terminal::screen::Live::open(quit, live_screen::shown(addresses, &watched))?;
    let done = served.run(ended).await;
    let closed = live.close();
    done?;
    Ok(closed?)
}

/// A controller that listens at the addresses of the command line.
struct Served<H> {
    server: Server<H>,
    /// The addresses for clients; `None` with serial lines only.
    network: Option<Listening>,
    /// The front that records, and the addresses to which it forwards.
    recorded: Option<(Front, Listening)>,
    /// The serial lines and the page in the line `ready`, each after a blank.
    words: String,
    #[cfg(feature = "web")]
    page: Option<web_panel::Page>,
}

impl<H: Serves> Served<H> {
    async fn bind(server: Server<H>, Serving { args, rac, file }: Serving<'_>) -> Result<Self, Failure> {
        let mut recorded = None;
        let (server, network) = if let Some(file) = file {
            if !args.serial.is_empty() {
                let what = "a serial line has no packets to record; leave out --write or --serial";
                return Err(Failure::Input(what.into()));
            }
            if matches!(args.token, Token::Address(_)) {
                return Err(no_addresses("--token"));
            }
            let front = Front::bind(args, rac, file).await?;
            let any = SocketAddr::from(([127, 0, 0, 1], 0));
            let (server, inner) = bind(server, &Listening { bcap: any, udp: any, rac: Some(any) }).await?;
            let network = front.listening()?;
            recorded = Some((front, inner));
            (server, Some(network))
        } else if args.no_network {
            (server, None)
        } else {
            let (server, network) = bind(server, &Listening { bcap: args.bcap, udp: args.udp, rac }).await?;
            (server, Some(network))
        };
        let (server, words) = open_lines(server, &args.serial)?;
        Ok(Self {
            server,
            network,
            recorded,
            words,
            #[cfg(feature = "web")]
            page: None,
        })
    }

    /// Returns the line `ready`.
    fn ready(&self) -> String {
        self.network.as_ref().map_or_else(|| "ready".into(), ToString::to_string) + &self.words
    }

    /// Starts a page for the controller at an address, which gets the address of b-CAP over TCP.
    #[cfg(feature = "web")]
    async fn with_page(
        mut self,
        listen: Option<SocketAddr>,
        page: impl AsyncFnOnce(SocketAddr, SocketAddr) -> Result<web_panel::Page, Failure>,
    ) -> Result<Self, Failure> {
        if let Some((listen, network)) = listen.zip(self.network.as_ref()) {
            let page = page(network.bcap, listen).await?;
            self.words += &format!(" web={}", page.url);
            self.page = Some(page);
        }
        Ok(self)
    }

    /// Serves until `ended`. The page ends before its controller does.
    async fn run(self, ended: impl Future<Output = ()>) -> Result<(), Failure> {
        #[cfg(feature = "web")]
        let page = self.page;
        let ended = async {
            ended.await;
            #[cfg(feature = "web")]
            if let Some(page) = page {
                page.end().await;
            }
        };
        let Some((front, Listening { bcap, udp, rac })) = self.recorded else {
            return Ok(self.server.run(ended).await?);
        };
        let (stop, stopped) = oneshot::channel::<()>();
        let robot = Robot { tcp: vec![bcap], udp, rac: rac.into_iter().collect() };
        let front = async {
            let written = front.serve(robot, ended).await;
            drop(stop);
            written
        };
        // the controller stops when the sender is dropped
        let (written, served) = tokio::join!(front, self.server.run(async { drop(stopped.await) }));
        served?;
        written
    }
}

/// Opens the serial lines; also returns their words for the `ready` line.
fn open_lines<H: Serves>(mut server: Server<H>, lines: &[SerialLine]) -> Result<(Server<H>, String), Failure> {
    let mut words = String::new();
    for line in lines {
        server = server.bcap_serial(line, print_event).map_err(|error| Failure::Connection {
            message: format!("cannot open serial:{line}: {error}"),
            hint: "check the name and the permissions of the device, and that no other program uses it".into(),
        })?;
        words += &format!(" serial={line}");
    }
    Ok((server, words))
}

/// Prints or shows that a serial line was unplugged or plugged in again.
fn print_event(line: &SerialLine, event: LineEvent<'_>) {
    let text = match event {
        LineEvent::Lost(error) => format!("serial:{line} is lost ({error}); waiting until it can be opened again"),
        LineEvent::Reopened => format!("serial:{line} is open again"),
        _ => return,
    };
    // a note would be written over the screen
    #[cfg(feature = "screens")]
    let Some(text) = live_screen::Refused::push_shown(text) else { return };
    note(&text);
}

/// A handler of both protocols.
trait Serves: bcap::server::Handler + rac::server::Handler + Send + 'static {}

impl<H: bcap::server::Handler + rac::server::Handler + Send + 'static> Serves for H {}

/// Reads a model, from its file if it is not built in; returns it with its text.
pub(crate) fn read_model(source: &Source<Profile>) -> Result<(Model, String), Failure> {
    match source {
        Source::BuiltIn(profile) => Ok((profile.model().clone(), profile.text().to_owned())),
        Source::File(path) => read_file("model", path, Model::parse),
    }
}

/// Reads an arm, from its file if it is not built in; returns it with its text.
fn read_arm(source: &Source<ArmProfile>) -> Result<(ArmModel, String), Failure> {
    match source {
        Source::BuiltIn(arm) => Ok((arm.arm().clone(), arm.text().to_owned())),
        Source::File(path) => read_file("arm", path, ArmModel::parse),
    }
}

fn read_scenario(path: &Path, config: &Config) -> Result<Scenario, Failure> {
    let parse = |text: &str| Scenario::parse(text).and_then(|scenario| scenario.check(config).map(|()| scenario));
    Ok(read_file("scenario", path, parse)?.0)
}

/// Reads and parses a file; also returns its text.
fn read_file<T, E: fmt::Display>(
    what: &str,
    path: &Path,
    parse: impl FnOnce(&str) -> Result<T, E>,
) -> Result<(T, String), Failure> {
    // a FIFO without a writer would block forever
    let regular = |metadata: fs::Metadata| match metadata.is_file() {
        true => fs::read_to_string(path),
        false => Err(io::Error::other("it is not a regular file")),
    };
    let shown = path.display();
    let text = fs::metadata(path).and_then(regular);
    let text = text.map_err(|error| Failure::Input(format!("cannot read the {what} {shown}: {error}")))?;
    match parse(&text) {
        Ok(parsed) => Ok((parsed, text)),
        Err(error) => Err(Failure::Input(format!("{shown} is not a valid {what}: {error}"))),
    }
}

/// Starts a thread for file jobs, so that a blocking file system does not delay other calls.
///
/// The process does not wait for this thread when it exits.
fn file_worker() -> io::Result<Executor> {
    let (jobs, queue) = mpsc::sync_channel::<Job>(FILE_JOBS);
    thread::Builder::new().name("files".into()).spawn(move || queue.into_iter().for_each(|job| job()))?;
    // a job that does not fit the queue is dropped, which answers its call with E_BUSY_PROC
    Ok(Executor::new(move |job| drop(jobs.try_send(job))))
}

/// Has the controller write the trajectory of its arm into a file.
fn record(path: &Path, config: &mut Config) -> Result<Trajectory, Failure> {
    let trajectory = Trajectory::create(path, config.wall_clock_origin_ms)
        .map_err(|error| Failure::Input(format!("--record {}: {error}", path.display())))?;
    let file = trajectory.clone();
    config.recorder = Recorder::new(move |point| {
        let TracePoint { at, axes, position, tool, work } = *point;
        file.add(&Point { at, axes, position, tool, work });
    });
    Ok(trajectory)
}

/// Starts a thread that prints tolerated faults and, with `refusals`, why arguments are refused. It drops lines when
/// its queue is full.
fn explainer(refusals: bool) -> io::Result<Observer> {
    let (lines, queue) = mpsc::sync_channel::<String>(EXPLANATIONS);
    let print = move || queue.into_iter().try_for_each(|line| writeln!(io::stderr(), "{line}"));
    thread::Builder::new().name("explain".into()).spawn(print)?;
    Ok(Observer::new(move |code, text| {
        let line = match code {
            HResult::S_OK => format!("tolerated: {text}"),
            _ if refusals => format!("refused with {code}: {text}"),
            _ => return,
        };
        drop(lines.try_send(line));
    }))
}

/// Binds the sockets of a controller; port 0 selects a free port.
pub(crate) async fn listen(controller: Controller, wanted: &Listening) -> Result<(Server<Paced>, Listening), Failure> {
    bind(delivery::server(&delivery::shared(controller)), wanted).await
}

async fn bind<H: Serves>(server: Server<H>, wanted: &Listening) -> Result<(Server<H>, Listening), Failure> {
    let server = server.bcap_tcp(wanted.bcap).await.map_err(|error| taken("--bcap", wanted.bcap, &error))?;
    let server = server.bcap_udp(wanted.udp).await.map_err(|error| taken("--udp", wanted.udp, &error))?;
    let server = match wanted.rac {
        Some(address) => server.rac_tcp(address).await.map_err(|error| taken("--rac", address, &error))?,
        None => server,
    };
    let addresses = server.addresses();
    let first = |addresses: &[SocketAddr]| addresses.first().copied();
    match (first(&addresses.bcap_tcp), first(&addresses.bcap_udp), first(&addresses.rac_tcp)) {
        (Some(bcap), Some(udp), rac) => Ok((server, Listening { bcap, udp, rac })),
        _ => Err(Failure::Stdio(io::Error::other("a socket has no local address"))),
    }
}

/// Returns the configuration of a controller by the command line, and starts the threads that it needs.
fn configured(args: &Sim, model: Model, arm: Option<&ArmModel>, files: &Path) -> Result<Config, Failure> {
    if !files.is_dir() {
        return Err(Failure::Input(format!("--files {}: the folder does not exist", files.display())));
    }
    let mut config = Config { files: Some(files.to_owned()), file_executor: file_worker()?, ..config(model) };
    (config.mode, config.token) = (args.mode, args.token);
    config.lenient = args.lenient;
    if args.explain || args.lenient {
        config.observer = explainer(args.explain)?;
    }
    if let Some(arm) = arm {
        config = config.with_arm(arm);
    }
    if let Some(robot_type) = &args.robot_type {
        config.robot_type.clone_from(robot_type);
    }
    config.slave.licensed = !args.no_slave_licence;
    Ok(config)
}

/// Returns the configuration of a controller with the clock of this machine.
fn config(model: Model) -> Config {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let origin = since_1970.as_micros().saturating_sub(bcap_std::now().as_micros().into()) / 1000;
    let wall_clock_origin_ms = i64::try_from(origin).unwrap_or(0);
    Config { wall_clock_origin_ms, ..Config::of(model) }
}
