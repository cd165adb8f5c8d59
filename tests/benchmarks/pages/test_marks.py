import pytest

from benchmarks.pages.marks import fill, outside

PAGE = (
    "**a <!-- figures word -->old<!-- end figures -->, b**\n"
    "<!-- figures rows -->\nold\n<!-- end figures -->\nc"
)
TEXTS = {"word": "new", "rows": "| 1 |\n|---|\n"}


def test_text_goes_into_the_line_and_tables_between_empty_lines():
    filled = fill(PAGE, TEXTS.__getitem__)
    assert filled == (
        "**a <!-- figures word -->new<!-- end figures -->, b**\n"
        "<!-- figures rows -->\n\n| 1 |\n|---|\n\n<!-- end figures -->\nc"
    )
    assert fill(filled, TEXTS.__getitem__) == filled


def test_what_stands_outside():
    assert outside(PAGE) == "**a , b**\n\nc"


@pytest.mark.parametrize(
    "page",
    [
        "<!-- figures word -->",
        "old<!-- end figures -->",
        "<!-- figures word --><!-- figures word -->old<!-- end figures -->",
    ],
)
def test_a_mark_without_its_end_is_an_error(page):
    with pytest.raises(ValueError, match="each mark of figures with its end"):
        fill(page, TEXTS.__getitem__)
