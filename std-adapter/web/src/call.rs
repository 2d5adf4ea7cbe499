//! The right of a page to make a call of any function.

use std::sync::Arc;

use bcap_core::bcap::Effect;
use bcap_live::request::Request;
use serde_json::Value;

use crate::raw::Desk;
use crate::socket::Page;

impl Page {
    /// Makes a call of the user, if its effect is allowed. `name` is the robot's name in the question.
    pub(crate) async fn call(&mut self, number: usize, name: &str, request: Request) -> Result<Value, String> {
        let who = match request.effect() {
            Effect::Session | Effect::Reads => None,
            Effect::Writes => Some(self.writer(number)?),
            _ => Some(self.mover(number)?),
        };
        let robot = if who.is_some() { self.named(number, name)? } else { self.robot(number)? };
        if self.desk.as_ref().is_some_and(|desk| desk.number != number)
            && let Some(desk) = self.desk.take()
        {
            desk.end(&self.app);
        }
        let desk = Arc::clone(self.desk.get_or_insert_with(|| Arc::new(Desk::new(number, Arc::clone(&robot)))));
        let what = format!("calls {request}");
        let made = tokio::task::spawn_blocking(move || desk.make(&request)).await;
        let made = made.unwrap_or_else(|_| Err("the call panicked; it is unknown whether it was done".into()));
        if let Some(who) = who {
            let outcome = match &made {
                Ok((code, _)) if code.is_err() => Err(code.to_string()),
                made => made.as_ref().map(drop).map_err(Clone::clone),
            };
            self.app.audit.write(&who, &robot.name, &what, &outcome);
        }
        made.map(|(_, reply)| reply)
    }
}
