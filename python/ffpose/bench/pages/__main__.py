"""``python -m ffpose.bench.pages [DOC…]``: measure data files, and put them into the pages.

Without a name nothing is measured, and the pages are written from the data files.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from ffpose._internal.machine import cores, processor
from ffpose.bench.output import in_threads
from ffpose.bench.pages.blocks import write_pages
from ffpose.bench.pages.documents import DOCUMENTS, Effort, measure, write
from ffpose.errors import DataError


def main() -> int:
    """Run the command in the folder of the sources."""
    root = Path()
    options = _parser().parse_args()
    try:
        if min(options.threads) != 1:
            raise ValueError(f"threads: expected 1, and more if you like, got {options.threads}")
        names = list(DOCUMENTS) if options.all else options.documents
        if unknown := set(names) - set(DOCUMENTS):
            raise ValueError(f"DOC: expected some of {', '.join(DOCUMENTS)}, got {sorted(unknown)}")
        effort = Effort(options.quick, tuple(sorted(set(options.threads))))
        for name in names:
            begin = time.perf_counter()
            write(name, measure(name, effort, options.machine, options.note, root), root)
            words = ", ".join(map(in_threads, effort.threads))
            print(f"{name}: {words}, {time.perf_counter() - begin:.0f} s", file=sys.stderr)
        for page in write_pages(root):
            print(f"{page} written", file=sys.stderr)
    except (DataError, OSError, RuntimeError, ValueError) as error:
        print(f"ffpose.bench.pages: {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m ffpose.bench.pages", description=__doc__)
    text = f"data files to measure: {', '.join(DOCUMENTS)}"
    parser.add_argument("documents", nargs="*", metavar="DOC", help=text)
    parser.add_argument("--all", action="store_true", help="measure every document")
    parser.add_argument("--machine", default=processor(), help="its name (default: processor's)")
    parser.add_argument("--note", default="", help="what the reader of the figures has to know")
    threads = sorted({1, min(2, cores())})
    parser.add_argument("--threads", type=int, nargs="+", default=threads, help="(default: 1, 2)")
    parser.add_argument("--quick", action="store_true", help="few cases, short timings")
    return parser


if __name__ == "__main__":
    sys.exit(main())
