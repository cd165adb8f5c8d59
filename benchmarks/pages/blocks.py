"""What the pages show of the data files: a text by name, for `benchmarks.pages.marks`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

from benchmarks.pages import filter_blocks, network_blocks
from benchmarks.pages.documents import read
from benchmarks.pages.markdown import Source
from benchmarks.pages.marks import fill
from ffpose._internal.files import atomic_write

PAGES = ("README.md", "docs/index.md", "docs/filter.md", "docs/benchmarks.md", "docs/deployment.md")
"""The pages that show figures; outside of marks they have none."""

BLOCKS: Mapping[str, Callable[[Source], str]] = {
    "speedup": filter_blocks.speedup,
    "filter": filter_blocks.means,
    "filter-short": partial(filter_blocks.means, groups=filter_blocks.SHORT),
    "filter-sets": filter_blocks.instruction_sets,
    "filter-rivals": filter_blocks.rivals,
    "filter-vector-code": filter_blocks.vector_code,
    "filter-limits": filter_blocks.limits,
    "networks": network_blocks.shares,
    "base": partial(network_blocks.latencies, name="base"),
    "gfnet": partial(network_blocks.latencies, name="gfnet"),
    "soyuz": partial(network_blocks.latencies, name="soyuz"),
    "which-network": network_blocks.which_network,
    "stages": network_blocks.stages,
    "starts": network_blocks.starts,
    "int8": network_blocks.int8,
    "views": network_blocks.views,
    "attention": network_blocks.attention,
}
"""What shows the figures of each name."""


def filled(page: str, root: Path) -> str:
    """Return a page's text with the figures of the data files below ``root`` between its marks.

    Raises:
        ValueError: There is no such block, or a mark without its end.
        ffpose.DataError: There is no such data file, or it is none of these.
    """
    source = cache(partial(read, root=root))
    return fill((root / page).read_text(), lambda name: _block(name)(source))


def _block(name: str) -> Callable[[Source], str]:
    if name not in BLOCKS:
        raise ValueError(f"figures: expected one of {', '.join(BLOCKS)}, got {name}")
    return BLOCKS[name]


def write_pages(root: Path) -> list[str]:
    """Put the figures of the data files into the pages, and return the names of changed pages."""
    texts = {page: filled(page, root) for page in PAGES}
    changed = [page for page, text in texts.items() if text != (root / page).read_text()]
    for page in changed:
        with atomic_write(root / page) as temporary:
            temporary.write_text(texts[page])
    return changed
