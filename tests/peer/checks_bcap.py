"""Checks of b-CAP: sessions, types, retransmissions, errors."""

import struct
import time

from client import *  # noqa: F403
from session import *  # noqa: F403

# ---- sessions

@check(*BCAP)
def a_session_from_start_to_stop(kind, address):
    peer = Client(kind, address)
    for function, args, values in [(SERVICE_START, [text("")], 0),
                                   (CONTROLLER_CONNECT, [text("b-CAP"), text("CaoProv.DENSO.VRC"), text("localhost"), text("")], 1)]:
        reply = peer.call(function, *args)
        equal((reply.code, len(reply.args)), (S_OK, values), f"code and values of function {function}")
    controller = reply.args[0]
    variable = peer.call(CONTROLLER_GET_VARIABLE, controller, text("IO150"), text("")).args[0]
    for function, args, values in [(VARIABLE_GET_VALUE, [variable], 1), (VARIABLE_PUT_VALUE, [variable, V(BOOL, -1)], 0),
                                   (VARIABLE_RELEASE, [variable], 0), (CONTROLLER_DISCONNECT, [controller], 0),
                                   (SERVICE_STOP, [], 0)]:
        reply = peer.call(function, *args)
        equal((reply.code, len(reply.args)), (S_OK, values), f"code and values of function {function}")
    peer.close()


@check("tcp", "udp")
def the_bytes_of_the_guide(kind, address):
    """b-CAP specification, sections 4.1.1 to 4.1.5: the packets of the guide's session, byte by byte where they do not depend on the handle."""
    peer = Client(kind, address)
    exchanges = [("01100000000100000001000000000004", "01100000000100000000000000000004"),
                 ("01100000000200000002000000000004", "01100000000200000000000000000004")]
    for request, reply in exchanges:
        peer.link.write(bytes.fromhex(request))
        equal(peer.link.receive(time.monotonic() + 5).hex(), reply, "reply")
    peer.close()


@check("serial")
def the_bytes_of_a_serial_frame(kind, address):
    """The CRC of Service_Stop with serial 1, as vendor libraries send it; the serials before were 65531 and 65532."""
    peer = Session(kind, address, serial=65530)
    peer.link.write(bytes.fromhex("011200000001000100020000000000893a04"))
    reply = peer.link.receive(time.monotonic() + 5)
    equal(reply and Packet.from_bytes(reply, True), Packet(1, 0, S_OK), "reply")
    peer.abandon()


@check(*BCAP)
def calls_before_service_start_are_refused(kind, address):
    peer = Client(kind, address)
    args = [text(""), text("CaoProv.DENSO.VRC"), text("localhost"), text("")]
    equal(peer.call(CONTROLLER_CONNECT, *args).code, NOT_CONNECTED, "code")
    equal(peer.call(SERVICE_START, text("")).code, S_OK, "Service_Start after a refused call")
    equal(peer.call(CONTROLLER_CONNECT, *args).code, S_OK, "Controller_Connect after Service_Start")
    peer.call(SERVICE_STOP)
    peer.close()


@check(*BCAP)
def options_of_service_start(kind, address):
    for option, code in [("", S_OK), ("WDT=400", S_OK), (",WDT=400,InvokeTimeout=180000", S_OK), (" wdt = 0x190 ", S_OK),
                         ("Unknown=1", E_INVALIDARG), ("WDT=79", E_INVALIDARG), ("InvokeTimeout=79", E_INVALIDARG)]:
        peer = Client(kind, address)
        equal(peer.call(SERVICE_START, text(option)).code, code, f"code of {option!r}")
        peer.close()


@check(*BCAP)
def a_session_after_a_session(kind, address):
    peer = Session(kind, address)
    before = peer.variable("I1")
    peer.ok(SERVICE_STOP)
    failed(peer.code(VARIABLE_GET_VALUE, before), "a handle after Service_Stop")
    peer.ok(SERVICE_START, text(""))
    failed(peer.code(VARIABLE_GET_VALUE, before), "a handle of the session before")
    peer.stop()


@check(*BCAP)
def handles_are_distinct_and_released_once(kind, address):
    peer = Session(kind, address)
    handles = [peer.variable("I1") for _ in range(10)]
    equal(len(set(handles)), 10, "number of different handles")
    for handle in handles:
        peer.ok(VARIABLE_RELEASE, handle)
        equal(peer.code(VARIABLE_RELEASE, handle), E_HANDLE, "second release")
        equal(peer.code(VARIABLE_GET_VALUE, handle), E_HANDLE, "call with a released handle")
    peer.stop()


@check("tcp", "udp")
def handles_belong_to_their_client(kind, address):
    one, other = Session(kind, address), Session(kind, address)
    handle = one.variable("I1")
    equal(other.code(VARIABLE_GET_VALUE, V(I4, handle.value + 1000)), E_HANDLE, "an unknown handle")
    foreign = other.code(VARIABLE_PUT_VALUE, handle, V(I4, 1))
    equal(foreign, E_HANDLE, "a handle of another client")
    one.stop()
    other.stop()


@check(*BCAP)
def a_handle_as_ui4_is_accepted(kind, address):
    peer = Session(kind, address)
    handle = peer.variable("I1")
    peer.ok(VARIABLE_GET_VALUE, V(UI4, handle.value))
    peer.stop()


@check(*BCAP)
def names_ignore_case(kind, address):
    peer = Session(kind, address)
    equal(peer.put("io151", V(BOOL, -1)), S_OK, "code")
    equal(peer.get("IO151"), V(BOOL, -1))
    peer.execute("clearERROR")
    peer.stop()


@check(*BCAP)
def serials_wrap_from_65535_to_1(kind, address):
    peer = Session(kind, address, serial=65529)
    for _ in range(12):
        peer.ok(CONTROLLER_GET_NAME, peer.controller)
    holds(peer.serial < 100, "the serial wrapped")
    peer.stop()


@check(*BCAP)
def long_calls_send_keep_alives(kind, address):
    """b-CAP specification, Table 4-1: with WDT=100 a motion of a second is announced with S_EXECUTING."""
    peer = with_motor(Session(kind, address, option="WDT=100", timeout=2.0))
    peer.command("ExtSpeed", V(R8, 20.0))
    joints = peer.command("CurJnt").value
    peer.executing = 0
    for step in (20.0, 0.0):
        goal = V(ARRAY | VARIANT, [V(ARRAY | R8, [joints[0] + step] + joints[1:]), text("J"), text("@E")])
        peer.ok(ROBOT_MOVE, peer.arm, V(I4, 1), goal, text(""))
    peer.command("ExtSpeed", V(R8, 100.0))
    if peer.executing == 0:
        raise AssertionError("no S_EXECUTING before the reply of a long motion")
    peer.stop()


@check("tcp")
def requests_may_share_a_segment(kind, address):
    peer = Session(kind, address)
    serials = [peer.next_serial() for _ in range(50)]
    name = lambda serial: Packet(serial, 0, CONTROLLER_GET_NAME, (peer.controller,)).to_bytes()
    peer.link.write(b"".join(map(name, serials)))
    for serial in serials:
        reply = Packet.from_bytes(peer.link.receive(time.monotonic() + 5))
        equal((reply.serial, reply.code), (serial, S_OK), "serial and code")
    peer.stop()


@check("tcp", "serial")
def requests_may_come_in_single_bytes(kind, address):
    peer = Session(kind, address)
    serial = peer.next_serial()
    data = Packet(serial, serial if peer.link.repeats else 0, CONTROLLER_GET_NAME, (peer.controller,)).to_bytes(peer.link.has_crc)
    for byte in data:
        peer.link.write(bytes([byte]))
    equal(peer.receive(serial).code, S_OK, "code")
    peer.stop()


# ---- types

def echoed(vt, *values):
    """Adds a check that a server keeps these values, alone and as an array, bit by bit: PutTag, then GetTag."""
    def run(kind, address):
        peer = Session(kind, address)
        variable = peer.variable("I1")
        wanted = [V(vt, value) for value in values]
        if vt not in (EMPTY, NULL):
            wanted += [V(vt | ARRAY, list(values)), V(vt | ARRAY, []), V(vt | ARRAY, list(values)[:1])]
        for value in wanted:
            keeps(peer, variable, value)
        peer.stop()
    names = {EMPTY: "empty", NULL: "null", I2: "i2", I4: "i4", R4: "r4", R8: "r8", CY: "cy", DATE: "date", BSTR: "bstr",
             ERROR: "error", BOOL: "bool", UI1: "ui1", UI2: "ui2", UI4: "ui4", I8: "i8", UI8: "ui8"}
    CHECKS.append((f"values_of_type_{names[vt]}", BCAP, run))


def keeps(peer, variable, value):
    equal(peer.code(VARIABLE_PUT_TAG, variable, value), S_OK, f"code of PutTag of {show(value)}")
    # compared as bytes: NaN is not equal to itself
    equal(encode(peer.ok(VARIABLE_GET_TAG, variable)).hex(), encode(value).hex(), f"{show(value)}")


def bits(form, *numbers):
    return [struct.unpack("<" + form, struct.pack("<" + {"f": "I", "d": "Q"}[form], number))[0] for number in numbers]


DOUBLES = (0.0, -0.0, 1.5, 1e308, 5e-324, -1e-300, float("inf"), float("-inf"), *bits("d", 0x7FF8000000000001))
echoed(EMPTY, None)
echoed(NULL, None)
echoed(I2, 0, 1, -1, 32767, -32768)
echoed(I4, 0, 1, -1, 2147483647, -2147483648)
echoed(R4, 0.0, -0.0, 0.5, *bits("f", 0x7F7FFFFF, 1, 0x7F800000, 0xFF800000, 0x7FC00000))
echoed(R8, *DOUBLES)
echoed(CY, 0, 12345678, -12345678, 2**63 - 1, -2**63)
echoed(DATE, 0.0, 25569.0, 45000.75, -1.25, 2958465.99999)
echoed(BSTR, "", "WDT=400", "é", "日本語ロボット", "\U0001F916", "a\0b", "a,b(c)\r\n\"", "\ud800")
echoed(ERROR, 0, 0x80004005, 0x83201483, 0xFFFFFFFF)
echoed(BOOL, 0, -1)
echoed(UI1, 0, 1, 127, 128, 255)
echoed(UI2, 0, 1, 32768, 65535)
echoed(UI4, 0, 1, 2147483648, 4294967295)
echoed(I8, 0, 1, -1, 2**63 - 1, -2**63)
echoed(UI8, 0, 1, 2**63, 2**64 - 1)


@check(*BCAP)
def variant_arrays_nest(kind, address):
    peer = Session(kind, address)
    variable = peer.variable("I1")
    value = V(ARRAY | VARIANT, [V(I4, 1), text("x"), V(EMPTY), V(NULL), V(ARRAY | R8, [1.0, 2.0]), V(ARRAY | BSTR, ["", "y"])])
    keeps(peer, variable, value)
    keeps(peer, variable, V(ARRAY | VARIANT, []))
    for _ in range(6):
        value = V(ARRAY | VARIANT, [value, V(BOOL, -1), V(ARRAY | UI1, [])])
        keeps(peer, variable, value)
    peer.stop()


@check("tcp")
def large_values(kind, address):
    peer = Session(kind, address)
    variable = peer.variable("S1")
    for count in (489, 16383, 16384, 20000):
        equal(peer.code(VARIABLE_PUT_VALUE, variable, text("x" * count)), S_OK, f"code for {count} characters")
        equal(peer.ok(VARIABLE_GET_VALUE, variable), text("x" * count))
    equal(peer.code(VARIABLE_PUT_VALUE, variable, text("")), S_OK, "code")
    peer.stop()


@check(*BCAP)
def user_variables_have_their_types(kind, address):
    peer = Session(kind, address)
    values = [("I2", V(I4, -2147483648)), ("F2", V(R4, 0.5)), ("D2", V(R8, 1e300)), ("S2", text("ロボット")),
              ("V2", V(ARRAY | R4, [1.0, -2.0, 3.5])), ("P2", V(ARRAY | R4, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0])),
              ("J2", V(ARRAY | R4, [float(n) for n in range(8)])), ("T2", V(ARRAY | R4, [float(n) for n in range(10)])),
              ("IO152", V(BOOL, -1)), ("IO152", V(BOOL, 0))]
    for name, value in values:
        equal(peer.put(name, value), S_OK, f"code of writing {name}")
        equal(peer.get(name), value, name)
    peer.stop()


@check(*BCAP)
def system_variables_have_their_types(kind, address):
    peer = Session(kind, address)
    for name, vt in [("@MODE", I4), ("@TIME", I4), ("@CURRENT_TIME", DATE), ("@BUSY_STATUS", BOOL), ("@ERROR_CODE", I4),
                     ("@EMERGENCY_STOP", BOOL), ("@VERSION", BSTR), ("@VAR_I_LEN", I4)]:
        equal(peer.get(name).vt, vt, f"VARTYPE of {name}")
    peer.stop()


# ---- retransmissions

@check("udp", "serial")
def a_retransmission_is_answered_and_not_executed(kind, address):
    """Each execution of GetVariable gives a new handle, so the handle counts executions."""
    peer = Session(kind, address)
    args = [peer.controller, text("I1"), text("")]
    first = peer.next_serial()
    peer.send(first, first, CONTROLLER_GET_VARIABLE, *args)
    reply = peer.receive(first)
    for _ in range(5):
        serial = peer.next_serial()
        peer.send(serial, first, CONTROLLER_GET_VARIABLE, *args)
        repeated = peer.receive(serial)
        equal(repeated, Packet(serial, 0, reply.code, reply.args), "reply to a retransmission")
    after = peer.ok(CONTROLLER_GET_VARIABLE, *args)
    holds(after.value != reply.args[0].value, "a new call is executed")
    peer.stop()


@check("udp", "serial")
def a_repeated_release_succeeds_once_more(kind, address):
    """The kept reply of a release is S_OK; executing it again would be E_HANDLE."""
    peer = Session(kind, address)
    variable = peer.variable("I1")
    first = peer.next_serial()
    for _ in range(3):
        peer.send(first, first, VARIABLE_RELEASE, variable)
        equal(peer.receive(first).code, S_OK, "code")
    equal(peer.code(VARIABLE_RELEASE, variable), E_HANDLE, "code of a new call")
    peer.stop()


@check("udp", "serial")
def a_repeated_failure_stays_a_failure(kind, address):
    peer = Session(kind, address)
    first = peer.next_serial()
    peer.send(first, first, VARIABLE_GET_VALUE, V(I4, 999))
    reply = peer.receive(first)
    serial = peer.next_serial()
    peer.send(serial, first, VARIABLE_GET_VALUE, V(I4, 999))
    equal((peer.receive(serial).code, reply.code), (E_HANDLE, E_HANDLE), "codes")
    peer.stop()


@check("udp", "serial")
def a_request_without_a_retry_marker_is_a_call(kind, address):
    """Reserved 0 stands for the serial itself."""
    peer = Session(kind, address)
    handles = set()
    for _ in range(3):
        serial = peer.next_serial()
        for _ in range(2):
            peer.send(serial, 0, CONTROLLER_GET_VARIABLE, peer.controller, text("I1"), text(""))
            handles.add(peer.receive(serial).args[0].value)
    equal(len(handles), 3, "executions of 3 calls that were sent twice")
    peer.stop()


@check("udp", "serial")
def a_repeated_service_start_keeps_the_session(kind, address):
    peer = Client(kind, address)
    first = peer.next_serial()
    for _ in range(3):
        serial = peer.next_serial()
        peer.send(serial, first, SERVICE_START, text(""))
        equal(peer.receive(serial), Packet(serial, 0, S_OK), "reply")
    args = [text(""), text("CaoProv.DENSO.VRC"), text("localhost"), text("")]
    equal(peer.call(CONTROLLER_CONNECT, *args).code, S_OK, "code of Controller_Connect")
    peer.call(SERVICE_STOP)
    peer.close()


@check("tcp")
def over_tcp_a_repeated_serial_is_executed(kind, address):
    peer = Session(kind, address)
    handles = set()
    serial = peer.next_serial()
    for _ in range(3):
        peer.send(serial, 0, CONTROLLER_GET_VARIABLE, peer.controller, text("I1"), text(""))
        handles.add(peer.receive(serial).args[0].value)
    equal(len(handles), 3, "executions")
    peer.stop()


@check("serial")
def a_wrong_crc_is_passed_over(kind, address):
    peer = Session(kind, address)
    serial = peer.next_serial()
    data = bytearray(Packet(serial, serial, CONTROLLER_GET_NAME, (peer.controller,)).to_bytes(True))
    data[9] ^= 0x10
    peer.link.write(bytes(data))
    equal(peer.receive(serial, 0.2), None, "reply to a frame with a wrong CRC")
    peer.ok(CONTROLLER_GET_NAME, peer.controller)
    peer.stop()


@check("serial")
def noise_between_frames_is_passed_over(kind, address):
    peer = Session(kind, address, timeout=0.5)
    for noise in (b"\xff" * 40, b"\x00\x04\x04", b"\x02\x03"):
        peer.link.write(noise)
        peer.ok(CONTROLLER_GET_NAME, peer.controller)
    peer.stop()


# ---- errors

@check(*BCAP)
def unknown_functions_are_refused(kind, address):
    """1 to 137 exist (b-CAP specification, Appendix A)."""
    peer = Session(kind, address)
    for function in (0, 138, 9999, 0x7FFFFFFF, 0xFFFFFFFF):
        equal(peer.code(function, peer.controller), E_INVALIDARG, f"code of function 0x{function:x}")
    peer.ok(CONTROLLER_GET_NAME, peer.controller)
    peer.stop()


@check(*BCAP)
def arguments_of_a_wrong_type_are_refused(kind, address):
    peer = Session(kind, address)
    for args in [(text("1"),), (V(R8, 1.0),), (V(ARRAY | I4, [1]),), (V(EMPTY),)]:
        equal(peer.code(VARIABLE_GET_VALUE, *args), INVALID_TYPE, f"code for {args}")
    equal(peer.code(CONTROLLER_GET_VARIABLE, peer.controller, V(I4, 1), text("")), INVALID_TYPE, "code for a name as I4")
    equal(peer.put("I1", text("x")) & 0x80000000, 0x80000000, "failure of text in I1")
    peer.stop()


@check(*BCAP)
def missing_arguments_are_refused(kind, address):
    peer = Session(kind, address)
    for function, args in [(VARIABLE_GET_VALUE, []), (CONTROLLER_DISCONNECT, []), (CONTROLLER_EXECUTE, [peer.controller]),
                           (VARIABLE_PUT_VALUE, [V(I4, 1)])]:
        failed(peer.code(function, *args), f"function {function} with {len(args)} arguments")
    peer.ok(CONTROLLER_GET_NAME, peer.controller)
    peer.stop()


@check(*BCAP)
def wrong_handles_are_refused(kind, address):
    peer = Session(kind, address)
    for handle in (0, -1, 999999, 2147483647, -2147483648):
        equal(peer.code(VARIABLE_GET_VALUE, V(I4, handle)), E_HANDLE, f"code for {handle}")
    equal(peer.code(VARIABLE_GET_VALUE, peer.controller), E_HANDLE, "code for the controller's handle")
    peer.stop()


@check(*BCAP)
def unknown_names_are_refused(kind, address):
    peer = Session(kind, address)
    for name in ("", "NoSuchVariable", "I999999", "@NO_SUCH", "ロボット", "I" + "1" * 50):
        failed(peer.code(CONTROLLER_GET_VARIABLE, peer.controller, text(name), text("")), f"variable {name!r}")
    failed(peer.code(CONTROLLER_EXECUTE, peer.controller, text("NoSuchCommand"), V(EMPTY)), "an unknown command")
    peer.stop()


@check(*BCAP)
def errors_are_explained(kind, address):
    peer = Session(kind, address)
    for code in (E_HANDLE, 0x84201482):
        answer = peer.execute("GetErrorDescription", V(I4, code - 2**32))
        equal((answer.vt, bool(answer.value)), (BSTR, True), f"a description of 0x{code:08x}")
    peer.stop()


DAMAGES = [("terminator", lambda data: data[:-1] + b"\x05"), ("length of an argument", lambda data: data[:15] + b"\xff" + data[16:]),
           ("number of arguments", lambda data: data[:13] + b"\x09" + data[14:]), ("VARTYPE", lambda data: data[:19] + b"\x63" + data[20:]),
           ("count of elements", lambda data: data[:19] + b"\x05\x20\xff\xff\xff\xff" + data[25:])]


@check("tcp")
def a_damaged_frame_ends_the_connection(kind, address):
    """RAC specification, Table 2-3: the controller answers E_INVALIDRCPACKET and cuts the connection; a code is not required here."""
    for what, damage in DAMAGES:
        peer = Session(kind, address)
        good = Packet(peer.next_serial(), 0, VARIABLE_GET_VALUE, (V(I4, 1),)).to_bytes()
        peer.link.write(damage(good))
        try:
            while (data := peer.link.receive(time.monotonic() + 5)) is not None:
                failed(Packet.from_bytes(data).code, f"a frame with a damaged {what}")
            raise AssertionError(f"the connection stays open after a damaged {what}")
        except (Closed, ConnectionResetError):
            peer.abandon()


@check("udp")
def a_damaged_datagram_ends_nothing(kind, address):
    peer = Session(kind, address)
    good = Packet(peer.next_serial(), 0, VARIABLE_GET_VALUE, (V(I4, 1),)).to_bytes()
    for data in [damage(good) for _, damage in DAMAGES] + [b"", b"\x01", good[:20], good + b"\x00", b"\xff" * 600]:
        peer.link.write(data)
    while (data := peer.link.receive(time.monotonic() + 0.3)) is not None:
        failed(Packet.from_bytes(data).code, "a damaged datagram")
    peer.ok(CONTROLLER_GET_NAME, peer.controller)
    peer.stop()


@check("tcp")
def a_huge_length_ends_the_connection(kind, address):
    """RAC specification, Table 2-3: packets over 16 MiB are E_PACKETSIZEOVER."""
    for length in (16 << 20 | 1 << 10, 0x7FFFFFFF, 0xFFFFFFFF):
        peer = Session(kind, address)
        peer.link.write(b"\x01" + struct.pack("<I", length) + b"\x01\0\0\0")
        try:
            while (data := peer.link.receive(time.monotonic() + 5)) is not None:
                failed(Packet.from_bytes(data).code, f"a length of {length}")
            raise AssertionError(f"the connection waits for {length} bytes")
        except (Closed, ConnectionResetError):
            peer.abandon()


@check("udp")
def datagrams_up_to_503_bytes_are_accepted(kind, address):
    """488 bytes (b-CAP specification, Table 6-1); vendor libraries take up to 503."""
    peer = Session(kind, address)
    variable = peer.variable("I1")
    for size in (488, 503):
        # 15 header, 14 handle, 4 + 6 array, 1 terminator
        equal(peer.code(VARIABLE_PUT_TAG, variable, V(ARRAY | UI1, [7] * (size - 40))), S_OK, f"code for {size} bytes")
    peer.stop()


@check("udp")
def an_over_long_datagram_is_not_executed(kind, address):
    peer = Session(kind, address)
    variable = peer.variable("I1")
    keeps(peer, variable, V(I4, 1))
    serial = peer.next_serial()
    peer.send(serial, serial, VARIABLE_PUT_TAG, variable, V(ARRAY | UI1, [7] * 800))
    reply = peer.receive(serial, 0.3)
    if reply is not None:
        failed(reply.code, "a datagram of 840 bytes")
    equal(peer.ok(VARIABLE_GET_TAG, variable), V(I4, 1))
    peer.stop()


@check("udp", "serial")
def a_reply_that_is_too_long_is_an_error(kind, address):
    """All names of variables need more than a datagram."""
    peer = Session(kind, address)
    equal(peer.code(CONTROLLER_GET_VARIABLE_NAMES, peer.controller, text("")), TOO_MUCH_DATA, "code")
    peer.ok(CONTROLLER_GET_NAME, peer.controller)
    peer.stop()


@check("tcp")
def all_names_of_variables(kind, address):
    peer = Session(kind, address)
    names = peer.ok(CONTROLLER_GET_VARIABLE_NAMES, peer.controller, text(""))
    flat = [item.value if isinstance(item, V) else item for item in names.value]
    holds("@MODE" in flat and all(isinstance(name, str) for name in flat), f"@MODE in {flat}")
    peer.stop()
