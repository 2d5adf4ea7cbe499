//! The preconditions of each call, apart from valid arguments. The code reads these rules; `docs/virtual-controller.md`
//! has them as a table.
//!
//! The conditions of a rule are checked in the order of the fields of [`Rule`], after the emergency stop.

/// The conditions of some calls.
#[derive(Debug)]
pub(crate) struct Rule {
    /// The functions, the commands and the system variables, as the table names them.
    calls: &'static str,
    /// Auto mode, otherwise [`MANUAL_MODE`](crate::codes::MANUAL_MODE).
    pub(crate) auto: bool,
    /// The executable token, otherwise `E_TOKEN_NOT_ETHERNET` or `E_TOKEN_ADDRESS`.
    pub(crate) token: bool,
    /// Whether the token is also needed on a model with a preparation: a COBOTTA allowed TakeArm and its preparation without
    /// the token.
    pub(crate) token_of_cobotta: bool,
    /// A released emergency stop, which is checked first, otherwise [`EMERGENCY_STOP`](crate::codes::EMERGENCY_STOP); and no
    /// error, otherwise `E_ERROR_PRESENT`, or [`FAULT_PRESENT`](crate::codes::FAULT_PRESENT) after one of level 5.
    pub(crate) no_error: bool,
    /// The arm authority, otherwise `E_ARM_NOT_TAKEN`.
    pub(crate) arm: Authority,
    /// The motor is on, otherwise `E_MOTOR_OFF`.
    pub(crate) motor: bool,
    /// Nothing moves the arm, otherwise `E_ROBOTISBUSY`.
    pub(crate) rest: bool,
}

/// The permitted owner of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Authority {
    /// Any client.
    Any,
    /// No other client.
    Free,
    /// The client of the call.
    Own,
}

impl Rule {
    /// Returns whether a function or a command is one of the calls.
    pub(crate) fn concerns(&self, name: &str) -> bool {
        self.calls.split(", ").any(|call| call.eq_ignore_ascii_case(name.trim()))
    }
}

const NOTHING: Rule = Rule {
    calls: "",
    auto: false,
    token: false,
    token_of_cobotta: true,
    no_error: false,
    arm: Authority::Any,
    motor: false,
    rest: false,
};

const EXECUTION: Rule = Rule { auto: true, token: true, no_error: true, ..NOTHING };

/// Motions. The arm must be at rest, but a motion of the client whose motion runs joins the queue.
pub(crate) const MOTION: Rule = Rule {
    calls: "Robot_Move, Robot_Drive, Robot_Rotate, Robot_GoHome, DriveEx, DriveAEx, Approach, Depart, RotateH, Draw, ArchMove",
    arm: Authority::Own,
    motor: true,
    rest: true,
    ..EXECUTION
};

/// Entering Slave Mode.
pub(crate) const ENTER_SLAVE_MODE: Rule = Rule { calls: "slvChangeMode", ..MOTION };

/// A pose of Slave Mode, which this client has entered. The end of Auto mode ends Slave Mode, so it is not checked here.
pub(crate) const SLAVE_MOVE: Rule = Rule { calls: "slvMove", token: true, ..NOTHING };

/// Taking the arm.
pub(crate) const TAKE_ARM: Rule = Rule { calls: "TakeArm", arm: Authority::Free, token_of_cobotta: false, ..EXECUTION };

/// Switching the motor on.
pub(crate) const MOTOR_ON: Rule = Rule { calls: "Motor 1, @SERVO_ON true", ..EXECUTION };

/// Switching the motor off.
pub(crate) const MOTOR_OFF: Rule =
    Rule { calls: "Motor 0, @SERVO_ON false", auto: true, token: true, token_of_cobotta: false, ..NOTHING };

/// Continuing a held motion.
pub(crate) const UNHOLD: Rule = Rule { calls: "Robot_Unhold", ..EXECUTION };

/// Starting a task.
pub(crate) const START_TASK: Rule = Rule { calls: "Task_Start, File_Run", ..EXECUTION };

/// The hand.
pub(crate) const HAND: Rule = Rule {
    calls: "Robot_Chuck, Robot_Unchuck, HandMoveA, HandMoveR, HandMoveH, HandMoveAH, HandMoveVH, Chuck, UnChuck, Org, MoveP, MoveA, MoveR, MoveAH, MoveRH, MoveH, MoveZH",
    ..EXECUTION
};

/// The preparation of a COBOTTA. A public program sends it before ClearError.
pub(crate) const MOTION_PREPARATION: Rule = Rule { calls: "MotionPreparation", no_error: false, ..CALIBRATION };

/// The calibration of a COBOTTA.
pub(crate) const CALIBRATION: Rule = Rule { calls: "AutoCal", token_of_cobotta: false, ..EXECUTION };

/// Settings of the arm. A client may change them unless another client owns the arm.
pub(crate) const SETTING: Rule = Rule {
    calls: "Robot_Speed, Robot_Accelerate, Robot_Change, MotionSkip, Arrive, PayLoad, SpeedMode, CrtMotionAllow, EncMotionAllow, EncMotionAllowJnt, ErAlw, GrvCtrl, GrvOffset, HighPathAccuracy, CurLmt, Zforce, MotionTimeout, SingularAvoid, SetAreaDef, SetArea, ResetArea, SetAreaEnabled, AddPathPoint, ClrPathPoint, LoadPathPoint, @CURRENT_TOOL, @CURRENT_WORK, @SPEED, @ACCEL, @DECEL, @JSPEED, @JACCEL, @JDECEL",
    arm: Authority::Free,
    ..NOTHING
};

/// Definitions of tools and work coordinates.
pub(crate) const DEFINITION: Rule =
    Rule { calls: "SetToolDef, SetWorkDef, SetBaseDef", arm: Authority::Own, ..NOTHING };

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: [&Rule; 13] = [
        &MOTION,
        &ENTER_SLAVE_MODE,
        &SLAVE_MOVE,
        &TAKE_ARM,
        &MOTOR_ON,
        &MOTOR_OFF,
        &UNHOLD,
        &START_TASK,
        &HAND,
        &MOTION_PREPARATION,
        &CALIBRATION,
        &SETTING,
        &DEFINITION,
    ];

    #[test]
    fn the_table_of_the_page_is_this_one() {
        let page = include_str!("../../../docs/virtual-controller.md");
        let section = page.split("\n## ").find(|section| section.starts_with("Conditions")).expect("the heading");
        let rows: Vec<Vec<_>> = section
            .lines()
            .filter(|line| line.starts_with('|'))
            .skip(2)
            .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
            .collect();
        let cells = RULES.map(|rule| {
            let needs = |needed: bool| if needed { "yes" } else { "-" };
            let arm = match rule.arm {
                Authority::Any => "-",
                Authority::Free => "free",
                Authority::Own => "own",
            };
            let [auto, no_error] = [rule.auto, rule.no_error].map(needs);
            let token = if rule.token && !rule.token_of_cobotta { "not COBOTTA" } else { needs(rule.token) };
            vec![rule.calls, auto, token, no_error, arm, needs(rule.motor), needs(rule.rest)]
        });
        assert_eq!(rows, cells);
    }
}
