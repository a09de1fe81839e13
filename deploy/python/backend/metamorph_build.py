"""The build backend: maturin, and before it the program `metamorph`, which goes into the wheel as well.

Swarms of processes need the program: an agent in a Python process would cost the memory of an interpreter each.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import maturin
from maturin import (  # noqa: F401
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

HERE = Path(__file__).resolve().parent.parent


def _program() -> None:
    root = HERE.parent.parent
    target = Path(os.environ.get("CARGO_TARGET_DIR", root / "target"))
    # The same for the extension, so that both share what they are built of.
    os.environ["CARGO_PROFILE_RELEASE_STRIP"] = "symbols"
    features = ["--features", "metamorph-world-controller/hosts"]
    command = ["cargo", "build", "--release", "--locked", *features, "--bin", "metamorph"]
    subprocess.run(command, cwd=root, check=True)
    to = HERE / "python" / "metamorph" / "bin"
    to.mkdir(exist_ok=True)
    shutil.copy2(target / "release" / "metamorph", to / "metamorph")


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    _program()
    return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    _program()
    return maturin.build_editable(wheel_directory, config_settings, metadata_directory)
