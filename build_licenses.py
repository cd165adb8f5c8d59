"""Prints the licenses of the Rust crates that a wheel links: `python build_licenses.py`."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent
OURS = ("--package=ffpose-py", "--package=ffpose-ort")
TEXTS = ("license*", "licence*", "copying*", "notice*")


def linked(target: str = "all") -> list[dict[str, Any]]:
    """Return cargo's records of the crates that the libraries link, by name.

    Args:
        target: Platform, by Rust's name; all takes what any of them links.
    """
    metadata = json.loads(_cargo("metadata", "--format-version=1"))
    tree = _cargo(
        "tree",
        *OURS,
        "--edges=normal,no-proc-macro",
        f"--target={target}",
        "--prefix=none",
        "--format={p}",
    )
    names = {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    crates = [
        crate
        for crate in metadata["packages"]
        if crate["source"] and (crate["name"], f"v{crate['version']}") in names
    ]
    return sorted(crates, key=lambda crate: (crate["name"], crate["version"]))


def _cargo(command: str, *options: str) -> str:
    words = ["cargo", command, "--locked", *options]
    return subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def license_texts(crate: dict[str, Any]) -> str:
    """Return the texts of the license files in a crate's folder."""
    folder = Path(crate["manifest_path"]).parent
    files = [file for file in sorted(folder.iterdir()) if file.is_file()]
    texts = [
        file.read_text(encoding="utf-8").strip()
        for file in files
        if any(Path(file.name.lower()).match(pattern) for pattern in TEXTS)
    ]
    return "\n\n".join(texts)


if __name__ == "__main__":
    print("The libraries of ffpose's wheels link Rust's standard library (MIT OR Apache-2.0,")
    print("https://github.com/rust-lang/rust) and these crates:")
    for crate in linked():
        print(f"\n{'=' * 80}\n{crate['name']} {crate['version']}: {crate['license']}")
        print(f"{crate['repository']}\n\n{license_texts(crate)}".rstrip())
