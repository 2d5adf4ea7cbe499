"""BCAPClient with the methods and arguments of the maker's Python client, for scripts that were written for it.

>>> from bcap.compat import bcapclient
>>> client = bcapclient.BCAPClient("192.168.0.1", 5007, 2000)
>>> client.service_start("")
>>> controller = client.controller_connect("", "CaoProv.DENSO.VRC9", "localhost", "")
>>> variable = client.controller_getvariable(controller, "I1", "")
>>> client.variable_getvalue(variable)
0

It differs from the maker's client in what happens at the end: Ctrl-C, an exception that ends the script, and the end of the
interpreter halt the robot, switch off a motor that the script has switched on, and give the arm back.
"""

from __future__ import annotations

import weakref
from ctypes import c_float
from typing import TYPE_CHECKING, Any, Callable, List

from .. import _bcap, _signals
from .orinexception import HResult, ORiNException

__all__ = ["BCAPClient", "HResult", "ORiNException"]

#: The methods of each object, in the order of their function numbers, from 1 on. A sign ends a name: `?` takes name and option,
#: `*` an option, `!` a command and a parameter, `=` a new value. The arguments of the others are in parentheses.
_METHODS = """
service: start(option='') stop()
controller: connect(name,provider,machine,option) disconnect(handle) getextension? getfile? getrobot? gettask? getvariable?
  getcommand? getextensionnames* getfilenames* getrobotnames* gettasknames* getvariablenames* getcommandnames* execute!
  getmessage(handle) getattribute(handle) gethelp(handle) getname(handle) gettag(handle) puttag= getid(handle) putid=
extension: getvariable? getvariablenames* execute! getattribute(handle) gethelp(handle) getname(handle) gettag(handle) puttag=
  getid(handle) putid= release(handle)
file: getfile? getvariable? getfilenames* getvariablenames* execute! copy? delete* move? run* getdatecreated(handle)
  getdatelastaccessed(handle) getdatelastmodified(handle) getpath(handle) getsize(handle) gettype(handle) getvalue(handle) putvalue=
  getattribute(handle) gethelp(handle) getname(handle) gettag(handle) puttag= getid(handle) putid= release(handle)
robot: getvariable? getvariablenames* execute! accelerate(handle,axis,accel,decel) change(handle,name) chuck*
  drive(handle,axis,mov,option='') gohome(handle) halt* hold* move(handle,comp,pose,option='')
  rotate(handle,rotsuf,deg,pivot,option='') speed(handle,axis,speed) unchuck* unhold* getattribute(handle) gethelp(handle)
  getname(handle) gettag(handle) puttag= getid(handle) putid= release(handle)
task: getvariable? getvariablenames* execute! start(handle,mode,option='') stop(handle,mode,option='') delete* getfilename(handle)
  getattribute(handle) gethelp(handle) getname(handle) gettag(handle) puttag= getid(handle) putid= release(handle)
variable: getdatetime(handle) getvalue(handle) putvalue= getattribute(handle) gethelp(handle) getname(handle) gettag(handle) puttag=
  getid(handle) putid= getmicrosecond(handle) release(handle)
command: execute(handle,mode) cancel(handle) gettimeout(handle) puttimeout= getstate(handle) getparameters(handle) putparameters=
  getresult(handle) getattribute(handle) gethelp(handle) getname(handle) gettag(handle) puttag= getid(handle) putid= release(handle)
message: reply(handle,data) clear(handle) getdatetime(handle) getdescription(handle) getdestination(handle) getnumber(handle)
  getserialnumber(handle) getsource(handle) getvalue(handle) release(handle)
"""

_SIGNS = {"?": "handle,name,option=''", "*": "handle,option=''", "!": "handle,command,param=None", "=": "handle,newval"}

#: These arguments are R4.
_R4 = {"accel", "decel", "mov", "deg", "speed"}


def _methods() -> List[str]:
    """Returns the source of each method: name(self, arguments)."""
    found: List[str] = []
    for word in _METHODS.split():
        if word.endswith(":"):
            prefix = word[:-1]
            continue
        name, _, given = word.partition("(")
        arguments = given[:-1] if given else _SIGNS[name[-1]]
        found.append(f"{prefix}_{name.rstrip(''.join(_SIGNS))}({arguments})")
    return found


class BCAPClient:
    """A client over TCP.

    :param host: a host name or an address
    :param port: 5007 on real controllers
    :param timeout: how long a call waits for a reply or a keep-alive, in seconds
    """

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._timeout = timeout
        self._client = _bcap.Client(host, port, timeout)
        self._end = weakref.finalize(self, self._client.close)
        _signals.arm_taken()
        weakref.finalize(self, _signals.arm_given).atexit = False

    def settimeout(self, timeout: float) -> None:
        """Sets how long a call waits, in seconds."""
        self._client.set_timeout(timeout)
        self._timeout = timeout

    def gettimeout(self) -> float:
        """Returns how long a call waits, in seconds."""
        return self._timeout

    def _call(self, number: int, *arguments: Any) -> Any:
        return self._client.call(number, arguments, ORiNException)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Callable[..., Any]:
            """The 137 functions."""


def _add(number: int, source: str) -> None:
    name, _, arguments = source[:-1].partition("(")
    names = [argument.partition("=")[0] for argument in arguments.split(",") if argument]
    values = "".join(f", _float({name})" if name in _R4 else f", {name}" for name in names)
    defined: Any = {"_float": c_float}
    exec(f"def {name}(self, {arguments}): return self._call({number}{values})", defined)
    method = defined[name]
    method.__doc__ = f"Function {number} of b-CAP."
    method.__qualname__ = f"BCAPClient.{name}"
    setattr(BCAPClient, name, method)


for _number, _source in enumerate(_methods(), 1):
    _add(_number, _source)
