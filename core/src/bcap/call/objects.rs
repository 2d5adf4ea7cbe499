//! The usual calls of an object, as methods of its handle.
//!
//! They are the functions of the [parent module](super) with an empty option, and the commands that every program of a
//! robot needs. Any connection can send them: blocking, tokio, embassy.

use super::{
    Any, Call, CommandHandle, ControllerHandle, ExtensionHandle, FileHandle, Nothing, RobotHandle, TaskHandle,
    VariableHandle, controller_disconnect, controller_execute, controller_get_command, controller_get_extension,
    controller_get_file, controller_get_robot, controller_get_task, controller_get_variable, extension_execute,
    extension_release, file_get_value, file_put_value, file_release, robot_change, robot_execute, robot_get_variable,
    robot_halt, robot_move, robot_release, task_execute, task_get_variable, task_release, task_start, task_stop,
    variable_get_value, variable_put_value, variable_release,
};
use crate::variant::Encode;

macro_rules! objects {
    ($($(#[$docs:meta])* $handle:ident {$(
        $(#[$help:meta])*
        $method:ident($($argument:ident: $kind:ty),*) -> $reply:ty = $call:ident($($passed:expr),*);
    )*})*) => {$(
        $(#[$docs])*
        impl $handle {$(
            $(#[$help])*
            #[doc = concat!("\n\n[`", stringify!($call), "`](super::", stringify!($call), ")")]
            #[must_use = "a call does nothing until a connection makes it"]
            pub fn $method(self, $($argument: $kind),*) -> impl Call<Reply = $reply> {
                $call(self, $($passed),*)
            }
        )*}
    )*};
}

objects! {
    /// # Examples
    ///
    /// ```no_run
    /// # fn example<X: bcap_core::io::blocking::Transport>(
    /// #     connection: &mut bcap_core::io::blocking::Connection<X, [u8; 512]>,
    /// #     controller: bcap_core::bcap::call::ControllerHandle,
    /// # ) -> Result<(), bcap_core::io::CallError<X::Error>> {
    /// let variable = connection.call(controller.variable("I1"))?;
    /// let value = connection.call(variable.get())?.as_i32();
    /// connection.call(variable.put(5_i32))?;
    /// # Ok(())
    /// # }
    /// ```
    ControllerHandle {
        /// Opens a variable.
        variable(name: &str) -> VariableHandle = controller_get_variable(name, "");
        /// Opens a robot.
        robot(name: &str) -> RobotHandle = controller_get_robot(name, "");
        /// Opens a task.
        task(name: &str) -> TaskHandle = controller_get_task(name, "");
        /// Opens a file.
        file(name: &str) -> FileHandle = controller_get_file(name, "");
        /// Opens an extension, such as a hand.
        extension(name: &str) -> ExtensionHandle = controller_get_extension(name, "");
        /// Opens a command object.
        command(name: &str) -> CommandHandle = controller_get_command(name, "");
        /// Executes a command.
        execute(command: &str, parameter: impl Encode) -> Any = controller_execute(command, parameter);
        /// Ends the session with the controller.
        disconnect() -> Nothing = controller_disconnect();
    }

    VariableHandle {
        /// Reads the value.
        get() -> Any = variable_get_value();
        /// Writes the value.
        put(value: impl Encode) -> Nothing = variable_put_value(value);
        /// Releases the variable.
        release() -> Nothing = variable_release();
    }

    RobotHandle {
        /// Opens a variable of the robot.
        variable(name: &str) -> VariableHandle = robot_get_variable(name, "");
        /// Takes the arm, `TakeArm`: with `keep` 0 speed, tool and work return to their defaults, with 1 they stay.
        take_arm(group: i32, keep: i32) -> Any = robot_execute("TakeArm", [group, keep]);
        /// Gives the arm back, `GiveArm`.
        give_arm() -> Any = robot_execute("GiveArm", ());
        /// Switches the motor on or off, `Motor`, and waits until it is.
        motor(on: bool) -> Any = robot_execute("Motor", [i32::from(on), 0]);
        /// Moves. Without `NEXT` in the option the reply arrives at the end of the motion. Dropping the call stops nothing;
        /// [`move_and_wait`](crate::procedure::move_and_wait) halts the robot when it fails.
        move_to(interpolation: i32, pose: impl Encode, option: &str) -> Nothing = robot_move(interpolation, pose, option);
        /// Halts the robot.
        halt() -> Nothing = robot_halt("");
        /// Selects a tool or a work coordinate system, such as `Tool1` or `Work0`.
        change(name: &str) -> Nothing = robot_change(name);
        /// Executes a command.
        execute(command: &str, parameter: impl Encode) -> Any = robot_execute(command, parameter);
        /// Releases the robot.
        release() -> Nothing = robot_release();
    }

    TaskHandle {
        /// Opens a variable of the task.
        variable(name: &str) -> VariableHandle = task_get_variable(name, "");
        /// Starts the task; its program may move the robot.
        start(mode: i32) -> Nothing = task_start(mode, "");
        /// Stops the task.
        stop(mode: i32) -> Nothing = task_stop(mode, "");
        /// Executes a command.
        execute(command: &str, parameter: impl Encode) -> Any = task_execute(command, parameter);
        /// Releases the task.
        release() -> Nothing = task_release();
    }

    FileHandle {
        /// Reads the content.
        read() -> Any = file_get_value();
        /// Replaces the content.
        write(content: impl Encode) -> Nothing = file_put_value(content);
        /// Releases the file.
        release() -> Nothing = file_release();
    }

    ExtensionHandle {
        /// Executes a command.
        execute(command: &str, parameter: impl Encode) -> Any = extension_execute(command, parameter);
        /// Releases the extension.
        release() -> Nothing = extension_release();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bcap::{Decoder, FrameWriter, FunctionId};

    /// Returns the function, the number of arguments and the handle of a call.
    fn sent(call: impl Call) -> (FunctionId, usize, i32) {
        let mut buffer = [0; 256];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        call.arguments(&mut frame).unwrap();
        let bytes = frame.finish(1, 0, call.function().0).unwrap();
        let frame = Decoder::TCP.decode_datagram(bytes).unwrap();
        let handle = frame.args.get(0).and_then(|value| value.as_i32()).unwrap();
        (frame.function(), frame.args.iter().count(), handle)
    }

    #[test]
    fn methods_make_the_calls_of_their_names() {
        let (controller, robot) = (ControllerHandle(3), RobotHandle(4));
        assert_eq!(sent(controller.variable("I1")), (FunctionId::CONTROLLER_GET_VARIABLE, 3, 3));
        assert_eq!(sent(VariableHandle(5).put(7_i32)), (FunctionId::VARIABLE_PUT_VALUE, 2, 5));
        assert_eq!(sent(robot.halt()), (FunctionId::ROBOT_HALT, 2, 4));
        assert_eq!(sent(robot.move_to(1, "@E P1", "NEXT")), (FunctionId::ROBOT_MOVE, 4, 4));
        assert_eq!(sent(TaskHandle(6).start(1)), (FunctionId::TASK_START, 3, 6));
        assert_eq!(sent(robot.motor(true)), (FunctionId::ROBOT_EXECUTE, 3, 4));
        assert_eq!(sent(robot.take_arm(0, 1)), (FunctionId::ROBOT_EXECUTE, 3, 4));
        assert_eq!(sent(FileHandle(8).read()), (FunctionId::FILE_GET_VALUE, 1, 8));
    }
}
