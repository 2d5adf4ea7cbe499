"""Fixtures: a virtual controller on a port, and a session with it. The package has one in memory: bcap_sim."""

import time
from typing import Callable, Iterator

import pytest

import bcap


@pytest.fixture
def sim() -> Iterator[bcap.Sim]:
    with bcap.sim() as sim:
        yield sim


@pytest.fixture
def cell(sim: bcap.Sim) -> Iterator[bcap.Controller]:
    with bcap.Controller(sim) as cell:
        yield cell


def eventually(condition: Callable[[], bool], within: float = 10.0) -> bool:
    """Waits for a condition, and returns whether it was met."""
    end = time.monotonic() + within
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


def at_rest(sim: bcap.Sim) -> bool:
    """Whether the arm is free, the motor off, Slave Mode off, and the robot at rest."""
    return not (sim.arm_taken or sim.motor_on or sim.moving or sim.slave_mode)
