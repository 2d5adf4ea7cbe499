"""The fixtures of bcap for pytest, which finds them by itself."""

from __future__ import annotations

from typing import Iterator

import pytest

from . import Sim, sim


@pytest.fixture
def bcap_sim() -> Iterator[Sim]:
    """A virtual RC8 in memory, on a virtual clock: a motion takes no time. Use it as bcap.Controller(bcap_sim)."""
    with sim(in_memory=True) as controller:
        yield controller
