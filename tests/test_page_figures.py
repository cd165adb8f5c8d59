"""What the pages say was measured is what the data files hold, and the model cards."""

import re

import pytest

from benchmarks.pages.blocks import PAGES, filled
from benchmarks.pages.documents import DOCUMENTS, read
from benchmarks.pages.marks import outside
from pages import ROOT, TEXTS

MEASURED = re.compile(
    r"\b\d[\d.,]*\s?(?:µs|ms|s|seconds?|minutes?|hours?|GFLOP/s|GB/s)\b"  # times and rates
    r"|\b\d+(?:\.\d+)? \(\d+(?:\.\d+)?\)"  # a mean with the smallest, a median with a percentile
    r"|\b\d+(?:\.\d+)? times\b"
    r"|\b\d+\.\d+ (?:to \d+\.\d+ )?of\b"  # a share
)


def without_code(text):
    """Return a page without its code blocks."""
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_shows_what_the_data_files_hold(page):
    assert TEXTS[page] == filled(page, ROOT)


@pytest.mark.parametrize("page", PAGES)
def test_no_measured_figure_stands_outside_of_marks(page):
    assert MEASURED.findall(without_code(outside(TEXTS[page]))) == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("11.5 (6.8) and 3.7 (3.2)", ["11.5 (6.8)", "3.7 (3.2)"]),
        ("takes 71 s, 24 ms of 53, p50", ["71 s", "24 ms"]),
        ("1.9 to 11 times as fast, in 0.46 of the time", ["11 times", "0.46 of"]),
        ("46 GFLOP/s; 6 minutes", ["46 GFLOP/s", "6 minutes"]),
        ("opset 18, 1280 × 960 pixels, 8–22 m, 2.38°, 11.6 MB", []),
    ],
)
def test_what_counts_as_measured(text, found):
    assert MEASURED.findall(text) == found


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_data_file_says_where_and_how_it_was_measured(name):
    figures = read(name, ROOT)
    assert figures.machine
    assert figures.threads
    assert {"torch", "ffpose", "instruction_set", "processor", "cores"} <= set(figures.environment)


def test_accuracies_of_the_readme_are_in_the_model_cards():
    """A rounded value is there with the same or more digits."""
    accuracy = re.compile(r"(\d+(?:\.\d+)?)(?:°| (m\b))")
    cards = [(float(value), unit) for value, unit in accuracy.findall(TEXTS["docs/models.md"])]
    text = without_code(outside(TEXTS["README.md"]))
    found = accuracy.findall(text)
    assert len(found) > 5
    for value, unit in found:
        digits = len(value.partition(".")[2])
        known = {round(each, digits) for each, its_unit in cards if its_unit == unit}
        assert float(value) in known, f"{value}{unit or '°'}: not in docs/models.md"
