//! The commands of the Execute functions: the effect of each, and whether Slave Mode allows it.
//!
//! The table has the commands of the RC8 provider guide, of public programs and of the virtual controller. A controller may
//! have others. A command that is not in it is [`Properties::UNKNOWN`]: it may move, and is not sent while a stream runs.

use super::effect::{Effect, InSlaveMode, Properties};
use super::function::{FunctionId, PROPERTIES};

/// A command of an Execute function.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Command {
    /// The function that executes it.
    pub function: FunctionId,
    /// Its name; controllers ignore case.
    pub name: &'static str,
    /// Its effect, and whether Slave Mode allows it.
    pub properties: Properties,
    /// The source of the facts about Slave Mode.
    pub source: &'static str,
}

impl Command {
    /// Finds a command by its name, ignoring case and surrounding blanks.
    #[must_use]
    pub fn find(function: FunctionId, name: &str) -> Option<&'static Self> {
        function.commands().find(|command| command.name.eq_ignore_ascii_case(name.trim()))
    }
}

impl FunctionId {
    /// Returns the properties of a call of this function.
    ///
    /// `command` is the second argument of an Execute function, the name of the command in any case; `option` is the option of
    /// a function that opens a file, which may create it. `None` stands for any text: the result covers all of them.
    ///
    /// # Examples
    ///
    /// ```
    /// use bcap_core::bcap::{Effect, FunctionId, InSlaveMode};
    ///
    /// let read = FunctionId::CONTROLLER_EXECUTE.properties(Some("GetCurErrorCount"), None);
    /// assert_eq!((read.effect, read.in_slave_mode), (Effect::Reads, InSlaveMode::Refused));
    /// assert_eq!(FunctionId::CONTROLLER_EXECUTE.properties(None, None).effect, Effect::Moves);
    /// ```
    #[must_use]
    pub fn properties(self, command: Option<&str>, option: Option<&str>) -> Properties {
        let opens_file = matches!(self, Self::CONTROLLER_GET_FILE | Self::FILE_GET_FILE);
        let properties = self.index().and_then(|i| PROPERTIES.get(i)).copied().unwrap_or(Properties::UNKNOWN);
        match command.filter(|_| self.executes()) {
            Some(name) => Command::find(self, name).map_or(Properties::UNKNOWN, |command| command.properties),
            None if opens_file && option == Some("") => Properties { effect: Effect::Session, ..properties },
            None => properties,
        }
    }

    /// Returns the effect of a call of this function, the strongest for any arguments.
    #[must_use]
    pub fn effect(self) -> Effect {
        self.properties(None, None).effect
    }

    /// Returns whether a controller in Slave Mode executes a call of this function, whatever its arguments are.
    #[must_use]
    pub fn in_slave_mode(self) -> InSlaveMode {
        self.properties(None, None).in_slave_mode
    }

    /// Returns whether the second argument of the function is the name of a command.
    #[must_use]
    pub const fn executes(self) -> bool {
        matches!(
            self,
            Self::CONTROLLER_EXECUTE
                | Self::EXTENSION_EXECUTE
                | Self::FILE_EXECUTE
                | Self::ROBOT_EXECUTE
                | Self::TASK_EXECUTE
        )
    }

    /// Iterates over the known commands of an Execute function.
    pub fn commands(self) -> impl Iterator<Item = &'static Command> {
        COMMANDS.iter().filter(move |command| command.function == self)
    }
}

const fn command(
    function: FunctionId,
    name: &'static str,
    effect: Effect,
    in_slave_mode: InSlaveMode,
    source: &'static str,
) -> Command {
    Command { function, name, properties: Properties { effect, in_slave_mode }, source }
}

const PRO: &str = "seen on a COBOTTA PRO 900, on the connection of the stream";
const PRO2: &str = "seen on a COBOTTA PRO 900, on a second connection";
const HAND: &str = "seen on a COBOTTA, on a second connection, with the arm at rest";
const SPEC: &str = "b-CAP guide for RC9, Slave Mode";
const GUIDE: &str = "RC8 provider guide 5.2.28: not available in Slave Mode";
const UNMARKED: &str = "the RC8 provider guide does not say that Slave Mode refuses it, nor that it allows it";
const NONE: &str = "no source";

/// The known commands, by function.
#[rustfmt::skip]
static COMMANDS: &[Command] = &[
    command(FunctionId::CONTROLLER_EXECUTE, "GetCurErrorCount", Effect::Reads, InSlaveMode::Refused, PRO2),
    command(FunctionId::CONTROLLER_EXECUTE, "GetCurErrorInfo", Effect::Reads, InSlaveMode::Refused, PRO2),
    command(FunctionId::CONTROLLER_EXECUTE, "SysState", Effect::Reads, InSlaveMode::Refused, PRO2),
    command(FunctionId::CONTROLLER_EXECUTE, "GetErrorDescription", Effect::Reads, InSlaveMode::Refused, PRO),
    command(FunctionId::CONTROLLER_EXECUTE, "HandCurPos", Effect::Reads, InSlaveMode::Refused, PRO),
    command(FunctionId::CONTROLLER_EXECUTE, "ClearError", Effect::Writes, InSlaveMode::Refused, PRO),
    command(FunctionId::CONTROLLER_EXECUTE, "StoState", Effect::Reads, InSlaveMode::Allowed, PRO),
    command(FunctionId::CONTROLLER_EXECUTE, "ManualReset", Effect::Moves, InSlaveMode::Allowed, PRO),
    command(FunctionId::CONTROLLER_EXECUTE, "HandMoveA", Effect::Moves, InSlaveMode::Allowed, HAND),
    command(FunctionId::CONTROLLER_EXECUTE, "HandMoveR", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "HandMoveH", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "HandMoveAH", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "HandMoveVH", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "HandStop", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "HandHoldState", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "HandCurLoad", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "GetErrorLogCount", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "GetErrorLog", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "GetOprLogCount", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "GetOprLog", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "GetPublicValue", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "SysInfo", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "SetPublicValue", Effect::Writes, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "KillAll", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "KillAllTsr", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "RunAllTsr", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "SuspendAll", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "StepStopAll", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "ContinueStartAll", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "Motor", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "ResetStoState", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "ManualResetPreparation", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::CONTROLLER_EXECUTE, "SetAutoMode", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "slvGetMode", Effect::Reads, InSlaveMode::Allowed, PRO2),
    command(FunctionId::ROBOT_EXECUTE, "CurJnt", Effect::Reads, InSlaveMode::Allowed, PRO2),
    command(FunctionId::ROBOT_EXECUTE, "CurPos", Effect::Reads, InSlaveMode::Allowed, PRO2),
    command(FunctionId::ROBOT_EXECUTE, "CurTool", Effect::Reads, InSlaveMode::Allowed, PRO2),
    command(FunctionId::ROBOT_EXECUTE, "GetSrvData", Effect::Reads, InSlaveMode::Allowed, PRO2),
    command(FunctionId::ROBOT_EXECUTE, "ForceValue", Effect::Writes, InSlaveMode::Allowed, PRO2),
    command(FunctionId::ROBOT_EXECUTE, "slvMove", Effect::Moves, InSlaveMode::Allowed, SPEC),
    command(FunctionId::ROBOT_EXECUTE, "slvChangeMode", Effect::Moves, InSlaveMode::Allowed, SPEC),
    command(FunctionId::ROBOT_EXECUTE, "slvSendFormat", Effect::Writes, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "slvRecvFormat", Effect::Writes, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "TMul", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "TInv", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "TNorm", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "J2T", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "T2J", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "J2P", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "P2J", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "T2P", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "P2T", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "Dev", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DevH", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "OutRange", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "MPS", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "RPM", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DPS", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DestPos", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurPosEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DestPosEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "HighCurPosEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DestJnt", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurJntEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DestJntEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "HighCurJntEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurTrn", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DestTrn", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurTrnEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "DestTrnEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "HighCurTrnEx", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurFig", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurSpd", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurAcc", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurDec", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurJSpd", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurJAcc", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "CurJDec", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "StartLog", Effect::Writes, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "StopLog", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "ClearLog", Effect::Writes, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "Motor", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ExtSpeed", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "TakeArm", Effect::Moves, InSlaveMode::Refused, PRO),
    command(FunctionId::ROBOT_EXECUTE, "GiveArm", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "Draw", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "Approach", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "Depart", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "DriveEx", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "DriveAEx", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "RotateH", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "Arrive", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "MotionSkip", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "MotionComplete", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetToolDef", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetToolDef", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "CurWork", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetWorkDef", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetWorkDef", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "WorkAttribute", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetAreaDef", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetAreaDef", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "SetArea", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ResetArea", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "AreaSize", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetAreaEnabled", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetAreaEnabled", Effect::Moves, InSlaveMode::Refused, PRO),
    command(FunctionId::ROBOT_EXECUTE, "AddPathPoint", Effect::Writes, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ClrPathPoint", Effect::Writes, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "GetPathPoint", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "LoadPathPoint", Effect::Writes, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "GetPathPointCount", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetRobotTypeName", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "ArchMove", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "CrtMotionAllow", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "EncMotionAllow", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "EncMotionAllowJnt", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ErAlw", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ForceCtrl", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ForceParam", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ForceWaitCondition", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ForceSensor", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "ForceChangeTable", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "GetSrvJntData", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GrvCtrl", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "CurLmt", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "Zforce", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "GrvOffset", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "HighPathAccuracy", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "MotionTimeout", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "SingularAvoid", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "SpeedMode", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "PayLoad", Effect::Moves, InSlaveMode::Refused, GUIDE),
    command(FunctionId::ROBOT_EXECUTE, "GenerateNonStopPath", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "RobInfo", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetBaseDef", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SyncTimeStart", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SyncTimeEnd", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SyncMoveStart", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SyncMoveEnd", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetBaseDef", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetHandIO", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetHandIO", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "StartServoLog", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "ClearServoLog", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "StopServoLog", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetCtrlLogMaxTime", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetCtrlLogMaxTime", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "GetCtrlLogInterval", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "SetCtrlLogInterval", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::ROBOT_EXECUTE, "HighCurPos", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "HighCurJnt", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "HighCurTrn", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "CurExtSpd", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "CurExtAcc", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "CurExtDec", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "TakeArmState", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "GetMotionPreparationState", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "GetLogCount", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "GetLogRecord", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "ConvertPosWork", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "CheckVirtualFence", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "CurScene", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "CurSubScene", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "SceneInfo", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "GetTool", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "SetTool", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "ManualResetPreparation", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "MotionPreparation", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::ROBOT_EXECUTE, "AutoCal", Effect::Moves, InSlaveMode::Unknown, NONE),
    command(FunctionId::TASK_EXECUTE, "GetStatus", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::TASK_EXECUTE, "GetThreadPriority", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::TASK_EXECUTE, "SetThreadPriority", Effect::Writes, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "Chuck", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "UnChuck", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "Motor", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "Org", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "MoveP", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "MoveA", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "MoveR", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "MoveAH", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "MoveRH", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "MoveH", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "MoveZH", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "Stop", Effect::Moves, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "CurPos", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "GetPoint", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_EmgState", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_ZonState", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_OrgState", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_HoldState", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_InposState", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_Error", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_BusyState", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "get_MotorState", Effect::Reads, InSlaveMode::Unknown, UNMARKED),
    command(FunctionId::EXTENSION_EXECUTE, "State", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::EXTENSION_EXECUTE, "count", Effect::Reads, InSlaveMode::Unknown, NONE),
    command(FunctionId::EXTENSION_EXECUTE, "open", Effect::Writes, InSlaveMode::Unknown, NONE),
    command(FunctionId::EXTENSION_EXECUTE, "close", Effect::Writes, InSlaveMode::Unknown, NONE),
    command(FunctionId::EXTENSION_EXECUTE, "input", Effect::Writes, InSlaveMode::Unknown, NONE),
    command(FunctionId::EXTENSION_EXECUTE, "clear", Effect::Writes, InSlaveMode::Unknown, NONE),
    command(FunctionId::EXTENSION_EXECUTE, "CalcPos", Effect::Reads, InSlaveMode::Unknown, NONE),
];

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    #[test]
    fn a_function_has_its_properties_whatever_its_arguments_are() {
        let of = |function: FunctionId| (function.effect(), function.in_slave_mode());
        assert_eq!(of(FunctionId::SERVICE_START), (Effect::Session, InSlaveMode::Allowed));
        assert_eq!(of(FunctionId::VARIABLE_GET_VALUE), (Effect::Reads, InSlaveMode::Allowed));
        assert_eq!(of(FunctionId::VARIABLE_PUT_VALUE), (Effect::Writes, InSlaveMode::Unknown));
        assert_eq!(of(FunctionId::CONTROLLER_GET_NAME), (Effect::Reads, InSlaveMode::Unknown));
        assert_eq!(of(FunctionId::ROBOT_HALT), (Effect::Moves, InSlaveMode::Allowed));
        assert_eq!(of(FunctionId::ROBOT_MOVE), (Effect::Moves, InSlaveMode::Refused));
        assert_eq!(of(FunctionId::TASK_START), (Effect::Moves, InSlaveMode::Unknown));
        assert_eq!(of(FunctionId(138)), (Effect::Moves, InSlaveMode::Unknown));
        for function in FunctionId::all() {
            let name = function.name().unwrap();
            if function.releases().is_some() {
                assert_eq!(of(function), (Effect::Session, InSlaveMode::Allowed), "{name}");
            }
            if function.executes() {
                assert_eq!(function.properties(None, None), Properties::UNKNOWN, "{name}");
            }
            let object = function.signature().unwrap().object.name();
            let is_put = name.strip_prefix(object).unwrap().starts_with("Put");
            assert!(!is_put || function.effect() == Effect::Writes, "{name}");
        }
    }

    #[test]
    fn only_an_option_can_create_a_file() {
        for function in [FunctionId::CONTROLLER_GET_FILE, FunctionId::FILE_GET_FILE] {
            let effect = |option| function.properties(None, option).effect;
            assert_eq!([effect(None), effect(Some("@Create")), effect(Some(""))], {
                [Effect::Writes, Effect::Writes, Effect::Session]
            });
        }
    }

    #[test]
    fn a_command_is_found_in_any_case_and_an_unknown_one_may_move() {
        let robot = |name| FunctionId::ROBOT_EXECUTE.properties(Some(name), None);
        assert_eq!(robot(" curjnt "), Properties { effect: Effect::Reads, in_slave_mode: InSlaveMode::Allowed });
        assert_eq!(robot("takearm"), Properties { effect: Effect::Moves, in_slave_mode: InSlaveMode::Refused });
        assert_eq!(robot("SysState"), Properties::UNKNOWN, "a command of another object");
        assert_eq!(robot("NoSuchCommand"), Properties::UNKNOWN);
        // a text that is not a command name changes nothing
        assert_eq!(FunctionId::ROBOT_HALT.properties(Some("Motor"), None).in_slave_mode, InSlaveMode::Allowed);
    }

    #[test]
    fn each_command_is_listed_once() {
        for command in COMMANDS {
            assert!(command.function.executes(), "{}", command.name);
            assert_eq!(Command::find(command.function, command.name), Some(command), "{}", command.name);
            let has_source = command.source != NONE && command.source != UNMARKED;
            assert_eq!(has_source, command.properties.in_slave_mode != InSlaveMode::Unknown, "{}", command.name);
        }
    }

    #[test]
    fn observed_commands_have_the_observed_answer() {
        let in_slave_mode = |function: FunctionId, name| function.properties(Some(name), None).in_slave_mode;
        for name in
            ["slvGetMode", "slvMove", "slvChangeMode", "CurJnt", "CurPos", "CurTool", "GetSrvData", "ForceValue"]
        {
            assert_eq!(in_slave_mode(FunctionId::ROBOT_EXECUTE, name), InSlaveMode::Allowed, "{name}");
        }
        for name in ["StoState", "ManualReset", "HandMoveA"] {
            assert_eq!(in_slave_mode(FunctionId::CONTROLLER_EXECUTE, name), InSlaveMode::Allowed, "{name}");
        }
        for name in
            ["GetCurErrorCount", "GetCurErrorInfo", "SysState", "ClearError", "GetErrorDescription", "HandCurPos"]
        {
            assert_eq!(in_slave_mode(FunctionId::CONTROLLER_EXECUTE, name), InSlaveMode::Refused, "{name}");
        }
        let marked =
            FunctionId::ROBOT_EXECUTE.commands().filter(|c| c.properties.in_slave_mode == InSlaveMode::Refused);
        assert_eq!(marked.count(), 41, "the RC8 provider guide marks 41 commands of the robot");
    }
}
