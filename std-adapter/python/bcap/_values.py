"""Poses, and the results of calls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable, Dict, Iterable, NamedTuple, Optional, Sequence, Tuple, Union

if TYPE_CHECKING:
    from typing_extensions import Self


class _Numbers(Tuple[float, ...]):
    kind = ""

    def __new__(cls, *numbers: Union[float, Iterable[float]]) -> Self:
        given: Any = numbers[0] if len(numbers) == 1 and not isinstance(numbers[0], (int, float)) else numbers
        return super().__new__(cls, (float(number) for number in given))

    def __repr__(self) -> str:
        return f"{self.kind}({', '.join(format(number, 'g') for number in self)})"


class P(_Numbers):
    """A position of the tool: X, Y, Z in mm, RX, RY, RZ in degrees, and optionally the figure.

    >>> P(400, 0, 300, 180, 0, 180, 5)
    P(400, 0, 300, 180, 0, 180, 5)
    """

    kind = "P"


class J(_Numbers):
    """Joints in degrees, or mm for a linear axis; 1 to 8 numbers, the others are 0."""

    kind = "J"


class T(_Numbers):
    """A position of the tool: X, Y, Z in mm, the orientation vector, the approach vector, and optionally the figure."""

    kind = "T"


#: A destination: a variable ("P1"), a value in the controller's language ("J(0, 45, 90)"), or P, J or T.
Destination = Union[str, P, J, T]

#: How exactly a motion ends: "exact", "commanded", "near", or a distance in mm.
Passing = Union[str, int]


class ErrorInfo(NamedTuple):
    """A present error of a controller."""

    code: int
    name: Optional[str]
    meaning: Optional[str]
    remedy: Optional[str]


class State(NamedTuple):
    """The problems of a robot: the current errors, the first cause first, and what a person must do before a recovery."""

    errors: Sequence[ErrorInfo]
    obstacles: Sequence[str]


class Change(NamedTuple):
    """A value that differs from the one before."""

    name: str
    value: Any


class Cycle(NamedTuple):
    """The pose of a stream that is wanted next, counted from 0."""

    number: int
    #: where the robot was when the stream began
    start: Tuple[float, ...]
    #: where the robot was at the last reply
    pose: Tuple[float, ...]


def step(way: str, destination: Optional[Destination] = None, **options: Any) -> Dict[str, Any]:
    """Returns a motion as the native module takes it."""
    given = {key: value for key, value in options.items() if value is not None}
    return {
        "way": way,
        "destination": destination,
        "via": None,
        "axes": [],
        "amount": 0.0,
        "plane": "",
        "centre": [0.0, 0.0, 0.0],
        "passing": "exact",
        "speed": None,
        "acceleration": None,
        "deceleration": None,
        **given,
    }


def path(destinations: Sequence[Destination], line: bool, passing: Passing, **options: Any) -> Sequence[Dict[str, Any]]:
    """Returns the motions of a path, the last of which ends exactly."""
    way = "move line" if line else "move joint"
    ends = ["exact" if len(destinations) > 1 else passing]
    passings = [passing] * (len(destinations) - 1) + ends
    return [step(way, end, passing=pass_, **options) for end, pass_ in zip(destinations, passings)]


Converter = Callable[[Any], Any]


def converter(numpy: bool) -> Converter:
    """Returns the conversion of values that were read."""
    if not numpy:
        return lambda value: value
    from numpy import asarray

    def convert(value: Any) -> Any:
        is_array = isinstance(value, list) and all(type(number) in (int, float) for number in value)
        return asarray(value) if is_array else value

    return convert


def change(taken: Optional[Tuple[str, Any, Optional[BaseException]]], convert: Converter) -> Optional[Change]:
    """Returns a change, or raises the failure of its reading."""
    if taken is None:
        return None
    name, value, failure = taken
    if failure is not None:
        raise failure
    return Change(name, convert(value))


def cycle(wanted: Optional[Tuple[int, Sequence[float], Sequence[float]]]) -> Cycle:
    """Returns the cycle that is wanted."""
    number, start, pose = wanted or (0, (), ())
    return Cycle(number, tuple(start), tuple(pose))
