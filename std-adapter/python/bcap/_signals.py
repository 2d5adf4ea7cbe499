"""SIGTERM and SIGHUP while an arm is taken.

By default these signals end the process immediately, so the robot would not be halted. While an arm is taken, and unless the program
has its own handler, they raise SystemExit in the main thread instead, as sys.exit does: `with` blocks end, and the arm is given back.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Optional

_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
_taken = 0


def _exit(number: int, frame: Optional[FrameType]) -> None:
    raise SystemExit(128 + number)


def arm_taken() -> None:
    """Installs the handlers; only the main thread can."""
    global _taken
    _taken += 1
    _replace(signal.SIG_DFL, _exit)


def arm_given() -> None:
    """Restores the default when the last arm is given back."""
    global _taken
    _taken -= 1
    if _taken == 0:
        _replace(_exit, signal.SIG_DFL)


def _replace(before: object, after: object) -> None:
    if threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            if signal.getsignal(number) == before:
                signal.signal(number, after)  # type: ignore[arg-type]
