//! The programs of tasks: lists of steps, which a [scenario](crate::scenario) defines.

use std::sync::Arc;
use std::time::Duration;

use bcap_core::hresult::HResult;
use bcap_core::variant::{Bstr, Variant};

use crate::value::{self, Value, kept, numbers_of_array, one_int, truth, whole};
use crate::variables::{Family, Variables, parse_name};

/// The program of a task. After its last step it begins again, or ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// The name of the task.
    pub name: String,
    /// The steps, each of which is a line.
    pub steps: Arc<[Step]>,
    /// The least time that each step takes, at least 1 ms.
    pub line: Duration,
    /// The mode of Task_Start in which it starts with the scenario; `None` waits for a client.
    pub start: Option<i32>,
    /// The public variables, at the beginning.
    pub public: PublicValues,
}

/// The public variables of a program, for GetPublicValue and SetPublicValue of the controller.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PublicValues(Vec<(String, Value)>);

impl PublicValues {
    pub(crate) const fn new(list: Vec<(String, Value)>) -> Self {
        Self(list)
    }

    fn place(&self, name: &str) -> Result<usize, HResult> {
        self.0.iter().position(|(known, _)| known.eq_ignore_ascii_case(name)).ok_or(HResult::E_CAO_OBJECT_NOTFOUND)
    }

    /// Returns a variable, or an element of an array.
    pub(crate) fn get(&self, name: &str, index: Option<usize>) -> Result<Value, HResult> {
        let value = &self.0[self.place(name)?].1;
        let Some(n) = index else { return Ok(value.clone()) };
        match value {
            Value::I4s(items) => items.get(n).copied().map(Value::I4).ok_or(HResult::DISP_E_BADINDEX),
            Value::R8s(items) => items.get(n).copied().map(Value::R8).ok_or(HResult::DISP_E_BADINDEX),
            Value::Texts(items) => items.get(n).cloned().map(Value::Text).ok_or(HResult::DISP_E_BADINDEX),
            _ => Err(HResult::E_INVALIDARG),
        }
    }

    /// Writes a variable, or an element of an array; type and count stay.
    pub(crate) fn put(&mut self, name: &str, index: Option<usize>, given: &Variant<'_>) -> Result<(), HResult> {
        let place = self.place(name)?;
        let present = &mut self.0[place].1;
        match (present, index) {
            (Value::I4s(items), Some(n)) => *items.get_mut(n).ok_or(HResult::DISP_E_BADINDEX)? = one_int(given)?,
            (Value::R8s(items), Some(n)) => *items.get_mut(n).ok_or(HResult::DISP_E_BADINDEX)? = one(given)?,
            (Value::Texts(items), Some(n)) => *items.get_mut(n).ok_or(HResult::DISP_E_BADINDEX)? = text(given)?,
            (_, Some(_)) => return Err(HResult::E_INVALIDARG),
            (Value::I4(item), None) => *item = one_int(given)?,
            (Value::R8(item), None) => *item = one(given)?,
            (Value::Bool(item), None) => *item = truth(given)?,
            (Value::Text(item), None) => *item = text(given)?,
            (Value::I4s(items), None) => {
                let given: Result<Vec<_>, _> = numbers_of_array(given)?.into_iter().map(whole).collect();
                *items = given.ok().filter(|given| given.len() == items.len()).ok_or(HResult::E_INVALIDARG)?;
            }
            (Value::R8s(items), None) => {
                let given = numbers_of_array(given)?;
                *items = Some(given).filter(|given| given.len() == items.len()).ok_or(HResult::E_INVALIDARG)?;
            }
            (Value::R4s(items), None) => {
                let given: Vec<_> = numbers_of_array(given)?.into_iter().map(|number| number as f32).collect();
                *items = Some(given).filter(|given| given.len() == items.len()).ok_or(HResult::E_INVALIDARG)?;
            }
            _ => return Err(HResult::E_INVALIDARG),
        }
        Ok(())
    }
}

fn one(given: &Variant<'_>) -> Result<f64, HResult> {
    value::number(&given.flatten()).ok_or(HResult::E_INVALIDARGTYPE)
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
    /// Makes an assignment to the variable of this name; `None` if no variable can have the name.
    #[must_use]
    pub fn new(name: &str, value: Constant) -> Option<Self> {
        match parse_name(name)? {
            (family, Some(index)) => Some(Self { family, index, value }),
            (_, None) => None,
        }
    }

    /// Tells whether a program can add a number to this variable.
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
        variables.put(self.family, self.index, &kept(&self.value.value().encoded()))
    }

    /// Adds the value to the variable.
    ///
    /// # Errors
    ///
    /// The errors of Variable_PutValue.
    pub(crate) fn add(&self, variables: &mut Variables) -> Result<(), HResult> {
        let present = number(&variables.get(self.family, self.index)?);
        let (Some(present), Constant::Number(more)) = (present, &self.value) else {
            return Err(HResult::E_INVALIDARGTYPE);
        };
        let sum = Constant::Number(present + more).value();
        variables.put(self.family, self.index, &kept(&sum.encoded()))
    }

    /// Tells whether the variable has the value.
    ///
    /// # Errors
    ///
    /// `DISP_E_BADINDEX` for a variable that does not exist.
    pub(crate) fn holds(&self, variables: &Variables) -> Result<bool, HResult> {
        let present = variables.get(self.family, self.index)?;
        Ok(match (&self.value, &present) {
            (Constant::Bool(wanted), Value::Bool(on)) => wanted == on,
            // a variable F holds the nearest R4
            (Constant::Number(wanted), Value::R4(n)) => *wanted as f32 == *n,
            (Constant::Number(wanted), Value::Bool(on)) => (*wanted != 0.0) == *on,
            (Constant::Number(wanted), other) => number(other) == Some(*wanted),
            (Constant::Text(wanted), Value::Bstr(bytes)) => {
                Bstr::from_utf16le(bytes).is_some_and(|text| text.to_string() == *wanted)
            }
            (Constant::Numbers(wanted), Value::R4s(numbers)) => {
                wanted.len() == numbers.len() && wanted.iter().zip(numbers).all(|(a, b)| *a as f32 == *b)
            }
            _ => false,
        })
    }
}

impl Constant {
    fn value(&self) -> Value {
        match self {
            Self::Bool(on) => Value::Bool(*on),
            Self::Number(n) if n.fract() == 0.0 && (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(n) => {
                Value::I4(*n as i32)
            }
            Self::Number(n) => Value::R8(*n),
            Self::Text(text) => Value::Text(text.clone()),
            Self::Numbers(numbers) => Value::R8s(numbers.clone()),
        }
    }
}

/// Returns the number of a value of a variable.
fn number(value: &Value) -> Option<f64> {
    match value {
        Value::I2(n) => Some((*n).into()),
        Value::I4(n) => Some((*n).into()),
        Value::Ui1(n) => Some((*n).into()),
        Value::R4(n) => Some((*n).into()),
        Value::R8(n) => Some(*n),
        _ => None,
    }
}
