//! The table of the 137 functions of b-CAP.
//!
//! A row contains the help, the number on the wire, the names, the object that the function belongs to, the arguments,
//! the value of the reply (b-CAP specification, Appendix A), the effect, and whether Slave Mode allows the call. The
//! typed calls of [`call`](super::call), the argument check of the server and its list of open handles are generated
//! from this table.
//!
//! | group      | numbers | group    | numbers | group    | numbers |
//! |------------|---------|----------|---------|----------|---------|
//! | Service    | 1-2     | File     | 37-61   | Variable | 100-111 |
//! | Controller | 3-25    | Robot    | 62-84   | Command  | 112-127 |
//! | Extension  | 26-36   | Task     | 85-99   | Message  | 128-137 |

mod table;

use core::fmt;

use super::effect::{Effect, InSlaveMode, Properties};
use crate::variant::Variant;

pub(crate) use table::for_each_function;

/// The number of a function on the wire.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FunctionId(pub i32);

/// The kinds of objects that handles refer to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Object {
    /// The session itself; it has no handle.
    Service,
    /// A controller.
    Controller,
    /// An extension board or a hand.
    Extension,
    /// A file of the controller.
    File,
    /// An arm.
    Robot,
    /// A task: a program that can run.
    Task,
    /// A variable.
    Variable,
    /// A command.
    Command,
    /// A message of the controller.
    Message,
}

impl Object {
    /// Returns the function that opens an object of this kind by its name, called on an object of the kind `owner`.
    #[must_use]
    pub fn opened_from(self, owner: Self) -> Option<FunctionId> {
        let by_name = [Kind::Handle(owner), Kind::Text, Kind::Text];
        FunctionId::all().find(|function| {
            function.opens() == Some(self) && function.signature().is_some_and(|found| found.arguments == by_name)
        })
    }

    /// Returns the function that releases an object of this kind.
    #[must_use]
    pub const fn released_by(self) -> FunctionId {
        match self {
            Self::Service => FunctionId::SERVICE_STOP,
            Self::Controller => FunctionId::CONTROLLER_DISCONNECT,
            Self::Extension => FunctionId::EXTENSION_RELEASE,
            Self::File => FunctionId::FILE_RELEASE,
            Self::Robot => FunctionId::ROBOT_RELEASE,
            Self::Task => FunctionId::TASK_RELEASE,
            Self::Variable => FunctionId::VARIABLE_RELEASE,
            Self::Command => FunctionId::COMMAND_RELEASE,
            Self::Message => FunctionId::MESSAGE_RELEASE,
        }
    }

    /// Returns the name, the prefix of the names of its functions.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Service => "Service",
            Self::Controller => "Controller",
            Self::Extension => "Extension",
            Self::File => "File",
            Self::Robot => "Robot",
            Self::Task => "Task",
            Self::Variable => "Variable",
            Self::Command => "Command",
            Self::Message => "Message",
        }
    }
}

/// The kind of an argument, or of the value in a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Kind {
    /// The handle of an object: I4 on the wire; UI4 is accepted, as some drivers send it.
    Handle(Object),
    /// I4; other integer types are accepted when the number fits.
    Int,
    /// R4; R8 and integers are accepted.
    Float,
    /// BSTR; EMPTY and NULL are accepted as the empty string.
    Text,
    /// Any VARIANT.
    Any,
    /// No value; for replies only. A value is ignored.
    Nothing,
    /// Any VARIANT or no value; for replies only.
    Maybe,
}

impl Kind {
    /// Returns whether `value` is accepted as this kind.
    #[must_use]
    pub fn accepts(self, value: &Variant<'_>) -> bool {
        match self {
            Self::Handle(_) => matches!(value, Variant::I4(_) | Variant::Ui4(_)),
            Self::Int => value.as_i32().is_some(),
            Self::Float => value.as_f64().is_some(),
            Self::Text => value.is_empty() || value.as_bstr().is_some(),
            Self::Any | Self::Maybe | Self::Nothing => !matches!(value, Variant::Opaque(_)),
        }
    }
}

/// The arguments and the result of a function.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Signature {
    /// The kinds of its arguments, in order.
    pub arguments: &'static [Kind],
    /// The value of its reply.
    pub result: Kind,
    /// The object it is called on.
    pub object: Object,
}

macro_rules! kind {
    (Nothing) => {
        Kind::Nothing
    };
    (Maybe) => {
        Kind::Maybe
    };
    (Int) => {
        Kind::Int
    };
    (Float) => {
        Kind::Float
    };
    (Text) => {
        Kind::Text
    };
    (Any) => {
        Kind::Any
    };
    ($object:ident) => {
        Kind::Handle(Object::$object)
    };
}

macro_rules! tables {
    ($(#[doc = $summary:literal] $(#[doc = $help:literal])*
       $number:literal $constant:ident $method:ident $name:literal $object:ident
       ($($argument:ident: $kind:ident),*) $result:ident, $effect:ident $in_slave_mode:ident;)*) => {
        impl FunctionId {
            $(
                #[doc = concat!("`", $name, "`, function ", stringify!($number), ":", $summary)]
                pub const $constant: Self = Self($number);
            )*
        }

        /// Signatures, the function with number 1 first.
        static SIGNATURES: [Signature; 137] = [
            $(Signature { arguments: &[$(kind!($kind)),*], result: kind!($result), object: Object::$object },)*
        ];

        // separate tables: a server on a board checks arguments but uses none of these
        static NAMES: [&str; 137] = [$($name,)*];
        static ARGUMENT_NAMES: [&[&str]; 137] = [$(&[$(stringify!($argument)),*],)*];
        pub(super) static PROPERTIES: [Properties; 137] = [
            $(Properties { effect: Effect::$effect, in_slave_mode: InSlaveMode::$in_slave_mode },)*
        ];
        static HELP: [&[&str]; 137] = [$(&[$summary, $($help),*],)*];
    };
}

for_each_function!(tables);

impl FunctionId {
    /// Iterates over all functions.
    pub fn all() -> impl ExactSizeIterator<Item = Self> + DoubleEndedIterator + Clone {
        (1_u8..138).map(|n| Self(i32::from(n)))
    }

    pub(super) fn index(self) -> Option<usize> {
        usize::try_from(self.0).ok()?.checked_sub(1)
    }

    /// Returns the arguments and the result; `None` for an unknown number.
    #[must_use]
    pub fn signature(self) -> Option<&'static Signature> {
        SIGNATURES.get(self.index()?)
    }

    /// Returns the name, as in `VariableGetValue`; [`Display`](fmt::Display) writes `Variable_GetValue`.
    #[must_use]
    pub fn name(self) -> Option<&'static str> {
        NAMES.get(self.index()?).copied()
    }

    /// Returns the names of the arguments, in order.
    #[must_use]
    pub fn argument_names(self) -> &'static [&'static str] {
        self.index().and_then(|i| ARGUMENT_NAMES.get(i)).copied().unwrap_or_default()
    }

    /// Returns the lines of the help, Markdown of at most 104 characters a line: a sentence that says what the function does,
    /// an empty line, and a list of the arguments, the value of the reply and the controllers. An unknown number has no lines.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::bcap::FunctionId;
    ///
    /// let mut help = FunctionId::ROBOT_HALT.help();
    /// assert_eq!(help.next(), Some("Halts the motion of the robot: the statement HALT."));
    /// assert!(help.any(|line| line == "* `robot`: its handle, from Controller_GetRobot."));
    /// ```
    pub fn help(self) -> impl Iterator<Item = &'static str> {
        let lines = self.index().and_then(|i| HELP.get(i)).copied().unwrap_or_default();
        // a doc comment has a blank after its slashes
        lines.iter().map(|line| line.strip_prefix(' ').unwrap_or(line))
    }

    /// Finds a function by its name or number: `VariableGetValue`, `Variable_GetValue`, `variable_get_value`,
    /// `bCap_VariableGetValue`, `101`; case and underscores do not matter.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        if let Ok(number) = text.parse::<u8>() {
            return Self::all().find(|f| f.0 == i32::from(number));
        }
        let folded = |s: &'static str| s.bytes().map(|b| b.to_ascii_lowercase());
        let wanted = || text.bytes().filter(|b| *b != b'_').map(|b| b.to_ascii_lowercase());
        Self::all().find(|f| {
            let name = f.name().unwrap_or_default();
            wanted().eq(folded(name)) || wanted().eq(folded("bcap").chain(folded(name)))
        })
    }

    /// Returns the kind of object that a successful call opens. Its handle is in the reply; the Service has none.
    #[must_use]
    pub fn opens(self) -> Option<Object> {
        match (self, self.signature()?.result) {
            (Self::SERVICE_START, _) => Some(Object::Service),
            (_, Kind::Handle(object)) => Some(object),
            _ => None,
        }
    }

    /// Returns the kind of object that a successful call releases. Its handle is the first argument; the Service has none.
    #[must_use]
    pub fn releases(self) -> Option<Object> {
        let object = self.signature()?.object;
        (object.released_by() == self).then_some(object)
    }
}

/// Writes the specification's name, `Variable_GetValue`, or `function 999`.
impl fmt::Display for FunctionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Some(signature), Some(name)) = (self.signature(), self.name()) else {
            return write!(f, "function {}", self.0);
        };
        let object = signature.object.name();
        write!(f, "{object}_{}", name.strip_prefix(object).unwrap_or(name))
    }
}

impl fmt::Debug for FunctionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) => f.write_str(name),
            None => write!(f, "FunctionId({})", self.0),
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::format;
    use std::string::{String, ToString};
    use std::vec::Vec;

    #[test]
    fn numbers_groups_and_names_agree() {
        let groups = [
            (Object::Service, 1..=2),
            (Object::Controller, 3..=25),
            (Object::Extension, 26..=36),
            (Object::File, 37..=61),
            (Object::Robot, 62..=84),
            (Object::Task, 85..=99),
            (Object::Variable, 100..=111),
            (Object::Command, 112..=127),
            (Object::Message, 128..=137),
        ];
        assert_eq!(FunctionId::all().len(), 137);
        for function in FunctionId::all() {
            let signature = function.signature().unwrap();
            let (object, _) = groups.iter().find(|(_, range)| range.contains(&function.0)).unwrap();
            assert_eq!(signature.object, *object, "{function:?}");
            assert!(function.name().unwrap().starts_with(object.name()));
            assert_eq!(function.argument_names().len(), signature.arguments.len());
            // all except the Service functions and Controller_Connect take a handle of their group first
            if function.0 > 3 {
                assert_eq!(signature.arguments[0], Kind::Handle(*object), "{function:?}");
            }
        }
    }

    #[test]
    fn the_table_is_the_one_of_the_specification() {
        assert_eq!(FunctionId::CONTROLLER_EXECUTE.0, 17);
        assert_eq!(FunctionId::ROBOT_EXECUTE.0, 64);
        assert_eq!(FunctionId::ROBOT_MOVE.0, 72);
        assert_eq!(FunctionId::VARIABLE_GET_VALUE.0, 101);
        assert_eq!(FunctionId::MESSAGE_RELEASE.0, 137);
        let movement = FunctionId::ROBOT_MOVE.signature().unwrap();
        assert_eq!(movement.arguments, [Kind::Handle(Object::Robot), Kind::Int, Kind::Any, Kind::Text]);
        assert_eq!(movement.result, Kind::Nothing);
    }

    /// Returns the summary of a help, and the items of its list.
    fn parts(function: FunctionId) -> (&'static str, Vec<String>) {
        let mut lines = function.help();
        let summary = lines.next().unwrap();
        assert_eq!(lines.next(), Some(""), "{function}");
        let mut items: Vec<String> = Vec::new();
        for line in lines {
            assert!(line.chars().count() <= 104, "{function}: {line}");
            match (line.strip_prefix("* "), items.last_mut()) {
                (Some(start), _) => items.push(start.into()),
                (None, Some(item)) if line.starts_with("  ") => {
                    item.push(' ');
                    item.push_str(line.trim_start());
                }
                _ => panic!("{function}: {line}"),
            }
        }
        (summary, items)
    }

    #[test]
    fn the_help_has_the_arguments_the_result_and_the_controllers() {
        for function in FunctionId::all() {
            let (summary, items) = parts(function);
            for sentence in items.iter().map(String::as_str).chain([summary]) {
                assert!(
                    sentence.len() > 10 && sentence.ends_with('.') && !sentence.contains("  "),
                    "{function}: {sentence}"
                );
            }
            let names = function.argument_names();
            let (arguments, others) = items.split_at(names.len());
            for (argument, name) in arguments.iter().zip(names) {
                assert!(argument.starts_with(&format!("`{name}`: ")), "{function}: {argument}");
            }
            let returned: Vec<_> = others.iter().filter(|item| item.starts_with("Returns ")).collect();
            assert_eq!(returned.len(), 1, "{function}");
            let result = function.signature().unwrap().result;
            assert_eq!(returned[0] == "Returns no value.", result == Kind::Nothing, "{function}");
            let wire = match result {
                Kind::Handle(_) | Kind::Int => "(I4)",
                Kind::Text => "(BSTR)",
                _ => "",
            };
            assert!(returned[0].contains(wire), "{function}: {}", returned[0]);
            let controllers = others.last().unwrap();
            assert!(controllers.starts_with("Controllers: "), "{function}: {controllers}");
        }
        assert_eq!(FunctionId(138).help().next(), None);
    }

    #[test]
    fn the_help_names_the_functions_that_open_and_release() {
        for function in FunctionId::all() {
            let help = function.help().collect::<Vec<_>>().join(" ");
            let names = |other: FunctionId| help.contains(&other.to_string());
            let signature = function.signature().unwrap();
            if let Kind::Handle(object) = signature.result {
                assert!(names(object.released_by()), "{function}");
            }
            if let Some(Kind::Handle(object)) = signature.arguments.first() {
                assert!(FunctionId::all().any(|f| f.opens() == Some(*object) && names(f)), "{function}");
            }
        }
    }

    #[test]
    fn functions_are_found_by_all_their_names() {
        for text in ["VariableGetValue", "Variable_GetValue", "variable_get_value", "bCap_VariableGetValue", "101"] {
            assert_eq!(FunctionId::parse(text), Some(FunctionId::VARIABLE_GET_VALUE), "{text}");
        }
        for text in ["", "0", "138", "-1", "VariableGetValu", "bCap_"] {
            assert_eq!(FunctionId::parse(text), None, "{text}");
        }
        for function in FunctionId::all() {
            assert_eq!(FunctionId::parse(&function.to_string()), Some(function));
        }
        assert_eq!(FunctionId::VARIABLE_GET_VALUE.to_string(), "Variable_GetValue");
        assert_eq!(FunctionId(999).to_string(), "function 999");
    }

    #[test]
    fn what_is_opened_can_be_released() {
        let opening = FunctionId::all().filter_map(FunctionId::opens).count();
        assert_eq!(opening, 14);
        let releasing: Vec<_> = FunctionId::all().filter(|f| f.releases().is_some()).map(|f| f.0).collect();
        assert_eq!(releasing, [2, 4, 36, 61, 84, 99, 111, 127, 137]);
        assert_eq!(FunctionId::CONTROLLER_GET_ROBOT.opens(), Some(Object::Robot));
        assert_eq!(FunctionId::CONTROLLER_GET_NAME.opens(), None);
        assert_eq!(FunctionId(138).opens(), None);
    }
}
