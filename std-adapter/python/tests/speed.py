"""Compares the clients of all languages on the same calls: `just speed` builds them and runs this program.

    speed.py ROUNDS [NAME=PROGRAM]...    with the clients of other languages, such as C=std-adapter/c/examples/calls

Each client is a process with an open session to one virtual controller. In each round every client makes every call, one client after
another and for a few milliseconds, so that other load of the machine meets all of them, and most of the time none. The figures are
medians of the rounds: calls a second, and the processor time of a call, user and system, of the client alone. A ratio is the median
of the ratios in each round. The package must be an optimised one: pip install ./std-adapter/python
"""

import asyncio
import select
import shutil
import socket
import struct
import subprocess
import sys
import sysconfig
import time
from pathlib import Path
from statistics import median
from typing import Any, Awaitable, Callable, Dict, List, Tuple

import bcap
import bcap.aio
from bcap.compat import bcapclient

CALLS = {"read": "read I1", "write": "write I1", "pose": "read P1", "joints": "joints"}
PYTHON = ["pure Python", "BCAPClient", "Controller", "aio.Controller"]
#: calls of a client in a round
COUNT = 50


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

    def request(self, function: int, *arguments: Any) -> bytes:
        packed = b""
        for value in arguments:
            if isinstance(value, str):
                text = value.encode("utf-16le")
                packed_value = struct.pack("<HII%ds" % len(text), 8, 1, len(text), text)
            else:
                packed_value = struct.pack("<HIi", 3, 1, value)
            packed += struct.pack("<I%ds" % len(packed_value), len(packed_value), packed_value)
        self.serial = self.serial % 0xFFFF + 1
        return struct.pack("<BIHHiH", 1, 16 + len(packed), self.serial, 0, function, len(arguments)) + packed + b"\4"

    def reply(self, body: bytes) -> Any:
        code, count = struct.unpack("<iH", body[4:10])
        assert code >= 0, hex(code)
        if not count or len(body) < 25:
            return None
        vartype, elements = struct.unpack("<HI", body[14:20])
        code, size = {3: ("i", 4), 4: ("f", 4), 5: ("d", 8)}[vartype & 0xFFF]
        values = struct.unpack(f"<{elements}{code}", body[20 : 20 + elements * size])
        return values if vartype & 0x2000 else values[0]

    def call(self, function: int, *arguments: Any) -> Any:
        self.socket.sendall(self.request(function, *arguments))
        head = self.receive(1) + self.receive(4)
        return self.reply(self.receive(struct.unpack("<I", head[1:])[0] - 5))


#: a reply with the I4 5, without its first five bytes
REPLY = struct.pack("<HHiHIHIiB", 1, 0, 0, 1, 10, 3, 1, 5, 4)


def pure_python(host: str, port: int) -> List[Callable[[], object]]:
    client = PurePython(host, port)
    client.call(1, "")
    controller = client.call(3, "", "CaoProv.DENSO.VRC", "localhost", "")
    integer, pose = (client.call(9, controller, name, "") for name in ("I1", "P1"))
    robot = client.call(7, controller, "Arm", "")
    return [
        lambda: client.call(101, integer), lambda: client.call(102, integer, 5), lambda: client.call(101, pose),
        lambda: client.call(64, robot, "CurJnt", ""), lambda: (client.request(101, integer), client.reply(REPLY)),
    ]  # fmt: skip


def bcap_client(host: str, port: int) -> List[Callable[[], object]]:
    client = bcapclient.BCAPClient(host, port, 10)
    client.service_start("")
    controller = client.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
    integer, pose = (client.controller_getvariable(controller, name, "") for name in ("I1", "P1"))
    robot = client.controller_getrobot(controller, "Arm", "")
    return [
        lambda: client.variable_getvalue(integer), lambda: client.variable_putvalue(integer, 5),
        lambda: client.variable_getvalue(pose), lambda: client.robot_execute(robot, "CurJnt", None),
    ]  # fmt: skip


def used() -> Tuple[float, float]:
    """Returns the processor time of this process and the time, in microseconds."""
    return time.process_time() * 1e6, time.perf_counter() * 1e6


def answer(began: Tuple[float, float], count: int) -> None:
    processor, wall = used()
    print((processor - began[0]) / count, (wall - began[1]) / count, flush=True)


def work(calls: Dict[str, Callable[[], object]]) -> None:
    """Makes the calls of each line of stdin, such as "read 50", and prints what each took. The first ones fill the caches."""
    for line in sys.stdin:
        call, count = calls[line.split()[0]], int(line.split()[1])
        for _ in range(count // 5):
            call()
        began = used()
        for _ in range(count):
            call()
        answer(began, count)


async def work_awaited(address: str) -> None:
    async with bcap.aio.Controller(address) as cell:
        made: List[Callable[[], Awaitable[object]]] = [
            lambda: cell.read("I1"), lambda: cell.write("I1", 5), lambda: cell.read("P1"), cell.joints,
        ]  # fmt: skip
        calls = dict(zip(CALLS, made))
        for line in sys.stdin:
            call, count = calls[line.split()[0]], int(line.split()[1])
            for _ in range(count // 5):
                await call()
            began = used()
            for _ in range(count):
                await call()
            answer(began, count)


def worker(name: str, address: str) -> None:
    host, port = "127.0.0.1", int(address.rsplit(":", 1)[1])
    if name == "aio.Controller":
        asyncio.run(work_awaited(address))
    elif name == "Controller":
        with bcap.Controller(address) as cell:
            work(dict(zip(CALLS, [lambda: cell["I1"], lambda: cell.write("I1", 5), lambda: cell["P1"], cell.joints])))
    else:
        work(dict(zip([*CALLS, "frame"], (pure_python if name == "pure Python" else bcap_client)(host, port))))


class Client:
    """A client in a process."""

    def __init__(self, name: str, command: List[str]) -> None:
        self.name = name
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        #: processor time and time of each round, for each call
        self.rounds: Dict[str, List[Tuple[float, float]]] = {call: [] for call in [*CALLS, "frame"]}

    def make(self, call: str, count: int) -> None:
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write(f"{call} {count}\n")
        self.process.stdin.flush()
        processor, wall = map(float, self.process.stdout.readline().split())
        self.rounds[call].append((processor, wall))

    def processor(self, call: str) -> float:
        return median(processor for processor, _ in self.rounds[call])

    def row(self, first: "Client") -> str:
        rate = median(1e6 / wall for _, wall in self.rounds["read"])
        times = " | ".join(f"{self.processor(call):.1f}" for call in CALLS)
        # of the same rounds, so that a busy moment counts for both
        pairs = [pair for call in CALLS for pair in zip(first.rounds[call], self.rounds[call])]
        cheaper, faster = (median(one[part] / other[part] for one, other in pairs) for part in (0, 1))
        return f"| {self.name} | {rate:,.0f} | {faster:.1f} | {times} | {cheaper:.1f} |"


def instructions(program: str, call: str, address: str) -> int:
    """Returns the instructions of a call outside of the kernel, as the difference of two runs under callgrind."""
    collected = []
    for count in (300, 800):
        command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", program, address]
        ran = subprocess.run(command, input=f"{call} {count}\n", capture_output=True, text=True, check=True)
        collected.append(int(ran.stderr.split("Collected : ")[1].split()[0]))
    return (collected[1] - collected[0]) // 600


def main() -> None:
    if sys.argv[1] == "worker":
        worker(sys.argv[2], sys.argv[3])
        return
    rounds, others = int(sys.argv[1]), dict(argument.split("=", 1) for argument in sys.argv[2:])
    # the optimised command of the package, so that the server is the same for all
    server = [str(Path(sysconfig.get_path("scripts"), "bcap")), "sim", "--bcap", "127.0.0.1:0", "--rac", "127.0.0.1:0"]
    with subprocess.Popen([*server, "--udp", "127.0.0.1:0"], stdout=subprocess.PIPE, text=True) as sim:
        assert sim.stdout
        ready = next(line for line in sim.stdout if line.startswith("ready"))
        address = "tcp:" + ready.split("bcap=")[1].split()[0]
        clients = [Client(name, [sys.executable, __file__, "worker", name, address]) for name in PYTHON]
        clients += [Client(name, [program, address]) for name, program in others.items()]
        with_frames = [client for client in clients if client.name in ("pure Python", "Rust")]
        for _ in range(rounds):
            for call in CALLS:
                for client in clients:
                    client.make(call, COUNT)
            for client in with_frames:
                client.make("frame", 100 * COUNT)
        print("| client | calls a second | ratio | " + " | ".join(CALLS.values()) + " | ratio |\n|---" + "|---" * 7 + "|")
        for client in clients:
            print(client.row(clients[0]))
        frames = ", ".join(f"{client.name} {client.processor('frame'):.3f} us" for client in with_frames)
        print(f"a request and a reply without a socket: {frames}")
        if shutil.which("valgrind"):
            for call in CALLS if others else ():
                counts = (f"{name} {instructions(program, call, address):,}" for name, program in others.items())
                print(f"instructions of {CALLS[call]}: {', '.join(counts)}")
        for client in clients:
            assert client.process.stdin
            client.process.stdin.close()
            assert client.process.wait(30) == 0, client.name
        sim.terminate()


main()
