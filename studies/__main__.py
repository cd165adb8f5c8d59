"""``python -m studies NAME --out DIR``: train the variants of a study, and print the table.

Finished runs are skipped and interrupted ones resumed, so the same command continues a study.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import studies
from ffpose._internal.options import is_usage
from ffpose.errors import explain
from studies.changes import read_changes
from studies.run import ablate


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser("python -m studies", description=__doc__, allow_abbrev=False)
    text = "; ".join(f"{study.name}: {study.about}" for study in studies.STUDIES.values())
    parser.add_argument("study", choices=list(studies.STUDIES), help=text)
    parser.add_argument("--out", type=Path, required=True, help="folder to write or to continue")
    parser.add_argument("--seeds", type=int, default=2, help="runs a variant (default: 2)")
    text = "budget of a run, in place of the study's"
    parser.add_argument("--epochs", type=int, help=text)
    parser.add_argument("--minutes", type=float, help="budget of a run, of the training's CPU time")
    parser.add_argument("--variants", nargs="+", default=[], help="names of those to run")
    text = "sets on disk, in URSO's layout, by name: DIR/soyuz_hard; without it scenes are rendered"
    parser.add_argument("--sets", type=Path, metavar="DIR", help=text)
    parser.add_argument("--test-images", type=int, default=500, help="of the rendered test set")
    text = "fields of `ffpose train` to change in all runs, as data.count=1000 model.depth=4"
    parser.add_argument("--changes", nargs="+", metavar="FIELD=VALUE", default=[], help=text)
    text = "render and cache the images alone, before a job array of variants"
    parser.add_argument("--prepare", action="store_true", help=text)
    return parser


def main(words: Sequence[str] | None = None) -> int:
    """Run a study; return 0 if all its runs finished, 1 after one line of explanation.

    Wrong usage raises SystemExit with code 2.
    """
    parser = build_parser()
    options = parser.parse_args(words)
    try:
        changes = read_changes(options.changes)
    except argparse.ArgumentError as error:
        parser.error(explain(error))
    try:
        outcome = ablate(
            studies.STUDIES[options.study],
            options.out,
            seeds=options.seeds,
            epochs=options.epochs,
            cpu_minutes=options.minutes,
            variants=options.variants,
            changes=changes,
            sets=options.sets,
            test_images=options.test_images,
            prepare=options.prepare,
        )
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        if is_usage(error, parser.format_usage()):
            parser.error(explain(error))
        print(f"studies: {explain(error)}", file=sys.stderr)
        return 1
    print(outcome.table.read_text(), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
