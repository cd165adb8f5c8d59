"""The table of results of a run that an older version began."""

import math

from ffpose.training.checkpoint import RunFolder
from studies.table import read_results


def test_columns_that_an_older_version_did_not_have_are_nan(tmp_path):
    folder = RunFolder(tmp_path)
    folder.save_results(
        [{"epoch": 1, "stage": "joint"}, {"epoch": 2, "stage": "joint", "new": 0.5}]
    )
    older, newer = read_results(folder.results)
    assert (older["epoch"], older["stage"]) == (1, "joint")
    assert math.isnan(older["new"])
    assert newer == {"epoch": 2, "stage": "joint", "new": 0.5}
