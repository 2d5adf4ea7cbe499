//! Measures how well a stream of Slave Mode meets its deadlines of 8 ms while another thread keeps a core busy.
//!
//! ```text
//! cargo bench -p bcap-tests --bench slave                      10,000 cycles in each mode, blocking and under tokio
//! cargo bench -p bcap-tests --bench slave -- 1000 --fifo       fewer, with SCHED_FIFO and locked memory
//! ```
//!
//! The virtual controller runs in a separate thread behind TCP. It shares the machine with the stream's thread and with
//! a thread that only counts. With `--fifo` the controller has the same priority as the stream. The output has the
//! figures of the engine, and the underflows that the controller counted. The benchmark fails on any underflow.

use std::hint::black_box;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Instant;

use bcap_core::procedure::{Provider, open_robot};
use bcap_core::slave::{
    AxisLimits, Config, Cycle, Engine, Format, MOVE_FRAME, Mode, Next, Pose, PoseType, ReceiveFormat, ReceivePose,
    SlaveMode, Stats,
};
use bcap_sim::{Controller, Profile};
use bcap_std::server::Limits;
use bcap_std::slave::Realtime;
use bcap_std::{Options, asynch, blocking};
use bcap_tests::served::Served;

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let cycles = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(10_000);
    let realtime = if arguments.iter().any(|argument| argument == "--fifo") {
        Realtime::default().fifo(Some(80)).lock_memory(true).core(None)
    } else {
        Realtime::default()
    };
    match run(cycles, realtime) {
        Ok(0) => ExitCode::SUCCESS,
        Ok(underflows) => {
            eprintln!("slave: {underflows} underflows");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("slave: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(cycles: u32, realtime: Realtime) -> Result<u64, Failure> {
    let busy = Arc::new(AtomicBool::new(true));
    let counting = Arc::clone(&busy);
    let counter = thread::spawn(move || {
        let mut count = 0_u64;
        while counting.load(Ordering::Relaxed) {
            count = black_box(count.wrapping_add(1));
        }
    });
    println!("{cycles} cycles of 8 ms each; times in us");
    println!(
        "{:<9} {:<5} {:>7} {:>5} {:>7} {:>10}   {:<29} {:<29} margin",
        "driver",
        "mode",
        "cycles",
        "late",
        "refused",
        "underflows",
        "round trip p50/p99/p99.9/max",
        "jitter p50/p99/p99.9/max"
    );
    let mut underflows = 0;
    for mode in [Mode::Mode0, Mode::Mode1, Mode::Mode2] {
        for driver in [Driver::Blocking, Driver::Tokio] {
            // a separate thread, so that its scheduling settings end with it
            let streamed = thread::spawn(move || stream(driver, mode, cycles, realtime)).join();
            let (stats, times, counted) = streamed.map_err(|_| "the stream has panicked")??;
            show(driver, mode, &stats, &times, counted);
            underflows += counted;
        }
    }
    busy.store(false, Ordering::Relaxed);
    counter.join().map_err(|_| "the counter has panicked")?;
    Ok(underflows)
}

/// Times in microseconds, with three digits.
type Times = hdrhistogram::Histogram<u32>;

#[derive(Clone, Copy)]
enum Driver {
    Blocking,
    Tokio,
}

/// Streams over one connection, and returns the figures with the underflows that the controller saw.
fn stream(driver: Driver, mode: Mode, cycles: u32, realtime: Realtime) -> Result<(Stats, [Times; 2], u64), Failure> {
    // first, so that the controller's thread inherits it: a real one does not share this machine
    realtime.apply()?;
    let sim = Served::of(Controller::new(bcap_sim::Config::new(Profile::Rc8)), Limits::default());
    let format = Format::new(SlaveMode { mode, pose: PoseType::J }, ReceiveFormat::pose(ReceivePose::J));
    // slow enough to pass the limits when a cycle of mode 1 finds no new pose
    let limits = AxisLimits::uniform(20.0, 400.0);
    let mut times = [times()?, times()?];
    let mut trajectory = |cycle: &Cycle<'_>| {
        follow(&mut times, cycle.stats);
        if cycle.number == cycles {
            return Next::Finish;
        }
        let mut joints: [f64; 8] = cycle.start.numbers().try_into().unwrap_or_default();
        joints[0] += 5.0 * (1.0 - (f64::from(cycle.number) / 500.0 * std::f64::consts::TAU).cos());
        Next::Pose(Pose::j(joints))
    };
    let began = Instant::now();
    let stats = match driver {
        Driver::Blocking => {
            let mut motion = blocking::connect_tcp(sim.tcp, &Options::default())?;
            let handles = motion.run(open_robot(Provider::RC8, None))?;
            let mut engine = Engine::<MOVE_FRAME>::new(Config { limits, ..Config::new(format, handles) })?;
            motion.run(engine.stream(&mut trajectory))?;
            engine.stats().clone()
        }
        Driver::Tokio => tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(async {
            let mut motion = asynch::connect_tcp(sim.tcp, &Options::default()).await?;
            let handles = motion.run(open_robot(Provider::RC8, None)).await?;
            let mut engine = Engine::<MOVE_FRAME>::new(Config { limits, ..Config::new(format, handles) })?;
            motion.run(engine.stream(&mut trajectory)).await?;
            Ok::<_, Failure>(engine.stats().clone())
        })?,
    };
    if began.elapsed() < bcap_sim::slave::CYCLE * cycles.saturating_sub(10) {
        return Err("the stream was faster than the controller".into());
    }
    follow(&mut times, &stats);
    let counted = sim.application().slave_counters().underflows;
    Ok((stats, times, counted))
}

/// Records the round trip and the jitter of the last cycle; a cycle with a refused pose has several and keeps the last.
fn follow(times: &mut [Times; 2], stats: &Stats) {
    for (times, counted) in times.iter_mut().zip([&stats.rtt, &stats.jitter]) {
        if u64::from(counted.count()) > times.len() {
            times.saturating_record_n(counted.last().into(), counted.count() - times.len() as u32);
        }
    }
}

fn times() -> Result<Times, Failure> {
    Ok(Times::new_with_bounds(1, 10_000_000, 3)?)
}

fn show(driver: Driver, mode: Mode, stats: &Stats, times: &[Times; 2], underflows: u64) {
    let driver = match driver {
        Driver::Blocking => "blocking",
        Driver::Tokio => "tokio",
    };
    let mode = match mode {
        Mode::Mode0 => 0,
        Mode::Mode1 => 1,
        Mode::Mode2 => 2,
    };
    let [rtt, jitter] = times.each_ref().map(|times| {
        let at = |share| times.value_at_quantile(share).to_string();
        [at(0.5), at(0.99), at(0.999), at(1.0)].join("/")
    });
    let margin = stats.least_margin.map_or("-".into(), |margin| format!("{:.1} ms", margin.as_secs_f64() * 1000.0));
    println!(
        "{driver:<9} {mode:<5} {:>7} {:>5} {:>7} {underflows:>10}   {rtt:<29} {jitter:<29} {margin}",
        stats.cycles, stats.late, stats.refused,
    );
}
