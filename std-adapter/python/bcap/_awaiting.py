"""Awaiting calls: what bcap.aio has that differs from bcap. tests/write_aio.py writes the rest of bcap.aio from bcap."""

from __future__ import annotations

import asyncio
import os
import weakref
from typing import TYPE_CHECKING, Any, AsyncIterator, Awaitable, Callable, Generator, Generic, Optional, Sequence, TypeVar

from . import _bcap, _values
from ._values import Change

if TYPE_CHECKING:
    from typing_extensions import Self

_R = TypeVar("_R")
_N = TypeVar("_N")


_inboxes: weakref.WeakKeyDictionary[asyncio.AbstractEventLoop, _bcap.Inbox] = weakref.WeakKeyDictionary()


def _inbox(loop: asyncio.AbstractEventLoop) -> _bcap.Inbox:
    """Returns the inbox of an event loop, which reads it."""
    inbox = _inboxes.get(loop)
    if inbox is None:
        inbox = _inboxes[loop] = _bcap.Inbox()
        os.set_blocking(inbox.fileno(), False)
        loop.add_reader(inbox.fileno(), _settle, inbox)
    return inbox


def _settle(inbox: _bcap.Inbox) -> None:
    for future, value, error in inbox.take():
        if future.done():
            continue
        if error is None:
            future.set_result(value)
        else:
            future.set_exception(error)


async def run(call: _bcap.Call[_R]) -> _R:
    """Runs a call. If the task is cancelled, so is the call."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[_R] = loop.create_future()
    started = call.start(_inbox(loop), future)
    try:
        return await future
    finally:
        started.cancel()


class Opening(Generic[_R]):
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


def opening(call: Callable[[], _bcap.Call[_N]], made: Callable[[_N], _R]) -> Opening[_R]:
    """Creates an object from the result of a call."""

    async def open_it() -> _R:
        return made(await run(call()))

    return Opening(open_it)


class Session:
    """A session with a controller, as bcap.Controller. It connects when it is awaited or entered."""

    _convert: _values.Converter
    _connecting: _bcap.Call[_bcap.Controller]
    _opened: Optional[_bcap.Controller] = None

    @property
    def _cell(self) -> _bcap.Controller:
        if self._opened is None:
            raise RuntimeError("the controller is not connected: await it, or use `async with`")
        return self._opened

    def __await__(self) -> Generator[Any, None, Self]:
        return self.__aenter__().__await__()

    async def __aenter__(self) -> Self:
        if self._opened is None:
            self._opened = await run(self._connecting)
        return self

    async def __aexit__(self, *raised: Any) -> None:
        await run(self._cell.close())

    async def watch(self, names: Sequence[str], interval: float = 0.1) -> AsyncIterator[Change]:
        """Reads variables every `interval` seconds, and iterates over their changes. A failed reading ends it."""
        watch = self._cell.watch([names] if isinstance(names, str) else names, interval)
        while (change := _values.change(await run(watch.next()), self._convert)) is not None:
            yield change
