"""The programs of docs/python.md, against the virtual controller."""

import re
import threading
from pathlib import Path

import pytest

import bcap

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "python.md").read_text()
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("number", range(6))
def test_a_program_of_the_book(
    number: int, sim: bcap.Sim, bcap_sim: bcap.Sim, capsys: pytest.CaptureFixture[str]
) -> None:
    program = PROGRAMS[number].replace('"tcp:192.168.0.1"', "address")
    program = program.replace('"192.168.0.1", 5007', '"127.0.0.1", ' + str(sim.address).rsplit(":", 1)[1])
    # a busy machine does not keep the cycle of Slave Mode
    address = bcap_sim if "slave_mode" in program else str(sim.address)
    exec(compile(program, f"docs/python.md, program {number + 1}", "exec"), {"__name__": "program", "address": address})
    # the halt of another thread looks at the robot until it rests
    for thread in threading.enumerate():
        if isinstance(thread, threading.Timer):
            thread.join(30)
    printed = capsys.readouterr().out
    assert ["5 parts", "stopped at J(", "{'cycles': 25", "[1, 1, 1, 1, 1, 1, 1, 1, 1, 1]", "", "I1 = 5"][number] in printed
    assert not (sim.arm_taken or sim.motor_on or sim.moving)


def test_a_stop_before_the_motion_prevents_it(sim: bcap.Sim, capsys: pytest.CaptureFixture[str]) -> None:
    program = PROGRAMS[1].replace('"tcp:192.168.0.1"', "address")
    # the timer of the program ends a second after its start
    late = program.replace("    try:\n", "    __import__('time').sleep(1.5)\n    try:\n")
    assert late != program
    before = list(sim.joints)
    exec(compile(late, "docs/python.md", "exec"), {"__name__": "program", "address": str(sim.address)})
    assert list(sim.joints) == before and "at the destination" not in capsys.readouterr().out
    assert not (sim.arm_taken or sim.motor_on or sim.moving)


def test_the_programs_have_the_lines_that_the_page_says() -> None:
    lines = [sum(bool(line.strip()) for line in program.splitlines()) for program in PROGRAMS]
    variables, motion, stream, fleet, without_robot, makers = lines
    assert max(lines) <= 20 and without_robot <= 5
    text = " ".join(PAGE.split())
    assert f"This script has {makers} lines" in text
    assert f"have {variables} (variables), {motion} (a motion with a stop), {stream} (Slave Mode) and {fleet} (ten" in text
