"""Forked processes: the objects of the parent are refused there, new ones work, and the parent keeps its own."""

import multiprocessing
import os
import sys
from typing import Any, Callable

import pytest

import bcap
from bcap.compat import bcapclient

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")


def refused(call: Callable[[], object]) -> str:
    try:
        call()
    except RuntimeError as error:
        return str(error)
    return "it was not refused"


def in_child(inherited: bcap.Controller, address: str, queue: "multiprocessing.Queue[Any]") -> None:
    old = refused(lambda: inherited["I1"])
    with bcap.Controller(address) as cell:
        # a stopper runs on the thread that all stoppers of a process share
        queue.put((old, cell["I1"], cell.stopper().halt()))


def test_a_forked_process_opens_its_own_connections(sim: bcap.Sim, cell: bcap.Controller) -> None:
    cell["I1"] = 7
    cell.stopper()
    context = multiprocessing.get_context("fork")
    queue: "multiprocessing.Queue[Any]" = context.Queue()
    child = context.Process(target=in_child, args=(cell, str(sim.address), queue))
    child.start()
    old, value, halted = queue.get(timeout=30)
    child.join(30)
    assert child.exitcode == 0
    assert "belongs to the process that this one was forked from" in old
    assert value == 7 and halted == "nothing moved"
    assert cell["I1"] == 7


def test_the_end_of_a_forked_process_leaves_the_arm_of_its_parent(sim: bcap.Sim, cell: bcap.Controller) -> None:
    client = bcapclient.BCAPClient("127.0.0.1", int(str(sim.address).rsplit(":", 1)[1]), 10)
    client.service_start("")
    with cell.take_arm() as arm:
        arm.motor_on()
        child = os.fork()
        if child == 0:
            # as a program ends, with all objects
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
            calls = [arm.motor_off, cell.joints, lambda: client.controller_connect("", "", "", "")]
            code = sum("was forked from" in refused(call) for call in calls)
            del arm, cell, client, calls
            bcap._bcap.end()
            os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
        assert sim.arm_taken and sim.motor_on
        arm.move(bcap.J(5, 45, 90, 0, 45, 0), speed=100)
    assert not sim.arm_taken
