"""The table's numbers, by hand."""

import csv
import json

import pytest

from ffpose.errors import DataError
from studies.table import epoch_within, read_run, write_tables
from tiny_study import tiny_study

NAMES = ("rotation_error_deg", "in_plane_error_deg", "out_of_plane_error_deg")


def errors(value, prefix=""):
    """Medians and means, all of one value but the translations."""
    return {
        **{f"{prefix}{kind}_{name}": value for kind in ("median", "mean") for name in NAMES},
        f"{prefix}median_relative_translation_error": value / 1000,
        f"{prefix}mean_translation_error_m": value / 10,
    }


def write_result(out, variant, seed, value, epochs):
    """Leave a finished run.

    Args:
        out: The study's folder.
        variant: Name.
        seed: Of the run.
        value: Of its errors on the test set.
        epochs: For each the CPU seconds and the error on the validation images.
    """
    folder = out / f"{variant}-seed{seed}"
    folder.mkdir(parents=True)
    history = [
        {
            "epoch": number,
            "stage": "joint",
            "samples": 10,
            "cpu_seconds": seconds,
            **errors(error, "val_"),
        }
        for number, (seconds, error) in enumerate(epochs, start=1)
    ]
    with (folder / "results.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(history[0]))
        writer.writeheader()
        writer.writerows(history)
    result = {
        "variant": variant,
        "seed": seed,
        "scene": "soyuz_easy",
        "settings": {"seed": seed},
        "epochs": len(epochs),
        "samples": 10 * len(epochs),
        "seconds": 1.0,
        "parameters": 7,
        "cpu_seconds": sum(seconds for seconds, _ in epochs),
        "latency_ms": 2.0,
        "test": {"images": 5, **errors(value), "mean_pose_baseline": errors(100.0)},
    }
    (folder / "results.json").write_text(json.dumps(result))


@pytest.fixture
def out(tmp_path):
    """Grid: 2 and 4 degrees, 5 CPU seconds an epoch; none: 7 degrees, 2.5 and 3 CPU seconds."""
    write_result(tmp_path, "grid", 0, 2.0, [(5.0, 30.0), (5.0, 20.0)])
    write_result(tmp_path, "grid", 1, 4.0, [(5.0, 34.0), (6.0, 21.0)])
    write_result(tmp_path, "none", 0, 7.0, [(2.5, 60.0), (3.0, 50.0)])
    return tmp_path


def cells(text, start):
    """The cells of the rows of a table that begin with a word."""
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [row[1:] for row in rows if row[0] == start]


def test_means_and_standard_deviations_over_the_seeds(out):
    text = write_tables(tiny_study(), out).read_text()
    at_the_end, within = cells(text, "grid")
    degrees = "3.00° ± 1.41°"  # of 2 and 4: mean 3, sqrt(((2-3)² + (4-3)²) / 1) = 1.41
    share = "0.30 % ± 0.14 %"
    # CPU seconds 10 and 11: mean 10.5, deviation 0.71.
    assert at_the_end == ["grid filter", "2", "20 ± 0", "10 ± 1", *[degrees] * 3, share]
    # Within 5.5 seconds one epoch of 30 and 34 degrees: mean 32, deviation sqrt(8) = 2.83.
    assert within == ["2", "10 ± 0", *["32.00° ± 2.83°"] * 3, "3.20 % ± 0.28 %"]
    at_the_end, within = cells(text, "none")
    assert at_the_end == ["no filter", "1", "20", "6", *["7.00°"] * 3, "0.70 %"]
    assert within == ["1", "20", *["50.00°"] * 3, "5.00 %"]
    (constant,) = cells(text, "constant pose")
    assert constant == ["soyuz_easy", "", "", "", *["100.00°"] * 3, "10.00 %"]
    assert "within 6 CPU" in text  # 5.5 seconds


def test_a_run_whose_first_epoch_takes_longer_than_another_run_has_no_value(out):
    write_result(out, "none", 1, 7.0, [(4.0, 60.0)])
    _, within = cells(write_tables(tiny_study(), out).read_text(), "grid")
    assert within == ["0", "–", "–", "–", "–", "–"]


def test_a_row_a_run(out):
    write_tables(tiny_study(), out)
    with (out / "ablation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["variant"], row["seed"]) for row in rows] == [
        ("grid", "0"),
        ("grid", "1"),
        ("none", "0"),
    ]
    second = rows[1]
    assert float(second["median_rotation_error_deg"]) == 4.0
    assert float(second["constant_median_rotation_error_deg"]) == 100.0
    assert (second["equal_cpu_seconds"], second["equal_cpu_samples"]) == ("5.5", "10.0")
    assert float(second["equal_cpu_val_median_rotation_error_deg"]) == 34.0


def test_runs_of_other_studies_and_unfinished_ones_do_not_count(out):
    write_result(out, "other", 0, 1.0, [(1.0, 1.0)])
    (out / "none-seed1").mkdir()
    (out / "none-seed1/results.csv").write_text("epoch\n")
    text = write_tables(tiny_study(), out).read_text()
    assert "other" not in text
    assert cells(text, "none")[0][1] == "1"


def test_what_has_not_run_is_named(tmp_path):
    assert "No run has finished" in write_tables(tiny_study(), tmp_path).read_text()
    write_result(tmp_path, "none", 0, 7.0, [(1.0, 1.0)])
    assert "Not run yet: grid." in write_tables(tiny_study(), tmp_path).read_text()


def test_the_papers_numbers_stand_beside(tmp_path):
    from studies import STUDIES

    write_result(tmp_path, "n3", 0, 6.0, [(1.0, 1.0)])
    text = write_tables(STUDIES["table2"], tmp_path).read_text()
    assert cells(text, "n3")[-1] == ["0.60 m", "6.00°", "1.0125 m", "6.5437°", "2.00", "61.61"]


@pytest.mark.parametrize(
    ("spent", "samples"), [(0.9, None), (1.0, 10.0), (2.9, 10.0), (3.0, 20.0), (99.0, 20.0)]
)
def test_the_last_epoch_within_a_time(spent, samples):
    history = [{"samples": 10.0, "cpu_seconds": 1.0}, {"samples": 10.0, "cpu_seconds": 2.0}]
    found = epoch_within(history, spent)
    assert (None if found is None else found["samples"]) == samples


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"test": {}, "settings": {}}'])
def test_a_damaged_result_is_named(out, text):
    (out / "grid-seed0/results.json").write_text(text)
    with pytest.raises(DataError, match=r"grid-seed0/results\.json: expected the result of a run"):
        read_run(out / "grid-seed0")
