"""Writes bcap/aio.py from bcap/__init__.py, so that names, arguments and texts are written once: python tests/write_aio.py"""

import ast
import re
from pathlib import Path
from typing import Iterator

PACKAGE = Path(__file__).resolve().parents[1] / "bcap"

HEAD = '''\
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
'''

#: what Session has, or asyncio does not
LEFT_OUT = {"Controller": {"__getitem__", "__setitem__", "__enter__", "__exit__", "watch"}}

#: a call with two levels of parentheses in its arguments
CALL = re.compile(r"(self\.\w+\.\w+\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\))\.wait\(\)")
OPENS = re.compile(r"return (Arm|SlaveStream)\((self\..*)\.wait\(\)\)")


def method(source: str) -> str:
    """Returns a method for asyncio."""
    if OPENS.search(source):
        source = re.sub(r"\) -> (\w+):", r") -> Opening[\1]:", source, count=1)
        return OPENS.sub(r"return opening(lambda: \2, \1)", source)
    # the connection begins in a coroutine
    source = re.sub(r"self\._cell = (_connect\(.*), True\)\.wait\(\)", r"self._connecting = \1, False)", source)
    awaiting = CALL.sub(r"await run(\1)", source)
    assert ".wait()" not in awaiting, f"a call that write_aio.py does not see:\n{awaiting}"
    awaiting = re.sub(r"(self\.(?:_?finish|give)\()", r"await \1", awaiting)
    awaiting = re.sub(r"def __(enter|exit)__", r"def __a\1__", awaiting)
    return awaiting if awaiting == source else awaiting.replace("    def ", "    async def ", 1)


def classes() -> Iterator[str]:
    text = (PACKAGE / "__init__.py").read_text()
    lines = text.splitlines()
    for item in ast.parse(text).body:
        if not isinstance(item, ast.ClassDef) or item.name not in ("Controller", "Arm", "SlaveStream", "Stopper"):
            continue
        base = "(Session)" if item.name == "Controller" else ""
        yield f'\n\nclass {item.name}{base}:\n    """As bcap.{item.name}."""\n'
        for part in item.body:
            if isinstance(part, ast.FunctionDef) and part.name not in LEFT_OUT.get(item.name, ()):
                first = min([part.lineno, *(decorator.lineno for decorator in part.decorator_list)])
                yield "\n" + method("\n".join(lines[first - 1 : part.end_lineno]) + "\n")


def written() -> str:
    return HEAD + "".join(classes())


if __name__ == "__main__":
    (PACKAGE / "aio.py").write_text(written())
