"""A b-CAP and RAC client written from the specifications alone, to judge the servers of this project.

It shares no code and no tables with them. Its decoder is strict: a reply that is not exactly what the
specification describes raises `Malformed`, so every call is also a check of the reply's bytes.

The specifications are the b-CAP specification for RC9 and the RAC specification for RC8.
"""

import select
import socket
import struct
import time
from dataclasses import dataclass

EMPTY, NULL, I2, I4, R4, R8, CY, DATE, BSTR = range(9)
ERROR, BOOL, VARIANT, UI1, UI2, UI4, I8, UI8 = 10, 11, 12, 17, 18, 19, 20, 21
ARRAY = 0x2000

# VARTYPE -> struct format of one element; CY counts ten-thousandths, DATE days since 1899-12-30
FIXED = {I2: "h", I4: "i", R4: "f", R8: "d", CY: "q", DATE: "d", ERROR: "I", BOOL: "h",
         UI1: "B", UI2: "H", UI4: "I", I8: "q", UI8: "Q"}

S_OK, S_EXECUTING = 0, 0x900
SERVICE_START, SERVICE_STOP, CONTROLLER_CONNECT, CONTROLLER_DISCONNECT = 1, 2, 3, 4
CONTROLLER_GET_ROBOT, CONTROLLER_GET_TASK, CONTROLLER_GET_VARIABLE = 7, 8, 9
CONTROLLER_GET_VARIABLE_NAMES, CONTROLLER_EXECUTE, CONTROLLER_GET_NAME = 15, 17, 21
ROBOT_EXECUTE, ROBOT_MOVE, ROBOT_RELEASE = 64, 72, 84
VARIABLE_GET_VALUE, VARIABLE_PUT_VALUE = 101, 102
VARIABLE_GET_TAG, VARIABLE_PUT_TAG, VARIABLE_RELEASE = 106, 107, 111


class Malformed(Exception):
    """A packet that the specification does not allow."""


class Silence(Exception):
    """No reply within the time limit, after all attempts."""


class Closed(Exception):
    """The server closed the connection."""


@dataclass(frozen=True)
class V:
    """A VARIANT: its VARTYPE, and a number, a str, None or a list of these (of V in VARIANT arrays)."""

    vt: int
    value: object = None


def encode(v):
    """Returns a VARIANT as bytes: VARTYPE, element count, data."""
    items = v.value if v.vt & ARRAY else [v.value]
    return struct.pack("<HI", v.vt, len(items)) + b"".join(element(v.vt & ~ARRAY, item) for item in items)


def element(vt, item):
    if vt in FIXED:
        return struct.pack("<" + FIXED[vt], item)
    if vt == BSTR:
        text = item.encode("utf-16-le", "surrogatepass")
        return struct.pack("<I", len(text)) + text
    return encode(item) if vt == VARIANT else b""


class Reader:
    """Reads a packet from front to back and refuses to read past its end."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        if self.at + count > len(self.data):
            raise Malformed(f"{count} bytes wanted at {self.at}, packet of {len(self.data)}")
        self.at += count
        return self.data[self.at - count:self.at]

    def unpack(self, form):
        values = struct.unpack("<" + form, self.take(struct.calcsize("<" + form)))
        return values[0] if len(values) == 1 else values

    def variant(self, depth=0):
        vt, count = self.unpack("HI")
        base, is_array = vt & ~ARRAY, bool(vt & ARRAY)
        known = base in FIXED or base == BSTR or (base == VARIANT and is_array) or (base in (EMPTY, NULL) and not is_array)
        if not known or depth > 16:
            raise Malformed(f"VARTYPE 0x{vt:04x} at depth {depth}")
        if not is_array and count != 1:
            raise Malformed(f"a scalar of {count} elements")
        if is_array and count > len(self.data):
            raise Malformed(f"an array of {count} elements")
        items = [self.element(base, depth) for _ in range(count)]
        return V(vt, items if is_array else items[0])

    def element(self, vt, depth):
        if vt in FIXED:
            return self.unpack(FIXED[vt])
        if vt == BSTR:
            length = self.unpack("I")
            if length % 2:
                raise Malformed(f"a BSTR of {length} bytes")
            return self.take(length).decode("utf-16-le", "surrogatepass")
        return self.variant(depth + 1) if vt == VARIANT else None


def crc16(data):
    """CRC-16/CCITT-FALSE, which serial lines add before the terminator."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


@dataclass(frozen=True)
class Packet:
    """A request (`code` is the function) or a reply (`code` is the HRESULT)."""

    serial: int
    reserved: int
    code: int
    args: tuple = ()

    def to_bytes(self, has_crc=False):
        body = struct.pack("<HHIH", self.serial, self.reserved, self.code, len(self.args))
        for arg in map(encode, self.args):
            body += struct.pack("<I", len(arg)) + arg
        body = struct.pack("<I", len(body) + (8 if has_crc else 6)) + body
        return b"\x01" + body + (struct.pack("<H", crc16(body)) if has_crc else b"") + b"\x04"

    @staticmethod
    def from_bytes(data, has_crc=False):
        end = len(data) - (3 if has_crc else 1)
        if len(data) < 16 or data[0] != 1 or data[-1] != 4 or struct.unpack("<I", data[1:5])[0] != len(data):
            raise Malformed(f"header, length or terminator: {data[:16].hex()}..{data[-1:].hex()}")
        if has_crc and struct.unpack("<H", data[end:-1])[0] != crc16(data[1:end]):
            raise Malformed("CRC")
        reader = Reader(data[:end])
        reader.at = 5
        serial, reserved, code, count = reader.unpack("HHIH")
        args = []
        for _ in range(count):
            length = reader.unpack("I")
            begin = reader.at
            args.append(reader.variant())
            if reader.at - begin != length:
                raise Malformed(f"an argument of {reader.at - begin} bytes that claims {length}")
        if reader.at != end:
            raise Malformed(f"{end - reader.at} bytes after the arguments")
        return Packet(serial, reserved, code, tuple(args))


class Stream:
    """A TCP connection, or a serial line behind a TCP port."""

    def __init__(self, line, has_crc=False):
        self.line, self.has_crc, self.repeats, self.pending = line, has_crc, has_crc, b""
        self.write, self.close = line.sendall, line.close

    def receive(self, until):
        """Returns the next packet, or None at `until`."""
        while True:
            if self.has_crc:  # noise before a packet is passed over
                self.pending = self.pending[max(self.pending.find(1), 0):] if 1 in self.pending else b""
            length = struct.unpack("<I", self.pending[1:5])[0] if len(self.pending) >= 5 else 5
            if len(self.pending) >= max(length, 5):
                packet, self.pending = self.pending[:length], self.pending[length:]
                return packet
            ready, _, _ = select.select([self.line], [], [], max(until - time.monotonic(), 0))
            if not ready:
                return None
            data = self.line.recv(65536)
            if not data:
                raise Closed
            self.pending += data


class Datagrams:
    """UDP: one packet a datagram."""

    has_crc, repeats = False, True

    def __init__(self, address):
        host, port = address.rsplit(":", 1)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((host, int(port)))  # the kernel drops datagrams of other senders
        self.write, self.close = self.socket.send, self.socket.close

    def receive(self, until):
        ready, _, _ = select.select([self.socket], [], [], max(until - time.monotonic(), 0))
        return self.socket.recv(65536) if ready else None


def open_link(kind, address):
    return Datagrams(address) if kind == "udp" else Stream(connect(address), kind == "serial")


def connect(address):
    host, port = address.rsplit(":", 1)
    line = socket.create_connection((host, int(port)), 5)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return line


class Client:
    """Calls, one at a time. A call over UDP or a serial line is repeated, with the serial of its first attempt in
    the reserved field."""

    def __init__(self, kind, address, timeout=2.0, attempts=5, serial=0):
        self.link = open_link(kind, address)
        self.timeout, self.attempts, self.serial = timeout, attempts if self.link.repeats else 1, serial
        self.executing = 0

    def next_serial(self):
        self.serial = self.serial % 0xFFFF + 1
        return self.serial

    def send(self, serial, first, function, *args):
        self.link.write(Packet(serial, first if self.link.repeats else 0, function, args).to_bytes(self.link.has_crc))

    def receive(self, serial, timeout=None):
        """Returns the reply with a serial, or None; S_EXECUTING restarts the time limit, 100 times at most."""
        until = time.monotonic() + (timeout or self.timeout)
        while (data := self.link.receive(until)) is not None:
            reply = Packet.from_bytes(data, self.link.has_crc)
            if reply.reserved != 0 or len(reply.args) > 1:
                raise Malformed(f"a reply with reserved {reply.reserved} and {len(reply.args)} values")
            if reply.serial == serial and reply.code != S_EXECUTING:
                return reply
            if reply.serial == serial and self.executing < 100:
                self.executing += 1
                until = time.monotonic() + self.timeout
        return None

    def call(self, function, *args):
        first = self.next_serial()
        serial = first
        for attempt in range(self.attempts):
            if attempt:
                serial = self.next_serial()
            self.send(serial, first, function, *args)
            if (reply := self.receive(serial)) is not None:
                return reply
        raise Silence(f"function {function}: no reply to {self.attempts} attempts of {self.timeout} s")

    def close(self):
        self.link.close()


def rac_line(address):
    """Opens a RAC connection; returns a function that sends bytes and returns the next response without its CR."""
    line, pending = connect(address), bytearray()

    def exchange(data, timeout=5.0):
        line.sendall(data)
        line.settimeout(timeout)
        while b"\r" not in pending:
            received = line.recv(4096)
            if not received:
                raise Closed
            pending.extend(received)
        response, _, rest = bytes(pending).partition(b"\r")
        pending[:] = rest
        return response.decode("utf-8")

    exchange.close = line.close
    return exchange
