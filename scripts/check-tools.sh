#!/bin/sh
# Says in one line what is missing or too old for a build, instead of letting the build fail half-way.
# Reads PYTHON (default python3); prints nothing when all is well.
set -eu

python=${PYTHON:-python3}
missing=0

complain() {
    printf 'error: %s\n' "$1" >&2
    missing=1
}

# at_least HAVE WANT: compares major.minor versions.
at_least() {
    have_major=${1%%.*}; have_rest=${1#*.}; have_minor=${have_rest%%.*}
    want_major=${2%%.*}; want_minor=${2#*.}
    [ "$have_major" -gt "$want_major" ] ||
        { [ "$have_major" -eq "$want_major" ] && [ "$have_minor" -ge "$want_minor" ]; }
}

for tool in cargo rustc; do
    if ! command -v "$tool" >/dev/null 2>&1; then
        complain "$tool is not on the PATH: install stable Rust 1.90 or newer from https://rustup.rs, then open a new shell"
        break
    fi
done
if command -v rustc >/dev/null 2>&1; then
    rust_version=$(rustc --version | awk '{print $2}')
    at_least "$rust_version" 1.90 ||
        complain "Rust $rust_version is too old, 1.90 or newer is needed: run 'rustup update stable'"
fi

if ! command -v "$python" >/dev/null 2>&1; then
    complain "$python is not on the PATH: install Python 3.10 or newer, or name one with 'make PYTHON=python3.12 ...'"
else
    python_version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    if ! at_least "$python_version" 3.10; then
        complain "$python is Python $python_version, 3.10 or newer is needed: name another with 'make PYTHON=python3.12 ...'"
    elif ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        complain "$python cannot create virtual environments: install its venv module (Debian and Ubuntu: apt install python3-venv)"
    fi
fi

command -v cc >/dev/null 2>&1 || command -v gcc >/dev/null 2>&1 || command -v clang >/dev/null 2>&1 ||
    complain "no C compiler (cc, gcc or clang) is on the PATH: Rust needs one to link (Debian and Ubuntu: apt install build-essential)"

exit "$missing"
