"""ORiNException and HResult, as in the maker's Python client."""


class HResult:
    """The codes that the client itself knows, as signed integers."""

    S_OK = 0
    S_FALSE = 1
    S_EXECUTING = 0x900
    E_TIMEOUT = 0x80000900 - 2**32
    E_NOTIMPL = 0x80004001 - 2**32
    E_ABORT = 0x80004004 - 2**32
    E_FAIL = 0x80004005 - 2**32
    E_UNEXPECTED = 0x8000FFFF - 2**32
    E_INVALIDPACKET = 0x80010000 - 2**32
    E_ACCESSDENIED = 0x80070005 - 2**32
    E_HANDLE = 0x80070006 - 2**32
    E_OUTOFMEMORY = 0x8007000E - 2**32
    E_INVALIDARG = 0x80070057 - 2**32

    @staticmethod
    def succeeded(hr: int) -> bool:
        """Whether a code is a success."""
        return hr >= 0

    @staticmethod
    def failed(hr: int) -> bool:
        """Whether a code is a failure."""
        return hr < 0


class ORiNException(Exception):
    """A call failed. `int(str(error))` and `error.hresult` are its code, a signed integer."""

    def __init__(self, hresult: int) -> None:
        super().__init__(hresult)

    @property
    def hresult(self) -> int:
        """The code."""
        code: int = self.args[0]
        return code
