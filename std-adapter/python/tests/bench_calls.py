"""Calls a second and processor time for each call: BCAPClient and Controller of this package, and a client in pure Python.

Run it by hand, with a wheel that was built with optimisation: python tests/bench_calls.py
"""

import select
import socket
import struct
import subprocess
import sys
import time
from typing import Any, Callable

import bcap
from bcap.compat import bcapclient


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
        return struct.unpack("<i", body[20:24])[0] if count and len(body) >= 25 else None


def measure(name: str, call: Callable[[], object], count: int = 20000) -> None:
    for _ in range(500):
        call()
    wall, processor = time.perf_counter(), time.process_time()
    for _ in range(count):
        call()
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(f"{name:22} {count / wall:8.0f} calls/s  {processor / count * 1e6:6.1f} us of processor time for each call")


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
        pure, compatible, cell = PurePython(host, port), bcapclient.BCAPClient(host, port, 10), bcap.Controller(address)
        pure.call(1, "")
        handle = pure.call(9, pure.call(3, "", "CaoProv.DENSO.VRC", "localhost", ""), "I1", "")
        measure("pure Python", lambda: pure.call(101, handle))
        compatible.service_start("")
        controller = compatible.controller_connect("", "CaoProv.DENSO.VRC", "localhost", "")
        variable = compatible.controller_getvariable(controller, "I1", "")
        measure("BCAPClient", lambda: compatible.variable_getvalue(variable))
        measure("Controller", lambda: cell["I1"])
        server.stdin.close()


main()
