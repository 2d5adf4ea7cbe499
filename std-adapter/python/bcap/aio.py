"""The objects of bcap for asyncio, with the same names.

>>> async with bcap.aio.Controller("tcp:192.168.0.1", model="rc9") as cell:
...     await cell.write("I1", await cell.read("I1") + 1)
...     async with cell.take_arm() as arm:
...         await arm.motor_on()
...         await arm.move("P1", speed=10)

Cancelling a motion halts the robot. Calls of one controller are made one after another, also while the robot moves; many controllers
need no threads. What opens an object is awaited (`cell = await bcap.aio.Controller(...)`) or used with `async with`.
"""

from __future__ import annotations

import asyncio
import weakref
from types import TracebackType
from typing import (
    Any,
    AsyncIterator,
    Awaitable,
    Callable,
    Dict,
    Generator,
    Generic,
    Iterable,
    List,
    Mapping,
    Optional,
    Sequence,
    Type,
    TypeVar,
    Union,
)

from . import Sim, _bcap, _connect, _signals, _values
from ._values import Change, Cycle, Destination, ErrorInfo, J, P, Passing, State
from .errors import StreamError

__all__ = ["Arm", "Controller", "SlaveStream", "Stopper"]

_R = TypeVar("_R")
_N = TypeVar("_N")


async def _run(call: _bcap.Call[_R]) -> _R:
    """Runs a call. If the task is cancelled, so is the call."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[_R] = loop.create_future()

    def settle(value: Any, error: Optional[BaseException]) -> None:
        if future.done():
            return
        if error is None:
            future.set_result(value)
        else:
            future.set_exception(error)

    started = call.start(lambda value, error: loop.call_soon_threadsafe(settle, value, error))
    try:
        return await future
    finally:
        started.cancel()


class _Opening(Generic[_R]):
    """An object that is opened when it is awaited or entered."""

    def __init__(self, opening: Callable[[], Awaitable[_R]]) -> None:
        self._opening = opening
        self._opened: Any = None

    def __await__(self) -> Generator[Any, None, _R]:
        return self._opening().__await__()

    async def __aenter__(self) -> _R:
        self._opened = await self._opening()
        opened: _R = await self._opened.__aenter__()
        return opened

    async def __aexit__(self, *raised: Any) -> None:
        await self._opened.__aexit__(*raised)


def _opening(call: Callable[[], _bcap.Call[_N]], made: Callable[[_N], _R]) -> _Opening[_R]:
    async def run() -> _R:
        return made(await _run(call()))

    return _Opening(run)


class Controller:
    """A session with a controller, as bcap.Controller. It connects when it is awaited or entered."""

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
        self._connecting = _connect(address, model, robot, timeout)
        self._opened: Optional[_bcap.Controller] = None

    @property
    def _cell(self) -> _bcap.Controller:
        if self._opened is None:
            raise RuntimeError("the controller is not connected: await it, or use `async with`")
        return self._opened

    def __await__(self) -> Generator[Any, None, Controller]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> Controller:
        if self._opened is None:
            self._opened = await _run(self._connecting)
        return self

    async def __aexit__(self, *raised: Any) -> None:
        await self.close()

    async def read(self, name: str) -> Any:
        """Reads a variable."""
        return self._convert(await _run(self._cell.read(name)))

    async def read_all(self, *names: str) -> List[Any]:
        """Reads several variables in one turn."""
        return [self._convert(value) for value in await _run(self._cell.read_all(names))]

    async def write(self, name: str, value: Any) -> None:
        """Writes a variable."""
        await _run(self._cell.write(name, value))

    async def wait_for(self, name: str, value: Any, timeout: float) -> Any:
        """Reads a variable every 10 ms until it has a value, for `timeout` seconds."""
        return await _run(self._cell.wait_for(name, value, timeout))

    async def watch(self, names: Sequence[str], interval: float = 0.1) -> AsyncIterator[Change]:
        """Reads variables every `interval` seconds, and iterates over their changes. A failed reading ends it."""
        watch = self._cell.watch([names] if isinstance(names, str) else names, interval)
        while (change := _values.change(await _run(watch.next()), self._convert)) is not None:
            yield change

    async def execute(self, command: str, parameter: Any = None) -> Any:
        """Executes a command of the controller."""
        return self._convert(await _run(self._cell.execute(command, parameter)))

    async def execute_robot(self, command: str, parameter: Any = None) -> Any:
        """Executes a command of the robot. Cancelling it does not stop a motion; use Arm.move()."""
        return self._convert(await _run(self._cell.execute_robot(command, parameter)))

    async def joints(self) -> J:
        """Reads the joints, in degrees."""
        return J(await _run(self._cell.joints()))

    async def position(self) -> P:
        """Reads the position of the tool, in mm and degrees."""
        return P(await _run(self._cell.position()))

    async def examine(self) -> State:
        """Reads what is wrong. It changes nothing."""
        errors, obstacles = await _run(self._cell.examine())
        return State([ErrorInfo(*error) for error in errors], obstacles)

    def take_arm(self) -> _Opening[Arm]:
        """Takes the arm: `async with cell.take_arm() as arm`."""
        return _opening(lambda: self._cell.take_arm(), Arm)

    def recover(self, *, alone: bool = False, speed: Optional[float] = None) -> _Opening[Arm]:
        """Clears the errors, takes the arm and switches the motor on. **The arm of a COBOTTA can move.**"""
        return _opening(lambda: self._cell.recover(alone, speed), Arm)

    def prepare(self) -> _Opening[Arm]:
        """Takes the arm, and prepares the motion of a COBOTTA. **The arm can move.**"""
        return _opening(lambda: self._cell.prepare(), Arm)

    async def stopper(self) -> Stopper:
        """Opens a second connection, over which the robot can be halted at any time."""
        return Stopper(await _run(self._cell.stopper()))

    async def read_file(self, name: str) -> Union[str, bytes]:
        """Reads a file of the controller."""
        content: Union[str, bytes] = await _run(self._cell.read_file(name))
        return content

    async def write_file(self, name: str, content: Union[str, bytes]) -> None:
        """Replaces the content of a file of the controller."""
        await _run(self._cell.write_file(name, content))

    async def start_task(self, name: str, mode: str = "once") -> None:
        """Starts a task: "once", "continuous" or "step"."""
        await _run(self._cell.start_task(name, mode))

    async def stop_task(self, name: str, mode: str = "default") -> None:
        """Stops a task: "default", "now", "step", "cycle" or "initialize"."""
        await _run(self._cell.stop_task(name, mode))

    async def task_status(self, name: str) -> str:
        """Returns the status of a task."""
        return await _run(self._cell.task_status(name))

    async def close(self) -> None:
        """Gives the arm back, releases all objects and ends the session."""
        await _run(self._cell.close())


class Arm:
    """The arm of a robot, which this program has taken, as bcap.Arm."""

    def __init__(self, arm: _bcap.Arm) -> None:
        self._arm = arm
        _signals.arm_taken()
        self._given = weakref.finalize(self, _signals.arm_given)
        self._given.atexit = False

    async def __aenter__(self) -> Arm:
        return self

    async def __aexit__(self, *raised: Any) -> None:
        await self.give()

    async def motor_on(self) -> None:
        """Switches the motor on, and waits until it is."""
        await _run(self._arm.motor(True))

    async def motor_off(self) -> None:
        """Switches the motor off, and waits until it is."""
        await _run(self._arm.motor(False))

    async def set_speed(self, percent: float) -> None:
        """Sets the external speed, in percent of the maximum."""
        await _run(self._arm.set_speed(percent))

    async def select_tool(self, number: int) -> None:
        """Selects a tool; 0 is the flange."""
        await _run(self._arm.select_tool(number))

    async def select_work(self, number: int) -> None:
        """Selects work coordinates; 0 is the base of the robot."""
        await _run(self._arm.select_work(number))

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
        """Moves, and returns when the robot rests at the last destination. Cancelling it halts the robot."""
        motions = _values.path(
            destinations, line, passing, via=via, speed=speed, acceleration=acceleration, deceleration=deceleration
        )
        await _run(self._arm.motions(motions, timeout))

    async def approach(
        self, destination: Destination, mm: float, *, line: bool = False, speed: Optional[float] = None, timeout: float = 60.0
    ) -> None:
        """Moves to the place that is `mm` before a destination, against the direction of the tool."""
        way = "approach line" if line else "approach joint"
        await _run(self._arm.motions([_values.step(way, destination, amount=mm, speed=speed)], timeout))

    async def depart(self, mm: float, *, line: bool = True, speed: Optional[float] = None, timeout: float = 60.0) -> None:
        """Moves back by `mm`, against the direction of the tool."""
        way = "depart line" if line else "depart joint"
        await _run(self._arm.motions([_values.step(way, amount=mm, speed=speed)], timeout))

    async def drive(
        self, axes: Mapping[int, float], *, relative: bool = False, speed: Optional[float] = None, timeout: float = 60.0
    ) -> None:
        """Turns axes, 1 to 8, to a value in degrees or mm, or by it."""
        way = "drive-by" if relative else "drive-to"
        await _run(self._arm.motions([_values.step(way, axes=list(axes.items()), speed=speed)], timeout))

    async def rotate(
        self, plane: str, degrees: float, centre: Sequence[float], *, speed: Optional[float] = None, timeout: float = 60.0
    ) -> None:
        """Moves the tool along a circle in the plane "xy", "yz" or "zx" about a point (X, Y, Z in mm)."""
        motion = _values.step("rotate", amount=degrees, plane=plane, centre=[float(c) for c in centre], speed=speed)
        await _run(self._arm.motions([motion], timeout))

    def slave_mode(
        self,
        *,
        mode: int = 2,
        kind: str = "J",
        max_speed: Optional[float] = None,
        max_acceleration: Optional[float] = None,
        pose_timeout: float = 1.0,
    ) -> _Opening[SlaveStream]:
        """Begins a stream of poses, one every 8 ms: `async with arm.slave_mode() as stream`."""
        config = {
            "mode": mode, "kind": kind, "max_speed": max_speed, "max_acceleration": max_acceleration, "pose_timeout": pose_timeout
        }  # fmt: skip
        return _opening(lambda: self._arm.stream(config), SlaveStream)

    async def give(self) -> None:
        """Halts a motion, switches the motor off and gives the arm back, as the end of the block does."""
        await _run(self._arm.give())
        self._given()


class SlaveStream:
    """A stream of Slave Mode, as bcap.SlaveStream."""

    def __init__(self, stream: _bcap.Stream) -> None:
        self._stream = stream
        self._cycle = _values.cycle(stream.wanted())
        #: after the end: cycles, late, refused, underflows
        self.statistics: Dict[str, int] = {}

    @property
    def cycle(self) -> Cycle:
        """The pose that is wanted next: its number, the start, and the pose at the last reply."""
        return self._cycle

    async def step(self, pose: Iterable[float]) -> Cycle:
        """Sends the pose of this cycle, and waits until the next one is wanted."""
        wanted = await _run(self._stream.step(list(pose)))
        if wanted is None:
            await self.finish()
            raise StreamError("the stream has ended")
        self._cycle = _values.cycle(wanted)
        return self._cycle

    async def finish(self) -> None:
        """Ends the stream, and waits until the robot rests at the last pose."""
        self.statistics = dict(await _run(self._stream.finish(False)))

    async def stop(self) -> None:
        """Ends the stream early: the robot slows down along its present direction."""
        self.statistics = dict(await _run(self._stream.finish(True)))

    async def __aenter__(self) -> SlaveStream:
        return self

    async def __aexit__(self, kind: Optional[Type[BaseException]], error: Any, trace: Optional[TracebackType]) -> None:
        if not self.statistics and not isinstance(error, StreamError):
            await (self.finish() if kind is None else self.stop())


class Stopper:
    """Halts the robot, even while another call waits. It is not an emergency stop."""

    def __init__(self, stopper: _bcap.Stopper) -> None:
        self._stopper = stopper

    async def halt(self) -> str:
        """Halts the robot, and waits until it rests."""
        return await _run(self._stopper.halt())
