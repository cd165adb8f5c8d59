"""Each page's commands run one after the other, in small, as a reader follows the page.

`SMALL` says what is made small and how, `NOT_RUN` what does not run and why; `reader_files` has
what a reader has before the first command. Every command is run or is among `NOT_RUN`, those of
other programs too, so that a page that gets a new one has to say what becomes of it.
"""

import os
import shlex
import shutil
import warnings
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import pytest

from benchmarks.__main__ import main as benchmarks
from benchmarks.filter import run as bench
from benchmarks.filter.cases import Case, Plan
from ffpose._internal.files import sha256
from ffpose.arrays import instruction_set
from ffpose.bench import filter as quick_bench
from ffpose.bench import model as model_bench
from ffpose.cli import main
from ffpose.learn import run as learn
from ffpose.learn.plan import Speed, TrainingPlan
from ffpose.onnx import pose_graph
from figures import blank_figures
from option_words import changes_of, options_of
from pages import TEXTS, blocks_in_order, code_blocks
from reader_files import FILTERFORMER, LOOKING, OF_PAGES, POSENET, write_files
from shell_lines import commands
from studies.__main__ import main as studies

TRAINING = "--epochs 1 --backbone-weights none"
SMALL_LOOKING = {**LOOKING, "image_size": [96, 128]}
VIEWS = (
    f"{shlex.join(options_of(SMALL_LOOKING))} "
    "--data.count 8 --data.empty 2 --data.decoys 2 --data.cut 2 --data.randomized 2 --data.dusk 2 "
    "--data.validation 2 --data.calibration 2 --data.workers 0 --batch-size 4 --config stages.yaml"
)
URSONET = {"backbone": "resnet18", "image_size": [240, 320]}
SMALL_URSONET = {**POSENET, "bottleneck": 8, "hidden": 16, "bins_per_dim": 4}
SCENES = {"count": 8, "empty": 2, "decoys": 2, "validation": 2, "calibration": 2, "workers": 0}
RENDERED = f"--changes {shlex.join(changes_of({'data': SCENES, 'batch_size': 4}))}"
ON_DISK = "--changes data.workers=0 backbone-weights=none "
INPUT = {"image_size": [48, 64]}
TWO_LOOKS = f"{RENDERED} model.image-size=96,128 model.first-stride=4"

SMALL = {
    # scenes: tenths of the sizes, and images enough for each split
    "--count 5000": "--count 10 --size 128x96",
    "--count 1000": "--count 2",
    "--count 100": "--count 2 --size 128x96",
    "--count 8": "--count 2 --size 128x96",
    "--size 640x480": "--size 64x48",
    "--seconds 120": "--seconds 1 --size 64x48",
    # trainings: an epoch, without the backbone's download, of a network that is soon trained
    "--epochs 100": TRAINING,
    "--model small": "--model tiny",
    "--model base": f"--model tiny {TRAINING}",
    "--config paper": "--config paper --config stages.yaml --model tiny --backbone-weights none",
    shlex.join(options_of(URSONET)): shlex.join(options_of({**SMALL_URSONET, **INPUT})),
    "configs/paper/filterformerpose-n5.yaml": "configs/paper/filterformerpose-n5.yaml --model tiny",
    "configs/soyuz-first.yaml": f"configs/soyuz-first.yaml {VIEWS}",
    "configs/soyuz.yaml": f"configs/soyuz.yaml {VIEWS}",
    "configs/dragon.yaml": f"configs/dragon.yaml {VIEWS}",
    "--count 60": "--count 2 --size 64x48",
    "--data.count 200": "--data.count 2",
    "--minutes 60": "--minutes 60 --init none",  # initial weights are of a larger network
    "--init generic": shlex.join(options_of(SMALL_LOOKING)),
    "--epochs 40": "--epochs 1 --batch-size 2 --data.workers 0 --processes 1",
    # studies: one run of a variant or two
    "--seeds 3 --minutes 3": "--seeds 1 --minutes 0.0001 --test-images 2"
    f" --variants tokens posenet {RENDERED}",
    "--seeds 3 --minutes 10": "--seeds 1 --minutes 0.0001 --test-images 2"
    f" --variants depthwise3 {TWO_LOOKS}",
    "--seeds 1 --minutes 5": "--seeds 1 --minutes 0.0001 --test-images 2"
    f" --variants filter {TWO_LOOKS}",
    "--out runs/table3 --seeds 3": "--out runs/table3 --seeds 1 --epochs 3"
    " --variants soyuz_hard-tokens soyuz_hard-none"
    f" {ON_DISK}{shlex.join(changes_of({'model': {**FILTERFORMER, **INPUT}}))}",
    "--out runs/table4": "--out runs/table4 --seeds 1 --epochs 3 --variants soyuz_hard-ursonet"
    f" {ON_DISK}{shlex.join(changes_of({'model': SMALL_URSONET}))}",
    "--out runs/table5": "--out runs/table5 --seeds 1 --epochs 3 --variants KingsCollege-posenet"
    f" {ON_DISK}{shlex.join(changes_of({'model': {**POSENET, **INPUT}}))}",
    # graphs: torch takes a minute to record those of the shipped networks
    "--looks 1 --candidates 1": "",  # as those in their place have; test_graph exports with fewer
    "export soyuz --track": "export look.safetensors",  # whose network cannot look at a point
    "export soyuz --out soyuz-standard.onnx": "export runs/small/best.safetensors"
    " --out soyuz-standard.onnx",
    "export soyuz": "export look.safetensors",
    # whose network is the learned one in other numbers
    "export runs/tuned/best.safetensors": "export runs/satellite/best.safetensors",
    "model soyuz": "model runs/small/best.safetensors",
}
"""Words of commands, and those that run in their place."""

NOT_RUN = {
    "make": "installs, tests or builds, which is how the tests came to run",
    "pip": "installs",
    "demo": "poses 200 images; tests/demo runs it in small",
    "echo": "with cc, writes a library for one brand of processors",
    "cc": "needs a C compiler",
    "LD_PRELOAD=$PWD/mkl.so": "needs that library, in a process that begins with it",
    "OPENBLAS_NUM_THREADS=1": "measures for a minute, and needs a new process",
    "camera-process": "stands for the reader's own program",
    "ffpose-onboard": "is built apart from ffpose; tests/onboard runs it",
    "track": "poses 240 frames; tests/tracking/test_run.py follows a sequence",
    "mitsuba": "needs a package of 60 MB; tests/render/test_second_renderer.py renders with it",
    "torchrun": "waits for other machines or takes minutes; --processes sets the same environment,"
    " and tests/training/test_processes.py restarts processes as torchrun does",
}
"""Words of commands that do not run here, and the reason."""

SMALL_CODE = {"range(5000)": "range(4)"}
"""Code of the pages, and what runs in its place."""

NEEDED = {"import ray": "ray"}
"""Code of the pages that runs where a package is installed: not in CI, as Ray gives up on a busy
machine, which takes longer than 30 seconds to start it."""

PROGRAMS = {"benchmarks": benchmarks, "studies": studies}
"""What ``python -m`` runs."""

COMMANDS = {
    page: [words for block in code_blocks(text, "sh") for words in commands(block)]
    for page, text in TEXTS.items()
}


def place(words, phrase):
    """Return where a phrase begins in a command; None if it does not."""
    parts = shlex.split(phrase)
    starts = range(len(words) - len(parts) + 1)
    return next((n for n in starts if words[n : n + len(parts)] == parts), None)


def runs(words):
    return all(place(words, phrase) is None for phrase in NOT_RUN)


RUN = {
    page: [
        step
        for language, block in blocks_in_order(text, "sh", "py")
        for step in (filter(runs, commands(block)) if language == "sh" else [block])
    ]
    for page, text in TEXTS.items()
}
"""For each page its commands, as words, and its blocks of Python, in order."""

RUN_COMMANDS = {page: [s for s in steps if not isinstance(s, str)] for page, steps in RUN.items()}
CODE = [step for steps in RUN.values() for step in steps if isinstance(step, str)]


def in_small(words):
    """Return what runs in place of a command."""
    for phrase, small in SMALL.items():
        if (start := place(words, phrase)) is not None:
            end = start + len(shlex.split(phrase))
            words = [*words[:start], *shlex.split(small), *words[end:]]
    return words


@pytest.fixture(scope="module")
def graphs(tmp_path_factory):
    """A folder of graphs, and what was exported there, by weights and options."""
    return tmp_path_factory.mktemp("graphs"), {}


@pytest.fixture
def exported_once(graphs, monkeypatch):
    """Pages export the same network again and again, which takes most of their time."""
    export, (kept, made) = pose_graph.export_weights, graphs

    def copied(weights, path, filter="custom", **options):
        options.pop("say", None)
        key = sha256(Path(weights)), filter, *sorted(options.items())
        if key not in made:
            made[key] = export(weights, kept / f"{len(made)}.onnx", filter, **options)
        return replace(made[key], path=Path(shutil.copy(made[key].path, path)))

    monkeypatch.setattr(pose_graph, "export_weights", copied)
    monkeypatch.setattr(model_bench, "export_weights", copied)


def narrowed(config):
    """Return a training whose network is small."""
    return replace(config, model_fields=config.model_fields | SMALL_LOOKING)


@pytest.fixture
def folder(tmp_path, monkeypatch, exported_once):
    """A folder to work in, where what no option makes small is small too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SCRATCH", str(tmp_path / "scratch"))
    cases = {instruction_set(): [Case("tokens", (4, 6), 1)]}
    monkeypatch.setattr(bench, "make_plan", lambda quick: Plan(cases, 0.001, ()))
    monkeypatch.setattr(bench, "ALLOCATORS", ["default"])  # each has a process of its own
    monkeypatch.setattr(quick_bench, "SIZES", {"tokens": ((4, 6),)})
    monkeypatch.setattr(quick_bench, "BATCHES", (1,))
    monkeypatch.setattr(learn, "measure_speed", lambda config, scene: (Speed(9.0, 99.0), "none"))
    tiny = (TrainingPlan("first", 40, 1), TrainingPlan("second", 40, 1))
    monkeypatch.setattr(learn, "plan_trainings", lambda *_: tiny)
    blank_figures(monkeypatch)
    training = learn.training
    monkeypatch.setattr(
        learn, "training", lambda *given, **named: narrowed(training(*given, **named))
    )
    monkeypatch.setattr(learn, "export_weights", pose_graph.export_weights)  # which keeps graphs
    few = partial(learn.LearnConfig, test_images=3, card_images=2)
    monkeypatch.setattr(learn, "LearnConfig", few)
    return tmp_path


def run_code(code, page):
    packages = [package for mark, package in NEEDED.items() if mark in code]
    if all(map(find_spec, packages)):
        for words, small in SMALL_CODE.items():
            code = code.replace(words, small)
        with warnings.catch_warnings():
            if packages:
                warnings.simplefilter("ignore")  # those packages' own
            exec(compile(code, page, "exec"), {"__name__": "__main__"})


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page, steps in RUN.items() if steps])
def test_the_commands_of_a_page_run_in_its_order(page, folder, capsys):
    write_files(page, folder)
    for step in RUN[page]:
        if isinstance(step, str):
            run_code(step, page)
            continue
        program, *arguments = map(os.path.expandvars, in_small(step))
        if program == "python":
            option, code, *words = arguments
            if option == "-m":
                assert PROGRAMS[code](words) == 0, f"{words}\n{capsys.readouterr().err}"
            else:
                assert option == "-c"
                run_code(code, page)
        else:
            assert program == "ffpose"
            assert main(arguments) == 0, f"{shlex.join(step)}\n{capsys.readouterr().err}"


@pytest.mark.parametrize("phrase", NOT_RUN)
def test_what_does_not_run_is_in_a_page(phrase):
    lines = chain.from_iterable(COMMANDS.values())
    assert any(place(words, phrase) is not None for words in lines)


@pytest.mark.parametrize("phrase", SMALL)
def test_what_is_made_small_is_run(phrase):
    lines = chain.from_iterable(RUN_COMMANDS.values())
    assert any(place(words, phrase) is not None for words in lines)


@pytest.mark.parametrize("words", [*SMALL_CODE, *NEEDED])
def test_code_that_is_changed_or_left_out_is_in_a_page(words):
    assert any(words in code for code in CODE)


@pytest.mark.parametrize(
    ("page", "name"), [(page, name) for page, files in OF_PAGES.items() for name in files]
)
def test_a_reader_has_only_what_the_commands_name(page, name):
    named = set(chain.from_iterable(map(in_small, RUN_COMMANDS[page])))
    assert {name, name.partition("/")[0]} & named
