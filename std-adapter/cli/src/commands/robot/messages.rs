//! `bcap errors --follow`: the messages of the controller. While a stream of Slave Mode runs, nothing is sent that would end it.

use std::time::{Duration, Instant};

use bcap_live::messages::{Message, next_message};

use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;
use crate::session::slave_mode::StreamCheck;

/// Prints the messages of the controller as they arrive, until a signal or the end of the time.
pub(crate) fn follow(time: Option<Duration>, session: &mut Session, json: bool) -> Result<(), Failure> {
    const INTERVAL: Duration = Duration::from_millis(50);
    let mut check = StreamCheck::default();
    let interrupt = session.handle_signals()?;
    let began = Instant::now();
    loop {
        session.restart_budget();
        fetch(session, &mut check, json)?;
        let left = time.map_or(INTERVAL, |time| time.saturating_sub(began.elapsed()));
        if left.is_zero() || interrupt.sleep(INTERVAL.min(left)).is_err() {
            return Ok(());
        }
    }
}

/// Prints the messages that the controller has.
fn fetch(session: &mut Session, check: &mut StreamCheck, json: bool) -> Result<(), Failure> {
    while let Some(message) = next_message(session, check)? {
        let Message { number, source, time, text } = &message;
        let object = serde_json::json!({ "number": number, "source": source, "time": time, "text": text });
        print_result(json, &object, &message.to_string())?;
    }
    Ok(())
}
