//! The right of a page to make a call of any function.

use std::sync::Arc;

use bcap_core::bcap::Effect;
use bcap_live::request::Request;

use crate::raw::Desk;
use crate::socket::{Answer, Page};

impl Page {
    /// Makes a call of the user, if its effect is allowed. `name` is the robot's name in the question.
    pub(crate) async fn call(&mut self, number: usize, name: &str, request: Request) -> Answer {
        let user = match request.effect() {
            Effect::Session | Effect::Reads => None,
            Effect::Writes => Some(self.writer(number)?),
            _ => Some(self.mover(number)?),
        };
        let robot = self.robot(number)?;
        if user.is_some() {
            robot.check_name(name)?;
        }
        if let Some(other) = self.desk.take_if(|desk| desk.number != number) {
            other.end(&self.app);
        }
        let desk = Arc::clone(self.desk.get_or_insert_with(|| Arc::new(Desk::new(number, Arc::clone(&robot)))));
        let what = format!("calls {request}");
        let made = tokio::task::spawn_blocking(move || desk.make(&request)).await;
        let made = made.unwrap_or_else(|_| Err("the call panicked; it is unknown whether it was done".into()));
        if let Some((who, _)) = user {
            let outcome = match &made {
                Ok((code, _)) if code.is_err() => Err(code.to_string()),
                made => made.as_ref().map(drop).map_err(Clone::clone),
            };
            self.app.audit.write(&who, &robot.name, &what, &outcome);
        }
        made.map(|(_, reply)| reply)
    }
}
