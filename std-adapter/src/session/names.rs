//! The names of variables: one rule for all reads, writes, scans and subscriptions.

use std::borrow::Cow;
use std::io;

use bcap_core::bcap::Object;
use bcap_core::io::asynch::Transport;
use bcap_core::procedure::PathStep;

use super::Session;
use crate::error::Error;
use crate::path::ObjectPath;

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Returns the object that has a variable, its handle, and the name of the variable there.
    ///
    /// A variable of the controller is named by a path: `I1`, `robot/@SERVO_ON`, `task:Pro1/@STATUS`. The objects on the way
    /// are opened when they are first used. For a variable of the robot `name` is the name itself.
    pub(super) async fn owner_of<'n>(
        &mut self,
        owner: Object,
        name: &'n str,
    ) -> Result<(Object, i32, Cow<'n, str>), Error> {
        if owner == Object::Robot {
            return Ok((owner, self.robot().await?.0, name.into()));
        }
        let mut owner = (Object::Controller, self.handle.0);
        if !name.contains('/') {
            return Ok((owner.0, owner.1, name.into()));
        }
        let path = ObjectPath::variable(name)?;
        let steps = path.steps();
        let (variable, objects) = steps.split_last().map_or((name, &[][..]), |(last, objects)| {
            // the path of a variable ends with its name
            (last.name.unwrap_or_default(), objects)
        });
        for step in objects {
            owner = (step.object, self.owner(owner, *step).await?);
        }
        Ok((owner.0, owner.1, variable.to_owned().into()))
    }

    /// Returns the handle of an object that has variables. The robot of the settings is opened only once: releasing a second
    /// handle of it could give the arm back.
    async fn owner(&mut self, owner: (Object, i32), step: PathStep<'_>) -> Result<i32, Error> {
        match (step.object, step.name) {
            (Object::Robot, name) if name.is_none() || name == self.robot_name.as_deref() => {
                self.robot().await.map(|robot| robot.0)
            }
            _ => self.object_of(owner, step).await,
        }
    }
}
