//! The rows of the table: each function of b-CAP with its help.
//!
//! The help of a row is Markdown: one sentence on one line, then a list of the arguments, the value of the reply, and
//! the controllers. It becomes the documentation of the typed call and [`FunctionId::help`](super::FunctionId::help).
//! It names the types of the wire. "All" controllers are RC8, RC9 and COBOTTA; "listed for all" means that the table of
//! the specification has the function, but neither its examples nor known public programs call it (b-CAP specification,
//! Appendix A). Where the specification does not define a number, a unit or a text, the help says so, and names what
//! the virtual controller (`bcap-sim`) takes.

/// Passes the table to another macro; a row is
/// `/// help` and `number CONSTANT method "Name" Object (argument: kind, ...) result, effect in_slave_mode;`.
///
/// Kinds of arguments: an object (its handle), `Int` (I4), `Float` (R4), `Text` (BSTR), `Any` (VARIANT). Results:
/// the same, `Nothing`, and `Maybe` where only some controllers return one. The last two columns are an
/// `Effect` and an `InSlaveMode`; the module `effect` has their sources.
macro_rules! for_each_function {
    ($receiver:ident) => {
        $receiver! {
            /// Starts the service of the controller for this client; the first call of a session.
            ///
            /// * `option`: `KEY=VALUE` pairs with commas between them; may be empty. A value below 80 is refused with
            ///   E_INVALIDARG.
            ///   * `WDT=`: the interval of the keep-alives (S_EXECUTING) that the server sends during a long call, in
            ///     ms: at least 80, and less than the client's timeout. Without it there are no keep-alives, and a call
            ///     that takes longer than the timeout fails at the client while the controller continues it.
            ///   * `InvokeTimeout=`: the time limit of one call, in ms: at least 80, 180000 by default. It is not in
            ///     the specification, but in the vendor's library and drivers.
            /// * Returns no value.
            /// * Controllers: all (b-CAP specification, section 4.1.1).
            1 SERVICE_START service_start "ServiceStart" Service (option: Text) Nothing, Session Allowed;

            /// Stops the service of the controller for this client; the last call of a session.
            ///
            /// * Returns no value.
            /// * Over UDP a server has no other way to learn that the client has left, so the call is essential there
            ///   (b-CAP specification, section 4.1.7).
            /// * Controllers: all (b-CAP specification, section 4.1.5).
            2 SERVICE_STOP service_stop "ServiceStop" Service () Nothing, Session Allowed;

            /// Connects to the controller through one of its providers.
            ///
            /// * `name`: any name for the controller object, such as `b-CAP`; may be empty.
            /// * `provider`: `CaoProv.DENSO.VRC` for RC8 and COBOTTA, `CaoProv.DENSO.VRC9` for RC9 and COBOTTA PRO.
            /// * `machine`: `localhost`, or the IP address of the controller.
            /// * `option`: connection options; may be empty. Public programs send `@IfNotMember`.
            /// * Returns the handle of the controller (I4), to be released with Controller_Disconnect.
            /// * Controllers: all (b-CAP specification, section 4.1.2).
            3 CONTROLLER_CONNECT controller_connect "ControllerConnect" Controller (name: Text, provider: Text, machine: Text, option: Text) Controller, Session Allowed;

            /// Disconnects from the controller and releases its handle.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * Returns no value.
            /// * Release the objects of the controller first, in reverse order of opening.
            /// * Controllers: all (b-CAP specification, section 4.1.4).
            4 CONTROLLER_DISCONNECT controller_disconnect "ControllerDisconnect" Controller (controller: Controller) Nothing, Session Allowed;

            /// Opens an extension of the controller, such as an electric hand.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `name`: the name of the extension, one of Controller_GetExtensionNames; `Hand0` and `Comm` in
            ///   public programs.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the handle of the extension (I4), to be released with Extension_Release.
            /// * Controllers: all.
            5 CONTROLLER_GET_EXTENSION controller_get_extension "ControllerGetExtension" Controller (controller: Controller, name: Text, option: Text) Extension, Session Unknown;

            /// Opens a file or a folder of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `name`: the path of the file; the name of a folder ends with a backslash.
            /// * `option`: an option string; public programs send `@Create=1` to create a file that does not exist.
            /// * Returns the handle of the file (I4), to be released with File_Release.
            /// * Controllers: all.
            6 CONTROLLER_GET_FILE controller_get_file "ControllerGetFile" Controller (controller: Controller, name: Text, option: Text) File, Writes Unknown;

            /// Opens the robot, the object for motions and for the state of the arm.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `name`: the name of the robot; `Arm` in the specification, or one of Controller_GetRobotNames.
            /// * `option`: an option string; may be empty. Public programs send `ID=0` or `ID=1` to choose one of
            ///   several arms, and `@IfNotMember`.
            /// * Returns the handle of the robot (I4), to be released with Robot_Release.
            /// * Controllers: all (b-CAP specification, section 4.3.1).
            7 CONTROLLER_GET_ROBOT controller_get_robot "ControllerGetRobot" Controller (controller: Controller, name: Text, option: Text) Robot, Session Allowed;

            /// Opens a task, a program of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `name`: the name of the task, such as `Pro1`, one of Controller_GetTaskNames.
            /// * `option`: an option string; the specification lists no options, its packets send an empty string.
            /// * Returns the handle of the task (I4), to be released with Task_Release.
            /// * Controllers: all (b-CAP specification, section 4.2.1).
            8 CONTROLLER_GET_TASK controller_get_task "ControllerGetTask" Controller (controller: Controller, name: Text, option: Text) Task, Session Unknown;

            /// Opens a user variable or a system variable of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `name`: the name of the variable, in any case: `I1` or `I[1]` (also F D S V P J T, IO, IOB, IOW,
            ///   IOD, IOF), `I*` for all of a kind with Variable_PutID as index, or a system variable such as
            ///   `@MODE`, `@ERROR_CODE`, `@VAR_I_LEN`.
            /// * `option`: an option string; the specification lists no options, its packets send an empty string.
            /// * Returns the handle of the variable (I4), to be released with Variable_Release.
            /// * Controllers: all (b-CAP specification, sections 4.1.2 and 4.1.6).
            9 CONTROLLER_GET_VARIABLE controller_get_variable "ControllerGetVariable" Controller (controller: Controller, name: Text, option: Text) Variable, Session Allowed;

            /// Opens a command object, which keeps a command with its parameters and its result.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `name`: the name of the command, one of Controller_GetCommandNames.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the handle of the command (I4), to be released with Command_Release.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            10 CONTROLLER_GET_COMMAND controller_get_command "ControllerGetCommand" Controller (controller: Controller, name: Text, option: Text) Command, Session Unknown;

            /// Lists the names of the extensions of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Controller_GetExtension (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            11 CONTROLLER_GET_EXTENSION_NAMES controller_get_extension_names "ControllerGetExtensionNames" Controller (controller: Controller, option: Text) Any, Reads Unknown;

            /// Lists the names of the files of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Controller_GetFile (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: all.
            12 CONTROLLER_GET_FILE_NAMES controller_get_file_names "ControllerGetFileNames" Controller (controller: Controller, option: Text) Any, Reads Unknown;

            /// Lists the names of the robots of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Controller_GetRobot (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: all.
            13 CONTROLLER_GET_ROBOT_NAMES controller_get_robot_names "ControllerGetRobotNames" Controller (controller: Controller, option: Text) Any, Reads Unknown;

            /// Lists the names of the tasks of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Controller_GetTask (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: all.
            14 CONTROLLER_GET_TASK_NAMES controller_get_task_names "ControllerGetTaskNames" Controller (controller: Controller, option: Text) Any, Reads Unknown;

            /// Lists the names of the variables of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Controller_GetVariable (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            15 CONTROLLER_GET_VARIABLE_NAMES controller_get_variable_names "ControllerGetVariableNames" Controller (controller: Controller, option: Text) Any, Reads Unknown;

            /// Lists the names of the commands of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Controller_GetCommand (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            16 CONTROLLER_GET_COMMAND_NAMES controller_get_command_names "ControllerGetCommandNames" Controller (controller: Controller, option: Text) Any, Reads Unknown;

            /// Executes a command of the controller's provider.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `command`: the name of the command, in any case. Public programs use ClearError,
            ///   GetErrorDescription, GetCurErrorCount, GetCurErrorInfo, GetErrorLogCount, GetErrorLog, SysState
            ///   and SysInfo.
            /// * `param`: the parameter of the command, EMPTY without one: an I4 code for GetErrorDescription, an
            ///   I4 index for GetCurErrorInfo and GetErrorLog.
            /// * Returns the result of the command (VARIANT): EMPTY for ClearError, BSTR for GetErrorDescription,
            ///   I4 for the counts and for SysState (bits), an array for GetCurErrorInfo and GetErrorLog.
            /// * In Slave Mode the controller refuses most commands; ClearError comes after its end (b-CAP
            ///   specification, sections 5.1 and 5.7).
            /// * Controllers: all; StoState and ManualReset on RC9 and COBOTTA, ManualResetPreparation and the HandMove
            ///   commands on COBOTTA (b-CAP specification, sections 4.3.6 and 5.7).
            17 CONTROLLER_EXECUTE controller_execute "ControllerExecute" Controller (controller: Controller, command: Text, param: Any) Any, Moves Unknown;

            /// Fetches the next message (event) of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * Returns the handle of the message (I4), to be released with Message_Release. In the virtual
            ///   controller the code is S_FALSE, without a handle, if there is no message.
            /// * The server does not send messages by itself; clients poll for them (b-CAP specification, section 1).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            18 CONTROLLER_GET_MESSAGE controller_get_message "ControllerGetMessage" Controller (controller: Controller) Message, Reads Unknown;

            /// Reads the attribute value of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * Returns the attribute (I4); the specification does not define its values.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            19 CONTROLLER_GET_ATTRIBUTE controller_get_attribute "ControllerGetAttribute" Controller (controller: Controller) Int, Reads Unknown;

            /// Reads the help text of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            20 CONTROLLER_GET_HELP controller_get_help "ControllerGetHelp" Controller (controller: Controller) Text, Reads Unknown;

            /// Reads the name of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * Returns the name (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            21 CONTROLLER_GET_NAME controller_get_name "ControllerGetName" Controller (controller: Controller) Text, Reads Unknown;

            /// Reads the tag of the controller, information that a client attaches to it.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * Returns the tag (VARIANT), the value of Controller_PutTag.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            22 CONTROLLER_GET_TAG controller_get_tag "ControllerGetTag" Controller (controller: Controller) Any, Reads Unknown;

            /// Sets the tag of the controller, information that a client attaches to it.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `value`: the tag, any VARIANT; Controller_GetTag returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            23 CONTROLLER_PUT_TAG controller_put_tag "ControllerPutTag" Controller (controller: Controller, value: Any) Nothing, Writes Unknown;

            /// Reads the ID of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * Returns the ID (VARIANT), the value of Controller_PutID.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            24 CONTROLLER_GET_ID controller_get_id "ControllerGetID" Controller (controller: Controller) Any, Reads Unknown;

            /// Sets the ID of the controller.
            ///
            /// * `controller`: its handle, from Controller_Connect.
            /// * `value`: the ID, any VARIANT; Controller_GetID returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            25 CONTROLLER_PUT_ID controller_put_id "ControllerPutID" Controller (controller: Controller, value: Any) Nothing, Writes Unknown;

            /// Opens a variable of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * `name`: the name of the variable, one of Extension_GetVariableNames.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the handle of the variable (I4), to be released with Variable_Release.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            26 EXTENSION_GET_VARIABLE extension_get_variable "ExtensionGetVariable" Extension (extension: Extension, name: Text, option: Text) Variable, Session Unknown;

            /// Lists the names of the variables of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Extension_GetVariable (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            27 EXTENSION_GET_VARIABLE_NAMES extension_get_variable_names "ExtensionGetVariableNames" Extension (extension: Extension, option: Text) Any, Reads Unknown;

            /// Executes a command of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * `command`: the name of the command, in any case: for an electric hand such as `Hand0` public
            ///   programs use Chuck, UnChuck and CurPos.
            /// * `param`: the parameter of the command; EMPTY without one.
            /// * Returns the result of the command (VARIANT): the distance of the fingers in mm for CurPos in the
            ///   virtual controller.
            /// * Controllers: all; the commands depend on the extension.
            28 EXTENSION_EXECUTE extension_execute "ExtensionExecute" Extension (extension: Extension, command: Text, param: Any) Any, Moves Unknown;

            /// Reads the attribute value of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * Returns the attribute (I4); the specification does not define its values.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            29 EXTENSION_GET_ATTRIBUTE extension_get_attribute "ExtensionGetAttribute" Extension (extension: Extension) Int, Reads Unknown;

            /// Reads the help text of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            30 EXTENSION_GET_HELP extension_get_help "ExtensionGetHelp" Extension (extension: Extension) Text, Reads Unknown;

            /// Reads the name of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * Returns the name (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            31 EXTENSION_GET_NAME extension_get_name "ExtensionGetName" Extension (extension: Extension) Text, Reads Unknown;

            /// Reads the tag of the extension, information that a client attaches to it.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * Returns the tag (VARIANT), the value of Extension_PutTag.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            32 EXTENSION_GET_TAG extension_get_tag "ExtensionGetTag" Extension (extension: Extension) Any, Reads Unknown;

            /// Sets the tag of the extension, information that a client attaches to it.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * `value`: the tag, any VARIANT; Extension_GetTag returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            33 EXTENSION_PUT_TAG extension_put_tag "ExtensionPutTag" Extension (extension: Extension, value: Any) Nothing, Writes Unknown;

            /// Reads the ID of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * Returns the ID (VARIANT), the value of Extension_PutID.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            34 EXTENSION_GET_ID extension_get_id "ExtensionGetID" Extension (extension: Extension) Any, Reads Unknown;

            /// Sets the ID of the extension.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * `value`: the ID, any VARIANT; Extension_GetID returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            35 EXTENSION_PUT_ID extension_put_id "ExtensionPutID" Extension (extension: Extension, value: Any) Nothing, Writes Unknown;

            /// Releases the extension; its handle is then invalid.
            ///
            /// * `extension`: its handle, from Controller_GetExtension.
            /// * Returns no value.
            /// * Controllers: all.
            36 EXTENSION_RELEASE extension_release "ExtensionRelease" Extension (extension: Extension) Nothing, Session Allowed;

            /// Opens another file, whose path is relative to the file or folder.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `name`: the name of the other file; the name of a folder ends with a backslash.
            /// * `option`: an option string, as for Controller_GetFile.
            /// * Returns the handle of the other file (I4), to be released with File_Release.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            37 FILE_GET_FILE file_get_file "FileGetFile" File (file: File, name: Text, option: Text) File, Writes Unknown;

            /// Opens a variable of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `name`: the name of the variable, one of File_GetVariableNames.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the handle of the variable (I4), to be released with Variable_Release.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            38 FILE_GET_VARIABLE file_get_variable "FileGetVariable" File (file: File, name: Text, option: Text) Variable, Session Unknown;

            /// Lists the names of the files in the folder.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for File_GetFile (VARIANT; an array of BSTR in the virtual controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            39 FILE_GET_FILE_NAMES file_get_file_names "FileGetFileNames" File (file: File, option: Text) Any, Reads Unknown;

            /// Lists the names of the variables of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for File_GetVariable (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            40 FILE_GET_VARIABLE_NAMES file_get_variable_names "FileGetVariableNames" File (file: File, option: Text) Any, Reads Unknown;

            /// Executes a command of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `command`: the name of the command; the specification lists no commands.
            /// * `param`: the parameter of the command; EMPTY without one.
            /// * Returns the result of the command (VARIANT).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            41 FILE_EXECUTE file_execute "FileExecute" File (file: File, command: Text, param: Any) Any, Moves Unknown;

            /// Copies the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `name`: the path of the copy. In the virtual controller it starts at the root, must not exist, and
            ///   may end with a backslash to name the folder only.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            42 FILE_COPY file_copy "FileCopy" File (file: File, name: Text, option: Text) Nothing, Writes Unknown;

            /// Deletes the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * The virtual controller deletes a folder only if it is empty.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            43 FILE_DELETE file_delete "FileDelete" File (file: File, option: Text) Nothing, Writes Unknown;

            /// Moves the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `name`: the new path, as for File_Copy.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            44 FILE_MOVE file_move "FileMove" File (file: File, name: Text, option: Text) Nothing, Writes Unknown;

            /// Executes the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns a string (BSTR); the specification does not say which.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            45 FILE_RUN file_run "FileRun" File (file: File, option: Text) Text, Moves Unknown;

            /// Reads the date and time at which the file was created.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the date (VARIANT; in the virtual controller a DATE: days since 1899-12-30 of the
            ///   controller's wall clock, without a time zone).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            46 FILE_GET_DATE_CREATED file_get_date_created "FileGetDateCreated" File (file: File) Any, Reads Unknown;

            /// Reads the date and time of the last access to the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the date (VARIANT; in the virtual controller a DATE: days since 1899-12-30 of the
            ///   controller's wall clock, without a time zone).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            47 FILE_GET_DATE_LAST_ACCESSED file_get_date_last_accessed "FileGetDateLastAccessed" File (file: File) Any, Reads Unknown;

            /// Reads the date and time of the last change of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the date (VARIANT; in the virtual controller a DATE: days since 1899-12-30 of the
            ///   controller's wall clock, without a time zone).
            /// * Controllers: all.
            48 FILE_GET_DATE_LAST_MODIFIED file_get_date_last_modified "FileGetDateLastModified" File (file: File) Any, Reads Unknown;

            /// Reads the path of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the path (BSTR): in the virtual controller the folder that contains the file, from the
            ///   root.
            /// * Controllers: all.
            49 FILE_GET_PATH file_get_path "FileGetPath" File (file: File) Text, Reads Unknown;

            /// Reads the size of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the size (I4), in bytes in the virtual controller.
            /// * Controllers: all.
            50 FILE_GET_SIZE file_get_size "FileGetSize" File (file: File) Int, Reads Unknown;

            /// Reads the type of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the type (BSTR): in the virtual controller the extension of the name, or `Folder`.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            51 FILE_GET_TYPE file_get_type "FileGetType" File (file: File) Text, Reads Unknown;

            /// Reads the content of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the content (VARIANT): BSTR for a text. The virtual controller returns an array of UI1 for
            ///   bytes that are not UTF-8.
            /// * Controllers: all.
            52 FILE_GET_VALUE file_get_value "FileGetValue" File (file: File) Any, Reads Unknown;

            /// Replaces the content of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `value`: the new content: BSTR; the virtual controller also accepts an array of UI1.
            /// * Returns no value.
            /// * The controller must permit writing (communication permission, b-CAP specification, section 3.1).
            /// * Controllers: all.
            53 FILE_PUT_VALUE file_put_value "FilePutValue" File (file: File, value: Any) Nothing, Writes Unknown;

            /// Reads the attribute value of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the attribute (I4); the specification does not define its values. The virtual controller
            ///   adds 1 for read-only and 16 for a folder.
            /// * Controllers: all.
            54 FILE_GET_ATTRIBUTE file_get_attribute "FileGetAttribute" File (file: File) Int, Reads Unknown;

            /// Reads the help text of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            55 FILE_GET_HELP file_get_help "FileGetHelp" File (file: File) Text, Reads Unknown;

            /// Reads the name of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the name (BSTR).
            /// * Controllers: all.
            56 FILE_GET_NAME file_get_name "FileGetName" File (file: File) Text, Reads Unknown;

            /// Reads the tag of the file, information that a client attaches to it.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the tag (VARIANT), the value of File_PutTag.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            57 FILE_GET_TAG file_get_tag "FileGetTag" File (file: File) Any, Reads Unknown;

            /// Sets the tag of the file, information that a client attaches to it.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `value`: the tag, any VARIANT; File_GetTag returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            58 FILE_PUT_TAG file_put_tag "FilePutTag" File (file: File, value: Any) Nothing, Writes Unknown;

            /// Reads the ID of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns the ID (VARIANT), the value of File_PutID.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            59 FILE_GET_ID file_get_id "FileGetID" File (file: File) Any, Reads Unknown;

            /// Sets the ID of the file.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * `value`: the ID, any VARIANT; File_GetID returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            60 FILE_PUT_ID file_put_id "FilePutID" File (file: File, value: Any) Nothing, Writes Unknown;

            /// Releases the file; its handle is then invalid.
            ///
            /// * `file`: its handle, from Controller_GetFile or File_GetFile.
            /// * Returns no value.
            /// * Controllers: all.
            61 FILE_RELEASE file_release "FileRelease" File (file: File) Nothing, Session Allowed;

            /// Opens a system variable of the robot.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `name`: the name of the variable, in any case: `@CURRENT_POSITION` and `@CURRENT_ANGLE` (R8
            ///   arrays, mm and degrees), `@SERVO_ON` and `@BUSY_STATUS` (BOOL), `@TYPE_NAME` (BSTR), `@SPEED`
            ///   (R4), `@EXTSPEED` (R4), or another one of Robot_GetVariableNames.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the handle of the variable (I4), to be released with Variable_Release.
            /// * Controllers: all.
            62 ROBOT_GET_VARIABLE robot_get_variable "RobotGetVariable" Robot (robot: Robot, name: Text, option: Text) Variable, Session Allowed;

            /// Lists the names of the variables of the robot.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Robot_GetVariable (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            63 ROBOT_GET_VARIABLE_NAMES robot_get_variable_names "RobotGetVariableNames" Robot (robot: Robot, option: Text) Any, Reads Unknown;

            /// Executes a command of the robot's provider.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `command`: the name of the command, in any case: TakeArm and GiveArm (arm authority), Motor,
            ///   ExtSpeed, CurPos, CurJnt, CurTrn (present pose), slvChangeMode, slvGetMode, slvMove, slvSendFormat
            ///   and slvRecvFormat (Slave Mode), and others.
            /// * `param`: the parameter of the command, EMPTY without one.
            ///   * TakeArm: arm group and keep (I4 array), such as `[0, 0]`; keep 0 resets speed, tool and work.
            ///   * Motor: state (1 on, 0 off) and no-wait (I4 array), such as `[1, 0]`.
            ///   * ExtSpeed: speed, or an array of speed, acceleration and deceleration, in percent.
            ///   * slvChangeMode: the mode (I4), 0 to leave Slave Mode.
            /// * Returns the result of the command (VARIANT): EMPTY for TakeArm, GiveArm and Motor; an R8 array for
            ///   CurPos (X Y Z in mm, RX RY RZ in degrees, figure), CurJnt (8 joints in degrees or mm) and CurTrn.
            /// * Motor on and motions need Auto mode and the executable token (b-CAP specification, sections 3.1 and
            ///   3.2). In Slave Mode the controller accepts only slvGetMode and slvMove, and slvChangeMode to leave it
            ///   (b-CAP specification, section 5.1, footnote 3).
            /// * Some commands move the robot. A client that stops waiting for the reply does not stop the motion.
            ///   Robot_Halt does, over a second connection while this one waits.
            /// * Controllers: all; Slave Mode is a licensed option (b-CAP specification, section 1.3);
            ///   MotionPreparation, AutoCal and ManualResetPreparation on COBOTTA (b-CAP specification, sections 4.3.2,
            ///   4.3.3 and 5.2).
            64 ROBOT_EXECUTE robot_execute "RobotExecute" Robot (robot: Robot, command: Text, param: Any) Any, Moves Unknown;

            /// Sets the internal acceleration and deceleration of the robot: the statement ACCEL.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `axis`: the number is not specified. The virtual controller takes -1 as ACCEL, for lines and joints,
            ///   and 0 as JACCEL, for joints only.
            /// * `accel`: the acceleration, in percent: 0.0001 to 100 in the virtual controller; the specification
            ///   gives no unit.
            /// * `decel`: the deceleration, as `accel`.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            65 ROBOT_ACCELERATE robot_accelerate "RobotAccelerate" Robot (robot: Robot, axis: Int, accel: Float, decel: Float) Nothing, Moves Refused;

            /// Selects a tool or a work coordinate system: the statement CHANGE.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `name`: `Tool` or `Work` with a number, such as `Tool1` or `Work0` in public drivers; 0 to 63 in the
            ///   virtual controller.
            /// * Returns no value.
            /// * Controllers: all.
            66 ROBOT_CHANGE robot_change "RobotChange" Robot (robot: Robot, name: Text) Nothing, Moves Refused;

            /// Closes the hand: the statement GRASP.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            67 ROBOT_CHUCK robot_chuck "RobotChuck" Robot (robot: Robot, option: Text) Nothing, Moves Unknown;

            /// Moves one axis by a distance: the statement DRIVE.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `number`: the number of the axis, from 1.
            /// * `distance`: the relative distance; in the virtual controller in degrees for a rotating axis and in mm
            ///   for a linear one.
            /// * `option`: motion options, as for Robot_Move.
            /// * Returns no value.
            /// * Needs Auto mode, the executable token for this client, no error, the arm authority (TakeArm) and the
            ///   motor on (b-CAP specification, sections 3, 4.3.2 and 4.3.3).
            /// * A client that stops waiting for the reply does not stop the motion. Robot_Halt does, over a second
            ///   connection while this one waits.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            68 ROBOT_DRIVE robot_drive "RobotDrive" Robot (robot: Robot, number: Int, distance: Float, option: Text) Nothing, Moves Unknown;

            /// Moves the robot to its home position: the statement GOHOME.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * Returns no value.
            /// * Needs Auto mode, the executable token for this client, no error, the arm authority (TakeArm) and the
            ///   motor on (b-CAP specification, sections 3, 4.3.2 and 4.3.3).
            /// * A client that stops waiting for the reply does not stop the motion. Robot_Halt does, over a second
            ///   connection while this one waits.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            69 ROBOT_GO_HOME robot_go_home "RobotGoHome" Robot (robot: Robot) Nothing, Moves Unknown;

            /// Halts the motion of the robot: the statement HALT.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `option`: an option string; the specification lists no options, its packets send an empty string.
            /// * Returns no value.
            /// * It halts a motion that Robot_Move has started with the option NEXT (b-CAP specification, section
            ///   4.3.4). A motion without NEXT blocks its connection until its end; halt it over a second connection.
            /// * The virtual controller answers at rest, with S_FALSE if nothing moved; the halted call ends with
            ///   E_MOTION_STOPPED, which remains an error until ClearError, as in the log of a real RC8A.
            /// * Controllers: all (b-CAP specification, section 4.3.4).
            70 ROBOT_HALT robot_halt "RobotHalt" Robot (robot: Robot, option: Text) Nothing, Moves Allowed;

            /// Pauses the motion of the robot until Robot_Unhold: the statement HOLD.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            71 ROBOT_HOLD robot_hold "RobotHold" Robot (robot: Robot, option: Text) Nothing, Moves Unknown;

            /// Moves the robot to a pose: the statement MOVE.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `interpolation`: the path: 1 point to point (P), 2 line (L), 3 circle (C), 4 free curve (S) (I4).
            /// * `pose`: the target, as text or as an array. P is X Y Z in mm, RX RY RZ in degrees and the figure; J is
            ///   joints in degrees or mm. The pass `@E` reaches the pose completely (b-CAP specification, section
            ///   5.6.1), `@P` passes it; `@0` and `@n` with a number are not described.
            ///   * BSTR: an optional pass, then a variable or a value: `P1`, `@E P1`, `@P J2`,
            ///     `@E P(400, 0, 300, 180, 0, 180, 5)`, `J(0, 45, 90, 0, 45, 0)`.
            ///   * Array of VARIANT (b-CAP specification, section 6.3): the numbers (R4 or R8 array) or the index of
            ///     the variable; the type (I4: 0 P, 1 T, 2 J, 3 V; or its text); the pass (I4: -1 `@P`, -2 `@E`, 0
            ///     `@0`; or its text).
            /// * `option`: motion options with commas between them; may be empty.
            ///   * `NEXT`: the call answers at once instead of at the end of the motion.
            ///   * `SPEED=` or `S=`, `ACCEL=`, `DECEL=`: speed, acceleration, deceleration, in percent, as a number or
            ///     a variable: `SPEED=10`, `SPEED=F2`.
            /// * Returns no value.
            /// * Needs Auto mode, the executable token for this client, no error, the arm authority (TakeArm) and the
            ///   motor on (b-CAP specification, sections 3, 4.3.2 and 4.3.3).
            /// * A motion command while another client's motion runs is refused with E_ROBOTISBUSY (RAC specification,
            ///   Table 2-3). In the virtual controller the motions of the same client join a queue.
            /// * After Robot_Halt the virtual controller ends the call with E_MOTION_STOPPED, as a real RC8A did.
            /// * A client that stops waiting for the reply does not stop the motion. Robot_Halt does, over a second
            ///   connection while this one waits.
            /// * Controllers: all (b-CAP specification, sections 4.3.4 and 5.6.1).
            72 ROBOT_MOVE robot_move "RobotMove" Robot (robot: Robot, interpolation: Int, pose: Any, option: Text) Nothing, Moves Refused;

            /// Rotates the robot in a plane about a pivot: the statement ROTATE.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `surface`: the plane of rotation (VARIANT): `XY`, `YZ`, `ZX`, `XYH`, `YZH`, `ZXH`, or three points V
            ///   (RC8 provider guide, 5.2.26).
            /// * `degrees`: the angle, in degrees.
            /// * `pivot`: the point about which it rotates (VARIANT), such as `V(0, 0, 0)`.
            /// * `option`: motion options, as for Robot_Move, and `Pose=`.
            /// * Returns no value.
            /// * Needs Auto mode, the executable token for this client, no error, the arm authority (TakeArm) and the
            ///   motor on (b-CAP specification, sections 3, 4.3.2 and 4.3.3).
            /// * A client that stops waiting for the reply does not stop the motion. Robot_Halt does, over a second
            ///   connection while this one waits.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            73 ROBOT_ROTATE robot_rotate "RobotRotate" Robot (robot: Robot, surface: Any, degrees: Float, pivot: Any, option: Text) Nothing, Moves Refused;

            /// Sets the internal speed of the robot: the statement SPEED or JSPEED.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `axis`: the number is not specified. Public drivers send -1, which the virtual controller takes as
            ///   SPEED, for lines and joints; it takes 0 as JSPEED, for joints only.
            /// * `speed`: the speed, in percent: 0.0001 to 100 in the virtual controller; the specification gives
            ///   no unit.
            /// * Returns no value.
            /// * The external speed is another setting: the command ExtSpeed of Robot_Execute.
            /// * Controllers: all.
            74 ROBOT_SPEED robot_speed "RobotSpeed" Robot (robot: Robot, axis: Int, speed: Float) Nothing, Moves Refused;

            /// Opens the hand: the statement RELEASE.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            75 ROBOT_UNCHUCK robot_unchuck "RobotUnchuck" Robot (robot: Robot, option: Text) Nothing, Moves Unknown;

            /// Continues the motion that Robot_Hold has paused.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * The robot may start to move at once.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            76 ROBOT_UNHOLD robot_unhold "RobotUnhold" Robot (robot: Robot, option: Text) Nothing, Moves Unknown;

            /// Reads the attribute value of the robot.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * Returns the attribute (I4); the specification does not define its values.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            77 ROBOT_GET_ATTRIBUTE robot_get_attribute "RobotGetAttribute" Robot (robot: Robot) Int, Reads Unknown;

            /// Reads the help text of the robot.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            78 ROBOT_GET_HELP robot_get_help "RobotGetHelp" Robot (robot: Robot) Text, Reads Unknown;

            /// Reads the name of the robot.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * Returns the name (BSTR), such as `Arm`.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            79 ROBOT_GET_NAME robot_get_name "RobotGetName" Robot (robot: Robot) Text, Reads Unknown;

            /// Reads the tag of the robot, information that a client attaches to it.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * Returns the tag (VARIANT), the value of Robot_PutTag.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            80 ROBOT_GET_TAG robot_get_tag "RobotGetTag" Robot (robot: Robot) Any, Reads Unknown;

            /// Sets the tag of the robot, information that a client attaches to it.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `value`: the tag, any VARIANT; Robot_GetTag returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            81 ROBOT_PUT_TAG robot_put_tag "RobotPutTag" Robot (robot: Robot, value: Any) Nothing, Writes Unknown;

            /// Reads the ID of the robot.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * Returns the ID (VARIANT), the value of Robot_PutID.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            82 ROBOT_GET_ID robot_get_id "RobotGetID" Robot (robot: Robot) Any, Reads Unknown;

            /// Sets the ID of the robot.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * `value`: the ID, any VARIANT; Robot_GetID returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            83 ROBOT_PUT_ID robot_put_id "RobotPutID" Robot (robot: Robot, value: Any) Nothing, Writes Unknown;

            /// Releases the robot; its handle is then invalid.
            ///
            /// * `robot`: its handle, from Controller_GetRobot.
            /// * Returns no value.
            /// * Controllers: all (b-CAP specification, section 4.3.5).
            84 ROBOT_RELEASE robot_release "RobotRelease" Robot (robot: Robot) Nothing, Session Allowed;

            /// Opens a system variable of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `name`: the name of the variable, in any case: `@STATUS` (I4), `@START` and
            ///   `@STOP` (I4, to be written), or another one of Task_GetVariableNames.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the handle of the variable (I4), to be released with Variable_Release.
            /// * Controllers: all.
            85 TASK_GET_VARIABLE task_get_variable "TaskGetVariable" Task (task: Task, name: Text, option: Text) Variable, Session Unknown;

            /// Lists the names of the variables of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns the list of names for Task_GetVariable (VARIANT; an array of BSTR in the virtual
            ///   controller).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            86 TASK_GET_VARIABLE_NAMES task_get_variable_names "TaskGetVariableNames" Task (task: Task, option: Text) Any, Reads Unknown;

            /// Executes a command of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `command`: the name of the command, in any case; public programs use GetStatus.
            /// * `param`: the parameter of the command; EMPTY without one.
            /// * Returns the result of the command (VARIANT): for GetStatus the I4 0 none, 1 suspended, 2 ready, 3
            ///   running, 4 step stop.
            /// * Controllers: all.
            87 TASK_EXECUTE task_execute "TaskExecute" Task (task: Task, command: Text, param: Any) Any, Moves Unknown;

            /// Starts the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `mode`: 1 one cycle, 2 continuous, 3 one step (I4). The b-CAP specification calls 2 both: one cycle in
            ///   its packets (section 4.2.2), continuous in its sample (section 4.2.4).
            /// * `option`: an option string; the specification lists no options, its packets send an empty string.
            /// * Returns no value.
            /// * Needs Auto mode and the executable token for this client (b-CAP specification, sections 3.1 and 3.2).
            /// * Controllers: all (b-CAP specification, section 4.2.2).
            88 TASK_START task_start "TaskStart" Task (task: Task, mode: Int, option: Text) Nothing, Moves Unknown;

            /// Stops the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `mode`: 0 default, 1 at once, 2 after the step, 3 after the cycle, 4 stop and initialise (I4). The
            ///   specification shows 3 only.
            /// * `option`: an option string; the specification lists no options, its packets send an empty string.
            /// * Returns no value.
            /// * Controllers: all (b-CAP specification, section 4.2.2).
            89 TASK_STOP task_stop "TaskStop" Task (task: Task, mode: Int, option: Text) Nothing, Moves Unknown;

            /// Deletes the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `option`: an option string; the specification lists no options.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            90 TASK_DELETE task_delete "TaskDelete" Task (task: Task, option: Text) Nothing, Writes Unknown;

            /// Reads the name of the file that the task comes from.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * Returns the name of the file (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            91 TASK_GET_FILE_NAME task_get_file_name "TaskGetFileName" Task (task: Task) Text, Reads Unknown;

            /// Reads the attribute value of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * Returns the attribute (I4); the specification does not define its values.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            92 TASK_GET_ATTRIBUTE task_get_attribute "TaskGetAttribute" Task (task: Task) Int, Reads Unknown;

            /// Reads the help text of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            93 TASK_GET_HELP task_get_help "TaskGetHelp" Task (task: Task) Text, Reads Unknown;

            /// Reads the name of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * Returns the name (BSTR), such as `Pro1`.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            94 TASK_GET_NAME task_get_name "TaskGetName" Task (task: Task) Text, Reads Unknown;

            /// Reads the tag of the task, information that a client attaches to it.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * Returns the tag (VARIANT), the value of Task_PutTag.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            95 TASK_GET_TAG task_get_tag "TaskGetTag" Task (task: Task) Any, Reads Unknown;

            /// Sets the tag of the task, information that a client attaches to it.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `value`: the tag, any VARIANT; Task_GetTag returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            96 TASK_PUT_TAG task_put_tag "TaskPutTag" Task (task: Task, value: Any) Nothing, Writes Unknown;

            /// Reads the ID of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * Returns the ID (VARIANT), the value of Task_PutID.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            97 TASK_GET_ID task_get_id "TaskGetID" Task (task: Task) Any, Reads Unknown;

            /// Sets the ID of the task.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * `value`: the ID, any VARIANT; Task_GetID returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            98 TASK_PUT_ID task_put_id "TaskPutID" Task (task: Task, value: Any) Nothing, Writes Unknown;

            /// Releases the task; its handle is then invalid.
            ///
            /// * `task`: its handle, from Controller_GetTask.
            /// * Returns no value.
            /// * Controllers: all (b-CAP specification, section 4.2.3).
            99 TASK_RELEASE task_release "TaskRelease" Task (task: Task) Nothing, Session Allowed;

            /// Reads the time stamp of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns the date and time (VARIANT; in the virtual controller a DATE: days since 1899-12-30 of the
            ///   controller's wall clock, without a time zone). There it is the time of the last access through
            ///   this handle.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            100 VARIABLE_GET_DATE_TIME variable_get_date_time "VariableGetDateTime" Variable (variable: Variable) Any, Reads Unknown;

            /// Reads the value of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns the value in the type of the variable: I is I4, F R4, D R8, S BSTR, IO BOOL. V, P, J, T
            ///   are R4 arrays of 3, 7, 8, 10 numbers, in mm and degrees: V is X Y Z; P is X Y Z RX RY RZ and
            ///   figure; J is 8 joints; T is position, orient vector, approach vector and figure. System variables
            ///   such as `@CURRENT_POSITION` are R8 arrays.
            /// * Controllers: all (b-CAP specification, section 4.1.3).
            101 VARIABLE_GET_VALUE variable_get_value "VariableGetValue" Variable (variable: Variable) Any, Reads Allowed;

            /// Writes the value of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * `value`: the new value, in the type that Variable_GetValue returns. Controllers convert some types:
            ///   the b-CAP specification writes I4 -1 to an IO in its sample (section 4.1.7), and a BOOL in its packet
            ///   (section 4.1.3); another type is an error.
            /// * Returns no value.
            /// * The controller must permit writing (communication permission, b-CAP specification, section 3.1).
            /// * Controllers: all (b-CAP specification, section 4.1.3).
            102 VARIABLE_PUT_VALUE variable_put_value "VariablePutValue" Variable (variable: Variable, value: Any) Nothing, Writes Unknown;

            /// Reads the attribute value of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns the attribute (I4); the specification does not define its values.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            103 VARIABLE_GET_ATTRIBUTE variable_get_attribute "VariableGetAttribute" Variable (variable: Variable) Int, Reads Unknown;

            /// Reads the help text of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            104 VARIABLE_GET_HELP variable_get_help "VariableGetHelp" Variable (variable: Variable) Text, Reads Unknown;

            /// Reads the name of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns the name (BSTR), such as `I1`.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            105 VARIABLE_GET_NAME variable_get_name "VariableGetName" Variable (variable: Variable) Text, Reads Unknown;

            /// Reads the tag of the variable, information that a client attaches to it.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns the tag (VARIANT), the value of Variable_PutTag.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            106 VARIABLE_GET_TAG variable_get_tag "VariableGetTag" Variable (variable: Variable) Any, Reads Unknown;

            /// Sets the tag of the variable, information that a client attaches to it.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * `value`: the tag, any VARIANT; Variable_GetTag returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            107 VARIABLE_PUT_TAG variable_put_tag "VariablePutTag" Variable (variable: Variable, value: Any) Nothing, Writes Unknown;

            /// Reads the ID of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns the ID (VARIANT): for a variable that was opened with a wildcard (`I*`) its index.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            108 VARIABLE_GET_ID variable_get_id "VariableGetID" Variable (variable: Variable) Any, Reads Unknown;

            /// Sets the ID of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * `value`: for a variable that was opened with a wildcard (`I*`), the index of the variable to read
            ///   or write next, from 0 to `@VAR_I_LEN` - 1 (I4). The use of other IDs is not specified.
            /// * Returns no value.
            /// * Controllers: all.
            109 VARIABLE_PUT_ID variable_put_id "VariablePutID" Variable (variable: Variable, value: Any) Nothing, Writes Unknown;

            /// Reads the fraction of the time stamp of the variable.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns microseconds (I4) by its name; the b-CAP specification, Appendix A, says milliseconds.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            110 VARIABLE_GET_MICROSECOND variable_get_microsecond "VariableGetMicrosecond" Variable (variable: Variable) Int, Reads Unknown;

            /// Releases the variable; its handle is then invalid.
            ///
            /// * `variable`: its handle, from a GetVariable function, such as Controller_GetVariable.
            /// * Returns no value.
            /// * Controllers: all (b-CAP specification, section 4.1.4).
            111 VARIABLE_RELEASE variable_release "VariableRelease" Variable (variable: Variable) Nothing, Session Allowed;

            /// Executes the command with its parameters.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * `mode`: in the virtual controller 0 waits for the result and 1 does not (I4); the specification
            ///   defines no modes.
            /// * Returns the result from some controllers, and no value from others: the vendor's client expects
            ///   one, its server sends none.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            112 COMMAND_EXECUTE command_execute "CommandExecute" Command (command: Command, mode: Int) Maybe, Moves Unknown;

            /// Cancels the command that Command_Execute has started.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            113 COMMAND_CANCEL command_cancel "CommandCancel" Command (command: Command) Nothing, Moves Unknown;

            /// Reads the time limit of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the time (I4), in ms in the virtual controller; the specification gives no unit.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            114 COMMAND_GET_TIMEOUT command_get_timeout "CommandGetTimeout" Command (command: Command) Int, Reads Unknown;

            /// Sets the time limit of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * `value`: the time (I4), in ms in the virtual controller, where 0 is no limit; the specification
            ///   gives no unit.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            115 COMMAND_PUT_TIMEOUT command_put_timeout "CommandPutTimeout" Command (command: Command, value: Int) Nothing, Writes Unknown;

            /// Reads the state of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the state (I4): in the virtual controller 0 not executed, 1 running, 2 done, 3 failed or
            ///   cancelled; the specification defines no numbers.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            116 COMMAND_GET_STATE command_get_state "CommandGetState" Command (command: Command) Int, Reads Unknown;

            /// Reads the parameters of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the parameters (VARIANT), the value of Command_PutParameters.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            117 COMMAND_GET_PARAMETERS command_get_parameters "CommandGetParameters" Command (command: Command) Any, Reads Unknown;

            /// Sets the parameters of the command for the next Command_Execute.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * `value`: the parameters, of the type that the command needs.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            118 COMMAND_PUT_PARAMETERS command_put_parameters "CommandPutParameters" Command (command: Command, value: Any) Nothing, Writes Unknown;

            /// Reads the result of the last execution of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the result (VARIANT).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            119 COMMAND_GET_RESULT command_get_result "CommandGetResult" Command (command: Command) Any, Reads Unknown;

            /// Reads the attribute value of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the attribute (I4); the specification does not define its values.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            120 COMMAND_GET_ATTRIBUTE command_get_attribute "CommandGetAttribute" Command (command: Command) Int, Reads Unknown;

            /// Reads the help text of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            121 COMMAND_GET_HELP command_get_help "CommandGetHelp" Command (command: Command) Text, Reads Unknown;

            /// Reads the name of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the name (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            122 COMMAND_GET_NAME command_get_name "CommandGetName" Command (command: Command) Text, Reads Unknown;

            /// Reads the tag of the command, information that a client attaches to it.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the tag (VARIANT), the value of Command_PutTag.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            123 COMMAND_GET_TAG command_get_tag "CommandGetTag" Command (command: Command) Any, Reads Unknown;

            /// Sets the tag of the command, information that a client attaches to it.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * `value`: the tag, any VARIANT; Command_GetTag returns it.
            /// * Returns no value.
            /// * The reply carries a value in the vendor's server and none in its client; both are accepted.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            124 COMMAND_PUT_TAG command_put_tag "CommandPutTag" Command (command: Command, value: Any) Nothing, Writes Unknown;

            /// Reads the ID of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns the ID (VARIANT), the value of Command_PutID.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            125 COMMAND_GET_ID command_get_id "CommandGetID" Command (command: Command) Any, Reads Unknown;

            /// Sets the ID of the command.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * `value`: the ID, any VARIANT; Command_GetID returns it.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            126 COMMAND_PUT_ID command_put_id "CommandPutID" Command (command: Command, value: Any) Nothing, Writes Unknown;

            /// Releases the command; its handle is then invalid.
            ///
            /// * `command`: its handle, from Controller_GetCommand.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            127 COMMAND_RELEASE command_release "CommandRelease" Command (command: Command) Nothing, Session Allowed;

            /// Replies to the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * `data`: the content of the reply, any VARIANT.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            128 MESSAGE_REPLY message_reply "MessageReply" Message (message: Message, data: Any) Nothing, Writes Unknown;

            /// Clears the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            129 MESSAGE_CLEAR message_clear "MessageClear" Message (message: Message) Nothing, Writes Unknown;

            /// Reads the time stamp of the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns the date and time (VARIANT; in the virtual controller a DATE: days since 1899-12-30 of the
            ///   controller's wall clock, without a time zone).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            130 MESSAGE_GET_DATE_TIME message_get_date_time "MessageGetDateTime" Message (message: Message) Any, Reads Unknown;

            /// Reads the description of the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns the text (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            131 MESSAGE_GET_DESCRIPTION message_get_description "MessageGetDescription" Message (message: Message) Text, Reads Unknown;

            /// Reads the destination of the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns the destination (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            132 MESSAGE_GET_DESTINATION message_get_destination "MessageGetDestination" Message (message: Message) Text, Reads Unknown;

            /// Reads the number of the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns the number (I4): the code of the error in the virtual controller.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            133 MESSAGE_GET_NUMBER message_get_number "MessageGetNumber" Message (message: Message) Int, Reads Unknown;

            /// Reads the serial number of the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns the serial number (I4): it counts up from 1 for each client in the virtual controller.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            134 MESSAGE_GET_SERIAL_NUMBER message_get_serial_number "MessageGetSerialNumber" Message (message: Message) Int, Reads Unknown;

            /// Reads the source of the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns the source (BSTR).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            135 MESSAGE_GET_SOURCE message_get_source "MessageGetSource" Message (message: Message) Text, Reads Unknown;

            /// Reads the value of the message.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns the value (VARIANT).
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            136 MESSAGE_GET_VALUE message_get_value "MessageGetValue" Message (message: Message) Any, Reads Unknown;

            /// Releases the message; its handle is then invalid.
            ///
            /// * `message`: its handle, from Controller_GetMessage.
            /// * Returns no value.
            /// * Controllers: listed for all; a controller without it answers E_NOTIMPL.
            137 MESSAGE_RELEASE message_release "MessageRelease" Message (message: Message) Nothing, Session Allowed;
        }
    };
}

pub(crate) use for_each_function;
