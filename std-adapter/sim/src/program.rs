//! The programs of tasks: lists of steps, which a [scenario](crate::scenario) defines.

use std::sync::Arc;
use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::variant::{Array, Element, FromVariant, OwnedVariant, VarType, Variant};

use crate::value::{ValueResult, number, numbers_of_array, one_int, owned, truth, whole};
use crate::variables::{Family, Variables, parse_name};

/// The program of a task. After its last step it begins again, or ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// The name of the task.
    pub name: String,
    /// The steps, each of which is a line.
    pub steps: Arc<[Step]>,
    /// Minimum time that each step takes, at least 1 ms.
    pub line: Duration,
    /// The mode of Task_Start in which it starts with the scenario; `None` waits for a client.
    pub start: Option<i32>,
    /// The public variables, at the beginning.
    pub public: PublicValues,
}

/// The public variables of a program, for GetPublicValue and SetPublicValue of the controller.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PublicValues(Vec<(String, OwnedVariant)>);

impl PublicValues {
    pub(crate) const fn new(list: Vec<(String, OwnedVariant)>) -> Self {
        Self(list)
    }

    fn place(&self, name: &str) -> Result<usize, HResult> {
        self.0.iter().position(|(known, _)| known.eq_ignore_ascii_case(name)).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)
    }

    /// Returns a variable, or an element of an array.
    pub(crate) fn get(&self, name: &str, index: Option<usize>) -> ValueResult {
        let value = &self.0[self.place(name)?].1;
        match (value.as_variant(), index) {
            (_, None) => Ok(value.clone()),
            // a pose is one value
            (Variant::Array(array), Some(n)) if array.element() != VarType::R4 => {
                array.get(n).map(OwnedVariant::from).ok_or(HResult::DISP_E_BADINDEX)
            }
            (_, Some(_)) => Err(HResult::E_INVALIDARG),
        }
    }

    /// Writes a variable, or an element of an array; type and count stay.
    pub(crate) fn put(&mut self, name: &str, index: Option<usize>, given: &Variant<'_>) -> Result<(), HResult> {
        let place = self.place(name)?;
        let present = &mut self.0[place].1;
        *present = match (present.as_variant(), index) {
            (Variant::Array(array), Some(n)) => match array.element() {
                VarType::I4 => with_element(array, n, one_int(given)?),
                VarType::R8 => with_element(array, n, one(given)?),
                VarType::BSTR => with_element(array, n, text(given)?),
                _ => Err(HResult::E_INVALIDARG),
            },
            (_, Some(_)) => Err(HResult::E_INVALIDARG),
            (Variant::I4(_), None) => owned(one_int(given)?),
            (Variant::R8(_), None) => owned(one(given)?),
            (Variant::Bool(_), None) => owned(truth(given)?),
            (Variant::Bstr(_), None) => owned(text(given)?),
            (Variant::Array(array), None) if array.element() != VarType::BSTR => {
                let numbers = numbers_of_array(given)?;
                if numbers.len() != array.len() {
                    return Err(HResult::E_INVALIDARG);
                }
                match array.element() {
                    VarType::I4 => {
                        let whole: Result<Vec<_>, _> = numbers.into_iter().map(whole).collect();
                        owned(whole.map_err(|_| HResult::E_INVALIDARG)?)
                    }
                    VarType::R4 => owned(numbers.into_iter().map(|number| number as f32).collect::<Vec<_>>()),
                    _ => owned(numbers),
                }
            }
            _ => Err(HResult::E_INVALIDARG),
        }?;
        Ok(())
    }
}

/// Copies an array with another value of an element.
fn with_element<'a, T: FromVariant<'a> + Element>(array: Array<'a>, n: usize, element: T) -> ValueResult {
    let mut items: Vec<T> = Variant::Array(array).convert().map_err(|_| HResult::E_INVALIDARGTYPE)?;
    *items.get_mut(n).ok_or(HResult::DISP_E_BADINDEX)? = element;
    owned(items)
}

fn one(given: &Variant<'_>) -> Result<f64, HResult> {
    number(&given.flatten()).ok_or(HResult::E_INVALIDARGTYPE)
}

fn text(value: &Variant<'_>) -> Result<String, HResult> {
    match value.flatten() {
        Variant::Bstr(text) => Ok(text.to_string()),
        _ => Err(HResult::E_INVALIDARGTYPE),
    }
}

/// A step of a program.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Writes variables.
    Set(Vec<Assignment>),
    /// Adds to variables I, F and D.
    Add(Vec<Assignment>),
    /// Waits for this time.
    Wait(Duration),
    /// Waits until all variables have these values.
    WaitFor(Vec<Assignment>),
    /// Moves the arm, as Robot_Move does, and waits for the end of the motion.
    Move {
        /// 1 joints, 2 line, 3 arc.
        interpolation: i32,
        /// As text: `"@E J(0,45,90,0,45,0)"`.
        pose: String,
        /// As for Robot_Move.
        option: String,
    },
    /// Raises an error of the controller.
    Error(HResult),
    /// Posts a message to the clients.
    Message(String),
}

/// A variable, and a value for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Assignment {
    family: Family,
    index: u32,
    value: Constant,
}

/// A value in a program.
#[derive(Clone, Debug, PartialEq)]
pub enum Constant {
    /// For IO.
    Bool(bool),
    /// For I, F, D, and the views of IO.
    Number(f64),
    /// For S.
    Text(String),
    /// For V, P, J and T.
    Numbers(Vec<f64>),
}

impl Assignment {
    /// Creates an assignment to the variable with this name; `None` if no variable can have the name.
    #[must_use]
    pub fn new(name: &str, value: Constant) -> Option<Self> {
        match parse_name(name)? {
            (family, Some(index)) => Some(Self { family, index, value }),
            (_, None) => None,
        }
    }

    /// Returns whether a program can add a number to this variable.
    pub(crate) fn is_sum(&self) -> bool {
        use bcap_core::rac::VariableKind as Kind;
        matches!(self.family, Family::Plain(Kind::I | Kind::F | Kind::D)) && matches!(self.value, Constant::Number(_))
    }

    /// Writes the value to the variable.
    ///
    /// # Errors
    ///
    /// The errors of Variable_PutValue.
    pub(crate) fn write(&self, variables: &mut Variables) -> Result<(), HResult> {
        variables.put(self.family, self.index, &self.value.value()?.as_variant())
    }

    /// Adds the value to the variable.
    ///
    /// # Errors
    ///
    /// The errors of Variable_PutValue.
    pub(crate) fn add(&self, variables: &mut Variables) -> Result<(), HResult> {
        let present = number(&variables.get(self.family, self.index)?.as_variant());
        let (Some(present), Constant::Number(more)) = (present, &self.value) else {
            return Err(HResult::E_INVALIDARGTYPE);
        };
        let sum = Constant::Number(present + more).value()?;
        variables.put(self.family, self.index, &sum.as_variant())
    }

    /// Returns whether the variable has the value.
    ///
    /// # Errors
    ///
    /// `DISP_E_BADINDEX` for a variable that does not exist. For a value that the variable never has: `E_INVALIDARGTYPE` for
    /// another type, `E_INVALIDARG` for another count of numbers.
    pub(crate) fn holds(&self, variables: &Variables) -> Result<bool, HResult> {
        let present = variables.get(self.family, self.index)?;
        Ok(match (&self.value, present.as_variant()) {
            (Constant::Bool(wanted), Variant::Bool(on)) => *wanted == on,
            // a variable F holds the nearest R4
            (Constant::Number(wanted), Variant::R4(n)) => *wanted as f32 == n,
            (Constant::Number(wanted), Variant::Bool(on)) => (*wanted != 0.0) == on,
            (Constant::Number(wanted), other) => number(&other).ok_or(HResult::E_INVALIDARGTYPE)? == *wanted,
            (Constant::Text(wanted), Variant::Bstr(text)) => text.to_string() == *wanted,
            (Constant::Numbers(wanted), Variant::Array(array)) if array.len() != wanted.len() => {
                return Err(HResult::E_INVALIDARG);
            }
            (Constant::Numbers(wanted), Variant::Array(array)) => {
                let nearest: Vec<_> = wanted.iter().map(|number| *number as f32).collect();
                array.items::<f32>().is_some_and(|items| items.iter().eq(nearest))
            }
            _ => return Err(HResult::E_INVALIDARGTYPE),
        })
    }
}

impl Constant {
    fn value(&self) -> ValueResult {
        match self {
            Self::Bool(on) => owned(*on),
            Self::Number(n) if n.fract() == 0.0 && (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(n) => {
                owned(*n as i32)
            }
            Self::Number(n) => owned(*n),
            Self::Text(text) => owned(text),
            Self::Numbers(numbers) => owned(numbers),
        }
    }
}
