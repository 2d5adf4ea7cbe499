"""The objects of bcap for asyncio, with the same names.

>>> async with bcap.aio.Controller("tcp:192.168.0.1", model="rc9") as cell:
...     await cell.write("I1", await cell.read("I1") + 1)
...     async with cell.take_arm() as arm:
...         await arm.motor_on()
...         await arm.move("P1", speed=10)

Cancelling a motion halts the robot. Calls of one controller are made in sequence, even while the robot moves; many controllers need
no threads. A call that opens an object is awaited (`cell = await bcap.aio.Controller(...)`) or used with `async with`.
"""
# written by tests/write_aio.py from __init__.py

from __future__ import annotations

import weakref
from types import TracebackType
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Type, Union

from . import Sim, _bcap, _connect, _signals, _values
from ._awaiting import Opening, Session, opening, run
from ._values import Cycle, Destination, ErrorInfo, J, P, Passing, State
from .errors import Error, StreamError

__all__ = ["Arm", "Controller", "SlaveStream", "Stopper"]


class Controller(Session):
    """As bcap.Controller."""

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
        self._connecting = _connect(address, model, robot, timeout, False)

    async def read(self, name: str) -> Any:
        """Reads a variable: "I1", "P5", "IO128", "@MODE", "robot/@SERVO_ON", "task:Pro1/@STATUS".

        :returns: int, float, bool, str, bytes, datetime, None, or a list of them; P is [X, Y, Z, RX, RY, RZ, figure]
        """
        return self._convert(await run(self._cell.read(name)))

    async def read_all(self, *names: str) -> List[Any]:
        """Reads several variables in one turn, and returns their values."""
        return [self._convert(value) for value in await run(self._cell.read_all(names))]

    async def write(self, name: str, value: Any) -> None:
        """Writes a variable. A sequence of numbers, such as a numpy array, is an array of R8; int is I4.

        :raises NoReply: the value may have been written
        """
        await run(self._cell.write(name, value))

    async def wait_for(self, name: str, value: Any, timeout: float) -> Any:
        """Reads a variable every 10 ms until it has a value, which is first converted to the type of the variable.

        :raises NotMet: after `timeout` seconds
        :raises InvalidArgument: the type of the variable cannot have the value
        """
        return await run(self._cell.wait_for(name, value, timeout))

    async def execute(self, command: str, parameter: Any = None) -> Any:
        """Executes a command of the controller, such as "ClearError", and returns its value."""
        return self._convert(await run(self._cell.execute(command, parameter)))

    async def execute_robot(self, command: str, parameter: Any = None) -> Any:
        """Executes a command of the robot, such as "CurTool", and returns its value. Use Arm.move() for motions."""
        return self._convert(await run(self._cell.execute_robot(command, parameter)))

    async def joints(self) -> J:
        """Reads the joints, in degrees."""
        return J(await run(self._cell.joints()))

    async def position(self) -> P:
        """Reads the position of the tool, in mm and degrees."""
        return P(await run(self._cell.position()))

    async def examine(self) -> State:
        """Reads the current errors, and what a person must do before a recovery. It changes nothing."""
        errors, obstacles = await run(self._cell.examine())
        return State([ErrorInfo(*error) for error in errors], obstacles)

    def take_arm(self) -> Opening[Arm]:
        """Takes the arm, so that this program can move the robot.

        :raises ControllerError: another client or a task owns the arm
        """
        return opening(lambda: self._cell.take_arm(), Arm)

    def recover(self, *, alone: bool = False, speed: Optional[float] = None) -> Opening[Arm]:
        """Clears the errors, takes the arm and switches the motor on. **The arm of a COBOTTA can move.**

        A person must have looked at the robot. `alone` says that no other client uses it; without it the errors stay if the
        controller does not say who owns the arm. `speed` sets the external speed in percent.

        :raises NotRecovered: with what to do; the arm is not taken
        """
        return opening(lambda: self._cell.recover(alone, speed), Arm)

    def prepare(self) -> Opening[Arm]:
        """Takes the arm, and prepares the motion of a COBOTTA. **The arm can move.**"""
        return opening(lambda: self._cell.prepare(), Arm)

    async def stopper(self) -> Stopper:
        """Opens a second connection, over which any thread can halt the robot at any time."""
        return Stopper(await run(self._cell.stopper()))

    async def read_file(self, name: str) -> Union[str, bytes]:
        """Reads a file of the controller. A path has backslashes between its parts."""
        content: Union[str, bytes] = await run(self._cell.read_file(name))
        return content

    async def write_file(self, name: str, content: Union[str, bytes]) -> None:
        """Replaces the content of a file of the controller."""
        await run(self._cell.write_file(name, content))

    async def start_task(self, name: str, mode: str = "once") -> None:
        """Starts a task: "once", "continuous" or "step". Its program may move the robot."""
        await run(self._cell.start_task(name, mode))

    async def stop_task(self, name: str, mode: str = "default") -> None:
        """Stops a task: "default", "now", after this "step" or "cycle", or "initialize", to begin anew at the next start."""
        await run(self._cell.stop_task(name, mode))

    async def task_status(self, name: str) -> str:
        """Returns "none", "suspended", "ready", "running", "stopped at a step" or "unknown"."""
        return await run(self._cell.task_status(name))

    async def close(self) -> None:
        """Gives the arm back, releases all objects and ends the session."""
        await run(self._cell.close())


class Arm:
    """As bcap.Arm."""

    def __init__(self, arm: _bcap.Arm) -> None:
        self._arm = arm
        _signals.arm_taken()
        self._given = weakref.finalize(self, _signals.arm_given)
        self._given.atexit = False

    async def motor_on(self) -> None:
        """Switches the motor on, and waits until it is."""
        await run(self._arm.motor(True))

    async def motor_off(self) -> None:
        """Switches the motor off, and waits until it is."""
        await run(self._arm.motor(False))

    async def set_speed(self, percent: float) -> None:
        """Sets the external speed, in percent of the maximum."""
        await run(self._arm.set_speed(percent))

    async def select_tool(self, number: int) -> None:
        """Selects a tool, the point that positions are about; 0 is the flange."""
        await run(self._arm.select_tool(number))

    async def select_work(self, number: int) -> None:
        """Selects work coordinates, in which positions are; 0 is the base of the robot."""
        await run(self._arm.select_work(number))

    async def move(
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
        await run(self._arm.motions(motions, timeout))

    async def approach(
        self, destination: Destination, mm: float, *, line: bool = False, speed: Optional[float] = None, timeout: float = 60.0
    ) -> None:
        """Moves to the place that is `mm` before a destination, against the direction of the tool."""
        way = "approach line" if line else "approach joint"
        await run(self._arm.motions([_values.step(way, destination, amount=mm, speed=speed)], timeout))

    async def depart(self, mm: float, *, line: bool = True, speed: Optional[float] = None, timeout: float = 60.0) -> None:
        """Moves back by `mm`, against the direction of the tool."""
        way = "depart line" if line else "depart joint"
        await run(self._arm.motions([_values.step(way, amount=mm, speed=speed)], timeout))

    async def drive(
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
        await run(self._arm.motions([motion], timeout))

    async def rotate(
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
        await run(self._arm.motions([motion], timeout))

    def slave_mode(
        self,
        *,
        mode: int = 2,
        kind: str = "J",
        max_speed: Optional[float] = None,
        max_acceleration: Optional[float] = None,
        pose_timeout: float = 1.0,
    ) -> Opening[SlaveStream]:
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
        return opening(lambda: self._arm.stream(config), SlaveStream)

    async def give(self) -> None:
        """Halts a motion of another thread, switches the motor off and gives the arm back, as the end of the block does.

        The call of the other thread raises OutcomeUnknown, or NoReply if no halt was confirmed.
        """
        await run(self._arm.give())
        self._given()

    async def __aenter__(self) -> Arm:
        return self

    async def __aexit__(self, *raised: Any) -> None:
        await self.give()


class SlaveStream:
    """As bcap.SlaveStream."""

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

    async def step(self, pose: Iterable[float]) -> Cycle:
        """Sends the pose of this cycle, and waits until the next one is wanted.

        :raises StreamError: the stream has ended: a pose beyond the limits, no pose in time, or an error of the controller
        :raises NoReply: **the robot may be moving**
        """
        wanted = await run(self._stream.step(list(pose)))
        if wanted is None:
            await self.finish()
            raise StreamError("the stream has ended")
        self._cycle = _values.cycle(wanted)
        return self._cycle

    async def finish(self) -> None:
        """Ends the stream, and waits until the robot rests at the last pose. A second call has the result of the first."""
        await self._finish(False)

    async def stop(self) -> None:
        """Ends the stream early: the robot slows down along its current direction."""
        await self._finish(True)

    async def _finish(self, stop: bool) -> None:
        if not self._ended:
            try:
                self.statistics = dict(await run(self._stream.finish(stop)))
            except Error as failure:
                self._failure = failure
            self._ended = True
        if self._failure is not None:
            raise self._failure

    async def __aenter__(self) -> SlaveStream:
        return self

    async def __aexit__(self, kind: Optional[Type[BaseException]], error: Any, trace: Optional[TracebackType]) -> None:
        if self._ended:
            return
        try:
            await self._finish(kind is not None)
        except Error as failure:
            if error is None:
                raise
            # the pending exception continues, and its traceback shows the failure
            failure.__context__, error.__context__ = error.__context__, failure


class Stopper:
    """As bcap.Stopper."""

    def __init__(self, stopper: _bcap.Stopper) -> None:
        self._stopper = stopper

    async def halt(self) -> str:
        """Halts the robot, and waits until it rests: "halted", "nothing moved", or "tasks stopped" if a task moved it.

        :raises NotHalted: **the robot still moves**
        """
        return await run(self._stopper.halt())
