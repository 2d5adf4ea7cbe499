"""Checks of Slave Mode (b-CAP specification, section 5), in joints and positions."""

import time

from client import *  # noqa: F403
from session import *  # noqa: F403

CYCLE = 0.008
MODES = {0: 0x000, 1: 0x100, 2: 0x200}
P, J, T = 1, 2, 3
# so slow that the robot counts as standing: a busy machine that sends too late makes no underflow
STEP = 5e-5


def enter(peer, mode, pose=J, send=0, receive=J):
    """Sets the formats and enters; returns where the robot stands, in joints or as a position."""
    peer.command("slvSendFormat", V(I4, send))
    peer.command("slvRecvFormat", V(I4, receive))
    start = peer.command({P: "CurPos", J: "CurJnt", T: "CurTrn"}[pose])
    equal(start.vt, ARRAY | R8, "VARTYPE of the pose")
    equal(peer.command("slvChangeMode", V(I4, MODES[mode] | pose)), V(EMPTY), "value of slvChangeMode")
    equal(peer.command("slvGetMode"), V(I4, MODES[mode] | pose), "mode")
    return start.value


def leave(peer):
    equal(peer.command("slvChangeMode", V(I4, 0)), V(EMPTY), "value of slvChangeMode")
    equal(peer.command("slvGetMode"), V(I4, 0), "mode")


def ahead(start, count):
    return V(ARRAY | R8, [start[0] + STEP * count] + list(start[1:]))


def move(peer, parameter):
    """Sends a pose until it is stored; returns the reply and how often the buffer was full."""
    for refused in range(1000):
        reply = peer.robot("slvMove", parameter)
        if reply.code != BUF_FULL:
            return reply, refused
        time.sleep(CYCLE / 2)
    raise AssertionError("the buffer stays full")


def stream(peer, mode, cycles):
    """Streams, with the last pose three times so that the robot stands (b-CAP specification, section 5.5), and leaves; returns the codes."""
    start = enter(peer, mode)
    codes = []
    for count in [*range(cycles), cycles - 1, cycles - 1]:
        reply, refused = move(peer, ahead(start, count))
        codes += [BUF_FULL] * refused + [reply.code]
        equal((reply.args[0].vt, len(reply.args[0].value)), (ARRAY | R8, 8), "pose in the reply")
        if reply.code == S_BUF_FULL or mode == 1:
            time.sleep(CYCLE)
    leave(peer)
    reached = peer.command("CurJnt").value[0] - start[0]
    holds(abs(reached - STEP * (cycles - 1)) < 1e-9, f"J1 moved {reached}, the last pose is {STEP * (cycles - 1)} away")
    return codes


@check("tcp", "udp", "serial")
def mode_0_streams_100_cycles(kind, address):
    peer = with_motor(Session(kind, address))
    codes = stream(peer, 0, 100)
    holds(set(codes) <= {S_OK, S_BUF_FULL, BUF_FULL}, f"codes {set(codes)}")
    peer.stop()


@check("tcp", "udp", "serial")
def mode_1_streams_100_cycles(kind, address):
    peer = with_motor(Session(kind, address))
    equal(set(stream(peer, 1, 100)), {S_OK}, "codes")
    peer.stop()


@check("tcp", "udp", "serial")
def mode_2_streams_100_cycles(kind, address):
    """A reply is withheld while the buffer of 3 is full, so 100 poses take 96 cycles of the controller's clock or more."""
    peer = with_motor(Session(kind, address))
    pose = V(ARRAY | R8, enter(peer, 2, receive=0x012))
    replies = [peer.robot("slvMove", pose) for _ in range(100)]
    equal({reply.code for reply in replies}, {S_OK}, "codes")
    first, last = (reply.args[0].value[0].value for reply in (replies[0], replies[-1]))
    holds(last - first >= 96 * 8, f"100 poses in {last - first} ms")
    leave(peer)
    equal(set(stream(peer, 2, 20)), {S_OK}, "codes")
    peer.stop()


@check("tcp", "udp", "serial")
def mode_0_says_when_the_buffer_is_full(kind, address):
    """Poses as fast as possible: S_BUF_FULL with the third, then E_BUF_FULL, and no pose is lost."""
    peer = with_motor(Session(kind, address))
    start = enter(peer, 0)
    codes, count = set(), 0
    until = time.monotonic() + 10
    while not {S_BUF_FULL, BUF_FULL} <= codes and time.monotonic() < until:
        code = peer.robot("slvMove", ahead(start, count)).code
        count += code != BUF_FULL
        codes.add(code)
    holds({S_BUF_FULL, BUF_FULL} <= codes <= {S_OK, S_BUF_FULL, BUF_FULL}, f"codes {[hex(c) for c in codes]}")
    leave(peer)
    peer.stop()


@check("tcp", "udp", "serial")
def an_underflow_in_motion_releases_slave_mode(kind, address):
    """Modes 0 and 2 (b-CAP specification, Table 5-6): the buffer runs empty while J1 moves at 1.25 degrees a second."""
    for mode in (0, 2):
        peer = with_motor(Session(kind, address))
        start = enter(peer, mode)
        for count in range(1, 4):
            peer.robot("slvMove", V(ARRAY | R8, [start[0] + 0.01 * count] + start[1:]))
        until = time.monotonic() + 10
        while peer.command("slvGetMode").value != 0:
            if time.monotonic() > until:
                raise AssertionError("slave mode stays on without poses")
        equal(peer.robot("slvMove", ahead(start, 0)).code, SLAVE_OFF, "code of slvMove after the underflow")
        holds(peer.execute("GetCurErrorCount").value > 0, "an error is shown")
        codes = [peer.execute("GetCurErrorInfo", V(I4, n)).value[0] for n in range(peer.execute("GetCurErrorCount").value)]
        holds(UNDERFLOW in [code.value & 0xFFFFFFFF for code in codes], f"0x84201482 in {codes}")
        peer.execute("ClearError")
        peer.stop()


@check("tcp", "udp", "serial")
def mode_1_holds_without_poses(kind, address):
    peer = with_motor(Session(kind, address))
    start = enter(peer, 1)
    equal(peer.robot("slvMove", ahead(start, 1)).code, S_OK, "code")
    time.sleep(10 * CYCLE)
    equal(peer.command("slvGetMode"), V(I4, 0x102), "mode after ten cycles without a pose")
    leave(peer)
    peer.stop()


@check("tcp", "udp", "serial")
def all_formats(kind, address):
    """Every format of table 5-2 with formats of table 5-3: the parameter is accepted, the reply has the parts in order."""
    peer = with_motor(Session(kind, address))
    for send in (0x0000, 0x0020, 0x0100, 0x0120, 0x0200, 0x0220):
        for receive in (0x001, 0x002, 0x003, 0x004, 0x005, 0x012, 0x032, 0x134, 0x174, 0x202, 0x272):
            start = enter(peer, 1, send=send, receive=receive)
            parts = [V(ARRAY | R8, start)]
            parts += [V(I4, 0x00050000)] if send & 0x0100 else []
            parts += [V(I4, 128), V(I4, 16), V(ARRAY | UI1, [0xA5, 0x5A])] if send & 0x0200 else []
            parts += [V(I4, 128), V(I4, 16)] if receive & 0x0200 else []
            parts += [V(I4, 0x00010000)] if send & 0x0020 else []
            reply = peer.robot("slvMove", parts[0] if len(parts) == 1 else V(ARRAY | VARIANT, parts))
            what = f"formats 0x{send:x}, 0x{receive:x}"
            equal(reply.code, S_OK, f"code, {what}")
            equal(shape(reply.args[0]), expected_shape(receive), f"reply, {what}")
            if send & receive & 0x0200:
                equal([part for part in reply.args[0].value if part.vt == ARRAY | UI1][0].value, [0xA5, 0x5A], f"user IO, {what}")
            leave(peer)
    peer.stop()


def shape(value):
    """Returns VARTYPE and count of each part; of a pose alone, of itself."""
    parts = value.value if value.vt == ARRAY | VARIANT else [value]
    return value.vt, [(part.vt, len(part.value) if part.vt & ARRAY else 1) for part in parts]


def expected_shape(receive):
    parts = [(I4, 1)] if receive & 0x010 else []
    parts += [(ARRAY | R8, {1: 7, 2: 8, 3: 10, 4: 15, 5: 18}[receive & 0xF])]
    parts += [(I4, 1)] if receive & 0x100 else []
    parts += [(ARRAY | UI1, 2)] if receive & 0x200 else []
    parts += [(I4, 1)] if receive & 0x020 else []
    parts += [(ARRAY | R8, 8)] if receive & 0x040 else []
    return (ARRAY | R8 if len(parts) == 1 else ARRAY | VARIANT), parts


@check("tcp", "udp", "serial")
def outputs_of_slave_mode_are_io_variables(kind, address):
    peer = with_motor(Session(kind, address))
    start = enter(peer, 1, send=0x0200, receive=0x002)
    pose = V(ARRAY | R8, start)
    equal(peer.robot("slvMove", V(ARRAY | VARIANT, [pose, V(I4, 136), V(I4, 8), V(ARRAY | UI1, [0x81])])).code, S_OK, "code")
    leave(peer)
    equal([peer.get(f"IO{n}").value for n in range(136, 144)], [-1, 0, 0, 0, 0, 0, 0, -1], "IO136 to IO143")
    peer.stop()


@check("tcp", "udp", "serial")
def poses_as_positions_and_with_approach_vectors(kind, address):
    peer = with_motor(Session(kind, address))
    for pose, count in ((P, 7), (T, 10)):
        start = enter(peer, 1, pose=pose, receive=pose)
        equal(len(start), count, "numbers of the pose")
        reply = peer.robot("slvMove", V(ARRAY | R8, start))
        equal((reply.code, len(reply.args[0].value)), (S_OK, count), "code and numbers of the reply")
        leave(peer)
    peer.stop()


@check("tcp", "udp", "serial")
def the_time_stamp_counts_milliseconds_or_microseconds(kind, address):
    peer = with_motor(Session(kind, address))
    for unit, least in ((0, 8), (1, 8000)):
        peer.command("slvRecvFormat", V(ARRAY | I4, [0x012, unit]))
        start = peer.command("CurJnt")
        peer.command("slvChangeMode", V(I4, 0x202))
        # the fourth reply is withheld for at least one cycle
        stamps = [peer.robot("slvMove", start).args[0].value[0] for _ in range(8)]
        holds(all(stamp.vt == I4 for stamp in stamps), "VARTYPE of the time stamps is I4")
        if not least <= stamps[-1].value - stamps[0].value < 1250 * least:
            raise AssertionError(f"unit {unit}: stamps from {stamps[0].value} to {stamps[-1].value} in 8 poses")
        leave(peer)
    peer.stop()


@check("tcp", "udp", "serial")
def slave_mode_refuses_what_it_cannot_take(kind, address):
    peer = with_motor(Session(kind, address))
    equal(peer.robot("slvMove", V(ARRAY | R8, [0.0] * 8)).code, SLAVE_OFF, "slvMove outside of slave mode")
    for mode in (4, 0x104, 0x301, -1, 0x100):
        failed(peer.robot("slvChangeMode", V(I4, mode)).code, f"mode {mode}")
    for form in (0x0300, 0x0001, -1):
        failed(peer.robot("slvSendFormat", V(I4, form)).code, f"send format {form}")
    for form in (0x0000, 0x0006, 0x0020, -1):
        failed(peer.robot("slvRecvFormat", V(I4, form)).code, f"receive format {form}")
    start = enter(peer, 1)
    for parameter in (V(ARRAY | R8, start[:6]), V(ARRAY | R8, []), V(EMPTY), text("P1"), V(ARRAY | R8, [float("nan")] * 8)):
        failed(peer.robot("slvMove", parameter).code, f"slvMove with {parameter}")
    leave(peer)
    peer.stop()


@check("tcp", "udp")
def slave_mode_needs_the_arm(kind, address):
    owner, other = with_motor(Session(kind, address)), Session(kind, address)
    other.arm = other.opened(CONTROLLER_GET_ROBOT, other.controller, text("Arm"), text(""))
    failed(other.robot("slvChangeMode", V(I4, 0x102)).code, "slave mode without the arm")
    enter(owner, 1)
    equal(other.command("slvGetMode").vt, I4, "VARTYPE of another client's slvGetMode")
    failed(other.robot("slvMove", V(ARRAY | R8, [0.0] * 8)).code, "slvMove of another client")
    leave(owner)
    owner.stop()
    other.stop()
