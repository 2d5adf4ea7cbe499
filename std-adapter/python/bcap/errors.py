"""The exceptions of bcap. All are subclasses of Error.

Error
 +- ControllerError     the controller refused a call, which had no effect
 |   +- NotRecovered    a recovery ended before its last step
 |   +- NotHalted       the robot still moves after a halt
 +- MotionError         the robot rests, and was not seen to arrive
 |   +- Halted          it was halted
 |   +- MotionFailed    the controller has an error
 |   +- MotionTimeout   the time limit passed
 |   +- OutcomeUnknown  whether it rests at the destination was not seen
 +- NotConnected        the call was not sent
 +- NoReply             the outcome of a call is unknown: the robot may be moving
 +- NotMet              a variable did not get a value in time
 +- StreamError         a stream of Slave Mode failed
 +- InvalidArgument     an argument is invalid; also a ValueError
"""

from __future__ import annotations

from typing import Optional


class Error(Exception):
    """Any failure of a call or a motion. The code is None unless the controller gave one."""

    #: whether the controller may have executed the call: a motion may be running, or may have moved the robot
    may_have_run: bool = False

    def __init__(
        self,
        text: str,
        code: Optional[int] = None,
        name: Optional[str] = None,
        meaning: Optional[str] = None,
        remedy: Optional[str] = None,
    ) -> None:
        super().__init__(text)
        #: the controller's code, such as 0x83204032
        self.code = code
        #: its name, such as "E_ACCESSDENIED"
        self.name = name
        #: its meaning in a sentence
        self.meaning = meaning
        #: what to do
        self.remedy = remedy


class ControllerError(Error):
    """The controller refused a call, which had no effect. It has code, name, meaning and remedy."""


class NotRecovered(ControllerError):
    """A recovery or preparation ended before its last step; the arm is not taken. The steps before may have had an effect."""

    may_have_run = True


class NotHalted(ControllerError):
    """The robot still moves after a halt, or the controller refuses the halt. Use the emergency stop."""

    may_have_run = True


class MotionError(Error):
    """The robot rests, and was not seen to arrive where the motion should end."""

    may_have_run = True


class Halted(MotionError):
    """The robot was halted, and rests elsewhere. Clear the error of the controller before the next motion."""


class MotionFailed(MotionError):
    """The controller has an error; it has code, name, meaning and remedy."""


class MotionTimeout(MotionError):
    """The time limit passed, and the robot was halted."""


class OutcomeUnknown(MotionError):
    """The robot rests, and whether that is the destination was not seen. Read its position."""


class NotConnected(Error):
    """There is no session with the controller, or the arm was lost or given back. The call was not sent."""


class NoReply(Error):
    """The outcome of a call or a stream is unknown: **the robot may be moving**.

    There is no reply, or the connection was lost during a stream, or the controller has abandoned the call (E_TIMEOUT, in code).
    """

    may_have_run = True


class NotMet(Error):
    """A variable did not get the value in time."""


class StreamError(Error):
    """A stream of Slave Mode failed: a pose was refused or late, or the controller has an error. No further pose is sent."""

    may_have_run = True


class InvalidArgument(Error, ValueError):
    """An argument is invalid. No call was made."""
