"""Scripts of the maker's Python client: call sequences of public programs, and programs in the style of public samples.

The sequences are from tests/drivers (its README describes the format). They are played through the methods of BCAPClient on the model
that each program is for.
"""

import ctypes
import inspect
import json
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Dict, Iterator, List

import pytest
from conftest import at_rest, eventually

import bcap
from bcap.compat import bcapclient
from bcap.compat.orinexception import HResult, ORiNException

DRIVERS = Path(__file__).resolve().parents[3] / "tests" / "drivers"
PROVIDERS = {"rc9": "CaoProv.DENSO.VRC9", "rc8": "CaoProv.DENSO.VRC", "cobotta": "CaoProv.DENSO.VRC"}
#: what the player here does not do
UNPLAYED = {"stream", "repeat", "during", "emergency_stop", "error"}


def read(path: Path) -> List[Dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines() if line]


def playable(path: Path) -> bool:
    head, *steps = read(path)
    return "sessions" not in head and not any(UNPLAYED & set(step) for step in steps)


#: it moves for 70 s; the tests in Rust play it on a virtual clock
LONG = {"python-next"}

SEQUENCES = sorted(path.stem for path in DRIVERS.glob("python-*.jsonl") if playable(path) and path.stem not in LONG)


def value_of(given: Any, names: Dict[str, Any]) -> Any:
    """Returns an argument of a sequence."""
    if isinstance(given, str) and given.startswith("$"):
        name, *rest = given[1:].split(".", 1)
        value = names[name]
        if rest:
            value = value[int(rest[0][:-2]) :] if rest[0].endswith("..") else value[int(rest[0])]
        return value
    if isinstance(given, list):
        return [value_of(item, names) for item in given]
    if isinstance(given, dict):
        ((kind, value),) = given.items()
        made = {"R4": ctypes.c_float, "I2": ctypes.c_short, "R8": float, "UI1": ctypes.c_ubyte, "BSTR": str, "BOOL": bool}[kind]
        return [made(item) for item in value] if isinstance(value, list) else made(value)
    return given


def plain(value: Any) -> Any:
    """Returns numbers as R4 has them."""
    if isinstance(value, list):
        return [plain(item) for item in value]
    number = getattr(value, "value", value)
    return ctypes.c_float(number).value if isinstance(number, float) else number


def play(client: bcapclient.BCAPClient, steps: List[Dict[str, Any]], model: str) -> int:
    """Plays a sequence, compares its codes and values, and returns the number of calls."""
    names: Dict[str, Any] = {"provider": PROVIDERS[model]}
    calls = 0
    for step in steps:
        if "pause_ms" in step:
            time.sleep(step["pause_ms"] / 1000)
            continue
        if model not in step.get("only", [model]):
            continue
        function = "".join(("_" + letter if letter.isupper() else letter) for letter in step["call"])[1:]
        owner, _, name = function.partition("_")
        method = getattr(client, f"{owner}_{name.replace('_', '')}".lower())
        wanted = step.get("code", "S_OK")
        wanted = wanted.get(model, "S_OK") if isinstance(wanted, dict) else wanted
        for _ in range(step.get("times", 10000 if "until" in step else 1)):
            code, value = 0, None
            try:
                value = method(*value_of(step.get("args", []), names))
            except ORiNException as error:
                code = error.hresult
            calls += 1
            if "until" not in step or plain(value) == plain(value_of(step["until"], names)):
                break
            time.sleep(0.001)
        else:
            assert "until" not in step
        if "code" in step:
            assert (code < 0) == wanted.startswith(("E_", "0x")), (step, hex(code & 0xFFFFFFFF))
        if "is" in step:
            assert plain(value) == plain(value_of(step["is"], names)), step
        if "as" in step:
            names[step["as"]] = value
    return calls


@pytest.mark.parametrize("name", SEQUENCES)
def test_a_sequence_of_a_public_program(name: str, tmp_path: Path) -> None:
    head, *steps = read(DRIVERS / f"{name}.jsonl")
    model = head["models"][0]
    with bcap.sim(model, scenario=head.get("scenario") or None, files=str(tmp_path)) as sim:
        with bcap.Controller(sim) as cell:
            for variable, value in head.get("variables", {}).items():
                cell[variable] = value_of(value, {})
        client = bcapclient.BCAPClient("127.0.0.1", int(str(sim.address).rsplit(":", 1)[1]), 10)
        assert play(client, steps, model) > 0
        del client
        assert eventually(lambda: at_rest(sim))


def test_enough_sequences_are_played() -> None:
    assert len(SEQUENCES) >= 23


def connect(sim: bcap.Sim) -> Any:
    return bcapclient.BCAPClient("127.0.0.1", int(str(sim.address).rsplit(":", 1)[1]), 10)


def test_a_script_that_reads_and_writes(sim: bcap.Sim) -> None:
    client = connect(sim)
    client.service_start("")
    controller = client.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
    handle = client.controller_getvariable(controller, "I1", "")
    client.variable_putvalue(handle, newval=12)
    assert client.variable_getvalue(handle) == 12
    position = client.controller_getvariable(controller, "P1")
    client.variable_putvalue(position, [400, 0.5, 300, 180, 0, 180, 5])
    assert client.variable_getvalue(position) == [400, 0.5, 300, 180, 0, 180, 5]
    text = client.controller_getvariable(controller, "S1", "")
    client.variable_putvalue(text, "x" * 20000)
    assert client.variable_getvalue(text) == "x" * 20000
    assert client.controller_getrobotnames(controller) == ["Arm0"]
    client.variable_release(handle)
    client.controller_disconnect(controller)
    client.service_stop()


def test_a_script_that_moves(sim: bcap.Sim) -> None:
    client = connect(sim)
    client.service_start("")
    controller = client.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
    robot = client.controller_getrobot(controller, "Arm", "")
    client.robot_execute(robot, "TakeArm", [0, 0])
    client.robot_execute(robot, "Motor", [1, 0])
    client.robot_speed(robot, -1, 100)
    client.robot_move(robot, 1, [[10, 45, 90, 0, 45, 0, 0, 0], "J", "@E"], "")
    assert sim.joints[0] == pytest.approx(10)
    client.robot_move(robot, 1, "@E J(30, 45, 90, 0, 45, 0)", "NEXT")
    client.robot_halt(robot, "")
    assert eventually(lambda: not sim.moving) and sim.joints[0] < 30
    # as a script that ends without a word
    del client
    assert eventually(lambda: at_rest(sim))


def test_an_error_is_a_signed_integer(sim: bcap.Sim) -> None:
    client = connect(sim)
    with pytest.raises(ORiNException) as refused:
        client.controller_getvariable(1, "I1", "")
    assert int(str(refused.value)) == refused.value.hresult < 0
    client.service_start("")
    controller = client.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
    with pytest.raises(ORiNException) as refused:
        client.controller_getvariable(controller, "NONE", "")
    assert HResult.failed(refused.value.hresult) and f"{refused.value.hresult & 0xFFFFFFFF:x}" == "80000204"
    assert isinstance(client.controller_execute(controller, "GetErrorDescription", refused.value.hresult), str)


def test_all_functions_have_the_makers_arguments() -> None:
    methods = [name for name in vars(bcapclient.BCAPClient) if "_" in name[1:] and not name.startswith("_")]
    assert len(methods) == 137
    arguments = {name: str(inspect.signature(getattr(bcapclient.BCAPClient, name))) for name in methods}
    assert arguments["controller_connect"] == "(self, name, provider, machine, option)"
    assert arguments["robot_move"] == "(self, handle, comp, pose, option='')"
    assert arguments["robot_accelerate"] == "(self, handle, axis, accel, decel)"
    assert arguments["variable_putvalue"] == "(self, handle, newval)"
    assert arguments["controller_execute"] == "(self, handle, command, param=None)"
    assert arguments["message_reply"] == "(self, handle, data)"


#: a program whose second thread moves the robot; `%s` is the code of its main thread
MOVED_BY_A_THREAD = """
import os, signal, sys, threading
from bcap.compat import bcapclient

client = bcapclient.BCAPClient("127.0.0.1", int(sys.argv[1]), 10)
client.service_start("")
controller = client.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
robot = client.controller_getrobot(controller, "Arm", "")
client.robot_execute(robot, "TakeArm", [0, 0])
client.robot_execute(robot, "Motor", [1, 0])

def move():
    try:
        client.robot_move(robot, 1, "@E J(90, 45, 90, 0, 45, 0)", "SPEED=1")
    except BaseException as error:
        failed.append(type(error).__name__)

failed = []
mover = threading.Thread(target=move, daemon=True)
mover.start()
sys.stdin.readline()
%s
"""


@contextmanager
def moved_by_a_thread(sim: bcap.Sim, meanwhile: str) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-c", MOVED_BY_A_THREAD % meanwhile, str(sim.address).rsplit(":", 1)[1]]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        # a program that hangs is killed
        killer = threading.Timer(60, program.kill)
        killer.start()
        assert program.stdin and eventually(lambda: sim.moving, 60)
        program.stdin.write("\n")
        program.stdin.flush()
        yield program
        program.communicate()
        killer.cancel()


def test_the_timeout_is_set_while_another_thread_moves(sim: bcap.Sim) -> None:
    with moved_by_a_thread(sim, "client.settimeout(7); print(client.gettimeout(), flush=True); sys.stdin.read()") as program:
        assert program.stdout and program.stdout.readline() == "7\n"
        assert sim.moving
    # the end of the interpreter halts the motion of the thread
    assert program.returncode == 0 and eventually(lambda: at_rest(sim))


def test_a_signal_during_a_wait_for_another_thread_halts_its_motion(sim: bcap.Sim) -> None:
    meanwhile = """
threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
try:
    client.controller_getvariable(controller, "I1", "")
except KeyboardInterrupt:
    mover.join()
    print("interrupted, and the thread had", *failed, flush=True)
    sys.stdin.read()
"""
    with moved_by_a_thread(sim, meanwhile) as program:
        assert program.stdout and program.stdout.readline() == "interrupted, and the thread had NoReply\n"
        # the arm is free when the controller has detected the end of the connection
        assert not (sim.moving or sim.motor_on) and 0 < sim.joints[0] < 45
        assert eventually(lambda: at_rest(sim))
    assert program.returncode == 0
