# Everything a newcomer needs: `make demo`, `make test`. `make help` lists the rest.
# The environment lives in .venv; stamp files in it make a second call fast.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# maturin refuses to choose between a virtual and a conda environment, so only ours is named.
IN_VENV := env -u CONDA_PREFIX -u PYTHONPATH -u PYTHONHOME VIRTUAL_ENV="$(CURDIR)/$(VENV)"

# Packages are compiled as they are imported: most of their files never are.
export PIP_COMPILE := 0

SOURCES := pyproject.toml Cargo.toml $(wildcard Cargo.lock) \
           $(shell find crates -path crates/fastslam-wasm -prune -o \( -name '*.rs' -o -name Cargo.toml \) -print)
WEB_SOURCES := $(SOURCES) $(shell find crates/fastslam-wasm -type f)
WEB := target/web/fastslam.html
PYTHON_BENCHES := $(wildcard benchmarks/bench_*.py)
QUICK ?=
# The bindings have no tests or benchmarks in Rust. Named beside the others they give them the features of the module's
# build, so that what `setup` has compiled serves here too.
CRATES := --package=fastslam-core --package=fastslam-sim --package=fastslam-py

# Older versions of make cannot keep apart what is printed side by side.
APART := $(if $(filter output-sync,$(.FEATURES)),--output-sync=target)

.DELETE_ON_ERROR:
.PHONY: help setup module demo test test-all test-rust test-python lint format docs web site bench clean

help: ## list the targets
	@awk -F':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(VENV)/.installed ## create .venv, build the Rust core (release) and install the package into it

# Any module will do for tests: that of `setup`, else one that is built in a third of the time.
module: $(VENV)/.module

demo: setup ## simulate a world, run the filter, print the numbers and where the report lies
	@$(BIN)/fastslam demo

# Packages are fetched while the Rust tests are compiled. Those of both languages run side by side, and what they print is
# kept apart where make can do that.
test: ## run the tests, Rust and Python, but those that are marked as slow
	@PYTHON="$(PYTHON)" scripts/check-tools.sh
	$(MAKE) --no-print-directory -j2 module test-rust CARGO_TEST_FLAGS=--no-run
	@echo "Both test suites run now, which takes some two minutes; each prints what it found when it is through."
	$(MAKE) --no-print-directory -j2 $(APART) test-rust test-python PYTEST_FLAGS=--short
	@echo "Left out: what is marked as slow, listed above as ignored (Rust) and skipped (Python). make test-all runs it."

test-all: ## run every test, Rust and Python
	@PYTHON="$(PYTHON)" scripts/check-tools.sh
	$(MAKE) --no-print-directory -j2 module test-rust CARGO_TEST_FLAGS=--no-run
	$(MAKE) --no-print-directory test-rust CARGO_TEST_FLAGS="-- --include-ignored"
	$(MAKE) --no-print-directory test-python

test-rust:
	cargo test $(CRATES) $(CARGO_TEST_FLAGS)

test-python: module
	$(IN_VENV) $(BIN)/python -m pytest -n 2 --dist worksteal $(PYTEST_FLAGS)

lint: setup ## check formatting, lints and types in both languages
	cargo fmt --all --check
	cargo clippy --workspace --exclude fastslam-wasm --all-targets -- -D warnings
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy

format: setup ## format both languages in place
	cargo fmt --all
	$(BIN)/python -m ruff check --fix .
	$(BIN)/python -m ruff format .

docs: setup ## write the reference pages that come from the code, and the picture of the README
	$(BIN)/python docs/generate.py
	$(BIN)/python docs/images/draw.py

web: $(WEB) ## build the page with the filter in a browser: one file, target/web/fastslam.html

site: $(VENV)/.site $(WEB) ## build the documentation site into site/; broken links fail
	RUSTDOCFLAGS="-D rustdoc::broken_intra_doc_links -A rustdoc::private_intra_doc_links" cargo doc --quiet --no-deps --target-dir target \
	  --package fastslam-core --package fastslam-sim
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet
	@cp -R target/doc site/rust
	$(BIN)/python docs/site/links.py site
	@echo "site/: look at it with $(BIN)/python -m http.server -d site"

bench: setup ## run the benchmarks (QUICK=1: counted instructions, and a short pass over scale)
	cargo bench $(if $(QUICK),$(filter-out %core,$(CRATES)) --bench instructions,$(CRATES) --bench '*')
	@set -e; for bench in $(PYTHON_BENCHES); do \
	  echo "== $$bench"; $(BIN)/python $$bench $(if $(QUICK),--quick); done

clean: ## remove .venv, caches and results; cargo's build folder too
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis results dist site python/fastslam/_core*.so
	cargo clean

$(VENV)/.created:
	@PYTHON="$(PYTHON)" scripts/check-tools.sh
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'maturin>=1.9,<2'
	@touch $@

$(VENV)/.site: $(VENV)/.created docs/site/requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r docs/site/requirements.txt
	@touch $@

$(WEB): $(WEB_SOURCES)
	rustup target add wasm32-unknown-unknown
	RUSTFLAGS="-C target-feature=+simd128" CARGO_TARGET_DIR=target \
	  cargo build -p fastslam-wasm --lib --profile web --target wasm32-unknown-unknown
	@mkdir -p target/web
	@cp target/wasm32-unknown-unknown/web/fastslam_wasm.wasm target/web/fastslam.wasm
	@$(PYTHON) crates/fastslam-wasm/page/bundle.py target/web/fastslam.wasm $@

$(VENV)/.installed: $(VENV)/.created $(SOURCES)
	@PYTHON="$(BIN)/python" scripts/check-tools.sh
	$(IN_VENV) $(BIN)/maturin develop --release --extras dev
	@touch $(VENV)/.module $@

# It takes the place of the one that `setup` made, which is made anew when it is asked for.
$(VENV)/.module: $(VENV)/.created $(SOURCES)
	@PYTHON="$(BIN)/python" scripts/check-tools.sh
	@rm -f $(VENV)/.installed
	$(IN_VENV) $(BIN)/maturin develop --extras dev
	@touch $@
