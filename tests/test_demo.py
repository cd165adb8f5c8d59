import json

import pytest

from ffpose.demo import DemoConfig, run

pytestmark = pytest.mark.slow

SMALL = DemoConfig(
    images=30, size=(64, 48), epochs=1, model_fields=(("depth", 1), ("head_hidden", 16))
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    run(out, SMALL, quiet=True)
    return out


@pytest.fixture
def document(folder):
    return json.loads((folder / "report.json").read_text())


def test_report_json_holds_figures_baseline_and_range(document):
    for figures in (document, document["mean_pose_baseline"]):
        assert figures["median_translation_error_m"] > 0
        assert 0 < figures["median_rotation_error_deg"] <= 180
    assert document["images"] == 30
    assert document["train_seconds"] > 0
    assert document["seconds_per_step"]["render"] > 0
    assert document["attitude_range_deg"]["roll"] == [-20, 20]
    assert document["versions"]["ffpose"]


def test_every_file_named_is_there(document, folder):
    assert {"report.html", "report.json", "training/best.safetensors"} <= set(document["files"])
    assert all((folder / name).is_file() for name in document["files"])


def test_the_page_stands_alone(folder):
    page = (folder / "report.html").read_text()
    assert "data:image/jpeg;base64," in page
    assert "data:image/svg+xml;base64," in page
    for outside in ('src="http', "src='", "<script", "<link", "@import", 'src="/'):
        assert outside not in page


def test_a_demo_can_be_run_again(folder, document):
    again = run(folder, SMALL, quiet=True)
    name = "median_rotation_error_deg"
    assert again[name] == document[name]
