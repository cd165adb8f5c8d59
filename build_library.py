"""Builds the custom operator's library into the package: `python build_library.py [TARGET]`.

TARGET is Rust's name of another platform and a glibc, as "aarch64-unknown-linux-gnu.2.28", for
which cargo-zigbuild links. The library is compiled with cargo from crates/ffpose-ort, and
`ffpose.onnx.get_library_path` finds it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent
FOLDER = ROOT / "python" / "ffpose" / "onnx"

OPTIONS = [
    "--locked",
    "--release",
    "--package=ffpose-ort",
    # The extension's too: with it what all depend on has the features that it has in the
    # extension and in the tests, and ffpose-core is compiled once.
    "--package=ffpose-track",
    "--message-format=json-render-diagnostics",
]


def build_library(target: str | None = None) -> Path:
    """Return the path of the library, which is compiled anew where its sources have changed.

    Args:
        target: Platform and glibc to link for with zig; None for this machine.
    """
    command = ["cargo", "zigbuild", f"--target={target}"] if target else ["cargo", "build"]
    output = subprocess.run(
        [*command, *OPTIONS], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    messages = [json.loads(line) for line in output.splitlines()]
    (library,) = (
        Path(file)
        for message in messages
        if message["reason"] == "compiler-artifact" and message["target"]["name"] == "ffpose_ort"
        for file in message["filenames"]
        if Path(file).suffix in (".so", ".dylib", ".dll")
    )
    FOLDER.mkdir(exist_ok=True)
    temporary = FOLDER / f".{library.name}.new"
    shutil.copy(library, temporary)
    return temporary.replace(FOLDER / library.name)  # a program may have the old one loaded


if __name__ == "__main__":
    try:
        print(build_library(*sys.argv[1:2]))
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"ffpose: cannot build the custom operator's library: {error}")
