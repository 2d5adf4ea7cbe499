//! The page in a real browser: the main job of each screen, and the safety rules that the page itself keeps.

use std::net::TcpListener;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use bcap_core::hresult::HResult;
use bcap_core::rac::VariableKind;
use bcap_core::variant::{OwnedVariant, Variant};
use bcap_std::{Motion, Move, Settings, blocking};

use crate::chromium::Browser;
use crate::safety::{other, start_moving};
use crate::support::{LIMIT, Sim, Web, until};

const I: VariableKind = VariableKind::I;

/// Opens the page of a server, and waits until it shows the state of its robot.
pub(crate) fn opened(web: &Web) -> Option<Browser> {
    let mut browser = Browser::start()?;
    browser.open(web.url());
    browser.until_text("#state", "ready, motor off");
    Some(browser)
}

fn value(sim: &Sim, kind: VariableKind, index: u32) -> OwnedVariant {
    OwnedVariant::from(sim.lock().variable::<64>(kind, index).unwrap().as_variant())
}

fn is(sim: &Sim, number: i32) -> bool {
    value(sim, I, 1).as_variant() == Variant::I4(number)
}

#[test]
fn a_user_writes_undoes_clears_and_halts() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], true);
    let Some(mut browser) = opened(&web) else { return };
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    assert_eq!(browser.eval("location.href"), format!("http://{}/", web.host()), "the token is not shown");
    assert_eq!(browser.eval(&text("kind")), "virtual controller");
    assert_eq!(browser.eval("document.body.className"), "virtual");
    browser.click("[data-id=variables]");
    browser.enter("#names", "I1 IO128");
    // the rows of the first selection move the buttons when they go
    browser.until("document.querySelectorAll('tbody tr, .lamp').length === 2");
    browser.until_text("tbody tr th", "I1");
    browser.until("document.querySelector('tbody button').disabled");
    browser.enter("#name", "Anna");
    browser.until_text("#control", "control: Anna (this page)");
    // Escape refuses, and Cancel has the focus
    browser.click("tbody button");
    browser.enter(".edit", "5");
    browser.until("document.getElementById('question').open");
    let robot = format!("press (tcp:{}), virtual controller", sim.address());
    assert_eq!(browser.eval(&text("question-robot")), robot);
    assert_eq!(browser.eval(&text("question-text")), "I1: 0 → 5");
    assert_eq!(browser.eval("document.activeElement.id"), "question-no");
    browser.key("Escape");
    browser.until_text("#notice", "nothing was written");
    assert!(is(&sim, 0));
    browser.click("tbody button");
    browser.enter(".edit", "5");
    browser.click("#question-yes");
    browser.until_text("#notice", "press: I1 = 5 is written");
    assert!(is(&sim, 5));
    browser.click(".writes button");
    browser.until_text("#question-text", "I1: 5 → 0");
    browser.click("#question-yes");
    browser.until_text("#notice", "press: I1 = 0 is written");
    assert!(is(&sim, 0));
    browser.click(".lamp");
    browser.until_text("#question-text", "IO128: false → true");
    browser.click("#question-yes");
    browser.until_text(".lamp.on .value", "on");
    assert_eq!(value(&sim, VariableKind::Io, 128).as_variant(), Variant::Bool(true));
    alarms(&sim, &mut browser);
    halt_by_key(&sim, &mut browser);
    // a reload frees the control
    browser.call("Page.reload", serde_json::json!({}));
    browser.until("document.getElementById('take') !== null");
    assert_eq!(browser.problems, [""; 0]);
    assert_eq!(web.lines().iter().filter(|line| line.contains("Anna: writes")).count(), 3);
}

/// The errors are explained and cleared, after a question.
fn alarms(sim: &Sim, browser: &mut Browser) {
    sim.lock().inject_error(HResult::from_u32(0x8350_0076), bcap_std::now());
    browser.until_text("#state", "error");
    browser.click("[data-id=alarms]");
    browser.until_text(".errors h3", "0x83500076");
    browser.until_text(".errors .first", "first cause");
    browser.until_text(".errors", "Remedy: ");
    browser.click("#clear");
    browser.until_text("#question-text", "Nothing is started");
    browser.click("#question-yes");
    browser.until_text(".alarms h2", "No errors");
    let sim = sim.lock();
    assert_eq!((sim.errors().count(), sim.motor_is_on()), (0, false));
}

/// The key h halts, except in a field of text.
fn halt_by_key(sim: &Sim, browser: &mut Browser) {
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let _motion = arm.start(&Move::joint("J(90,45,90,0,45,0)").speed_percent(1.0), LIMIT).unwrap().keep();
    sim.until("the robot moves", bcap_sim::Controller::is_moving);
    browser.until_text("#state", "moving");
    browser.click("[data-id=variables]");
    browser.click("#search");
    browser.key("h");
    browser.until("document.getElementById('search').value === 'h'");
    assert!(sim.lock().is_moving(), "a letter of a field halts nothing");
    browser.eval("document.activeElement.blur()");
    browser.key("h");
    browser.until_text("#notice", "press: halted, the robot rests");
    assert!(!sim.lock().is_moving());
    arm.motor_off().unwrap();
    arm.give().unwrap();
    sim.lock().clear_errors(bcap_std::now());
}

/// A question makes the rest of the page inert. Its own HALT halts the robot, and does not answer the question.
#[test]
fn a_robot_is_halted_during_a_question() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], true);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=variables]");
    browser.enter("#names", "I1");
    browser.until("document.querySelectorAll('tbody tr, .lamp').length === 1");
    browser.enter("#name", "Anna");
    browser.until_text("#control", "control: Anna (this page)");
    let mut cell = other(&sim);
    start_moving(&sim, &mut cell);
    browser.until_text("#state", "moving");
    browser.click("tbody button");
    browser.enter(".edit", "5");
    browser.until("document.getElementById('question').open");
    browser.press("#halt");
    browser.lift();
    assert!(sim.lock().is_moving(), "the header is inert");
    browser.until_text("#question-halt", "HALTpress");
    browser.click("#question-halt");
    browser.until_text("#question-notice", "press: halted, the robot rests");
    assert!(!sim.lock().is_moving());
    assert_eq!(browser.eval("document.getElementById('question').open"), true);
    for scheme in ["light", "dark"] {
        browser.look((768, 1024), scheme);
        assert_eq!(browser.eval(AUDIT), serde_json::json!([]), "{scheme}");
    }
    browser.click("#question-no");
    browser.until_text("#notice", "nothing was written");
    assert!(is(&sim, 0));
    // the outcome is not shown in the next question
    browser.click("tbody button");
    browser.enter(".edit", "5");
    browser.until("document.getElementById('question').open");
    assert_eq!(browser.eval("document.getElementById('question-notice').textContent"), "");
    assert_eq!(browser.problems, [""; 0]);
    assert_eq!(web.lines().iter().filter(|line| line.contains("HALT")).count(), 1);
}

/// A browser opens six connections to a host. Presses of HALT for a controller that does not answer leave connections free for
/// other robots. The first press keeps its connection, because quick presses must not prevent HALT from reaching the server.
#[test]
fn presses_for_a_silent_controller_do_not_pile_up() {
    let sim = Sim::start();
    // the operating system accepts connections, but no program answers them
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap();
    let robots = [("press", sim.address()), ("welder", address), ("gluer", address), ("packer", address)];
    let web = Web::start(&robots, false);
    let Some(mut browser) = opened(&web) else { return };
    browser.eval(
        "(() => { const send = fetch; window.sent = [];
            window.fetch = (...all) => { const n = sent.push('pending') - 1; const reply = send(...all);
                reply.catch((error) => { sent[n] = error.name; }); return reply; };
            const notice = document.getElementById('notice');
            window.told = [];
            new MutationObserver(() => told.push(notice.textContent)).observe(notice, { childList: true }); })()",
    );
    // in quick succession: the first halt fails only after 6 s
    browser.eval(
        "(async () => { for (const n of [2, 2, 2, 2, 3, 3, 4, 4]) { document.querySelector(`.tile:nth-child(${n}) .halt`).click();
            await new Promise((resolve) => { setTimeout(resolve); }); } })()",
    );
    // of four pending requests, the first of each robot stays
    let sent = "pending AbortError AbortError AbortError pending AbortError pending pending";
    assert_eq!(browser.eval("sent.join(' ')"), sent);
    browser.click(".tile:nth-child(1) .halt");
    // the outcome of another halt may replace this notice; failures stay in the alerts
    browser.until("told.some((text) => text.includes('press: the robot was at rest'))");
    assert_eq!(browser.problems, [""; 0]);
    // refuses connections from here on, so that the halt ends
    drop(silent);
}

/// The user must use the emergency stop until this robot is halted: no other outcome, and no halt of another robot, clears that.
#[test]
fn a_halt_that_failed_stays_shown_until_that_robot_is_halted() {
    let (sim, other) = (Sim::start(), Sim::start());
    let address = other.address();
    let web = Web::start(&[("press", sim.address()), ("welder", address)], true);
    let Some(mut browser) = opened(&web) else { return };
    drop(other);
    browser.click(".tile:nth-child(2) .halt");
    browser.until_text("header .alerts", "welder: NOT HALTED, use the emergency stop");
    let shown = "document.querySelector('header .alerts').checkVisibility() && document.querySelectorAll('header .alerts li').length";
    browser.click(".tile:nth-child(1) .halt");
    browser.until_text("#notice", "press: the robot was at rest");
    assert_eq!(browser.eval(shown), 1);
    browser.click("[data-id=variables]");
    browser.enter("#names", "I1");
    browser.until("document.querySelectorAll('tbody tr, .lamp').length === 1");
    browser.until("document.getElementById('notice').textContent === ''");
    assert_eq!(browser.eval(shown), 1);
    // the rest of the page is inert during a question
    browser.enter("#name", "Anna");
    browser.until_text("#control", "control: Anna (this page)");
    browser.click("tbody button");
    browser.enter(".edit", "5");
    browser.until("document.getElementById('question').open");
    browser.until_text("#question .alerts", "welder: NOT HALTED");
    for scheme in ["light", "dark"] {
        browser.look((768, 1024), scheme);
        assert_eq!(browser.eval(AUDIT), serde_json::json!([]), "{scheme}");
    }
    browser.click("#question-no");
    let other = Sim::at(address);
    browser.click("[data-id=cell]");
    browser.until_text(".tile:nth-child(2)", "ready, motor off");
    assert_eq!(browser.eval(shown), 1);
    browser.click(".tile:nth-child(2) .halt");
    browser.until(&format!("({shown}) === 0"));
    drop(other);
    browser.click(".tile:nth-child(2) .halt");
    browser.until(&format!("({shown}) === 1"));
    browser.click("header .alerts button");
    browser.until(&format!("({shown}) === 0"));
}

/// Opens the screen of tasks with the control of the robot. `None` without a browser.
fn at_the_tasks(web: &Web) -> Option<Browser> {
    let mut browser = Browser::start()?;
    browser.keep_sockets();
    browser.open(web.url());
    browser.until_text("#state", "ready, motor off");
    browser.enter("#name", "Anna");
    browser.until_text("#control", "control: Anna (this page)");
    browser.click("[data-id=tasks]");
    browser.until("document.getElementById('task').options.length > 0");
    Some(browser)
}

/// A start that a connection which hangs would deliver late is not sent. A stop is.
#[test]
fn a_start_is_not_sent_over_a_connection_that_hangs() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let Some(mut browser) = at_the_tasks(&web) else { return };
    // messages of the server are lost; messages of the page arrive
    browser.eval("sockets.at(-1).onmessage = null");
    browser.until_text("#stale", "bcap web does not answer");
    browser.click("[data-what=forever]");
    browser.click("#question-yes");
    browser.until_text("#notice.bad", "bcap web has not answered for 3 s; nothing was done");
    browser.click("[data-what=stop]");
    browser.click("#question-yes");
    until("the stop arrives", || web.lines().iter().any(|line| line.contains("Anna: stops")));
    assert!(!web.lines().iter().any(|line| line.contains("Anna: runs")), "{:?}", web.lines());
    // the page abandons the connection, and opens another
    browser.until("sockets.length > 1 && document.getElementById('stale').hidden");
}

/// The server carries out the order, and its answer is lost.
#[test]
fn an_order_whose_answer_is_lost_is_not_called_undone() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let Some(mut browser) = at_the_tasks(&web) else { return };
    browser.eval(
        "(() => { const socket = sockets.at(-1); const take = socket.onmessage;
            socket.onmessage = (event) => { if (JSON.parse(event.data).t !== 'answer') take(event); }; })()",
    );
    browser.click("[data-what=forever]");
    browser.click("#question-yes");
    until("the task is started", || web.lines().iter().any(|line| line.contains("runs again and again")));
    browser.eval("sockets.at(-1).close()");
    let unknown = "the connection to bcap web is lost; it is unknown whether it was done";
    browser.until(&format!("document.getElementById('notice').textContent === '{unknown}'"));
}

/// The server starts again with another token.
#[test]
fn a_page_whose_token_is_old_says_so() {
    let sim = Sim::start();
    let start =
        |listen: &str| Web::with(&|config| config.listen = listen.parse().unwrap(), &[("press", sim.address())], false);
    let web = start("127.0.0.1:0");
    let Some(mut browser) = opened(&web) else { return };
    let host = web.host().to_owned();
    drop(web);
    browser.until_text("#stale", "NOT CONNECTED to bcap web: the values are old.");
    let _web = start(&host);
    let why = "the token is missing or wrong; open the address that bcap web printed";
    browser.until_text("#stale", &format!("NOT CONNECTED to bcap web: {why}."));
}

#[test]
fn hostile_texts_stay_text_and_lost_connections_are_shown() {
    let sim = Sim::start();
    let hostile =
        "<img src=x onerror=window.owned=1><script>window.owned=2</script>\u{202e}".to_owned() + &"A".repeat(1 << 20);
    let hostile_value = OwnedVariant::new(hostile.as_str()).unwrap();
    sim.lock().set_variable(VariableKind::S, 1, &hostile_value.as_variant()).unwrap();
    let address = sim.address();
    let web = Web::start(&[("<b>press</b>", address), ("welder", address)], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.until_text(".tile h2", "<b>press</b>");
    assert_eq!(browser.eval("document.querySelectorAll('.tile').length"), 2);
    assert_eq!(browser.eval("document.getElementById('control').textContent"), "read-only");
    browser.click("[data-id=variables]");
    browser.enter("#names", "S1");
    browser.until_text("tbody .value", "<img src=x");
    let found = browser.eval("[document.querySelectorAll('img, b, main script').length, String(window.owned), document.body.scrollWidth <= innerWidth]");
    assert_eq!(found, serde_json::json!([0, "undefined", true]));
    // even if an attacker could add a script to the page, it would not run
    let script = "(() => { const s = document.createElement('script'); s.textContent = 'window.owned = 3'; document.body.append(s); return String(window.owned); })()";
    assert_eq!(browser.eval(script), "undefined");
    assert!(
        browser.problems.iter().all(|problem| problem.contains("Content Security Policy")),
        "{:?}",
        browser.problems
    );
    assert_eq!(browser.problems.len(), 1, "{:?}", browser.problems);
    browser.problems.clear();
    // three pages at the same time, and a page that is loaded again in every state
    let pages = [browser.open_page(), browser.open_page()];
    for page in &pages {
        browser.turn_to(page);
        browser.open(web.url());
        browser.until_text("#state", "ready, motor off");
    }
    for (change, state) in [(true, "not ready"), (false, "ready, motor off")] {
        sim.lock().emergency_stop(change, bcap_std::now());
        if !change {
            sim.lock().clear_errors(bcap_std::now());
        }
        for page in &pages {
            browser.turn_to(page);
            browser.call("Page.reload", serde_json::json!({}));
            browser.until(&format!(
                "/{}|error/.test(document.getElementById('state')?.textContent)",
                if change { state } else { "ready, motor off" }
            ));
        }
    }
    drop(sim);
    browser.until_text("#state", "not connected");
    // a selection that no controller could answer is made when one is there
    browser.click("[data-id=variables]");
    browser.enter("#names", "I1");
    browser.until_text("#notice.bad", "there is no connection to the controller");
    let sim = Sim::at(address);
    browser.until_text("#state", "ready, motor off");
    browser.until_text("tbody th", "I1");
    drop((sim, web));
    browser.until("!document.getElementById('stale').hidden");
    browser.until_text("#stale", "NOT CONNECTED");
    browser.click("#halt");
    browser.until_text("#notice.bad", "NOT HALTED, use the emergency stop");
}

/// The drawing ends where the controller says that the flange is; a motion leaves a path, and is plotted and saved.
#[test]
fn the_arm_is_drawn_and_its_numbers_are_plotted() {
    let sim = Sim::start();
    let web = Web::start(&[("press", sim.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    browser.click("[data-id=arm]");
    let arm = &bcap_sim::Profile::Rc8.model().robot_type;
    browser.until_text(".views + p", &format!("Drawn with the dimensions of the model file of {arm}."));
    let distance = "(() => { const flange = document.querySelector('.view').querySelectorAll('.joints circle');
        const [x, y] = ['cx', 'cy'].map((name) => Number([...flange].at(-1).getAttribute(name)));
        const r = Number([...flange].at(-1).getAttribute('r'));
        const [, left, up] = document.querySelector('.cross').getAttribute('d').match(/M([-\\d.e]+) ([-\\d.e]+)h/);
        return Math.hypot(x - Number(left) - 2 * r, y - Number(up)) < 0.1; })()";
    browser.until(distance);
    browser.click("[data-id=plots]");
    browser.until_text(".legend", "J1 0.000");
    let mut cell = blocking::Controller::connect(&format!("tcp:{}", sim.address()), &Settings::rc8()).unwrap();
    let mut arm = cell.robot().unwrap().take_arm().unwrap();
    arm.motor_on().unwrap();
    let motion = arm.move_to(&Move::joint("J(30,45,90,0,45,0)").speed_percent(100.0), LIMIT).unwrap();
    assert_eq!(motion, Motion::Arrived);
    browser.until_text(".legend", "J1 30.000");
    browser.click("#hold");
    browser.until_text("#hold", "Go on");
    let saved = "(async () => { let saved; URL.createObjectURL = (blob) => { saved = blob; return ''; };
        document.getElementById('csv').click(); return saved.text(); })()";
    let csv = browser.eval(saved);
    let mut lines = csv.as_str().unwrap().lines();
    assert_eq!(lines.next(), Some("time,\"J1\",\"J2\",\"J3\""));
    let rows: Vec<&str> = lines.collect();
    assert!(rows.len() > 3 && rows[0].ends_with("Z,0,45,90") && rows.last().unwrap().ends_with("Z,30,45,90"), "{csv}");
    browser.click("[data-id=arm]");
    browser.until("document.querySelector('.path').points.numberOfItems > 2");
    browser.until(distance);
    assert_eq!(browser.problems, [""; 0]);
}

/// The server sends variables only to their screens: a plot does not record them on another screen, nor from another robot.
#[test]
fn a_plot_records_no_variable_that_is_not_read() {
    let (sim, other) = (Sim::start(), Sim::start());
    let web = Web::start(&[("press", sim.address()), ("welder", other.address())], false);
    let Some(mut browser) = opened(&web) else { return };
    let set = |number: i32| sim.lock().set_variable(I, 1, &Variant::I4(number)).unwrap();
    set(1);
    browser.click("[data-id=variables]");
    browser.enter("#names", "I1");
    browser.until_text("tbody td.value", "1");
    browser.click("[data-id=plots]");
    browser.until("document.querySelectorAll('.choices input').length > 0 && document.querySelector('.choices').textContent.includes('I1')");
    browser.eval("[...document.querySelectorAll('.choices input')].at(-1).click()");
    browser.until_text(".legend", "I1 1.000");
    browser.click("[data-id=cell]");
    set(2);
    let left = browser.eval("Date.now()").as_f64().unwrap();
    std::thread::sleep(std::time::Duration::from_millis(1500));
    browser.click("[data-id=plots]");
    browser.until_text(".legend", "I1 2.000");
    let csv = |browser: &mut Browser| {
        let saved = "(async () => { let saved; URL.createObjectURL = (blob) => { saved = blob; return ''; };
            document.getElementById('csv').click(); return saved.text(); })()";
        browser.eval(saved).as_str().unwrap().to_owned()
    };
    let text = csv(&mut browser);
    assert!(text.starts_with("time,") && text.lines().next().unwrap().ends_with("\"I1\""), "{text}");
    let after = browser.eval(&format!("new Date({left}).toISOString()"));
    let frozen = |line: &&str| line.split(',').next() > after.as_str() && line.ends_with(",1");
    assert_eq!(text.lines().skip(1).filter(frozen).count(), 0, "{after}: {text}");
    // welder has no selection of this page
    browser.eval("(() => { const robots = document.getElementById('robots'); robots.value = '1'; robots.onchange({ target: robots }); })()");
    browser.until_text(".legend", "J1");
    std::thread::sleep(std::time::Duration::from_millis(700));
    let text = csv(&mut browser);
    assert!(!text.contains("I1"), "{text}");
    assert_eq!(browser.problems, [""; 0]);
}

/// Answers that arrive after the page has turned to another robot are not drawn there.
#[test]
fn an_answer_for_one_robot_is_not_drawn_under_another_one() {
    let (sim, other) = (Sim::start(), Sim::start());
    sim.lock().inject_error(HResult::from_u32(0x8350_0178), bcap_std::now());
    let web = Web::start(&[("press", sim.address()), ("welder", other.address())], false);
    let Some(mut browser) = Browser::start() else { return };
    browser.keep_sockets();
    browser.open(web.url());
    browser.until_text("#state", "error");
    // answers are held until `free()`
    browser.eval(
        "(() => { const socket = sockets.at(-1); const take = socket.onmessage; window.held = []; window.holds = false;
            socket.onmessage = (event) => { if (holds && JSON.parse(event.data).t === 'answer') held.push(event); else take(event); };
            window.free = () => { holds = false; held.splice(0).forEach((event) => take(event)); };
            window.turn = (robot) => { const robots = document.getElementById('robots'); robots.value = robot; robots.onchange({ target: robots }); }; })()",
    );
    for (screen, button, drawn) in [("alarms", "#log", ".log td"), ("raw", "#call", ".reply > *")] {
        browser.click(&format!("[data-id={screen}]"));
        browser.click(button);
        browser.until(&format!("document.querySelector('{drawn}') !== null"));
        browser.eval("turn(1); 0");
        browser.until(&format!("document.querySelector('{drawn}') === null"));
        browser.eval("turn(0); holds = true");
        browser.click(button);
        browser.until("held.length > 1");
        browser.eval("turn(1); 0");
        browser.until("held.length > 2");
        browser.eval("free()");
        std::thread::sleep(std::time::Duration::from_millis(300));
        assert_eq!(
            browser.eval(&format!("document.querySelector('{drawn}')?.textContent")),
            serde_json::Value::Null,
            "{screen}"
        );
        browser.eval("turn(0); 0");
    }
    assert_eq!(browser.problems, [""; 0]);
}

/// Evaluates whether a jog is ready, or was refused.
pub(crate) const IS_BEGUN: &str = "/ready:/.test(document.getElementById('jog-phase').textContent) || /no jog:/.test(document.getElementById('notice').textContent)";

/// A button is held by the mouse and by a key; after a lift the robot does not move. A hidden tab, a lost focus and a second
/// finger end the jog.
#[test]
fn a_button_is_held_and_what_takes_the_page_away_ends_the_jog() {
    let sim = Sim::start();
    let web = Web::moving(&[("press", sim.address())]);
    let Some(mut browser) = opened(&web) else { return };
    browser.enter("#name", "Anna");
    browser.until_text("#control", "control: Anna (this page)");
    browser.click("[data-id=jog]");
    let begin = |browser: &mut Browser| {
        sim.lock().clear_errors(bcap_std::now());
        browser.until_text("#state", "ready, motor off");
        browser.click("#jog-begin");
        browser.until_text("#question-robot", "press (tcp:");
        assert!(sim.lock().arm_owner().is_none(), "before the answer nothing is taken");
        browser.eval("document.getElementById('notice').textContent = ''");
        let ended = web.ended_jogs();
        browser.click("#question-yes");
        // the page may miss a short jog
        until("the jog is ready, or has ended", || web.ended_jogs() > ended || browser.eval(IS_BEGUN) == true);
    };
    let rests = || sim.until("it rests, and the arm is free", |sim| !sim.is_moving() && sim.arm_owner().is_none());
    let ends = [
        "dispatchEvent(new Event('blur'))",
        "Object.defineProperty(document, 'hidden', { value: true, configurable: true }); document.dispatchEvent(new Event('visibilitychange')); delete document.hidden",
        "document.body.dispatchEvent(new PointerEvent('pointerdown', { pointerId: 7, bubbles: true }))",
        "document.querySelector('[data-id=cell]').click(); document.querySelector('[data-id=jog]').click()",
    ];
    let (mut moved, last) = (0, Instant::now() + Duration::from_secs(180));
    // each end once, and again until an attempt has moved the robot
    for (n, end) in ends.iter().cycle().enumerate() {
        if n >= ends.len() && (moved > 0 || Instant::now() > last) {
            break;
        }
        begin(&mut browser);
        // a busy machine may lose the heartbeat, which is not a fault of the page
        let button = ".axis:nth-child(1) button:nth-of-type(2)";
        if browser.eval(&format!("document.querySelector('{button}')?.disabled")) != false {
            continue;
        }
        let before = sim.lock().axes();
        browser.press(button);
        until("the robot moves, or the jog has ended", || {
            sim.lock().axes() != before || sim.lock().arm_owner().is_none()
        });
        moved += usize::from(sim.lock().axes() != before);
        browser.eval(&format!("{end}; 0"));
        rests();
        browser.lift();
    }
    assert!(moved > 0, "each attempt has lost its heartbeat");
    assert_eq!(browser.problems, [""; 0]);
}

/// The contrast of each visible text to what is behind it, as WCAG 2 defines it; and that the page has names and an order for a
/// keyboard. Returns what is wrong.
const AUDIT: &str = include_str!("audit.js");

#[test]
fn each_screen_is_legible_and_works_with_a_keyboard() {
    let sim = Sim::start();
    for code in [0x8350_0076, 0x8350_0178] {
        sim.lock().inject_error(HResult::from_u32(code), bcap_std::now());
    }
    let folder = tempfile::tempdir().unwrap();
    let recordings = bcap_web::Recordings { folder: folder.path().to_owned(), limit: 1_000_000_000 };
    let web = Web::with(&|config| config.recordings = Some(recordings.clone()), &[("press", sim.address())], true);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(web.url());
    browser.until_text("#state", "error");
    browser.key("Tab");
    assert_eq!(browser.eval("document.activeElement.id"), "halt", "HALT is the first");
    browser.enter("#name", "Anna");
    for screen in ["cell", "variables", "alarms", "arm", "tasks", "jog", "plots", "packets", "raw", "backup", "session"]
    {
        browser.click(&format!("[data-id={screen}]"));
        browser.until("document.querySelector('.tile, .spark polyline, .errors li, .joints circle, .axis, #task, .choices input, .packets td, #usage:not(:empty), #backup-name, #audit li') !== null");
        // the bytes of a packet are legible, as well
        let opens = match screen {
            "packets" => Some(".packets .serial"),
            "raw" => Some("#call"),
            _ => None,
        };
        if let Some(selector) = opens {
            browser.click(selector);
            browser.click(".packet .field:nth-child(3)");
            browser.eval("scrollTo(0, 0)");
        }
        if screen == "session" {
            browser.click("#record");
            browser.until_text("#recording li", "● press: records 2");
            browser.until("document.querySelectorAll('#recordings tr').length === 1");
        }
        look(&mut browser, screen);
    }
    // the panel is a screen of a virtual controller only
    let cell = crate::panel::Cell::start();
    browser.open(cell.web.url());
    browser.click("[data-id=panel]");
    browser.until("document.getElementById('scenario') !== null");
    look(&mut browser, "panel");
    assert_eq!(browser.problems, [""; 0]);
}

/// Audits a screen in both sizes and themes, and saves its pictures if they are wanted.
fn look(browser: &mut Browser, screen: &str) {
    let folder = std::env::var_os("BCAP_WEB_PICTURES");
    for scheme in ["light", "dark"] {
        for size in [(1280, 800), (768, 1024)] {
            browser.look(size, scheme);
            assert_eq!(browser.eval(AUDIT), serde_json::json!([]), "{screen} {scheme} {size:?}");
            if let Some(folder) = &folder {
                let name = format!("web-{screen}-{}x{}-{scheme}.webp", size.0, size.1);
                save(&Path::new(folder).join(name), &browser.picture());
            }
        }
    }
}

/// Writes base64 to a file.
fn save(path: &Path, base64: &str) {
    let text = path.with_extension("base64");
    std::fs::write(&text, base64).unwrap();
    let decoded = Command::new("base64").arg("-d").arg(&text).output().unwrap();
    std::fs::write(path, decoded.stdout).unwrap();
    std::fs::remove_file(text).unwrap();
}
