"""A small server of b-CAP or RAC, written like the client beside it, to judge the clients of this project.

    python3 server.py LINK

LINK is tcp, udp or rac. Prints `ready HOST:PORT`, serves one client, and prints a line for each check of what the client sent.
A correct client is not affected by what the server does to it: it cuts replies into bytes, sends S_EXECUTING and replies
of other calls first, and over UDP it ignores first attempts.
"""

import socket
import sys
import time

from client import *  # noqa: F403

E_HANDLE, E_NOTIMPL, E_INVALIDCOMMAND = 0x80070006, 0x80004001, 0x80010005


class Judge:
    """Counts, for each named check, what was seen and what was wrong."""

    def __init__(self):
        self.seen, self.wrong = {}, {}

    def see(self, name, is_right, detail=""):
        self.seen[name] = self.seen.get(name, 0) + 1
        if not is_right:
            self.wrong.setdefault(name, detail)

    def tell(self, kind):
        for name, count in self.seen.items():
            print(f"FAILED {name}: {self.wrong[name]}" if name in self.wrong else f"ok {name} ({count} times)")
        failed = len(self.wrong)
        print(f"{len(self.seen)} checks over {kind}: {len(self.seen) - failed} passed, {failed} failed", flush=True)


class Controller:
    """Variables of any name that keep any value; handles are not reused."""

    SHAPES = {SERVICE_START: [BSTR], SERVICE_STOP: [], CONTROLLER_CONNECT: [BSTR] * 4, CONTROLLER_DISCONNECT: [I4],
              CONTROLLER_GET_VARIABLE: [I4, BSTR, BSTR], VARIABLE_GET_VALUE: [I4], VARIABLE_PUT_VALUE: [I4, None],
              VARIABLE_RELEASE: [I4]}

    def __init__(self, judge):
        self.judge, self.values, self.handles, self.next = judge, {}, {}, 1
        self.started = False

    def open(self, name):
        self.next += 1
        self.handles[self.next] = name
        return S_OK, (V(I4, self.next),)

    def execute(self, function, args):
        """Carries a call out; returns the code and the values."""
        shape = self.SHAPES.get(function)
        if shape is not None:
            found = [arg.vt for arg in args]
            fits = len(found) == len(shape) and all(want in (None, vt) for want, vt in zip(shape, found))
            self.judge.see("arguments_have_the_types_of_the_function", fits, f"function {function} with {found}")
        self.judge.see("service_start_comes_first", self.started or function == SERVICE_START, f"function {function}")
        if function in (SERVICE_START, SERVICE_STOP):
            self.started = function == SERVICE_START
            return S_OK, ()
        if function == CONTROLLER_CONNECT:
            return self.open("controller")
        handle = args[0].value if args else None
        if handle not in self.handles:
            return E_HANDLE, ()
        name = self.handles[handle]
        if function == CONTROLLER_GET_VARIABLE:
            return self.open("variable " + args[1].value)
        if function == VARIABLE_PUT_VALUE:
            self.values[name] = args[1]
        elif function == VARIABLE_GET_VALUE:
            return S_OK, (self.values.get(name, V(EMPTY)),)
        elif function in (VARIABLE_RELEASE, CONTROLLER_DISCONNECT):
            del self.handles[handle]
        else:
            return E_NOTIMPL, ()
        return S_OK, ()


class Session:
    """One client: its serials, its last reply, and what is done to it."""

    def __init__(self, judge, repeats):
        self.judge, self.repeats, self.controller = judge, repeats, Controller(judge)
        self.serial, self.first, self.kept, self.calls = 0, None, None, 0

    def answer(self, data):
        """Takes the bytes of a request; returns the packets to send."""
        try:
            request = Packet.from_bytes(data)
        except Malformed as error:
            self.judge.see("requests_are_what_the_specification_describes", False, str(error))
            return []
        see = self.judge.see
        see("requests_are_what_the_specification_describes", True)
        # the specification fixes no first serial
        follows = request.serial != 0 and self.serial in (0, (request.serial - 2) % 0xFFFF + 1)
        see("serials_count_up_and_skip_0", follows, f"{request.serial} after {self.serial}")
        self.serial = request.serial
        if not self.repeats:
            see("reserved_is_0_over_tcp", request.reserved == 0, f"{request.reserved}")
            return self.disturb(self.run(request))
        see("datagrams_have_488_bytes_at_most", len(data) <= 488, f"{len(data)} bytes")
        return self.datagram(request)

    def datagram(self, request):
        see, is_first = self.judge.see, request.serial == request.reserved
        if is_first:
            self.first, self.calls, self.kept = request, self.calls + 1, None
        else:
            same = self.first and (request.reserved, request.code, tuple(map(encode, request.args))) == (
                self.first.serial, self.first.code, tuple(map(encode, self.first.args)))
            see("a_retransmission_repeats_its_call", same, f"{request} after {self.first}")
        # the first attempt of every third call is lost: in turn before it is executed and on the way back
        if self.calls % 3 == 0 and is_first:
            self.kept = self.run(request) if self.calls % 2 else None
            return []
        if self.kept is None:
            self.kept = self.run(request)
        return self.disturb(Packet(request.serial, 0, self.kept.code, self.kept.args))

    def run(self, request):
        code, values = self.controller.execute(request.code, request.args)
        return Packet(request.serial, 0, code, values)

    def disturb(self, reply):
        """Puts packets in front of every other reply that are not it: a keep-alive, another call's reply."""
        if self.serial % 2:
            return [reply]
        other = (self.serial + 40000) % 0xFFFF + 1
        return [Packet(self.serial, 0, S_EXECUTING), Packet(other, 0, E_NOTIMPL), Packet(other, 0, S_OK, (V(I4, 666),)), reply]


def serve_stream(listener, judge):
    connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    session, stream = Session(judge, False), Stream(connection)
    try:
        while True:
            data = stream.receive(time.monotonic() + 3600)
            packets = b"".join(packet.to_bytes() for packet in session.answer(data))
            step = 1 if session.serial % 5 == 0 else len(packets)
            for at in range(0, len(packets), step or 1):
                connection.sendall(packets[at:at + step])
    except (Closed, ConnectionError):
        judge_end(session, judge)


def serve_datagrams(server, judge):
    session = Session(judge, True)
    while True:
        data, peer = server.recvfrom(65536)
        packets = session.answer(data)
        for packet in packets:
            server.sendto(packet.to_bytes(), peer)
        if packets and session.first.code == SERVICE_STOP:
            return judge_end(session, judge)


def judge_end(session, judge):
    judge.see("service_stop_is_the_last_call", not session.controller.started)
    judge.see("all_handles_are_released", not session.controller.handles, f"{session.controller.handles}")


def serve_lines(listener, judge):
    values, pending = {}, b""
    connection, _ = listener.accept()
    while data := connection.recv(4096):
        pending += data
        while b"\r" in pending:
            line, _, pending = pending.partition(b"\r")
            for byte in respond(line, values, judge):
                connection.sendall(bytes([byte]))


def respond(line, values, judge):
    judge.see("lines_have_256_bytes_at_most", len(line) < 256, f"{len(line) + 1} bytes")
    fields = line.decode("utf-8").split(":", 4)
    shape = len(fields) == 5 and fields[0] in ("GET", "PUT") and fields[1] == "RC8" and fields[2].isdecimal()
    judge.see("lines_have_five_fields", shape, repr(line))
    if not shape or fields[3] not in ("I", "F", "D", "S", "V", "P", "J", "T", "IO"):
        return b"%d\r" % (E_INVALIDCOMMAND - 2**32)
    verb, _, *variable, value = fields
    judge.see("get_has_no_value", verb == "PUT" or value == "", repr(line))
    if verb == "PUT":
        values[tuple(variable)] = value
        return b"0\r"
    if tuple(variable) not in values:
        return b"%d\r" % (E_HANDLE - 2**32)
    # the samples of the specification have a blank after the comma (RAC specification, section 4.1)
    return b"0, " + values[tuple(variable)].encode() + b"\r"


def main():
    if sys.argv[1:] not in (["tcp"], ["udp"], ["rac"]):
        sys.exit(__doc__)
    kind, judge = sys.argv[1], Judge()
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM)
    server.bind(("127.0.0.1", 0))
    serve = {"tcp": serve_stream, "udp": serve_datagrams, "rac": serve_lines}[kind]
    if kind != "udp":
        server.listen()
    print("ready {}:{}".format(*server.getsockname()), flush=True)
    serve(server, judge)
    judge.tell(kind)
    sys.exit(1 if judge.wrong else 0)


if __name__ == "__main__":
    main()
