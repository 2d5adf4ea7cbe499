"""Builds the wheel: maturin's backend, after the command `bcap` was built, which the wheel puts into bin/.

BCAP_COMMAND is the path of a command that exists already; without it, cargo builds one with the profile of releases.
"""

import os
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import Any, Dict, Optional

import maturin
from maturin import *  # noqa: F403 (the other hooks of PEP 517)

HERE = Path(__file__).resolve().parent
SCRIPTS = HERE / "bcap.data" / "scripts"
# maturin wants the folder for each of its hooks
SCRIPTS.mkdir(parents=True, exist_ok=True)
SUFFIX = sysconfig.get_config_var("EXE") or ""


def command() -> Path:
    """Returns the command, which is built first."""
    given = os.environ.get("BCAP_COMMAND")
    if given:
        return Path(given)
    workspace = HERE.parents[1]
    target = Path(os.environ.get("CARGO_TARGET_DIR", workspace / "target"))
    subprocess.run(
        ["cargo", "build", "--release", "--locked", "-p", "bcap-cli", "--target-dir", str(target)], cwd=workspace, check=True
    )
    return target / "release" / f"bcap{SUFFIX}"


def build_wheel(
    wheel_directory: str, config_settings: Optional[Dict[str, Any]] = None, metadata_directory: Optional[str] = None
) -> str:
    shutil.copy2(command(), SCRIPTS / f"bcap{SUFFIX}")
    name: str = maturin.build_wheel(wheel_directory, config_settings, metadata_directory)
    return name
