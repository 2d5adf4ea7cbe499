//! The table of the 137 functions of b-CAP.
//!
//! A row contains the number on the wire, the names, the object that the function belongs to, the arguments, and the value
//! of the reply (S2:1613-1806). The typed calls of [`call`](super::call), the argument check of the server and its list of
//! open handles are generated from this table.
//!
//! | group      | numbers | group    | numbers | group    | numbers |
//! |------------|---------|----------|---------|----------|---------|
//! | Service    | 1-2     | File     | 37-61   | Variable | 100-111 |
//! | Controller | 3-25    | Robot    | 62-84   | Command  | 112-127 |
//! | Extension  | 26-36   | Task     | 85-99   | Message  | 128-137 |

use core::fmt;

use crate::variant::Variant;

/// Passes the table to another macro; a row is
/// `number CONSTANT method "Name" Object (argument: kind, ...) result;`.
///
/// Kinds of arguments: an object (its handle), `Int` (I4), `Float` (R4), `Text` (BSTR), `Any` (VARIANT). Results:
/// the same, `Nothing`, and `Maybe` where only some controllers return one.
macro_rules! for_each_function {
    ($receiver:ident) => {
        $receiver! {
            1 SERVICE_START service_start "ServiceStart" Service (option: Text) Nothing;
            2 SERVICE_STOP service_stop "ServiceStop" Service () Nothing;
            3 CONTROLLER_CONNECT controller_connect "ControllerConnect" Controller (name: Text, provider: Text, machine: Text, option: Text) Controller;
            4 CONTROLLER_DISCONNECT controller_disconnect "ControllerDisconnect" Controller (controller: Controller) Nothing;
            5 CONTROLLER_GET_EXTENSION controller_get_extension "ControllerGetExtension" Controller (controller: Controller, name: Text, option: Text) Extension;
            6 CONTROLLER_GET_FILE controller_get_file "ControllerGetFile" Controller (controller: Controller, name: Text, option: Text) File;
            7 CONTROLLER_GET_ROBOT controller_get_robot "ControllerGetRobot" Controller (controller: Controller, name: Text, option: Text) Robot;
            8 CONTROLLER_GET_TASK controller_get_task "ControllerGetTask" Controller (controller: Controller, name: Text, option: Text) Task;
            9 CONTROLLER_GET_VARIABLE controller_get_variable "ControllerGetVariable" Controller (controller: Controller, name: Text, option: Text) Variable;
            10 CONTROLLER_GET_COMMAND controller_get_command "ControllerGetCommand" Controller (controller: Controller, name: Text, option: Text) Command;
            11 CONTROLLER_GET_EXTENSION_NAMES controller_get_extension_names "ControllerGetExtensionNames" Controller (controller: Controller, option: Text) Any;
            12 CONTROLLER_GET_FILE_NAMES controller_get_file_names "ControllerGetFileNames" Controller (controller: Controller, option: Text) Any;
            13 CONTROLLER_GET_ROBOT_NAMES controller_get_robot_names "ControllerGetRobotNames" Controller (controller: Controller, option: Text) Any;
            14 CONTROLLER_GET_TASK_NAMES controller_get_task_names "ControllerGetTaskNames" Controller (controller: Controller, option: Text) Any;
            15 CONTROLLER_GET_VARIABLE_NAMES controller_get_variable_names "ControllerGetVariableNames" Controller (controller: Controller, option: Text) Any;
            16 CONTROLLER_GET_COMMAND_NAMES controller_get_command_names "ControllerGetCommandNames" Controller (controller: Controller, option: Text) Any;
            17 CONTROLLER_EXECUTE controller_execute "ControllerExecute" Controller (controller: Controller, command: Text, param: Any) Any;
            18 CONTROLLER_GET_MESSAGE controller_get_message "ControllerGetMessage" Controller (controller: Controller) Message;
            19 CONTROLLER_GET_ATTRIBUTE controller_get_attribute "ControllerGetAttribute" Controller (controller: Controller) Int;
            20 CONTROLLER_GET_HELP controller_get_help "ControllerGetHelp" Controller (controller: Controller) Text;
            21 CONTROLLER_GET_NAME controller_get_name "ControllerGetName" Controller (controller: Controller) Text;
            22 CONTROLLER_GET_TAG controller_get_tag "ControllerGetTag" Controller (controller: Controller) Any;
            23 CONTROLLER_PUT_TAG controller_put_tag "ControllerPutTag" Controller (controller: Controller, value: Any) Nothing;
            24 CONTROLLER_GET_ID controller_get_id "ControllerGetID" Controller (controller: Controller) Any;
            25 CONTROLLER_PUT_ID controller_put_id "ControllerPutID" Controller (controller: Controller, value: Any) Nothing;
            26 EXTENSION_GET_VARIABLE extension_get_variable "ExtensionGetVariable" Extension (extension: Extension, name: Text, option: Text) Variable;
            27 EXTENSION_GET_VARIABLE_NAMES extension_get_variable_names "ExtensionGetVariableNames" Extension (extension: Extension, option: Text) Any;
            28 EXTENSION_EXECUTE extension_execute "ExtensionExecute" Extension (extension: Extension, command: Text, param: Any) Any;
            29 EXTENSION_GET_ATTRIBUTE extension_get_attribute "ExtensionGetAttribute" Extension (extension: Extension) Int;
            30 EXTENSION_GET_HELP extension_get_help "ExtensionGetHelp" Extension (extension: Extension) Text;
            31 EXTENSION_GET_NAME extension_get_name "ExtensionGetName" Extension (extension: Extension) Text;
            32 EXTENSION_GET_TAG extension_get_tag "ExtensionGetTag" Extension (extension: Extension) Any;
            33 EXTENSION_PUT_TAG extension_put_tag "ExtensionPutTag" Extension (extension: Extension, value: Any) Nothing;
            34 EXTENSION_GET_ID extension_get_id "ExtensionGetID" Extension (extension: Extension) Any;
            35 EXTENSION_PUT_ID extension_put_id "ExtensionPutID" Extension (extension: Extension, value: Any) Nothing;
            36 EXTENSION_RELEASE extension_release "ExtensionRelease" Extension (extension: Extension) Nothing;
            37 FILE_GET_FILE file_get_file "FileGetFile" File (file: File, name: Text, option: Text) File;
            38 FILE_GET_VARIABLE file_get_variable "FileGetVariable" File (file: File, name: Text, option: Text) Variable;
            39 FILE_GET_FILE_NAMES file_get_file_names "FileGetFileNames" File (file: File, option: Text) Any;
            40 FILE_GET_VARIABLE_NAMES file_get_variable_names "FileGetVariableNames" File (file: File, option: Text) Any;
            41 FILE_EXECUTE file_execute "FileExecute" File (file: File, command: Text, param: Any) Any;
            42 FILE_COPY file_copy "FileCopy" File (file: File, name: Text, option: Text) Nothing;
            43 FILE_DELETE file_delete "FileDelete" File (file: File, option: Text) Nothing;
            44 FILE_MOVE file_move "FileMove" File (file: File, name: Text, option: Text) Nothing;
            45 FILE_RUN file_run "FileRun" File (file: File, option: Text) Text;
            46 FILE_GET_DATE_CREATED file_get_date_created "FileGetDateCreated" File (file: File) Any;
            47 FILE_GET_DATE_LAST_ACCESSED file_get_date_last_accessed "FileGetDateLastAccessed" File (file: File) Any;
            48 FILE_GET_DATE_LAST_MODIFIED file_get_date_last_modified "FileGetDateLastModified" File (file: File) Any;
            49 FILE_GET_PATH file_get_path "FileGetPath" File (file: File) Text;
            50 FILE_GET_SIZE file_get_size "FileGetSize" File (file: File) Int;
            51 FILE_GET_TYPE file_get_type "FileGetType" File (file: File) Text;
            52 FILE_GET_VALUE file_get_value "FileGetValue" File (file: File) Any;
            53 FILE_PUT_VALUE file_put_value "FilePutValue" File (file: File, value: Any) Nothing;
            54 FILE_GET_ATTRIBUTE file_get_attribute "FileGetAttribute" File (file: File) Int;
            55 FILE_GET_HELP file_get_help "FileGetHelp" File (file: File) Text;
            56 FILE_GET_NAME file_get_name "FileGetName" File (file: File) Text;
            57 FILE_GET_TAG file_get_tag "FileGetTag" File (file: File) Any;
            58 FILE_PUT_TAG file_put_tag "FilePutTag" File (file: File, value: Any) Nothing;
            59 FILE_GET_ID file_get_id "FileGetID" File (file: File) Any;
            60 FILE_PUT_ID file_put_id "FilePutID" File (file: File, value: Any) Nothing;
            61 FILE_RELEASE file_release "FileRelease" File (file: File) Nothing;
            62 ROBOT_GET_VARIABLE robot_get_variable "RobotGetVariable" Robot (robot: Robot, name: Text, option: Text) Variable;
            63 ROBOT_GET_VARIABLE_NAMES robot_get_variable_names "RobotGetVariableNames" Robot (robot: Robot, option: Text) Any;
            64 ROBOT_EXECUTE robot_execute "RobotExecute" Robot (robot: Robot, command: Text, param: Any) Any;
            65 ROBOT_ACCELERATE robot_accelerate "RobotAccelerate" Robot (robot: Robot, axis: Int, accel: Float, decel: Float) Nothing;
            66 ROBOT_CHANGE robot_change "RobotChange" Robot (robot: Robot, name: Text) Nothing;
            67 ROBOT_CHUCK robot_chuck "RobotChuck" Robot (robot: Robot, option: Text) Nothing;
            68 ROBOT_DRIVE robot_drive "RobotDrive" Robot (robot: Robot, number: Int, distance: Float, option: Text) Nothing;
            69 ROBOT_GO_HOME robot_go_home "RobotGoHome" Robot (robot: Robot) Nothing;
            70 ROBOT_HALT robot_halt "RobotHalt" Robot (robot: Robot, option: Text) Nothing;
            71 ROBOT_HOLD robot_hold "RobotHold" Robot (robot: Robot, option: Text) Nothing;
            72 ROBOT_MOVE robot_move "RobotMove" Robot (robot: Robot, interpolation: Int, pose: Any, option: Text) Nothing;
            73 ROBOT_ROTATE robot_rotate "RobotRotate" Robot (robot: Robot, surface: Any, degrees: Float, pivot: Any, option: Text) Nothing;
            74 ROBOT_SPEED robot_speed "RobotSpeed" Robot (robot: Robot, axis: Int, speed: Float) Nothing;
            75 ROBOT_UNCHUCK robot_unchuck "RobotUnchuck" Robot (robot: Robot, option: Text) Nothing;
            76 ROBOT_UNHOLD robot_unhold "RobotUnhold" Robot (robot: Robot, option: Text) Nothing;
            77 ROBOT_GET_ATTRIBUTE robot_get_attribute "RobotGetAttribute" Robot (robot: Robot) Int;
            78 ROBOT_GET_HELP robot_get_help "RobotGetHelp" Robot (robot: Robot) Text;
            79 ROBOT_GET_NAME robot_get_name "RobotGetName" Robot (robot: Robot) Text;
            80 ROBOT_GET_TAG robot_get_tag "RobotGetTag" Robot (robot: Robot) Any;
            81 ROBOT_PUT_TAG robot_put_tag "RobotPutTag" Robot (robot: Robot, value: Any) Nothing;
            82 ROBOT_GET_ID robot_get_id "RobotGetID" Robot (robot: Robot) Any;
            83 ROBOT_PUT_ID robot_put_id "RobotPutID" Robot (robot: Robot, value: Any) Nothing;
            84 ROBOT_RELEASE robot_release "RobotRelease" Robot (robot: Robot) Nothing;
            85 TASK_GET_VARIABLE task_get_variable "TaskGetVariable" Task (task: Task, name: Text, option: Text) Variable;
            86 TASK_GET_VARIABLE_NAMES task_get_variable_names "TaskGetVariableNames" Task (task: Task, option: Text) Any;
            87 TASK_EXECUTE task_execute "TaskExecute" Task (task: Task, command: Text, param: Any) Any;
            88 TASK_START task_start "TaskStart" Task (task: Task, mode: Int, option: Text) Nothing;
            89 TASK_STOP task_stop "TaskStop" Task (task: Task, mode: Int, option: Text) Nothing;
            90 TASK_DELETE task_delete "TaskDelete" Task (task: Task, option: Text) Nothing;
            91 TASK_GET_FILE_NAME task_get_file_name "TaskGetFileName" Task (task: Task) Text;
            92 TASK_GET_ATTRIBUTE task_get_attribute "TaskGetAttribute" Task (task: Task) Int;
            93 TASK_GET_HELP task_get_help "TaskGetHelp" Task (task: Task) Text;
            94 TASK_GET_NAME task_get_name "TaskGetName" Task (task: Task) Text;
            95 TASK_GET_TAG task_get_tag "TaskGetTag" Task (task: Task) Any;
            96 TASK_PUT_TAG task_put_tag "TaskPutTag" Task (task: Task, value: Any) Nothing;
            97 TASK_GET_ID task_get_id "TaskGetID" Task (task: Task) Any;
            98 TASK_PUT_ID task_put_id "TaskPutID" Task (task: Task, value: Any) Nothing;
            99 TASK_RELEASE task_release "TaskRelease" Task (task: Task) Nothing;
            100 VARIABLE_GET_DATE_TIME variable_get_date_time "VariableGetDateTime" Variable (variable: Variable) Any;
            101 VARIABLE_GET_VALUE variable_get_value "VariableGetValue" Variable (variable: Variable) Any;
            102 VARIABLE_PUT_VALUE variable_put_value "VariablePutValue" Variable (variable: Variable, value: Any) Nothing;
            103 VARIABLE_GET_ATTRIBUTE variable_get_attribute "VariableGetAttribute" Variable (variable: Variable) Int;
            104 VARIABLE_GET_HELP variable_get_help "VariableGetHelp" Variable (variable: Variable) Text;
            105 VARIABLE_GET_NAME variable_get_name "VariableGetName" Variable (variable: Variable) Text;
            106 VARIABLE_GET_TAG variable_get_tag "VariableGetTag" Variable (variable: Variable) Any;
            107 VARIABLE_PUT_TAG variable_put_tag "VariablePutTag" Variable (variable: Variable, value: Any) Nothing;
            108 VARIABLE_GET_ID variable_get_id "VariableGetID" Variable (variable: Variable) Any;
            109 VARIABLE_PUT_ID variable_put_id "VariablePutID" Variable (variable: Variable, value: Any) Nothing;
            110 VARIABLE_GET_MICROSECOND variable_get_microsecond "VariableGetMicrosecond" Variable (variable: Variable) Int;
            111 VARIABLE_RELEASE variable_release "VariableRelease" Variable (variable: Variable) Nothing;
            112 COMMAND_EXECUTE command_execute "CommandExecute" Command (command: Command, mode: Int) Maybe;
            113 COMMAND_CANCEL command_cancel "CommandCancel" Command (command: Command) Nothing;
            114 COMMAND_GET_TIMEOUT command_get_timeout "CommandGetTimeout" Command (command: Command) Int;
            115 COMMAND_PUT_TIMEOUT command_put_timeout "CommandPutTimeout" Command (command: Command, value: Int) Nothing;
            116 COMMAND_GET_STATE command_get_state "CommandGetState" Command (command: Command) Int;
            117 COMMAND_GET_PARAMETERS command_get_parameters "CommandGetParameters" Command (command: Command) Any;
            118 COMMAND_PUT_PARAMETERS command_put_parameters "CommandPutParameters" Command (command: Command, value: Any) Nothing;
            119 COMMAND_GET_RESULT command_get_result "CommandGetResult" Command (command: Command) Any;
            120 COMMAND_GET_ATTRIBUTE command_get_attribute "CommandGetAttribute" Command (command: Command) Int;
            121 COMMAND_GET_HELP command_get_help "CommandGetHelp" Command (command: Command) Text;
            122 COMMAND_GET_NAME command_get_name "CommandGetName" Command (command: Command) Text;
            123 COMMAND_GET_TAG command_get_tag "CommandGetTag" Command (command: Command) Any;
            124 COMMAND_PUT_TAG command_put_tag "CommandPutTag" Command (command: Command, value: Any) Nothing;
            125 COMMAND_GET_ID command_get_id "CommandGetID" Command (command: Command) Any;
            126 COMMAND_PUT_ID command_put_id "CommandPutID" Command (command: Command, value: Any) Nothing;
            127 COMMAND_RELEASE command_release "CommandRelease" Command (command: Command) Nothing;
            128 MESSAGE_REPLY message_reply "MessageReply" Message (message: Message, data: Any) Nothing;
            129 MESSAGE_CLEAR message_clear "MessageClear" Message (message: Message) Nothing;
            130 MESSAGE_GET_DATE_TIME message_get_date_time "MessageGetDateTime" Message (message: Message) Any;
            131 MESSAGE_GET_DESCRIPTION message_get_description "MessageGetDescription" Message (message: Message) Text;
            132 MESSAGE_GET_DESTINATION message_get_destination "MessageGetDestination" Message (message: Message) Text;
            133 MESSAGE_GET_NUMBER message_get_number "MessageGetNumber" Message (message: Message) Int;
            134 MESSAGE_GET_SERIAL_NUMBER message_get_serial_number "MessageGetSerialNumber" Message (message: Message) Int;
            135 MESSAGE_GET_SOURCE message_get_source "MessageGetSource" Message (message: Message) Text;
            136 MESSAGE_GET_VALUE message_get_value "MessageGetValue" Message (message: Message) Any;
            137 MESSAGE_RELEASE message_release "MessageRelease" Message (message: Message) Nothing;
        }
    };
}
pub(crate) use for_each_function;

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
    /// Tells whether `value` is accepted as this kind.
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
    ($($number:literal $constant:ident $method:ident $name:literal $object:ident
       ($($argument:ident: $kind:ident),*) $result:ident;)*) => {
        impl FunctionId {
            $(
                #[doc = concat!("`", $name, "`, function ", stringify!($number), ".")]
                pub const $constant: Self = Self($number);
            )*
        }

        /// Signatures, the function with number 1 first.
        static SIGNATURES: [Signature; 137] = [
            $(Signature { arguments: &[$(kind!($kind)),*], result: kind!($result), object: Object::$object },)*
        ];

        // names are a separate table: a server on a board checks arguments but prints no names
        static NAMES: [&str; 137] = [$($name,)*];
        static ARGUMENT_NAMES: [&[&str]; 137] = [$(&[$(stringify!($argument)),*],)*];
    };
}

for_each_function!(tables);

impl FunctionId {
    /// Iterates over all functions.
    pub fn all() -> impl ExactSizeIterator<Item = Self> + DoubleEndedIterator + Clone {
        (1_u8..138).map(|n| Self(i32::from(n)))
    }

    fn index(self) -> Option<usize> {
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
    use std::string::ToString;

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
            // all except the Service functions and Controller_Connect are called on a handle of their own group
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
        let releasing: std::vec::Vec<_> = FunctionId::all().filter(|f| f.releases().is_some()).map(|f| f.0).collect();
        assert_eq!(releasing, [2, 4, 36, 61, 84, 99, 111, 127, 137]);
        assert_eq!(FunctionId::CONTROLLER_GET_ROBOT.opens(), Some(Object::Robot));
        assert_eq!(FunctionId::CONTROLLER_GET_NAME.opens(), None);
        assert_eq!(FunctionId(138).opens(), None);
    }
}
