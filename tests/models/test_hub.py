"""Pretrained weights of the hub, for which functions stand in: what is taken, what is said."""

import errno
import hashlib
import logging
import ssl
import time

import pytest
import safetensors.torch
import timm
import torch

from ffpose import DataError
from ffpose.models import build_backbone, hub

NAME = "test_efficientnet"
REPOSITORY = "timm/test_efficientnet.r160_in1k"
COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture
def file(tmp_path):
    """Weights of the whole classifier, where the hub's client keeps them: a folder a commit."""
    path = tmp_path / "snapshots" / COMMIT / "model.safetensors"
    path.parent.mkdir(parents=True)
    torch.manual_seed(0)
    safetensors.torch.save_file(timm.create_model(NAME).state_dict(), path)
    return path


@pytest.fixture
def client(monkeypatch):
    import huggingface_hub

    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(huggingface_hub, "try_to_load_from_cache", lambda *_, **__: None)
    monkeypatch.setattr(huggingface_hub, "get_hf_file_metadata", refuse)
    monkeypatch.setattr(huggingface_hub, "hf_hub_download", refuse)
    return huggingface_hub


@pytest.fixture
def pinned(monkeypatch, file):
    """The weights are known: this commit, these bytes."""
    pin = hub.Pin(COMMIT, hashlib.sha256(file.read_bytes()).hexdigest())
    monkeypatch.setitem(hub.PINNED, REPOSITORY, pin)


def refuse(*_args, **_kwargs):
    raise ConnectionError("no route")


def same_as(backbone, file):
    state = safetensors.torch.load_file(file)
    return all(
        torch.equal(value, state[name]) for name, value in backbone.features.state_dict().items()
    )


def test_auto_takes_what_the_cache_has(client, monkeypatch, file):
    monkeypatch.setattr(client.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(client, "try_to_load_from_cache", lambda *_, **__: str(file))
    assert same_as(build_backbone(NAME, (16, 8), "auto"), file)


def test_auto_downloads(client, monkeypatch, file):
    monkeypatch.setattr(client, "get_hf_file_metadata", lambda *_: "there")
    monkeypatch.setattr(client, "hf_hub_download", lambda *_, **__: str(file))
    assert same_as(build_backbone(NAME, (16, 8), "auto"), file)


def test_the_revision_is_told(client, monkeypatch, file):
    monkeypatch.setattr(client, "try_to_load_from_cache", lambda *_, **__: str(file))
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    expected = {"name": NAME, "source": REPOSITORY, "revision": COMMIT, "sha256": digest}
    assert build_backbone(NAME, (16, 8), "auto").source == expected


def test_known_weights_are_asked_for_by_their_commit(client, monkeypatch, file, pinned):
    asked = []

    def cached(repository, name, *, revision):
        asked.append((repository, name, revision))

    def header(url):
        asked.append(url)

    def download(repository, name, *, revision):
        asked.append((repository, name, revision))
        return str(file)

    monkeypatch.setattr(client, "try_to_load_from_cache", cached)
    monkeypatch.setattr(client, "get_hf_file_metadata", header)
    monkeypatch.setattr(client, "hf_hub_download", download)
    assert same_as(build_backbone(NAME, (16, 8), "auto"), file)
    wanted = (REPOSITORY, "model.safetensors", COMMIT)
    url = f"https://huggingface.co/{REPOSITORY}/resolve/{COMMIT}/model.safetensors"
    assert asked == [wanted, url, wanted]


@pytest.mark.parametrize("place", ["cache", "hub"])
def test_other_bytes_than_the_known_ones_are_refused(place, client, monkeypatch, file, pinned):
    file.write_bytes(file.read_bytes()[:-1] + b"\0")
    if place == "cache":
        monkeypatch.setattr(client, "try_to_load_from_cache", lambda *_, **__: str(file))
    monkeypatch.setattr(client, "get_hf_file_metadata", lambda *_: "there")
    monkeypatch.setattr(client, "hf_hub_download", lambda *_, **__: str(file))
    expected = rf"model\.safetensors: expected {REPOSITORY} at {COMMIT}, SHA-256 \w+, got \w+"
    with pytest.raises(DataError, match=expected):
        build_backbone(NAME, (16, 8), "auto")


@pytest.mark.parametrize("name", ["efficientnet_b0", "resnet18", "resnet50"])
def test_the_papers_backbones_are_known(name):
    """What timm calls by this name is a repository of which commit and digest are known."""
    pin = hub.PINNED[timm.models.get_pretrained_cfg(name).hf_hub_id]
    assert (len(pin.commit), len(pin.sha256)) == (40, 64)
    assert int(pin.commit, 16)
    assert int(pin.sha256, 16)


def test_without_a_hub_it_says_what_to_type(client):
    with pytest.raises(FileNotFoundError) as refused:
        build_backbone(NAME, (16, 8), "auto")
    for words in (
        "expected the pretrained ones of test_efficientnet, got none (asking https://",
        "failed: no route",
        "--backbone-weights none",
        "--backbone-weights FILE",
    ):
        assert words in str(refused.value)


class Forbidden(Exception):
    """An error of the hub's client, which is none of Python's own."""


CERTIFICATE = ssl.SSLCertVerificationError("certificate verify failed: self-signed certificate")
FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (CERTIFICATE, "certificate verify failed: self-signed certificate"),
        (Forbidden("403 Client Error"), "Forbidden: 403 Client Error"),
        (FULL, "No space left on device"),
    ],
)
@pytest.mark.parametrize("step", ["get_hf_file_metadata", "hf_hub_download"])
def test_what_happened_is_said(step, error, words, client, monkeypatch):
    """Also where the client says something else: that the file is not in the cache."""

    def fail(*_, **__):
        raise FileNotFoundError("is it in the cache?") from error

    monkeypatch.setattr(client, "get_hf_file_metadata", lambda *_: "there")
    monkeypatch.setattr(client, step, fail)
    with pytest.raises(FileNotFoundError) as refused:
        hub.find_pretrained(NAME)
    assert words in str(refused.value)
    assert "took over" not in str(refused.value)
    assert refused.value.__cause__.__cause__ is error


def test_a_download_is_said_in_the_log(client, monkeypatch, file, caplog):
    caplog.set_level(logging.INFO, logger="ffpose")
    monkeypatch.setattr(client, "get_hf_file_metadata", lambda *_: "there")
    monkeypatch.setattr(client, "hf_hub_download", lambda *_, **__: str(file))
    hub.find_pretrained(NAME)
    assert f"downloading the weights of {NAME} from https://" in caplog.text


def test_auto_asks_no_one_when_offline(client, monkeypatch):
    monkeypatch.setattr(client.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(client, "get_hf_file_metadata", lambda *_: pytest.fail("asked"))
    with pytest.raises(FileNotFoundError, match="HF_HUB_OFFLINE is set"):
        build_backbone(NAME, (16, 8), "auto")


def test_auto_where_timm_has_none():
    with pytest.raises(FileNotFoundError, match=r"\(timm has none\)"):
        build_backbone("mobilenetv4_conv_small_035", (16, 8), "auto")


def test_auto_never_hangs(client, monkeypatch):
    monkeypatch.setattr(client, "get_hf_file_metadata", lambda *_: time.sleep(60))
    monkeypatch.setattr(hub, "ANSWER_SECONDS", 0.05)
    started = time.monotonic()
    with pytest.raises(FileNotFoundError, match=r"asking https://huggingface\.co took over"):
        hub.find_pretrained(NAME)
    monkeypatch.setattr(client, "get_hf_file_metadata", lambda *_: "there")
    monkeypatch.setattr(client, "hf_hub_download", lambda *_, **__: time.sleep(60))
    monkeypatch.setattr(hub, "DOWNLOAD_SECONDS", 0.05)
    with pytest.raises(FileNotFoundError, match="the download took over"):
        hub.find_pretrained(NAME)
    assert time.monotonic() - started < 30


def test_within():
    assert hub.within(10, lambda: 3) == 3
    assert hub.within(10, lambda: None) is None
    with pytest.raises(ConnectionError, match="no route"):
        hub.within(10, refuse)
    with pytest.raises(TimeoutError):
        hub.within(0.05, lambda: time.sleep(60))
