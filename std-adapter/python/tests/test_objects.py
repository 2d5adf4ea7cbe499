"""Variables, motions, streams, tasks, files and errors, against the virtual controller."""

import math
import os
import signal
import subprocess
import sys
import sysconfig
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy
import pytest
from conftest import at_rest, eventually

import bcap

#: the reply to the call that leaves Slave Mode is late
SLOW_END = '[[fault]]\nwhen = { call = 2, of = "slvChangeMode" }\nthen = { delay_ms = 1500 }\n'
#: values that contain themselves, as lists and by tolist()
ENDLESS = """
import bcap

class Itself:
    def tolist(self):
        return self

pose = [0.0]
pose.append(pose)
with bcap.sim(in_memory=True) as sim, bcap.Controller(sim) as cell:
    for value in (pose, Itself()):
        try:
            cell["P1"] = value
        except ValueError as error:
            print(error)
"""
HOME = bcap.J(0, 45, 90, 0, 45, 0)
ASIDE = bcap.J(30, 45, 90, 0, 45, 0)


def test_variables_have_pythons_types(cell: bcap.Controller) -> None:
    cell["I1"] = 5
    cell["F2"] = 1.5
    cell["S3"] = "häß"
    cell["IO128"] = True
    cell["P4"] = (400.0, 0, 300.0, 180.0, 0, 180.0, 5)
    assert (cell["I1"], cell["F2"], cell["S3"], cell["IO128"]) == (5, 1.5, "häß", True)
    assert cell["P4"] == [400.0, 0.0, 300.0, 180.0, 0.0, 180.0, 5.0]
    assert cell.read_all("I1", "S3") == [5, "häß"]
    assert isinstance(cell["@CURRENT_TIME"], datetime)
    assert cell["robot/@SERVO_ON"] is False


def test_numpy_is_accepted_and_returned_if_wanted(sim: bcap.Sim) -> None:
    with bcap.Controller(sim, numpy=True) as cell:
        cell["P1"] = numpy.array([400, 0, 300, 180, 0, 180, 5], dtype=numpy.float32)
        cell["I1"] = numpy.int64(7)
        cell["F1"] = numpy.float64(2.5)
        position = cell["P1"]
        assert isinstance(position, numpy.ndarray) and position.tolist() == [400, 0, 300, 180, 0, 180, 5]
        assert (cell["I1"], cell["F1"]) == (7, 2.5)


def test_a_refusal_has_code_meaning_and_remedy(cell: bcap.Controller) -> None:
    with pytest.raises(bcap.ControllerError) as refused:
        cell["NO_SUCH_VARIABLE"]
    error = refused.value
    assert (error.code, error.name) == (0x80000204, "E_CAO_OBJECT_NOTFOUND")
    assert error.meaning == "There is no such object." and error.remedy and error.remedy in str(error)


def test_arguments_are_checked(cell: bcap.Controller, sim: bcap.Sim) -> None:
    with pytest.raises(TypeError, match="a value of <class 'object'> cannot be sent"):
        cell["I1"] = object()
    with pytest.raises(ValueError, match='unknown model "rc10"; known are rc8, rc8a'):
        bcap.Controller(sim, model="rc10")
    with pytest.raises(bcap.InvalidArgument, match="robot: write tcp:HOST"):
        bcap.Controller("robot")
    with pytest.raises(bcap.NotConnected):
        bcap.Controller("tcp:127.0.0.1:1")
    with pytest.raises(OverflowError):
        cell["I1"] = 2**70
    with cell.take_arm() as arm:
        with pytest.raises(TypeError, match="a destination is P"):
            arm.move([1.0, 2.0])  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="P does not have 2 numbers"):
            arm.move(bcap.P(1, 2))


@pytest.mark.parametrize("value", [{1, 2}, frozenset({1}), {1: 2}])
def test_a_set_and_a_dictionary_are_refused(bcap_sim: bcap.Sim, value: Any) -> None:
    with bcap.Controller(bcap_sim) as cell:
        for refused in (value, [value]):
            with pytest.raises(TypeError, match=f"a value of {type(value)} cannot be sent"):
                cell["V1"] = refused


def test_a_value_that_contains_itself_is_refused(tmp_path: Path) -> None:
    # in another process, because an overflow of the native stack would end this one
    ended = subprocess.run([sys.executable, "-c", ENDLESS], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout.count("nested deeper than 16")) == (0, 2), ended.stderr


def test_a_motion_arrives_and_the_arm_is_given_back(cell: bcap.Controller, sim: bcap.Sim) -> None:
    with cell.take_arm() as arm:
        arm.motor_on()
        arm.move(ASIDE, speed=100)
        assert sim.arm_taken and sim.motor_on and sim.joints[0] == pytest.approx(30)
        arm.move(bcap.J(28, 45, 90, 0, 45, 0), bcap.J(26, 45, 90, 0, 45, 0), passing="near")
        assert cell.joints()[0] == pytest.approx(26)
    assert at_rest(sim)


def test_every_motion(bcap_sim: bcap.Sim) -> None:
    with bcap.Controller(bcap_sim) as cell, cell.take_arm() as arm:
        cell["P1"] = [400, 0, 300, 180, 0, 180, 5]
        arm.motor_on()
        arm.move("P1", line=True, speed=50, acceleration=50, deceleration=50)
        assert cell.position()[:3] == pytest.approx([400, 0, 300], abs=0.01)
        arm.depart(20)
        assert cell.position()[2] == pytest.approx(320, abs=0.01)
        arm.approach("P1", 50, line=True)
        assert cell.position()[2] == pytest.approx(350, abs=0.01)
        arm.move(bcap.P(400, 50, 300, 180, 0, 180, 5), via=bcap.P(420, 25, 320, 180, 0, 180, 5))
        assert cell.position()[1] == pytest.approx(50, abs=0.01)
        before = cell.joints()
        arm.drive({1: 5.0, 6: -3.0}, relative=True)
        assert cell.joints()[0] == pytest.approx(before[0] + 5) and cell.joints()[5] == pytest.approx(before[5] - 3)
        arm.drive({1: 0.0})
        assert cell.joints()[0] == pytest.approx(0, abs=0.001)


def test_a_motion_without_the_motor_is_refused(cell: bcap.Controller) -> None:
    with cell.take_arm() as arm, pytest.raises(bcap.Error) as refused:
        arm.move(ASIDE)
    assert refused.value.code


def test_a_stopper_halts_and_the_motion_says_so(cell: bcap.Controller, sim: bcap.Sim) -> None:
    stopper = cell.stopper()

    def stop() -> None:
        assert eventually(lambda: sim.moving)
        assert stopper.halt() == "halted"

    with cell.take_arm() as arm, ThreadPoolExecutor() as pool:
        arm.motor_on()
        stopping = pool.submit(stop)
        with pytest.raises((bcap.Halted, bcap.MotionFailed)):
            arm.move(ASIDE, speed=1)
        stopping.result()
    assert at_rest(sim) and stopper.halt() == "nothing moved"


def test_the_time_limit_halts(cell: bcap.Controller, sim: bcap.Sim) -> None:
    with cell.take_arm() as arm:
        arm.motor_on()
        with pytest.raises(bcap.MotionTimeout):
            arm.move(ASIDE, speed=1, timeout=0.2)
        assert not sim.moving


def test_the_end_of_the_block_ends_the_motion_of_another_thread(cell: bcap.Controller, sim: bcap.Sim) -> None:
    with ThreadPoolExecutor(20) as pool, cell.take_arm() as arm:
        arm.motor_on()
        moving = pool.submit(arm.move, ASIDE, speed=1)
        assert eventually(lambda: sim.moving)
        # enough calls that some get the lock of the arm before they are notified that the arm is given back
        waiting = [pool.submit(arm.set_speed, 50) for _ in range(16)]
        # other calls continue in the meantime
        cell["I1"] = 3
        time.sleep(0.1)
    assert at_rest(sim)
    ended, unsent = moving.exception(), [call.exception() for call in waiting]
    assert isinstance(ended, bcap.OutcomeUnknown) and "halted on its way" in str(ended) and ended.may_have_run
    assert all(isinstance(error, bcap.NotConnected) and not error.may_have_run for error in unsent), unsent
    with pytest.raises(bcap.NotConnected, match="given back"):
        arm.motor_on()


def test_a_halt_that_fails_is_not_claimed() -> None:
    scenario = '[[fault]]\nwhen = { every = 1, of = "Robot_Halt" }\nthen = { refuse = "E_FAIL" }\n'
    with bcap.sim(scenario=scenario) as sim, bcap.Controller(sim) as cell, ThreadPoolExecutor() as pool:
        arm = cell.take_arm()
        arm.motor_on()
        moving = pool.submit(arm.move, ASIDE, speed=1)
        assert eventually(lambda: sim.moving)
        with pytest.raises(bcap.Error):
            arm.give()
        ended = moving.exception()
    assert isinstance(ended, bcap.NoReply) and "may be moving" in str(ended) and ended.may_have_run


def test_changes_of_variables(cell: bcap.Controller) -> None:
    cell["I1"] = 1
    changes = cell.watch(["I1", "NONE"], interval=0.01)
    first = next(changes)
    assert first == ("I1", 1)
    with pytest.raises(bcap.ControllerError):
        next(changes)
    cell["I1"] = 2
    assert next(changes) == bcap.Change("I1", 2)


def test_waiting_for_a_value(cell: bcap.Controller) -> None:
    with pytest.raises(bcap.NotMet, match="its last value was"):
        cell.wait_for("I1", 9, timeout=0.05)
    threading.Timer(0.05, lambda: cell.write("I1", 9)).start()
    assert cell.wait_for("I1", 9, timeout=10) == 9


@pytest.mark.parametrize(
    "name, value, wanted",
    [
        ("F1", 1.5, 1.5),
        ("F1", 0.1, 0.1),
        ("F1", 2.0, 2),
        ("D1", 3, 3),
        ("I1", 4, 4.0),
        ("S1", "on", "on"),
        ("IO128", True, True),
        ("IO128", True, 1),
        ("P1", [400, 0, 300.5, 180, 0, 180, 5], bcap.P(400, 0, 300.5, 180, 0, 180, 5)),
        ("V1", [1, 2, 3], [1, 2, 3]),
        ("J1", [0.1] * 8, numpy.full(8, 0.1)),
        ("T1", [0.5] * 9 + [5], [0.5] * 9 + [5]),
    ],
)
def test_a_wanted_value_is_compared_in_the_type_of_the_variable(bcap_sim: bcap.Sim, name: str, value: Any, wanted: Any) -> None:
    with bcap.Controller(bcap_sim) as cell:
        with pytest.raises(bcap.NotMet):
            cell.wait_for(name, wanted, 0)
        cell[name] = value
        assert cell.wait_for(name, wanted, 1) == cell[name]


@pytest.mark.parametrize("name, wanted", [("I1", 1.5), ("I1", 2**40), ("F1", "1.5"), ("S1", 5), ("IO128", 2), ("P1", 5), ("I1", [5])])
def test_a_value_that_a_variable_cannot_have_is_refused(bcap_sim: bcap.Sim, name: str, wanted: Any) -> None:
    with bcap.Controller(bcap_sim) as cell, pytest.raises(bcap.InvalidArgument, match=f"{name} cannot have the wanted value: expected"):
        cell.wait_for(name, wanted, 5)


def test_a_call_that_the_controller_has_given_up_may_have_run() -> None:
    scenario = '[[fault]]\nwhen = { call = 1, of = "Variable_PutValue" }\nthen = { refuse = "E_TIMEOUT" }\n'
    with bcap.sim(scenario=scenario, in_memory=True) as sim, bcap.Controller(sim) as cell:
        with pytest.raises(bcap.NoReply) as given_up:
            cell["I1"] = 5
        assert given_up.value.code == 0x80000900 and given_up.value.may_have_run
        with pytest.raises(bcap.ControllerError) as refused:
            cell["NONE"] = 5
        assert not refused.value.may_have_run


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_the_caller_owns_the_loop_of_slave_mode(bcap_sim: bcap.Sim, mode: int) -> None:
    with bcap.Controller(bcap_sim) as cell, cell.take_arm() as arm:
        arm.motor_on()
        with arm.slave_mode(mode=mode, max_speed=100, max_acceleration=800) as stream:
            start = stream.cycle.start
            for number in range(125):
                joints = list(start)
                joints[0] += 2 * (1 - math.cos(number / 125 * math.pi))
                cycle = stream.step(numpy.array(joints))
            assert cycle.number == 125 and 0 < cycle.pose[0] <= 4.1
        statistics = stream.statistics
        assert statistics["cycles"] >= 125 and statistics["underflows"] == 0
        # the stream has ended, and its end is not reported as a failure
        stream.finish()
        assert stream.statistics == statistics
        assert cell.joints()[0] == pytest.approx(4, abs=0.05) and not bcap_sim.slave_mode


def test_a_stream_refuses_a_pose_beyond_the_limits(bcap_sim: bcap.Sim) -> None:
    with bcap.Controller(bcap_sim) as cell, cell.take_arm() as arm:
        arm.motor_on()
        with pytest.raises(bcap.StreamError), arm.slave_mode(max_speed=10, max_acceleration=800) as stream:
            joints = list(stream.cycle.start)
            joints[0] += 5
            stream.step(joints)
            stream.step(joints)
        assert cell.joints()[0] == pytest.approx(0, abs=0.1)


def test_a_stream_without_poses_stops(cell: bcap.Controller, sim: bcap.Sim) -> None:
    with cell.take_arm() as arm:
        arm.motor_on()
        with pytest.raises(bcap.StreamError, match="no pose within 50ms"):
            with arm.slave_mode(pose_timeout=0.05) as stream:
                assert eventually(lambda: not sim.slave_mode)
                stream.step(stream.cycle.start)
    assert at_rest(sim)


def test_a_stream_that_loses_its_connection_does_not_say_that_the_robot_stopped(sim: bcap.Sim) -> None:
    arm = bcap.Controller(sim).take_arm()
    arm.motor_on()
    with pytest.raises(bcap.NoReply, match="the robot may be moving") as lost, arm.slave_mode() as stream:
        for number in range(200):
            stream.step(stream.cycle.start)
            if number == 5:
                sim.close()
    assert lost.value.may_have_run
    for end in (stream.finish, stream.stop):
        with pytest.raises(bcap.NoReply) as again:
            end()
        assert again.value is lost.value


def test_a_signal_during_the_end_of_a_stream_is_raised() -> None:
    with bcap.sim(scenario=SLOW_END) as sim, bcap.Controller(sim) as cell, cell.take_arm() as arm:
        arm.motor_on()
        with pytest.raises(KeyboardInterrupt), arm.slave_mode() as stream:
            threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
            stream.finish()
        # the end of the block has waited for the end of the stream
        assert stream.statistics and not sim.slave_mode


def test_a_failed_end_of_a_stream_does_not_replace_an_exception(sim: bcap.Sim) -> None:
    arm = bcap.Controller(sim).take_arm()
    arm.motor_on()
    with pytest.raises(ValueError, match="of the program") as raised, arm.slave_mode():
        sim.close()
        raise ValueError("of the program")
    assert isinstance(raised.value.__context__, bcap.NoReply)


def test_errors_and_recovery(cell: bcap.Controller, sim: bcap.Sim) -> None:
    sim.emergency_stop()
    state = cell.examine()
    assert any("emergency stop" in obstacle for obstacle in state.obstacles)
    with pytest.raises(bcap.NotRecovered, match="emergency stop"):
        cell.recover(alone=True)
    sim.emergency_stop(False)
    with cell.recover(alone=True) as arm:
        assert sim.motor_on
        arm.move(ASIDE, speed=100)
    assert cell.examine() == bcap.State([], []) and at_rest(sim)


def test_a_cobotta_is_prepared(sim: bcap.Sim) -> None:
    with bcap.sim("cobotta", in_memory=True) as cobotta, bcap.Controller(cobotta) as cell:
        with cell.take_arm() as arm, pytest.raises(bcap.ControllerError) as unprepared:
            arm.motor_on()
        assert unprepared.value.remedy
        cell.execute("ManualResetPreparation")
        cell.execute("ClearError")
        with cell.prepare() as arm:
            arm.motor_on()


def test_tasks_and_files(tmp_path: Path) -> None:
    (tmp_path / "new.txt").touch()
    scenario = '[[task]]\nname = "Pro1"\nsteps = [{ wait_ms = 100000 }]\n'
    with bcap.sim(scenario=scenario, files=str(tmp_path), in_memory=True) as sim, bcap.Controller(sim) as cell:
        assert cell.task_status("Pro1") == "ready"
        cell.start_task("Pro1")
        assert cell.task_status("Pro1") == "running"
        cell.stop_task("Pro1", "initialize")
        assert cell.task_status("Pro1") == "ready"
        cell.write_file("new.txt", "line 1\n")
        assert cell.read_file("new.txt") == "line 1\n"


def test_commands(cell: bcap.Controller) -> None:
    assert cell.execute("ClearError") is None
    assert cell.execute_robot("CurTool") == 0


def test_the_command_comes_with_the_package(cell: bcap.Controller, sim: bcap.Sim) -> None:
    cell["I1"] = 4711
    command = [str(Path(sysconfig.get_path("scripts"), "bcap")), "get", "--robot", str(sim.address), "I1"]
    assert "4711" in subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_a_session_goes_on_between_calls(sim: bcap.Sim) -> None:
    with bcap.Controller(sim) as cell, bcap.Controller(sim) as other:
        changes = cell.watch("I1", interval=0.01)
        assert next(changes) == bcap.Change("I1", 0)
        arm = cell.take_arm()
        arm.motor_on()
        other["I1"] = 5
        del arm
        # no call of this session is made: its keeper gives the arm back, and reads the variable
        assert eventually(lambda: at_rest(sim))
        assert next(changes) == bcap.Change("I1", 5)
