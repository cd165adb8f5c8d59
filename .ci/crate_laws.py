"""Tests the crates of both lock files by deny.toml: licenses, duplicate versions, sources.

So does `.ci/deny`, which releases run for the advisories too; its program takes minutes to build.
"""

import re
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REGISTRY = "registry+https://github.com/rust-lang/crates.io-index"
RULES = tomllib.loads((ROOT / "deny.toml").read_text())
ALLOWED = set(RULES["licenses"]["allow"])
TWICE = {skip["crate"].partition("@")[0] for skip in RULES["bans"]["skip"]}


def is_allowed(license: str) -> bool:
    """Whether what is allowed meets an SPDX expression, or cargo's old one with a slash for OR."""
    words = re.findall(r"[()/]|[^\s()/]+(?: WITH [^\s()]+)?", license)
    operators = {"(": "(", ")": ")", "OR": "or", "/": "or", "AND": "and"}
    return bool(words) and eval(" ".join(operators.get(w, str(w in ALLOWED)) for w in words))


def wrong(folder: Path) -> list[str]:
    """Return what is wrong with the crates of a workspace, those of its tests left out."""
    options = ["--locked", "--workspace", "--target=all", "--edges=no-dev"]
    command = ["cargo", "tree", *options, "--prefix=none", "--no-dedupe", "--format={p}\t{l}"]
    tree = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
    licenses = dict(line.split("\t") for line in tree.stdout.splitlines() if "\t" in line)
    versions = Counter(package.split()[0] for package in licenses)
    lock = tomllib.loads((folder / "Cargo.lock").read_text())
    return [
        *(
            f"{package}: {license}"
            for package, license in licenses.items()
            if not is_allowed(license)
        ),
        *(f"{name}: {n} versions" for name, n in versions.items() if n > 1 and name not in TWICE),
        *(
            f"{c['name']}: {c['source']}"
            for c in lock["package"]
            if c.get("source", REGISTRY) != REGISTRY
        ),
    ]


if __name__ == "__main__":
    folders = (ROOT, ROOT / "crates/ffpose-onboard")
    sys.exit("\n".join(f"{each}: {what}" for each in folders for what in wrong(each)) or None)
