"""Unsafe Rust lives in few places, read from the sources; clippy sees that each block is argued."""

import re
from pathlib import Path

import pytest

CRATES = Path(__file__).parents[1] / "crates"

# Each place, and what cannot be said there without it.
PLACES = {
    "ffpose-core/src/simd": "vector instructions, and memory read and written as vectors",
    "ffpose-onboard/src/c.rs": "pointers that come from C",
    "ffpose-onboard/src/watch.rs": "the scheduler's functions",
    "ffpose-ort/src/border": "ONNX Runtime's C functions, and those that it calls",
    "ffpose-py/src/array.rs": "NumPy's memory, without flags that a forked child keeps",
    "ffpose-py/src/pool.rs": "torch's threads, by their C symbols",
    "ffpose-py/src/tensor.rs": "torch's memory, by its C description",
}

UNSAFE = re.compile(r"\bunsafe\s+(?:fn|impl|trait|extern)\b|\bunsafe\s*[({]")


def code(path: Path) -> str:
    return re.sub(r"//.*", "", path.read_text())


@pytest.mark.parametrize(
    "path", sorted(CRATES.glob("*/src/**/*.rs")), ids=lambda path: str(path.relative_to(CRATES))
)
def test_unsafe_code_is_where_it_is_expected(path):
    name = path.relative_to(CRATES).as_posix()
    if not any(name == place or name.startswith(f"{place}/") for place in PLACES):
        assert not UNSAFE.search(code(path))


def test_it_is_found_where_it_is():
    found = [
        path for path in (CRATES / "ffpose-core/src/simd").glob("*.rs") if UNSAFE.search(code(path))
    ]
    assert len(found) > 1


def test_each_block_needs_its_argument():
    lints = (CRATES.parent / "Cargo.toml").read_text()
    assert 'undocumented_unsafe_blocks = "deny"' in lints
    assert 'unsafe_op_in_unsafe_fn = "deny"' in lints
