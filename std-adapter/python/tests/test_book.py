"""The programs of docs/python.md, against the virtual controller."""

import re
import threading
from pathlib import Path

import pytest

import bcap

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "python.md").read_text()
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("number", range(5))
def test_a_program_of_the_book(
    number: int, sim: bcap.Sim, memory: bcap.Sim, capsys: pytest.CaptureFixture[str]
) -> None:
    program = PROGRAMS[number].replace('"tcp:192.168.0.1"', "address")
    # a busy machine does not keep the cycle of Slave Mode
    address = memory if "slave_mode" in program else str(sim.address)
    exec(compile(program, f"docs/python.md, program {number + 1}", "exec"), {"__name__": "program", "address": address})
    # the halt of another thread looks at the robot until it rests
    for thread in threading.enumerate():
        if isinstance(thread, threading.Timer):
            thread.join(30)
    printed = capsys.readouterr().out
    assert ["5 parts", "stopped at J(", "{'cycles': 25", "[1, 1, 1, 1, 1, 1, 1, 1, 1, 1]", ""][number] in printed
    assert not (sim.arm_taken or sim.motor_on or sim.moving)


def test_every_program_is_run() -> None:
    assert len(PROGRAMS) == 5
    # with their blank lines
    assert max(program.count("\n") for program in PROGRAMS) <= 21
