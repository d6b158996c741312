#!/usr/bin/env bash
# Runs the Python tests with the oldest versions of all dependencies that pyproject.toml allows (scripts/oldest.txt), on
# the oldest Python that is there. Needs the built module (make setup), which serves every Python from 3.10 on. Arguments
# go to pytest; with --short alone a part that meets every dependency runs (the command line, files, figures, scores).
set -euo pipefail
cd "$(dirname "$0")/.."

# Python 3.10, else the next that is there; the module is built for all from 3.10 on.
find_python() {
    local name candidate
    for name in python3.10 python3.11; do
        for candidate in "$(command -v "$name" || true)" "$HOME"/.pyenv/versions/"${name#python}".*/bin/python; do
            # A name may be there without a Python behind it.
            [ -n "$candidate" ] && "$candidate" -c 'import ensurepip, venv' 2>/dev/null && { echo "$candidate"; return; }
        done
    done
}

python=$(find_python)
if [ -z "$python" ]; then
    echo "skipped: neither Python 3.10 nor 3.11 is here, and the oldest versions of NumPy are built for no newer one"
    exit 0
fi
[ "${1:-}" = --short ] && set -- -q tests/test_config.py tests/test_filter.py \
    tests/test_cli_inspect.py tests/test_datasets_native.py tests/test_evaluation_align.py tests/test_frames.py tests/test_report.py
[ -e python/fastslam/_core.abi3.so ] || { echo "error: no compiled module: run make setup first" >&2; exit 1; }

venv=${OLDEST_VENV:-target/oldest-venv}
if ! cmp -s scripts/oldest.txt "$venv/.installed"; then
    rm -rf "$venv"
    "$python" -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r scripts/oldest.txt
    cp scripts/oldest.txt "$venv/.installed"
fi
"$venv/bin/python" - <<'CHECK'
import re
import sys
from importlib.metadata import version

# What is tested must be what is declared.
text = open("pyproject.toml", encoding="utf-8").read()
declared = "".join(re.findall(r"^(?:dependencies|frames) = \[(.*?)\]", text, re.S | re.M))
declared += "".join(re.findall(r'"(?:pandas|polars)>=[0-9.]+"', text))
bounds = dict(re.findall(r'"([a-z]+)>=([0-9.]+)', declared))
assert len(bounds) >= 9, bounds
for name, least in bounds.items():
    have = version(name)
    assert (have + ".").startswith(least + "."), f"{name} {have} is not the oldest allowed, {least}"
print(f"Python {sys.version.split()[0]}, " + ", ".join(f"{name} {version(name)}" for name in (*bounds, "click")))
CHECK
env -u VIRTUAL_ENV PYTHONPATH="$PWD/python" "$venv/bin/python" -m pytest -p no:cacheprovider "$@"
