"""The program without Python, built and started."""

import json
import re
import shutil
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest

from ffpose.onnx.metadata import sealed
from onboard_program import CRATE, ROOT, projections

TARGET = ROOT / "target" / "onboard"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """What needs the program waits for Rust's compiler."""
    for item in items:
        if "program" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def program():
    """The program, as `make onboard` builds it; a build that is up to date takes no time."""
    if not shutil.which("cargo"):
        pytest.skip("cargo is not installed")
    (needed,) = re.findall(r'rust-version = "1\.(\d+)"', (CRATE / "Cargo.toml").read_text())
    version = subprocess.run(["cargo", "--version"], capture_output=True, text=True, check=True)
    if int(version.stdout.split(".")[1]) < int(needed):
        pytest.skip(f"the program needs Rust 1.{needed}, got {version.stdout.strip()}")
    folders = ["--manifest-path", str(CRATE / "Cargo.toml"), "--target-dir", str(TARGET)]
    command = ["cargo", "build", "--locked", "--release", "--quiet", *folders]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return TARGET / "release" / "ffpose-onboard"


@pytest.fixture(scope="session")
def runtime():
    """ONNX Runtime's library, the one that Python uses a copy of."""
    onnxruntime = pytest.importorskip("onnxruntime")
    found = sorted((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.*"))
    if not found:
        pytest.skip("onnxruntime holds no library for other programs here")
    return found[0]


@pytest.fixture
def run(program, runtime):
    """Runs the program on one thread; returns exit code, documents and lines of standard error."""

    def run(model, *arguments, lines=(), runtime=runtime):
        command = [program, "--model", model, "--runtime", runtime, "--threads", "1", *arguments]
        done = subprocess.run(
            command, input="\n".join(map(str, lines)), capture_output=True, text=True, check=False
        )
        documents = [json.loads(line) for line in done.stdout.splitlines()]
        return done.returncode, documents, done.stderr.splitlines()

    return run


@pytest.fixture(scope="session")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("onboard") / "projections.onnx"
    path.write_bytes(sealed(projections()))
    return path


@pytest.fixture
def folder(tmp_path):
    """Makes a folder of image files of the given bytes."""

    def make(files):
        folder = tmp_path / "images"
        folder.mkdir()
        for name, data in files.items():
            (folder / name).write_bytes(data)
        return folder

    return make


@pytest.fixture
def fly(program, runtime):
    """Starts the program in its loop; asked for one image, it answers with one line."""
    with ExitStack() as stack:

        def fly(model, *arguments):
            command = [program, "--model", model, "--runtime", runtime, "--threads", "1", "--stdin"]
            process = stack.enter_context(
                subprocess.Popen(
                    [*command, *arguments],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                    bufsize=1,
                )
            )
            stack.callback(process.kill)
            return process

        yield fly


@pytest.fixture
def flying(fly, model):
    return fly(model)
