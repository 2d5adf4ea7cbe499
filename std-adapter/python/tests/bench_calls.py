"""Processor time of a call, user and system: the clients of this package, and a client in pure Python.

Run it by hand, with a wheel that was built with optimisation: python tests/bench_calls.py. It prints the least of several rounds,
because other load of a machine adds to the time and never takes from it. std-adapter/c/speed measures C and Rust.
"""

import asyncio
import select
import socket
import struct
import subprocess
import sys
import time
from typing import Any, Awaitable, Callable, Dict, List

import bcap
import bcap.aio
from bcap.compat import bcapclient

ROUNDS, CALLS = 12, 1000


class PurePython:
    """A client of the same shape as the maker's: struct, select before each of three receives, and a copy for each argument."""

    def __init__(self, host: str, port: int) -> None:
        self.socket, self.serial = socket.create_connection((host, port)), 0

    def receive(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            select.select([self.socket], [], [], 10)
            data += self.socket.recv(count - len(data))
        return data

    def call(self, function: int, *arguments: Any) -> Any:
        packed = b""
        for value in arguments:
            if isinstance(value, str):
                text = value.encode("utf-16le")
                packed_value = struct.pack("<HII%ds" % len(text), 8, 1, len(text), text)
            else:
                packed_value = struct.pack("<HIi", 3, 1, value)
            packed += struct.pack("<I%ds" % len(packed_value), len(packed_value), packed_value)
        self.serial = self.serial % 0xFFFF + 1
        frame = struct.pack("<BIHHiH", 1, 16 + len(packed), self.serial, 0, function, len(arguments)) + packed + b"\4"
        self.socket.sendall(frame)
        head = self.receive(1) + self.receive(4)
        body = self.receive(struct.unpack("<I", head[1:])[0] - 5)
        code, count = struct.unpack("<iH", body[4:10])
        assert code >= 0, hex(code)
        if not count or len(body) < 25:
            return None
        vartype, elements = struct.unpack("<HI", body[14:20])
        code, size = {3: ("i", 4), 4: ("f", 4), 5: ("d", 8)}[vartype & 0xFFF]
        values = struct.unpack(f"<{elements}{code}", body[20 : 20 + elements * size])
        return values if vartype & 0x2000 else values[0]


def report(name: str, calls: Dict[str, float]) -> None:
    print(f"{name:14}" + "".join(f"{calls[call]:12.1f}" for call in CALLED), flush=True)


CALLED = ("read I1", "write I1", "read P1", "joints")


def least(call: Callable[[], object]) -> float:
    """Returns the processor time of a call in microseconds."""
    times: List[float] = []
    for _ in range(ROUNDS):
        began = time.process_time()
        for _ in range(CALLS):
            call()
        times.append((time.process_time() - began) / CALLS * 1e6)
    return min(times)


async def least_awaited(call: Callable[[], Awaitable[object]]) -> float:
    times: List[float] = []
    for _ in range(ROUNDS):
        began = time.process_time()
        for _ in range(CALLS):
            await call()
        times.append((time.process_time() - began) / CALLS * 1e6)
    return min(times)


def measure(name: str, calls: List[Callable[[], object]]) -> None:
    report(name, {called: least(call) for called, call in zip(CALLED, calls)})


async def measure_aio(address: str) -> None:
    async with bcap.aio.Controller(address) as cell:
        calls = [lambda: cell.read("I1"), lambda: cell.write("I1", 5), lambda: cell.read("P1"), cell.joints]
        report("aio", {called: await least_awaited(call) for called, call in zip(CALLED, calls)})


def main() -> None:
    if sys.argv[1:] == ["serve"]:
        served = bcap.sim()
        print(served.address, flush=True)
        sys.stdin.read()
        return
    with subprocess.Popen([sys.executable, __file__, "serve"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout and server.stdin
        address = server.stdout.readline().strip()
        host, port = "127.0.0.1", int(address.rsplit(":", 1)[1])
        print(f"{'us each':14}" + "".join(f"{call:>12}" for call in CALLED))
        pure = PurePython(host, port)
        pure.call(1, "")
        controller = pure.call(3, "", "CaoProv.DENSO.VRC", "localhost", "")
        integer, pose = (pure.call(9, controller, name, "") for name in ("I1", "P1"))
        robot = pure.call(7, controller, "Arm", "")
        measure("pure Python", [
            lambda: pure.call(101, integer), lambda: pure.call(102, integer, 5), lambda: pure.call(101, pose),
            lambda: pure.call(64, robot, "CurJnt", ""),
        ])  # fmt: skip
        old = bcapclient.BCAPClient(host, port, 10)
        old.service_start("")
        handle = old.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
        variable, position = (old.controller_getvariable(handle, name, "") for name in ("I1", "P1"))
        arm = old.controller_getrobot(handle, "Arm", "")
        measure("BCAPClient", [
            lambda: old.variable_getvalue(variable), lambda: old.variable_putvalue(variable, 5),
            lambda: old.variable_getvalue(position), lambda: old.robot_execute(arm, "CurJnt", None),
        ])  # fmt: skip
        with bcap.Controller(address) as cell:
            measure("Controller", [lambda: cell["I1"], lambda: cell.write("I1", 5), lambda: cell["P1"], cell.joints])
        asyncio.run(measure_aio(address))
        server.stdin.close()


main()
