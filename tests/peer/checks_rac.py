"""Checks of RAC, the text protocol of the RC8 (S0)."""

from client import connect, rac_line
from session import check, equal, holds

VALUES = [("I", "3,123"), ("I", "3,-2147483648"), ("F", "4,123.5"), ("D", "5,123.01"), ("S", "8,Test"), ("S", "8,a,b(c)"),
          ("S", "8,日本"), ("V", "8196,1,2,3"), ("P", "8196,1,2,3,4,5,6,-1"), ("J", "8196,1,2,3,4,5,6,7,8"),
          ("T", "8196,1,2,3,4,5,6,7,8,9,-1"), ("IO", "11,0")]


def numbers(response):
    """Splits a response into code, type and value; numbers are compared as numbers, text as text."""
    code, _, rest = response.partition(",")
    kind, _, value = rest.partition(",")
    if kind.strip() in ("", "8"):
        return int(code), kind.strip(), value
    return int(code), kind.strip(), [float(number) for number in value.split(",")]


def refused(response, what):
    code = int(response.partition(",")[0], 0)
    if not code & 0x80000000 or "," in response:
        raise AssertionError(f"{what} was answered with {response!r}")
    return code & 0xFFFFFFFF


@check("rac")
def all_kinds_of_variables(_, address):
    """RAC specification, sections 3.2 to 4.2: the guide's samples, written and read back."""
    line = rac_line(address)
    for kind, value in VALUES:
        index = 20 if kind == "IO" else 10
        equal(line(f"PUT:RC8:{index}:{kind}:{value}\r".encode()), "0", f"response to PUT {kind}")
        response = line(f"GET:RC8:{index}:{kind}:\r".encode())
        equal(numbers(response), numbers("0," + value), f"value of {kind}")
    line.close()


@check("rac")
def true_is_minus_one(_, address):
    line = rac_line(address)
    for written, read in (("11,-1", -1.0), ("11,1", -1.0), ("11,0", 0.0)):
        equal(line(f"PUT:RC8:20:IO:{written}\r".encode()), "0", "response")
        equal(numbers(line(b"GET:RC8:20:IO:\r")), (0, "11", [read]), "value")
    line.close()


@check("rac")
def blanks_of_the_samples_are_accepted(_, address):
    """RAC specification, section 2.1.1: blanks and tabs at the head of a line; the samples have a blank after each comma."""
    line = rac_line(address)
    for request in (b"PUT:RC8:11:I:3, 123\r", b" \t PUT:RC8:11:I:3,123\r", b"PUT:RC8:11:I: 3, 123\r"):
        equal(line(b"PUT:RC8:11:I:3,0\r"), "0", "response")
        equal(line(request), "0", f"response to {request}")
        equal(numbers(line(b"GET:RC8:11:I:\r")), (0, "3", [123.0]), f"value after {request}")
    equal(line(b"PUT:RC8:11:V: 8196, 1, 2, 3\r"), "0", "response to the sample of V")
    line.close()


@check("rac")
def numbers_survive(_, address):
    line = rac_line(address)
    for kind, vt, value in (("F", 4, 16777216.0), ("F", 4, 0.1), ("D", 5, 0.30000000000000004), ("D", 5, 1e308), ("D", 5, -5e-324)):
        equal(line(f"PUT:RC8:12:{kind}:{vt},{value!r}\r".encode()), "0", "response")
        found = float(line(f"GET:RC8:12:{kind}:\r".encode()).split(",")[2])
        exact = abs(found - value) <= abs(value) * 6e-8 if kind == "F" else found == value
        holds(exact, f"{kind} {value!r} read as {found!r}")
    line.close()


@check("rac")
def lines_of_256_bytes_and_no_more(_, address):
    """RAC specification, section 2.1.1: with the CR."""
    line = rac_line(address)
    head = b"PUT:RC8:13:S:8,"
    longest = b"x" * (255 - len(head))
    equal(line(head + longest + b"\r"), "0", "response to 256 bytes")
    equal(line(b"PUT:RC8:13:I:3,7\r"), "0", "response")
    refused(line(head + longest + b"yy\r"), "a line of 258 bytes")
    refused(line(head + b"z" * 5000 + b"\r"), "a line of 5000 bytes")
    equal(numbers(line(b"GET:RC8:13:I:\r")), (0, "3", [7.0]), "value after the refused lines")
    equal(line(head + b"\r"), "0", "response to an empty string")
    line.close()


@check("rac")
def wrong_lines_are_refused_and_end_nothing(_, address):
    line = rac_line(address)
    for wrong in ("", "HELLO", "GET", "DEL:RC8:1:I:", "GET:RC9:1:I:", "GET:RC8:1:X:", "GET:RC8:-1:I:", "GET:RC8:x:I:",
                  "GET:RC8:999999:I:", "GET:RC8:99999999999999999999:I:", "PUT:RC8:1:I:", "PUT:RC8:1:I:3", "PUT:RC8:1:I:3,",
                  "PUT:RC8:1:I:3,12x", "PUT:RC8:1:I:99,1", "PUT:RC8:1:I:8,text", "PUT:RC8:1:V:8196,1,2", "PUT:RC8:1:I:3,99999999999"):
        refused(line(wrong.encode() + b"\r"), repr(wrong))
        equal(numbers(line(b"GET:RC8:1:I:\r"))[:2], (0, "3"), f"response after {wrong!r}")
    line.close()


@check("rac")
def codes_of_errors(_, address):
    """RAC specification, Table 2-3."""
    line = rac_line(address)
    equal(refused(line(b"DEL:RC8:1:I:\r"), "a wrong verb"), 0x80010005, "E_INVALIDCOMMAND")
    equal(refused(line(b"PUT:RC8:1:I:3,12x\r"), "a wrong value"), 0x80010003, "E_INVALIDARGTYPE")
    equal(refused(line(b"GET:RC8:x:I:\r"), "a wrong index"), 0x80070057, "E_INVALIDARG")
    equal(refused(line(b"x" * 300 + b"\r"), "a long line"), 0x80010011, "E_PACKETSIZEOVER")
    line.close()


@check("rac")
def lines_in_pieces_and_lines_together(_, address):
    line = rac_line(address)
    with connect(address) as raw:
        for byte in b"PUT:RC8:14:I:3,14\r":
            raw.sendall(bytes([byte]))
        raw.settimeout(5)
        equal(raw.recv(100), b"0\r", "response to single bytes")
    equal(line(b"GET:RC8:14:I:\r" * 20), "0,3,14", "first response of 20")
    for _ in range(19):
        equal(line(b""), "0,3,14", "response")
    line.close()


@check("rac")
def binary_bytes_are_refused(_, address):
    line = rac_line(address)
    refused(line(bytes(range(14, 256)) + b"\r"), "bytes that are no UTF-8")
    refused(line(b"PUT:RC8:1:S:8,\xff\xfe\r"), "a string that is no UTF-8")
    equal(numbers(line(b"GET:RC8:1:I:\r"))[:2], (0, "3"), "response after that")
    line.close()


@check("rac")
def values_are_shared_by_connections(_, address):
    one, other = rac_line(address), rac_line(address)
    equal(one(b"PUT:RC8:15:I:3,15\r"), "0", "response")
    equal(other(b"GET:RC8:15:I:\r"), "0,3,15", "value")
    one.close()
    equal(other(b"GET:RC8:15:I:\r"), "0,3,15", "value after the writer left")
    other.close()
