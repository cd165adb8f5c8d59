"""Tests dist: wheels take their tag's glibc and name every linked crate, the sdist is all sources.

What glibc both libraries of a wheel ask for, auditwheel tells, which must be in PATH.

The names are in the SBOM, CycloneDX in `.dist-info/sboms` (PEP 770), which maturin makes of the
extension; the library for ONNX Runtime must link no others.
"""

import json
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from build_licenses import linked  # noqa: E402 - found by the line above

SOURCES = (
    *("Cargo.lock", "Cargo.toml", "LICENSE", "README.md", "THIRD-PARTY.txt", "pyproject.toml"),
    *("build_*.py", "python", "crates/ffpose-[!o]*", "crates/ffpose-ort"),
)
"""Patterns of git, what a wheel is built from."""

(source,) = (ROOT / "dist").glob("*.tar.gz")
with tarfile.open(source) as archive:
    packed = {name.partition("/")[2] for name in archive.getnames()} - {"PKG-INFO"}
listing = subprocess.run(
    ["git", "ls-files", "--", *SOURCES], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
)
tracked = set(listing.stdout.split())
assert packed == tracked, f"{source.name}: expected what git tracks, differs by {packed ^ tracked}"
print(f"{source.name}: {len(packed)} files, as tracked")

for path in (ROOT / "dist").glob("*.whl"):
    with zipfile.ZipFile(path) as wheel:
        (sbom,) = (name for name in wheel.namelist() if ".dist-info/sboms/" in name)
        components = json.loads(wheel.read(sbom))["components"]
    machine = path.stem.rpartition("manylinux_2_28_")[2]
    shown = subprocess.run(
        ["auditwheel", "show", path], check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    glibc = re.search(r'platform tag: "manylinux_2_(\d+)_', " ".join(shown.split()))
    assert glibc is not None, shown
    assert int(glibc[1]) <= 28, f"{path.name}: expected glibc 2.28 or older: {shown}"
    crates = {(each["name"], each["version"]) for each in linked(f"{machine}-unknown-linux-gnu")}
    missing = crates - {(each["name"], each["version"]) for each in components}
    assert not missing, f"{path.name}: expected every linked crate in {sbom}, misses {missing}"
    print(f"{path.name}: all {len(crates)} crates are in its SBOM")
