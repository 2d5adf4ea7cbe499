//! `bcap errors --follow`: the messages of the controller. While a stream of Slave Mode runs, nothing is sent that would end it.

use std::time::Duration;

use bcap_live::messages::{Message, next_message};

use crate::failure::Failure;
use crate::output::print_result;
use crate::session::Session;
use bcap_live::stream::StreamCheck;

/// Prints the messages of the controller as they arrive, until a signal or the end of the time.
pub(crate) fn follow(time: Option<Duration>, session: &mut Session, json: bool) -> Result<(), Failure> {
    let mut check = StreamCheck::default();
    session.repeat(Duration::from_millis(50), time, |session| fetch(session, &mut check, json))
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
