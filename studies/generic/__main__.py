"""``python -m studies.generic --out FILE``: train the weights ``generic``.

Ten minutes of a GPU beside 16 cores that render; half a day of two cores.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from studies.generic.train import GenericConfig, train_generic


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser("python -m studies.generic", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    parser.add_argument("--views", type=Path, default=Path("runs/views"), help="folder of views")
    for name in ("spacecraft", "count", "batch_size", "workers"):
        option, default = f"--{name.replace('_', '-')}", getattr(GenericConfig, name)
        parser.add_argument(option, type=int, default=default, help=f"(default: {default})")
    parser.add_argument("--epochs", type=int, nargs="+", default=list(GenericConfig.epochs))
    parser.add_argument("--init", default="soyuz", help="weights to start from")
    parser.add_argument("--device", default="auto")
    return parser


if __name__ == "__main__":
    options = vars(build_parser().parse_args())
    train_generic(GenericConfig(**{**options, "epochs": tuple(options["epochs"])}))
