//! Generates sessions from a seed, runs them, and reduces, confirms and saves findings.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use arbitrary::Unstructured;

use super::device::Device;
use super::finding::{Finding, Kind};
use super::minimise::minimise;
use super::save::Files;
use super::{Error, Record};
use crate::generate;
use crate::grammar::Grammar;
use crate::network::Random;
use crate::step::Step;

/// The number of random bytes for a session; more than any session needs.
const ENTROPY: usize = 1 << 14;
/// One session in this number opens and releases one object again and again.
const OPENINGS: u64 = 16;
/// The maximum number of runs to reduce a finding, and the maximum time.
const RUNS: u32 = 200;
const TIME: Duration = Duration::from_secs(60);
/// The wait between two checks for a device that restarts.
const LOOK: Duration = Duration::from_millis(50);

/// A finding that is reduced and saved.
#[derive(Debug)]
pub struct Saved {
    /// The finding.
    pub finding: Finding,
    /// The number of the session that found it, from 0 on.
    pub session: u64,
    /// The time since the start.
    pub after: Duration,
    /// The number of remaining steps.
    pub steps: usize,
    /// Whether it occurred again when the same steps were repeated.
    pub is_repeatable: bool,
    /// Its files.
    pub files: Files,
}

/// The limits of a run.
#[derive(Debug)]
pub struct Plan {
    /// Chooses the sessions.
    pub seed: u64,
    /// The permitted requests of sessions.
    pub grammar: Grammar,
    /// When the run ends.
    pub until: Instant,
    /// The maximum number of sessions.
    pub sessions: u64,
    /// The maximum number of different findings.
    pub findings: u64,
    /// The time limit for a restart of a device that does not answer after a finding.
    pub wait: Duration,
    /// The folder for findings.
    pub out: PathBuf,
}

/// Fuzzes until a limit; calls `each` with every finding. Returns the number of sessions, and whether the device still answers.
///
/// # Errors
///
/// When the run is ended, or a file cannot be written; errors of `each`. If the run is ended while a finding is being reduced,
/// the steps reduced until then are saved, and `each` gets the finding first.
pub fn fuzz<E: From<Error>>(
    device: &mut Device<'_>,
    plan: &Plan,
    record: Record<'_>,
    mut each: impl FnMut(&Saved) -> Result<(), E>,
) -> Result<(u64, bool), E> {
    let began = Instant::now();
    let mut found: Vec<Finding> = Vec::new();
    let mut sessions = 0;
    while sessions < plan.sessions && Instant::now() < plan.until {
        let session = sessions;
        sessions += 1;
        let steps = steps(plan, session, device.has_rac());
        let Some(finding) = device.run(&steps, None)? else { continue };
        // the end of the run does not lose the finding
        let recovered = match recover(device, plan.wait) {
            Err(Error::Ended) => None,
            recovered => Some(recovered?),
        };
        if found.iter().any(|known| known.is_same(&finding)) && recovered != Some(false) {
            continue;
        }
        let (after, answers) = (began.elapsed(), recovered == Some(true));
        let saved = keep(device, plan, record, Found { finding, session, after, steps, answers }, found.len() + 1)?;
        each(&saved)?;
        found.push(saved.finding);
        let answers = recover(device, plan.wait)?;
        if !answers || found.len() as u64 >= plan.findings {
            return Ok((sessions, answers));
        }
    }
    Ok((sessions, true))
}

/// Generates the steps of a session; they depend only on the seed and its number.
fn steps(plan: &Plan, session: u64, has_rac: bool) -> Vec<Step> {
    let mut random = Random(plan.seed);
    let bytes = generate::bytes(random.number() ^ session.wrapping_mul(0x9e37_79b9_7f4a_7c15), ENTROPY);
    let mut u = Unstructured::new(&bytes);
    let kind = u.int_in_range(0..=OPENINGS - 1);
    let steps = match kind {
        Ok(0) => plan.grammar.openings(&mut u),
        Ok(1..=3) if has_rac => (0..8).map(|_| plan.grammar.line(&mut u).map(Step::Line)).collect(),
        _ => plan.grammar.session(&mut u),
    };
    // the bytes always suffice, because an empty `Unstructured` gives zeros
    steps.unwrap_or_default()
}

/// Waits until the device answers again, and starts it once if possible; returns whether it answers.
fn recover(device: &mut Device<'_>, limit: Duration) -> Result<bool, Error> {
    let mut until = Instant::now() + limit;
    let mut may_start = true;
    loop {
        let Some(found) = device.probe(None)? else { return Ok(true) };
        let is_over = Instant::now() >= until;
        // a device that accepts connections may still recover by itself
        let starts = may_start && (is_over || found.kind == Kind::Crash);
        may_start &= !starts;
        if starts && device.restarter.as_mut().is_some_and(|restarter| restarter.run().unwrap_or(false)) {
            until = Instant::now() + limit;
        } else if is_over {
            return Ok(false);
        }
        device.sleep(LOOK)?;
    }
}

/// The finding of a session.
struct Found {
    finding: Finding,
    session: u64,
    after: Duration,
    steps: Vec<Step>,
    /// Whether the device answers new clients afterwards.
    answers: bool,
}

/// Reduces a finding and saves it.
fn keep(device: &mut Device<'_>, plan: &Plan, record: Record<'_>, found: Found, number: usize) -> Result<Saved, Error> {
    let Found { finding, session, after, steps, answers } = found;
    let files = Files::new(&plan.out, number, &finding)?;
    let mut remarks = vec![
        format!("bcap fuzz, seed {}, session {session}: {finding}", plan.seed),
        "run it again: bcap fuzz --robot ADDR --again FILE --yes-this-device-is-mine".into(),
    ];
    // first of all, because the device may not recover
    files.write_steps(&steps, &remarks)?;
    let mut saved = Saved { finding, session, after, steps: steps.len(), is_repeatable: false, files };
    if !answers {
        return Ok(saved);
    }
    let until = Instant::now() + TIME;
    let (mut runs, finding) = (0, saved.finding.clone());
    let mut fails = |steps: &[Step]| {
        runs += 1;
        if runs > RUNS || Instant::now() >= until {
            return Ok(None);
        }
        let found = device.run(steps, None)?;
        let answers = recover(device, plan.wait)?;
        Ok(answers.then(|| found.is_some_and(|found| found.is_same(&finding))))
    };
    let steps = match fails(&steps) {
        Ok(Some(true)) => {
            saved.is_repeatable = true;
            minimise(steps, fails)
        }
        Ok(Some(false)) => {
            remarks.push("the steps did not fail again, so it depends on an earlier session or on timing".into());
            steps
        }
        Ok(None) => {
            remarks.push("the steps were run again, and the device did not come back".into());
            steps
        }
        Err(Error::Ended) => steps,
        Err(error) => return Err(error),
    };
    let is_ended = device.is_ended();
    if is_ended {
        remarks.push("the run was ended before the steps were reduced and captured".into());
    }
    saved.steps = steps.len();
    saved.files.write_steps(&steps, &remarks)?;
    if is_ended {
        return Ok(saved);
    }
    let not_written = |error| Error::File(saved.files.capture.clone(), error);
    let recording = record(&saved.files.capture).map_err(not_written)?;
    let last = device.run(&steps, Some(recording.recorder()));
    recording.finish().map_err(not_written)?;
    match last {
        Ok(Some(last)) if last.is_same(&saved.finding) => saved.finding = last,
        // the end of the run ends the capture early
        Ok(_) | Err(Error::Ended) => {}
        Err(error) => return Err(error),
    }
    Ok(saved)
}

#[cfg(test)]
mod tests {
    use std::net::{SocketAddr, TcpListener};
    use std::path::Path;
    use std::{env, fs, io, process, thread};

    use bcap_core::bcap::FunctionId;

    use super::*;
    use crate::frame::TestFrame;
    use crate::fuzz::{Gate, Recording, read};
    use crate::judge::TCP;
    use crate::wire::{Link, Received, Wire};

    const LIMIT: Duration = Duration::from_secs(10);

    /// Serves Service_Start and Service_Stop to one client at a time. Closes the connection at any other packet.
    fn serve() -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        thread::spawn(move || {
            for client in listener.incoming() {
                let mut wire = Wire::of_stream(client.unwrap(), LIMIT).unwrap();
                while let Received::Packet(bytes) = wire.receive(LIMIT) {
                    let Some(request) = TCP.decode_packet(&bytes) else { break };
                    if ![FunctionId::SERVICE_START, FunctionId::SERVICE_STOP].contains(&FunctionId(request.code)) {
                        break;
                    }
                    let reply = TestFrame { serial: request.serial, reserved: 0, code: 0, args: vec![] };
                    if wire.send(&reply.to_wire(false)).is_err() {
                        break;
                    }
                }
            }
        });
        address
    }

    #[test]
    fn a_finding_is_saved_and_reported_when_the_run_is_ended() {
        let out = env::temp_dir().join(format!("bcap-fuzz-ended-{}", process::id()));
        let _ = fs::remove_dir_all(&out);
        // as soon as the finding has a file, before its steps are run again
        let is_ended = || fs::read_dir(&out).is_ok_and(|mut files| files.next().is_some());
        let gate = Gate::new(Vec::new(), false);
        let mut device = Device::new(vec![serve()], Link::Tcp, gate, LIMIT, &is_ended);
        let plan = Plan {
            seed: 1,
            grammar: Grammar::reading(),
            until: Instant::now() + Duration::from_secs(600),
            sessions: 400,
            findings: 1,
            wait: LIMIT,
            out: out.clone(),
        };
        let mut record =
            |_: &Path| -> io::Result<Box<dyn Recording>> { Err(io::Error::other("nothing is captured after the end")) };
        let mut reported = Vec::new();
        let result = fuzz(&mut device, &plan, &mut record, |saved| {
            reported.push((saved.finding.kind, saved.is_repeatable, saved.steps, saved.files.steps.clone()));
            Ok::<_, Error>(())
        });
        assert!(matches!(result, Err(Error::Ended)), "{result:?}");
        let [(kind, is_repeatable, count, file)] = &reported[..] else { panic!("{reported:?}") };
        assert_eq!((*kind, *is_repeatable), (Kind::Reset, false));
        let steps = read(file).unwrap();
        assert_eq!(steps.len(), *count);
        assert!(fs::read_to_string(file).unwrap().contains("# the run was ended before"));
        fs::remove_dir_all(&out).unwrap();
    }
}
