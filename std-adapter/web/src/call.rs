//! The right of a page to make a call of any function.

use std::sync::Arc;

use bcap_core::bcap::Effect;
use bcap_live::request::Request;

use crate::order::{Agreed, Screen};
use crate::raw::Desk;
use crate::socket::{Answer, Page};
use crate::threads::lock;

impl Page {
    /// Makes a call of the user, if its effect is allowed.
    pub(crate) async fn call(&self, agreed: Agreed, request: Request) -> Answer {
        let Agreed { robot: number, name, revoked, repeats } = agreed;
        if !self.shows(Screen::Raw, number) {
            return Err("the screen was left; nothing was done".into());
        }
        let user = match request.effect() {
            Effect::Session | Effect::Reads => None,
            Effect::Writes => Some(self.writer(number)?),
            _ => Some(self.mover(number)?),
        };
        let robot = self.robot(number)?;
        if user.is_some() {
            robot.check_name(&name)?;
        }
        if repeats && request.effect() == Effect::Moves {
            return Err("a call that can move the robot is not repeated; nothing was done".into());
        }
        let desk = {
            let mut motions = lock(&self.motions);
            if let Some(other) = motions.desk.take_if(|desk| desk.number != number) {
                other.end(&self.app);
            }
            Arc::clone(motions.desk.get_or_insert_with(|| Arc::new(Desk::new(number, Arc::clone(&robot)))))
        };
        let (app, mut permit) = (Arc::clone(&self.app), robot.permit_since(revoked));
        // on a thread that continues when the page is closed, so that the call is written to the audit log
        let made = self.app.work.spawn_blocking(move || {
            let made = desk.make(&request, &mut permit);
            drop(permit);
            if let Some((who, _)) = user {
                let outcome = match &made {
                    Ok((code, _)) if code.is_err() => Err(code.to_string()),
                    made => made.as_ref().map(drop).map_err(Clone::clone),
                };
                app.audit.write(&who, &robot.name, &format!("calls {request}"), &outcome);
            }
            made
        });
        let made = made.await.unwrap_or_else(|_| Err("the call panicked; it is unknown whether it was done".into()));
        made.map(|(_, reply)| reply)
    }
}
