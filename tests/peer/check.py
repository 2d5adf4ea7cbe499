"""Named checks of a server of b-CAP or RAC, by the client beside this file.

    python3 check.py LINK ADDRESS [WORD]

LINK is tcp, udp, serial or rac; ADDRESS is host:port (for serial, frames with a CRC over TCP); only checks whose
names contain WORD run. Prints a line for each check and a last line with their number; exits with 1 if one failed.
"""

import sys
import traceback

import checks_bcap  # noqa: F401
import checks_rac  # noqa: F401
import checks_slave  # noqa: F401
from client import Silence
from session import CHECKS, stop_all


def main():
    if len(sys.argv) not in (3, 4) or sys.argv[1] not in ("tcp", "udp", "serial", "rac"):
        sys.exit(__doc__)
    kind, address, word = sys.argv[1], sys.argv[2], (sys.argv[3:] or [""])[0]
    passed, broken, silent = 0, 0, 0
    for name, run in [(name, run) for name, links, run in CHECKS if kind in links and word in name]:
        if silent == 3:
            print("stopped: the server does not reply", flush=True)
            break
        try:
            run(kind, address)
            passed += 1
            print(f"ok {name}", flush=True)
        except Exception as error:
            broken += 1
            silent += isinstance(error, Silence)
            at = traceback.extract_tb(error.__traceback__)[1]
            stop_all()
            print(f"FAILED {name} (line {at.lineno}): {type(error).__name__}: {error}", flush=True)
    print(f"{passed + broken} checks over {kind}: {passed} passed, {broken} failed")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
