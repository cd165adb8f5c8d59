"""The pages of the documentation, and the code in them."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
TEXTS = {
    path.relative_to(ROOT).as_posix(): path.read_text()
    for path in [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
}
"""Each page by its name."""


def code_blocks(text, *languages):
    """Return the code blocks of these languages in a page."""
    return [code for _, code in blocks_in_order(text, *languages)]


def blocks_in_order(text, *languages):
    """Return language and code of each block of these languages in a page."""
    fence = re.compile(rf"^```({'|'.join(languages)})\n(.*?)^```", re.DOTALL | re.MULTILINE)
    return fence.findall(text)
