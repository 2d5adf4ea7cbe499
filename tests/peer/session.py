"""The list of checks, and a client with a session, which the checks share."""

from client import (ARRAY, BSTR, CONTROLLER_CONNECT, CONTROLLER_EXECUTE, CONTROLLER_GET_ROBOT, CONTROLLER_GET_VARIABLE, EMPTY,
                    I4, ROBOT_EXECUTE, S_OK, SERVICE_START, SERVICE_STOP, VARIABLE_GET_VALUE, VARIABLE_PUT_VALUE, Client, Closed, Malformed, Silence, V)

NOT_CONNECTED, TOO_MUCH_DATA, BUF_FULL = 0x80000902, 0x80000909, 0x83201483
INVALID_PACKET, INVALID_RECEIVED, INVALID_TYPE = 0x80010000, 0x80010001, 0x80010003
E_HANDLE, E_INVALIDARG, E_NOTIMPL = 0x80070006, 0x80070057, 0x80004001
S_BUF_FULL, UNDERFLOW, SLAVE_OFF = 0x0F200501, 0x84201482, 0x83500121

CHECKS = []
OPEN = []  # sessions that a failed check left open


def check(*links):
    """Adds a function to the list for these links; it is named after the function."""
    def add(function):
        CHECKS.append((function.__name__, links, function))
        return function
    return add


BCAP = ("tcp", "udp", "serial")


def text(value):
    return V(BSTR, value)


def equal(found, expected, what="value"):
    if found != expected:
        raise AssertionError(f"{what}: {show(found)}, expected {show(expected)}")


def holds(condition, what):
    if not condition:
        raise AssertionError(f"does not hold: {what}")


def show(value):
    return f"0x{value:08x}" if isinstance(value, int) and value > 0xFFFF else repr(value)[:300]


def failed(code, what):
    if not code & 0x80000000:
        raise AssertionError(f"{what} was accepted with 0x{code:08x}")


class Session(Client):
    """A client with a started service and a controller's handle."""

    def __init__(self, kind, address, option="", **options):
        super().__init__(kind, address, **options)
        OPEN.append(self)
        self.ok(SERVICE_START, text(option))
        self.controller = self.opened(CONTROLLER_CONNECT, text("b-CAP"), text("CaoProv.DENSO.VRC"), text("localhost"), text(""))

    def ok(self, function, *args):
        """Calls and returns the value; the code must be S_OK."""
        reply = self.call(function, *args)
        equal(reply.code, S_OK, f"code of function {function}")
        return reply.args[0] if reply.args else None

    def opened(self, function, *args):
        handle = self.ok(function, *args)
        if handle is None or handle.vt != I4:
            raise AssertionError(f"function {function} returned {handle}, expected a handle as I4")
        return handle

    def code(self, function, *args):
        return self.call(function, *args).code

    def variable(self, name):
        return self.opened(CONTROLLER_GET_VARIABLE, self.controller, text(name), text(""))

    def get(self, name):
        return self.ok(VARIABLE_GET_VALUE, self.variable(name))

    def put(self, name, value):
        return self.code(VARIABLE_PUT_VALUE, self.variable(name), value)

    def robot(self, name, parameter=V(EMPTY)):
        return self.call(ROBOT_EXECUTE, self.arm, text(name), parameter)

    def command(self, name, parameter=V(EMPTY)):
        """Robot_Execute that must succeed; returns the value."""
        reply = self.robot(name, parameter)
        equal(reply.code, S_OK, f"code of {name}")
        equal(len(reply.args), 1, f"values of {name}")
        return reply.args[0]

    def execute(self, name, parameter=V(EMPTY)):
        return self.ok(CONTROLLER_EXECUTE, self.controller, text(name), parameter)

    def stop(self):
        OPEN.remove(self)
        self.ok(SERVICE_STOP)
        self.close()

    def abandon(self):
        """Closes the link without a call."""
        OPEN.remove(self)
        self.close()


def stop_all():
    """Ends the sessions that a failed check left open, so that the next check finds the arm free."""
    while OPEN:
        peer = OPEN.pop()
        try:
            peer.call(SERVICE_STOP)
        except (OSError, Closed, Malformed, Silence):
            pass
        peer.close()


def with_motor(peer):
    """Gets the robot and what a motion needs: no error, the arm, the motor."""
    peer.arm = peer.opened(CONTROLLER_GET_ROBOT, peer.controller, text("Arm"), text(""))
    peer.execute("ClearError")
    peer.command("TakeArm", V(ARRAY | I4, [0, 0]))
    peer.command("Motor", V(ARRAY | I4, [1, 0]))
    return peer
