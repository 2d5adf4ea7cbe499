//! Opens, reads and writes variables: user variables, and the system variables of controller, robot and tasks.

use bcap_core::bcap::server::Request;
use bcap_core::bcap::{FunctionId, Object};
use bcap_core::handler::PeerId;
use bcap_core::hresult::HResult;
use bcap_core::variant::Variant;

use super::{Controller, system};
use crate::answer::{Answer, Answered};
use crate::arm;
use crate::objects::{DefinitionKind, Item, OpenObject, Parent, VariableRef};
use crate::table::Property;
use crate::tasks;
use crate::value::{ValueResult, numbers_of_array, owned};
use crate::variables::{self, Family, parse_name};

impl Controller {
    /// Opens a variable of an object by its name.
    pub(super) fn open_variable(&mut self, peer: PeerId, owner: Parent, name: &str) -> Answered {
        let target = match (find_variable(owner, name), parse_name(name), owner) {
            (Some(n), _, _) => VariableRef::System(owner, n),
            (None, Some((family, Some(index))), Parent::Controller) => {
                self.shared.variables.check(family, index)?;
                VariableRef::User(family, index)
            }
            (None, Some((family, None)), Parent::Controller) => VariableRef::Wildcard(family, None),
            (None, _, Parent::Robot) => {
                let (kind, number) = DefinitionKind::parse(name).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)?;
                number.map_or(Ok(()), |number| self.arm.numbers(kind, number).map(drop))?;
                VariableRef::Definition(kind, number)
            }
            _ => return Err(HResult::E_CAO_OBJECT_NOTFOUND),
        };
        self.open(peer, Item::Variable(target), name.trim().to_owned())
    }

    pub(super) fn call_variable(&mut self, peer: PeerId, target: VariableRef, request: &Request<'_>) -> Answered {
        let stamp = self.objects.get(peer, request.handle(), Object::Variable)?.stamp;
        let config = &self.shared.config;
        match request.function {
            FunctionId::VARIABLE_GET_VALUE => self.get(peer, target).map(Answer::Value),
            FunctionId::VARIABLE_PUT_VALUE => self.put(peer, target, &request.value(1)),
            FunctionId::VARIABLE_GET_DATE_TIME => Answer::of(config.date(stamp)?),
            FunctionId::VARIABLE_GET_MICROSECOND => Answer::of(config.microsecond(stamp)),
            _ => Err(HResult::E_NOTIMPL),
        }
    }

    fn get(&mut self, peer: PeerId, target: VariableRef) -> ValueResult {
        match target {
            VariableRef::User(family, n) => self.shared.variables.get(family, n),
            VariableRef::Wildcard(family, n) => self.shared.variables.get(family, n.unwrap_or(0)),
            VariableRef::Crc(crc) => owned(crc),
            VariableRef::Definition(kind, number) => self.arm.numbers(kind, number.unwrap_or(0)),
            VariableRef::System(Parent::Controller, n) => property(system::VARIABLES, n)?.getter()?(self),
            VariableRef::System(Parent::Robot, n) => {
                property(arm::robot_variables::VARIABLES, n)?.getter()?(&self.arm, &self.shared.context(peer))
            }
            VariableRef::System(Parent::Task(task), n) => {
                property(tasks::VARIABLES, n)?.getter()?(self.tasks.get(task)?)
            }
        }
    }

    fn put(&mut self, peer: PeerId, target: VariableRef, value: &Variant<'_>) -> Answered {
        let (owner, n) = match target {
            VariableRef::User(family, n) => return self.put_user(peer, family, n, value).map(|()| Answer::Done),
            VariableRef::Wildcard(family, n) => {
                return self.put_user(peer, family, n.unwrap_or(0), value).map(|()| Answer::Done);
            }
            VariableRef::Definition(kind, number) => {
                let mut ctx = self.shared.context(peer);
                ctx.may_write()?;
                return self.arm.put_numbers(&mut ctx, kind, number.unwrap_or(0), &numbers_of_array(value)?);
            }
            VariableRef::Crc(_) => return Err(HResult::E_CAO_NOT_WRITABLE),
            VariableRef::System(owner, n) => (owner, n),
        };
        let mut ctx = self.shared.context(peer);
        ctx.may_write()?;
        match owner {
            Parent::Controller => property(system::VARIABLES, n)?.setter()?(self, peer, value),
            Parent::Robot => property(arm::robot_variables::VARIABLES, n)?.setter()?(&mut self.arm, &mut ctx, value),
            Parent::Task(task) => {
                let answered = property(tasks::VARIABLES, n)?.setter()?(self.tasks.get_mut(task)?, &mut ctx, value);
                self.free_arm_of_tasks();
                answered
            }
        }
    }

    pub(super) fn put_user(
        &mut self,
        peer: PeerId,
        family: Family,
        n: u32,
        value: &Variant<'_>,
    ) -> Result<(), HResult> {
        let ctx = self.shared.context(peer);
        ctx.may_write()?;
        ctx.variables.put(family, n, value)
    }
}

/// Describes the values that Variable_PutValue accepts.
pub(super) fn accepted_value(entry: &OpenObject) -> Option<&'static str> {
    match entry.item {
        Item::Variable(VariableRef::User(family, _) | VariableRef::Wildcard(family, _)) => {
            Some(variables::accepted(family))
        }
        Item::Variable(VariableRef::Definition(..)) => {
            Some("an array of 6 numbers of a tool, 6 or 7 of a work, 11 to 34 of an area")
        }
        Item::Variable(VariableRef::System(owner, n)) => match owner {
            Parent::Controller => system::VARIABLES.get(n)?.accepts,
            Parent::Robot => arm::robot_variables::VARIABLES.get(n)?.accepts,
            Parent::Task(_) => tasks::VARIABLES.get(n)?.accepts,
        },
        _ => None,
    }
}

/// Returns the entry of a system variable in the table of its owner.
fn property<G, P>(table: &'static [Property<G, P>], n: usize) -> Result<&'static Property<G, P>, HResult> {
    table.get(n).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)
}

/// Finds a system variable in the table of its owner.
fn find_variable(owner: Parent, name: &str) -> Option<usize> {
    match owner {
        Parent::Controller => Property::position(system::VARIABLES, name),
        Parent::Robot => Property::position(arm::robot_variables::VARIABLES, name),
        Parent::Task(_) => Property::position(tasks::VARIABLES, name),
    }
}

/// Returns the names of the system variables of an owner.
pub(super) fn names_of(owner: Parent) -> Vec<&'static str> {
    match owner {
        Parent::Controller => system::VARIABLES.iter().map(|property| property.name).collect(),
        Parent::Robot => {
            let definitions = ["Tool*", "Work*", "Area*"];
            arm::robot_variables::VARIABLES.iter().map(|property| property.name).chain(definitions).collect()
        }
        Parent::Task(_) => tasks::VARIABLES.iter().map(|property| property.name).collect(),
    }
}
