from dataclasses import replace

from benchmarks.model.subjects import subject
from ffpose.models import PolarPose, read_metadata


def test_a_network_has_fewer_looks(tmp_path):
    weights = tmp_path / "twice.safetensors"
    fields = {"image_size": (64, 64), "first_stride": 2, "object_size": (16, 96), "directions": 50}
    model = PolarPose.from_config("polar", **fields)
    model.save_pretrained(weights, data={"name": "own"})
    measured = subject(str(weights), tmp_path, looks=1, candidates=3)
    changed = read_metadata(measured.weights)
    assert measured.model.config == changed.config
    assert (changed.config.looks, changed.config.candidates) == (1, 3)
    same = replace(changed.config, looks=model.config.looks, candidates=model.config.candidates)
    assert replace(changed, config=same) == read_metadata(weights)
