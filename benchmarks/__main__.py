"""``python -m benchmarks COMMAND``, from the root of the repository."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import benchmarks
from benchmarks import correlation, look, onboard, textures, tracking, twist
from benchmarks.filter.run import run as run_filter
from benchmarks.model import attention, deployment
from benchmarks.output import in_threads
from benchmarks.pages.blocks import write_pages
from benchmarks.pages.cards import fill_page
from benchmarks.pages.documents import DOCUMENTS, Effort, measure, write
from ffpose._internal.machine import cores, processor
from ffpose.errors import explain

WHOLE = {
    "look": (look, "the slope and the time of a look where an object is expected"),
    "onboard": (onboard, "a frame posed alone and one with a track, by the program for the target"),
    "tracking": (tracking, "tracks through rendered sequences against frames posed alone"),
    "correlation": (correlation, "angles over which a network's errors correlate"),
    "textures": (textures, "what textures add to the time of a rendered image"),
    "twist": (twist, "change of the attitude with the twist of the second look's camera"),
}
"""Modules that know their own arguments."""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks", description=benchmarks.__doc__, allow_abbrev=False
    )
    commands = parser.add_subparsers(dest="command", required=True)
    text = "the filter against torch.fft, torch.compile, SciPy and matrices, by instruction set"
    filter = commands.add_parser("filter", help=text)
    text = "a network in torch and in the runtimes that take its graph"
    model = commands.add_parser("model", help=text)
    model.add_argument("network", help="a preset, weights, or gfnet")
    model.add_argument("--batch", type=int, nargs="+", help="images a batch (default: 1 8)")
    model.add_argument("--threads", type=int, nargs="+", help="(default: 1, 2, all cores)")
    model.add_argument("--looks", type=int, help="number of second looks")
    model.add_argument("--candidates", type=int, help="number of places looked at first")
    text = "base, small and tiny, with and without torch's attention and torch.fft"
    commands.add_parser("attention", help=text)
    text = "put the tables of the model cards into pages, after <!-- card: SET -->"
    carded = commands.add_parser("cards", help=text)
    carded.add_argument("pages", type=Path, nargs="+", metavar="PAGE", help="Markdown")
    text = "of the cards, SET/card.json (default: cards)"
    carded.add_argument("--folder", type=Path, default=Path("cards"), help=text)
    for name, (module, text) in WHOLE.items():
        module.add_arguments(commands.add_parser(name, help=text, description=module.__doc__))
    text = "measure data files, and put the figures of all into the pages"
    pages = commands.add_parser("pages", help=text)
    text = f"data files to measure: {', '.join(DOCUMENTS)}"
    pages.add_argument("documents", nargs="*", metavar="DOC", help=text)
    pages.add_argument("--all", action="store_true", help="measure every document")
    pages.add_argument("--machine", default=processor(), help="its name (default: processor's)")
    pages.add_argument("--note", default="", help="what the reader of the figures has to know")
    threads = sorted({1, min(2, cores())})
    pages.add_argument("--threads", type=int, nargs="+", default=threads, help="(default: 1, 2)")
    for each in (filter, model, commands.choices["attention"], pages):
        each.add_argument("--quick", action="store_true", help="few cases, short timings")
        if each is not pages:
            each.add_argument("--json", action="store_true", help="print every timing as JSON")
    for each in (filter, model):
        each.add_argument("--plot", type=Path, help="picture to draw, PNG")
    return parser


def main(words: Sequence[str] | None = None) -> int:
    """Run a benchmark; return 0, or 1 after one line of explanation."""
    options = build_parser().parse_args(words)
    try:
        _run(options)
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        print(f"benchmarks: {explain(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("benchmarks: interrupted", file=sys.stderr)
        return 130
    return 0


def _run(options: argparse.Namespace) -> None:
    match options.command:
        case "filter":
            run_filter(options.json, options.plot, options.quick)
        case "model":
            fields = {name: getattr(options, name) for name in ("looks", "candidates")}
            deployment.run(
                options.network,
                options.json,
                options.plot,
                options.quick,
                batches=options.batch,
                threads=options.threads,
                **{name: value for name, value in fields.items() if value is not None},
            )
        case "attention":
            attention.run(options.json, options.quick)
        case name if name in WHOLE:
            WHOLE[name][0].run(options)
        case "cards":
            for page in options.pages:
                fill_page(page, options.folder)
        case _:
            _fill_pages(options)


def _fill_pages(options: argparse.Namespace) -> None:
    root = Path()
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


if __name__ == "__main__":
    sys.exit(main())
