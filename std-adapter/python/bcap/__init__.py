"""DENSO robot controllers (RC8, RC9, COBOTTA) over b-CAP.

>>> import bcap
>>> cell = bcap.Controller("tcp:192.168.0.1", model="rc9")
>>> cell["I1"] = cell["I1"] + 1
>>> with cell.take_arm() as arm:                    # given back at the end, with the motor off
...     arm.motor_on()
...     arm.move("P1", speed=10)                    # returns when the robot rests at P1; otherwise raises

Lengths are in mm, angles in degrees, times in seconds, speeds in percent.

* bcap.aio has the same objects for asyncio.
* bcap.sim() is a virtual controller, for tests.
* bcap.compat.bcapclient runs scripts that were written for the maker's client.
* bcap.errors has the exceptions.

Ctrl-C, an exception, sys.exit, SIGTERM and the end of the interpreter halt the robot, switch the motor off and give the arm back.
A process that is killed (SIGKILL) or calls os._exit does not; then only the controller can stop the robot. This is not an emergency
stop. Objects may be used by several threads. In a forked process the objects of its parent are refused.
"""

from __future__ import annotations

import atexit
import weakref
from types import TracebackType
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple, Type, Union

from . import _bcap, _signals, _values
from ._values import Change, Cycle, Destination, ErrorInfo, J, P, Passing, State, T
from .errors import (
    ControllerError,
    Error,
    Halted,
    InvalidArgument,
    MotionError,
    MotionFailed,
    MotionTimeout,
    NoReply,
    NotConnected,
    NotHalted,
    NotMet,
    NotRecovered,
    OutcomeUnknown,
    StreamError,
)

__all__ = [
    "Arm", "Change", "Controller", "ControllerError", "Cycle", "Destination", "Error", "ErrorInfo", "Halted", "InvalidArgument",
    "J", "MotionError", "MotionFailed", "MotionTimeout", "NoReply", "NotConnected", "NotHalted", "NotMet", "NotRecovered",
    "OutcomeUnknown", "P", "Passing", "Sim", "SlaveStream", "State", "Stopper", "StreamError", "T", "sim",
]  # fmt: skip

atexit.register(_bcap.end)


class Controller:
    """A session with a controller. Connects immediately, and again when the connection is lost.

    :param address: "tcp:HOST[:PORT]", "udp:HOST[:PORT]", "serial:PATH[?baud=N]", or a virtual controller of bcap.sim()
    :param model: "rc8", "rc8a", "rc9", "cobotta" or "cobotta-pro"; by default "rc8", or the model of the virtual controller
    :param robot: the name of the robot; by default the first one that the controller lists
    :param timeout: the time limit of connecting, in seconds
    :param numpy: whether arrays of numbers are returned as numpy.ndarray instead of list
    :raises NotConnected: if no controller answers

    Use it as a context manager, or close() it: that gives the arm back and ends the session.
    """

    def __init__(
        self,
        address: Union[str, Sim],
        model: Optional[str] = None,
        *,
        robot: Optional[str] = None,
        timeout: float = 5.0,
        numpy: bool = False,
    ) -> None:
        self._convert = _values.converter(numpy)
        self._cell = _connect(address, model, robot, timeout, True).wait()

    def __getitem__(self, name: str) -> Any:
        """Reads a variable, as read() does."""
        return self.read(name)

    def __setitem__(self, name: str, value: Any) -> None:
        """Writes a variable, as write() does."""
        self.write(name, value)

    def read(self, name: str) -> Any:
        """Reads a variable: "I1", "P5", "IO128", "@MODE", "robot/@SERVO_ON", "task:Pro1/@STATUS".

        :returns: int, float, bool, str, bytes, datetime, None, or a list of them; P is [X, Y, Z, RX, RY, RZ, figure]
        """
        return self._convert(self._cell.read(name).wait())

    def read_all(self, *names: str) -> List[Any]:
        """Reads several variables in one turn, and returns their values."""
        return [self._convert(value) for value in self._cell.read_all(names).wait()]

    def write(self, name: str, value: Any) -> None:
        """Writes a variable. A sequence of numbers, such as a numpy array, is an array of R8; int is I4.

        :raises NoReply: the value may have been written
        """
        self._cell.write(name, value).wait()

    def wait_for(self, name: str, value: Any, timeout: float) -> Any:
        """Reads a variable every 10 ms until it has a value, which is first converted to the type of the variable.

        :raises NotMet: after `timeout` seconds
        :raises InvalidArgument: the type of the variable cannot have the value
        """
        return self._cell.wait_for(name, value, timeout).wait()

    def watch(self, names: Sequence[str], interval: float = 0.1) -> Iterator[Change]:
        """Reads variables every `interval` seconds, and iterates over their changes, beginning with the first values.

        A reading that fails raises its error; the iterator may be used further. A slow reader gets the latest values only.
        """
        return _Watch(self._cell.watch([names] if isinstance(names, str) else names, interval), self._convert)

    def execute(self, command: str, parameter: Any = None) -> Any:
        """Executes a command of the controller, such as "ClearError", and returns its value."""
        return self._convert(self._cell.execute(command, parameter).wait())

    def execute_robot(self, command: str, parameter: Any = None) -> Any:
        """Executes a command of the robot, such as "CurTool", and returns its value. Use Arm.move() for motions."""
        return self._convert(self._cell.execute_robot(command, parameter).wait())

    def joints(self) -> J:
        """Reads the joints, in degrees."""
        return J(self._cell.joints().wait())

    def position(self) -> P:
        """Reads the position of the tool, in mm and degrees."""
        return P(self._cell.position().wait())

    def examine(self) -> State:
        """Reads the current errors, and what a person must do before a recovery. It changes nothing."""
        errors, obstacles = self._cell.examine().wait()
        return State([ErrorInfo(*error) for error in errors], obstacles)

    def take_arm(self) -> Arm:
        """Takes the arm, so that this program can move the robot.

        :raises ControllerError: another client or a task owns the arm
        """
        return Arm(self._cell.take_arm().wait())

    def recover(self, *, alone: bool = False, speed: Optional[float] = None) -> Arm:
        """Clears the errors, takes the arm and switches the motor on. **The arm of a COBOTTA can move.**

        A person must have looked at the robot. `alone` says that no other client uses it; without it the errors stay if the
        controller does not say who owns the arm. `speed` sets the external speed in percent.

        :raises NotRecovered: with what to do; the arm is not taken
        """
        return Arm(self._cell.recover(alone, speed).wait())

    def prepare(self) -> Arm:
        """Takes the arm, and prepares the motion of a COBOTTA. **The arm can move.**"""
        return Arm(self._cell.prepare().wait())

    def stopper(self) -> Stopper:
        """Opens a second connection, over which any thread can halt the robot at any time."""
        return Stopper(self._cell.stopper().wait())

    def read_file(self, name: str) -> Union[str, bytes]:
        """Reads a file of the controller. A path has backslashes between its parts."""
        content: Union[str, bytes] = self._cell.read_file(name).wait()
        return content

    def write_file(self, name: str, content: Union[str, bytes]) -> None:
        """Replaces the content of a file of the controller."""
        self._cell.write_file(name, content).wait()

    def start_task(self, name: str, mode: str = "once") -> None:
        """Starts a task: "once", "continuous" or "step". Its program may move the robot."""
        self._cell.start_task(name, mode).wait()

    def stop_task(self, name: str, mode: str = "default") -> None:
        """Stops a task: "default", "now", after this "step" or "cycle", or "initialize", to begin anew at the next start."""
        self._cell.stop_task(name, mode).wait()

    def task_status(self, name: str) -> str:
        """Returns "none", "suspended", "ready", "running", "stopped at a step" or "unknown"."""
        return self._cell.task_status(name).wait()

    def close(self) -> None:
        """Gives the arm back, releases all objects and ends the session."""
        self._cell.close().wait()

    def __enter__(self) -> Controller:
        return self

    def __exit__(self, *raised: Any) -> None:
        self.close()


def _connect(
    address: Union[str, Sim], model: Optional[str], robot: Optional[str], timeout: float, driven: bool
) -> _bcap.Call[_bcap.Controller]:
    if isinstance(address, Sim):
        return _bcap.connect(address.address or "", model or address.model, robot, timeout, address._sim, driven)
    return _bcap.connect(address, model or "rc8", robot, timeout, None, driven)


class _Watch(Iterator[Change]):
    def __init__(self, watch: _bcap.Watch, convert: _values.Converter) -> None:
        self._watch, self._convert = watch, convert

    def __next__(self) -> Change:
        change = _values.change(self._watch.next().wait(), self._convert)
        if change is None:
            raise StopIteration
        return change


class Arm:
    """The arm of a robot, which this program has taken.

    At the end of its `with` block, and when it is dropped, the robot is halted, a motor that was switched on is switched off, and
    the arm is given back.
    """

    def __init__(self, arm: _bcap.Arm) -> None:
        self._arm = arm
        _signals.arm_taken()
        self._given = weakref.finalize(self, _signals.arm_given)
        self._given.atexit = False

    def motor_on(self) -> None:
        """Switches the motor on, and waits until it is."""
        self._arm.motor(True).wait()

    def motor_off(self) -> None:
        """Switches the motor off, and waits until it is."""
        self._arm.motor(False).wait()

    def set_speed(self, percent: float) -> None:
        """Sets the external speed, in percent of the maximum."""
        self._arm.set_speed(percent).wait()

    def select_tool(self, number: int) -> None:
        """Selects a tool, the point that positions are about; 0 is the flange."""
        self._arm.select_tool(number).wait()

    def select_work(self, number: int) -> None:
        """Selects work coordinates, in which positions are; 0 is the base of the robot."""
        self._arm.select_work(number).wait()

    def move(
        self,
        *destinations: Destination,
        line: bool = False,
        via: Optional[Destination] = None,
        speed: Optional[float] = None,
        acceleration: Optional[float] = None,
        deceleration: Optional[float] = None,
        passing: Passing = "exact",
        timeout: float = 60.0,
    ) -> None:
        """Moves to a destination, or through several without a stop, and returns when the robot rests at the last one.

        :param destinations: "P1", "J(0, 45, 90)", or P, J or T
        :param line: whether the tool moves along a line; otherwise all joints move at the same time
        :param via: the tool moves along an arc through this place
        :param speed: in percent of the speed that the arm is set to; also acceleration and deceleration
        :param passing: how exactly a destination is reached, for several all but the last: "exact", "commanded", "near", or a
            distance in mm
        :param timeout: of all motions in seconds; then the robot is halted
        :raises MotionError: the robot rests elsewhere: Halted, MotionFailed, MotionTimeout, OutcomeUnknown
        :raises NoReply: **the robot may be moving**
        """
        motions = _values.path(
            destinations, line, passing, via=via, speed=speed, acceleration=acceleration, deceleration=deceleration
        )
        self._arm.motions(motions, timeout).wait()

    def approach(
        self, destination: Destination, mm: float, *, line: bool = False, speed: Optional[float] = None, timeout: float = 60.0
    ) -> None:
        """Moves to the place that is `mm` before a destination, against the direction of the tool."""
        way = "approach line" if line else "approach joint"
        self._arm.motions([_values.step(way, destination, amount=mm, speed=speed)], timeout).wait()

    def depart(self, mm: float, *, line: bool = True, speed: Optional[float] = None, timeout: float = 60.0) -> None:
        """Moves back by `mm`, against the direction of the tool."""
        way = "depart line" if line else "depart joint"
        self._arm.motions([_values.step(way, amount=mm, speed=speed)], timeout).wait()

    def drive(
        self,
        axes: Mapping[int, float],
        *,
        relative: bool = False,
        speed: Optional[float] = None,
        timeout: float = 60.0,
    ) -> None:
        """Turns axes, 1 to 8, to a value in degrees or mm, or by it: drive({1: 10.0}, relative=True)."""
        way = "drive-by" if relative else "drive-to"
        motion = _values.step(way, axes=list(axes.items()), speed=speed)
        self._arm.motions([motion], timeout).wait()

    def rotate(
        self,
        plane: str,
        degrees: float,
        centre: Sequence[float],
        *,
        speed: Optional[float] = None,
        timeout: float = 60.0,
    ) -> None:
        """Moves the tool along a circle in the plane "xy", "yz" or "zx" about a point (X, Y, Z in mm); the tool turns with it."""
        motion = _values.step("rotate", amount=degrees, plane=plane, centre=[float(c) for c in centre], speed=speed)
        self._arm.motions([motion], timeout).wait()

    def slave_mode(
        self,
        *,
        mode: int = 2,
        kind: str = "J",
        max_speed: Optional[float] = None,
        max_acceleration: Optional[float] = None,
        pose_timeout: float = 1.0,
    ) -> SlaveStream:
        """Begins a stream of poses, one every 8 ms, whose loop is the caller's. The motor must be on.

        :param mode: 0 buffers 24 ms of poses, 1 only the latest, 2 answers when the pose is used, and sets the pace
        :param kind: "J" for 8 joints, "P" for 7 numbers, "T" for 10 numbers
        :param max_speed: a pose that needs a higher speed of an axis is not sent, in degrees or mm per second
        :param max_acceleration: the same, per second squared; it also limits how the robot stops
        :param pose_timeout: how long the robot may wait for a pose, in seconds; then it stops
        """
        config = {
            "mode": mode, "kind": kind, "max_speed": max_speed, "max_acceleration": max_acceleration, "pose_timeout": pose_timeout
        }  # fmt: skip
        return SlaveStream(self._arm.stream(config).wait())

    def give(self) -> None:
        """Halts a motion of another thread, switches the motor off and gives the arm back, as the end of the block does.

        The call of the other thread raises OutcomeUnknown, or NoReply if no halt was confirmed.
        """
        self._arm.give().wait()
        self._given()

    def __enter__(self) -> Arm:
        return self

    def __exit__(self, *raised: Any) -> None:
        self.give()


class SlaveStream:
    """A stream of Slave Mode. The end of its `with` block ends it at the last pose; an exception stops the robot with a ramp.

    >>> with arm.slave_mode(max_speed=100, max_acceleration=800) as stream:
    ...     for number in range(250):
    ...         joints = list(stream.cycle.start)
    ...         joints[0] += number / 250
    ...         stream.step(joints)
    """

    def __init__(self, stream: _bcap.Stream) -> None:
        self._stream = stream
        self._cycle = _values.cycle(stream.wanted())
        #: after the end: cycles, late, refused, underflows
        self.statistics: Dict[str, int] = {}
        self._ended = False
        self._failure: Optional[Error] = None

    @property
    def cycle(self) -> Cycle:
        """The pose that is wanted next: its number, the start, and the pose at the last reply."""
        return self._cycle

    def step(self, pose: Iterable[float]) -> Cycle:
        """Sends the pose of this cycle, and waits until the next one is wanted.

        :raises StreamError: the stream has ended: a pose beyond the limits, no pose in time, or an error of the controller
        :raises NoReply: **the robot may be moving**
        """
        wanted = self._stream.step(list(pose)).wait()
        if wanted is None:
            self.finish()
            raise StreamError("the stream has ended")
        self._cycle = _values.cycle(wanted)
        return self._cycle

    def finish(self) -> None:
        """Ends the stream, and waits until the robot rests at the last pose. A second call has the result of the first."""
        self._finish(False)

    def stop(self) -> None:
        """Ends the stream early: the robot slows down along its current direction."""
        self._finish(True)

    def _finish(self, stop: bool) -> None:
        if not self._ended:
            try:
                self.statistics = dict(self._stream.finish(stop).wait())
            except Error as failure:
                self._failure = failure
            self._ended = True
        if self._failure is not None:
            raise self._failure

    def __enter__(self) -> SlaveStream:
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], error: Any, trace: Optional[TracebackType]) -> None:
        if self._ended:
            return
        try:
            self._finish(kind is not None)
        except Error as failure:
            if error is None:
                raise
            # the pending exception continues, and its traceback shows the failure
            failure.__context__, error.__context__ = error.__context__, failure


class Stopper:
    """Halts the robot from any thread, even while another call waits. It is not an emergency stop."""

    def __init__(self, stopper: _bcap.Stopper) -> None:
        self._stopper = stopper

    def halt(self) -> str:
        """Halts the robot, and waits until it rests: "halted", "nothing moved", or "tasks stopped" if a task moved it.

        :raises NotHalted: **the robot still moves**
        """
        return self._stopper.halt().wait()


class Sim:
    """A virtual controller, from sim()."""

    def __init__(self, sim: _bcap.Sim) -> None:
        self._sim = sim

    @property
    def address(self) -> Optional[str]:
        """The address "tcp:127.0.0.1:PORT"; UDP has the same port. None in memory."""
        return self._sim.address

    @property
    def model(self) -> str:
        """The model."""
        return self._sim.model

    @property
    def moving(self) -> bool:
        """Whether the robot moves."""
        return self._sim.moving

    @property
    def motor_on(self) -> bool:
        """Whether the motor is on."""
        return self._sim.motor_on

    @property
    def arm_taken(self) -> bool:
        """Whether a client owns the arm."""
        return self._sim.arm_taken

    @property
    def slave_mode(self) -> bool:
        """Whether Slave Mode is on."""
        return self._sim.slave_mode != 0

    @property
    def joints(self) -> J:
        """Where the robot is, in degrees."""
        return J(self._sim.joints)

    def emergency_stop(self, pressed: bool = True) -> None:
        """Presses or releases the emergency stop."""
        self._sim.emergency_stop(pressed)

    def close(self) -> None:
        """Ends the controller, and closes its connections."""
        self._sim.close()

    def __enter__(self) -> Sim:
        return self

    def __exit__(self, *raised: Any) -> None:
        self.close()


def sim(
    model: str = "rc8",
    *,
    port: int = 0,
    scenario: Optional[str] = None,
    files: Optional[str] = None,
    in_memory: bool = False,
) -> Sim:
    """Starts a virtual controller in this process.

    :param model: "rc8", "rc8a", "rc9", "cobotta" or "cobotta-pro"
    :param port: of 127.0.0.1, for TCP and UDP; 0 takes a free one
    :param scenario: the initial state and faults, as TOML (docs/virtual-controller.md)
    :param files: the folder with the controller's files; without one it has none
    :param in_memory: without sockets, on a virtual clock that never waits: Controller(bcap.sim(in_memory=True))
    """
    return Sim(_bcap.Sim(model, port, scenario, files, in_memory))
