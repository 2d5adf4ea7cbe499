"""Programs that are interrupted at 200 random moments: the arm is free, the motor off, and the robot at rest."""

import random
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Tuple

import pytest
from conftest import at_rest, eventually

import bcap

PROGRAM = Path(__file__).with_name("interrupted.py")

#: the exit codes that a program may have; a program that SIGTERM ends before the arm is taken has -15
KINDS = {
    "KeyboardInterrupt": {1, -2, 130},
    "SIGTERM": {143, -15},
    "exception": {1},
    "sys.exit": {3},
    "stream": {1, -2, 130},
    "asyncio": {1, -2, 130},
    "compat": {1, -2, 130},
    "end": {0},
    "cycle": {0},
}


def interrupted(kind: str, delay: float) -> Tuple[bool, bool]:
    """Runs a program; returns whether the robot was released, and whether the program had moved it."""
    with bcap.sim() as sim:
        command = [sys.executable, str(PROGRAM), str(sim.address), kind, str(delay)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
            if kind == "cycle":
                assert program.stdout and program.stdout.readline() == b"dropped\n"
                released = eventually(lambda: at_rest(sim))
            output = program.communicate(timeout=60)
        codes = KINDS.get(kind, {-9})
        assert program.returncode in codes, (kind, delay, program.returncode, output)
        if kind != "cycle":
            # after the end of a session, only the controller's detection of the closed connection takes time
            released = eventually(lambda: at_rest(sim), 5)
        moved = abs(sim.joints[0]) > 0.001
        if released:
            # it is dropped, not closed: on a busy machine the close can exceed its deadline
            second = bcap.Controller(sim)
            assert second["robot/@SERVO_ON"] is False
            second.execute("ClearError")
            second.take_arm().give()
        return released, moved


def test_200_random_interrupts_release_the_robot() -> None:
    random_delay = random.Random(36)
    shares = {"KeyboardInterrupt": 50, "end": 25, "SIGTERM": 25, "exception": 20, "sys.exit": 20, "stream": 20, "asyncio": 15}
    shares.update(compat=15, cycle=10)
    cases = [(kind, random_delay.uniform(0, 1.0)) for kind, share in shares.items() for _ in range(share)]
    assert len(cases) == 200
    with ThreadPoolExecutor(8) as pool:
        ended = list(pool.map(lambda case: interrupted(*case), cases))
    left = [case for case, (released, _) in zip(cases, ended) if not released]
    assert left == []
    # the interrupts also hit motions
    assert sum(moved for _, moved in ended) > 10


def test_a_killed_program_leaves_the_motor_on() -> None:
    """The control: what the test above checks is not the work of the virtual controller."""
    assert interrupted("SIGKILL", 1.5)[0] is False
