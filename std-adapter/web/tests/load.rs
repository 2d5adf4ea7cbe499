//! 1,000 variables at 5 Hz, so 10,000 packets/s, in three browsers: `just web-load MINUTES`.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::chromium::Browser;

/// A program that ends with this.
struct Program {
    process: Child,
    first: String,
}

impl Program {
    /// Starts `bcap` with arguments, and waits for its first line.
    fn start(args: &[&str]) -> Self {
        let bcap = std::env::var_os("BCAP").expect("BCAP is the path of `bcap`; run `just web-load`");
        let mut process = Command::new(bcap).args(args).stdout(Stdio::piped()).spawn().unwrap();
        let mut first = String::new();
        BufReader::new(process.stdout.as_mut().unwrap()).read_line(&mut first).unwrap();
        Self { process, first: first.trim().to_owned() }
    }

    /// Returns the processor time and the resident memory in KB.
    fn usage(&self) -> (Duration, u64) {
        let of = |file: &str| std::fs::read_to_string(format!("/proc/{}/{file}", self.process.id())).unwrap();
        let stat = of("stat");
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        let ticks: u64 = fields[11..13].iter().map(|ticks| ticks.parse::<u64>().unwrap()).sum();
        let status = of("status");
        let memory = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        (Duration::from_millis(ticks * 10), memory.trim().trim_end_matches(" kB").parse().unwrap())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Counts the frames of the page, and the messages from the server.
const COUNT: &str = "(() => { window.frames_ = 0; const next = () => { window.frames_ += 1; requestAnimationFrame(next); }; next(); })()";

/// Returns the memory of the scripts in KB after a collection.
fn heap(browser: &mut Browser) -> u64 {
    browser.call("HeapProfiler.collectGarbage", json!({}));
    let metrics = browser.call("Performance.getMetrics", json!({}))["metrics"].clone();
    let found = metrics.as_array().unwrap().iter().find(|metric| metric["name"] == "JSHeapUsedSize").cloned();
    found.and_then(|metric| metric["value"].as_f64()).unwrap_or_default() as u64 / 1024
}

#[test]
#[ignore = "minutes; `just web-load`"]
fn a_thousand_variables_and_their_packets_in_three_browsers() {
    let minutes: f64 = std::env::var("MINUTES").map_or(2.0, |minutes| minutes.parse().unwrap());
    let any = "127.0.0.1:0";
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("changes.toml");
    std::fs::write(&scenario, changes()).unwrap();
    let scenario = scenario.to_str().unwrap();
    let sim = Program::start(&["sim", "--bcap", any, "--udp", any, "--rac", any, "--scenario", scenario]);
    let address = sim.first.split(' ').find_map(|word| word.strip_prefix("bcap=")).unwrap();
    let web = Program::start(&["web", "--listen", any, "--robot", &format!("tcp:{address}")]);
    let screens = ["variables", "plots", "packets"];
    let mut browsers: Vec<Browser> = screens.iter().filter_map(|_| Browser::start()).collect();
    assert_eq!(browsers.len(), 3, "three browsers");
    for (browser, screen) in browsers.iter_mut().zip(screens) {
        browser.open(&web.first);
        browser.until_text("#state", "ready, motor off");
        browser.call("Performance.enable", json!({}));
        browser.click("[data-id=variables]");
        browser.enter("#names", NAMES);
        // the IO are lamps
        browser.until("document.querySelectorAll('tbody tr, .lamp').length >= 1000");
        browser.click(&format!("[data-id={screen}]"));
        browser.eval(COUNT);
    }
    // the first minute fills caches
    thread::sleep(Duration::from_secs_f64((minutes * 60.0 / 4.0).min(60.0)));
    let frames = |browser: &mut Browser| browser.eval("window.frames_").as_f64().unwrap();
    let (began, before) = (Instant::now(), web.usage());
    let first: Vec<_> = browsers.iter_mut().map(|browser| (frames(browser), heap(browser))).collect();
    let mut samples = vec![before.1];
    while began.elapsed() < Duration::from_secs_f64(minutes * 60.0) {
        thread::sleep(Duration::from_secs(5));
        samples.push(web.usage().1);
    }
    let (time, after) = (began.elapsed(), web.usage());
    let cpu = (after.0 - before.0).as_secs_f64() / time.as_secs_f64() * 100.0;
    println!(
        "server: {cpu:.1} % of a core over {:.0} s; memory {} KB at the start, {} KB at the end, {} KB at most",
        time.as_secs_f64(),
        before.1,
        after.1,
        samples.iter().max().unwrap()
    );
    println!("packets/s: {:.0}", packets(&mut browsers[2]));
    for ((browser, screen), (count, memory)) in browsers.iter_mut().zip(screens).zip(first) {
        let rate = (frames(browser) - count) / time.as_secs_f64();
        println!(
            "page {screen}: {rate:.1} frames/s; scripts {memory} KB at the start, {} KB at the end; shown: {}",
            heap(browser),
            told(browser)
        );
        assert_eq!(browser.problems, [""; 0], "{screen}");
    }
}

/// The names of the variables: 100 of each kind, and 200 IO.
const NAMES: &str = "I0-I99 F0-F99 D0-D99 V0-V99 P0-P99 J0-J99 T0-T99 S0-S99 IO128-IO327";

/// Returns a scenario whose task changes all of them five times a second.
fn changes() -> String {
    let each = |count: usize, text: &dyn Fn(usize) -> String| (0..count).map(text).collect::<Vec<_>>().join(", ");
    let add = each(100, &|n| format!("I{n} = 1, F{n} = 0.5, D{n} = 0.25"));
    let set = |value: i32| {
        let array = |count: usize| format!("[{}]", each(count, &|_| format!("{value}.5")));
        let [v, p, j, t] = [3, 7, 8, 10].map(array);
        let arrays = each(100, &|n| format!("V{n} = {v}, P{n} = {p}, J{n} = {j}, T{n} = {t}, S{n} = \"part {value}\""));
        let bits = each(200, &|n| format!("IO{} = {}", n + 128, value == 1));
        format!("{{ add = {{ {add} }} }}, {{ set = {{ {arrays}, {bits} }} }}")
    };
    let (one, other) = (set(1), set(2));
    format!("[[task]]\nname = \"Changes\"\nstart = 2\nline_ms = 100\nsteps = [{one}, {other}]\n")
}

/// Returns the packets of a second, by the page's list of calls by object: each call has a request and a reply.
fn packets(browser: &mut Browser) -> f64 {
    browser.eval(
        "[...document.querySelectorAll('main button')].find((button) => button.textContent === 'By object').click()",
    );
    browser.until("document.querySelectorAll('.by-object tr').length > 10");
    thread::sleep(Duration::from_secs(3));
    let rate = "[...document.querySelectorAll('.by-object tr td:nth-child(3)')].reduce((sum, cell) => sum + Number(cell.textContent), 0)";
    2.0 * browser.eval(rate).as_f64().unwrap()
}

/// Returns the page's counts of omitted items.
fn told(browser: &mut Browser) -> Value {
    browser.eval("[...document.querySelectorAll('main p')].map((line) => line.textContent).filter((text) => /packet|call|kept|left|variables/.test(text)).slice(0, 2).join(' | ') || document.querySelectorAll('main tbody tr, main polyline').length + ' rows'")
}
