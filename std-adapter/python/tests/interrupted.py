"""A program that is interrupted: `interrupted.py ADDRESS KIND DELAY`. test_interrupts.py runs it."""

import asyncio
import gc
import math
import os
import signal
import sys
import threading
import time
from typing import Any

import bcap
import bcap.aio
from bcap.compat import bcapclient

ADDRESS, KIND, DELAY = sys.argv[1], sys.argv[2], float(sys.argv[3])
HOME, ASIDE = bcap.J(0, 45, 90, 0, 45, 0), bcap.J(20, 45, 90, 0, 45, 0)


def after_delay(action: Any) -> None:
    timer = threading.Timer(DELAY, action)
    timer.daemon = True
    timer.start()


def send(number: int) -> None:
    after_delay(lambda: os.kill(os.getpid(), number))


def raise_later(error: BaseException) -> None:
    def handler(*_: Any) -> None:
        raise error

    signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, DELAY)


def swing(cell: bcap.Controller, arm: bcap.Arm) -> None:
    arm.motor_on()
    while True:
        arm.move(ASIDE, speed=10)
        cell["I1"] = cell["I1"] + 1
        arm.move(HOME, speed=10)


def move() -> None:
    with bcap.Controller(ADDRESS) as cell, cell.take_arm() as arm:
        swing(cell, arm)


def stream() -> None:
    with bcap.Controller(ADDRESS) as cell, cell.take_arm() as arm:
        arm.motor_on()
        with arm.slave_mode(max_speed=100, max_acceleration=800) as poses:
            while True:
                joints = list(poses.cycle.start)
                joints[0] += 1 - math.cos(poses.cycle.number / 100)
                poses.step(joints)


async def move_async() -> None:
    async with bcap.aio.Controller(ADDRESS) as cell, cell.take_arm() as arm:
        await arm.motor_on()
        while True:
            await arm.move(ASIDE, speed=10)
            await arm.move(HOME, speed=10)


def move_as_the_makers_client() -> None:
    client = bcapclient.BCAPClient("127.0.0.1", int(ADDRESS.rsplit(":", 1)[1]), 10)
    client.service_start("")
    controller = client.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
    robot = client.controller_getrobot(controller, "Arm", "")
    client.robot_execute(robot, "TakeArm", [0, 0])
    client.robot_execute(robot, "Motor", [1, 0])
    while True:
        client.robot_move(robot, 1, "@E J(20, 45, 90, 0, 45, 0)", "SPEED=10")
        client.robot_move(robot, 1, "@E J(0, 45, 90, 0, 45, 0)", "SPEED=10")


def end_of_the_interpreter() -> None:
    """Nothing gives the arm back, and a thread moves the robot."""
    cell = bcap.Controller(ADDRESS)
    arm = cell.take_arm()
    sys.kept = (cell, arm)  # type: ignore[attr-defined]
    threading.Thread(target=swing, args=(cell, arm), daemon=True).start()
    time.sleep(DELAY)


class Node:
    """It refers to itself."""

    def __init__(self, *kept: Any) -> None:
        self.me, self.kept = self, kept


def dropped() -> None:
    """The objects are in a cycle, while a stream holds the robot; the program continues."""
    cell = bcap.Controller(ADDRESS)
    arm = cell.take_arm()
    arm.motor_on()
    node = Node(arm, arm.slave_mode(pose_timeout=60), None if DELAY < 0.2 else cell)
    time.sleep(DELAY / 10)
    del arm, node
    gc.collect()
    print("dropped", flush=True)
    sys.stdin.read()


def main() -> None:
    if KIND == "KeyboardInterrupt":
        send(signal.SIGINT)
        move()
    elif KIND == "SIGTERM":
        send(signal.SIGTERM)
        move()
    elif KIND == "exception":
        raise_later(ValueError("of the program"))
        move()
    elif KIND == "sys.exit":
        raise_later(SystemExit(3))
        move()
    elif KIND == "stream":
        send(signal.SIGINT)
        stream()
    elif KIND == "asyncio":
        send(signal.SIGINT)
        asyncio.run(move_async())
    elif KIND == "compat":
        send(signal.SIGINT)
        move_as_the_makers_client()
    elif KIND == "end":
        end_of_the_interpreter()
    elif KIND == "cycle":
        dropped()
    else:
        send(signal.SIGKILL)
        move()


main()
