#!/usr/bin/env bash
# Builds what a release uploads, into dist/ (or the folder named): the source distribution and, from that, wheels for Linux
# on x86-64 and on 64-bit ARM (manylinux_2_17, one wheel for all Python from 3.10 on); the packages of the two crates, which
# are compiled as a registry would serve them. Checks the metadata, that nothing
# newer than GLIBC 2.17 is asked for, and that each wheel runs `fastslam demo` in a fresh environment without Rust on every
# Python from 3.10 on that is here; the wheel for ARM under qemu-user with Debian's Python, where both can be had.
# It installs nothing outside `target/`, and says at the end what it could not check for want of a tool. In front of the folder:
#   --check  checks what is there and builds nothing
#   --all    fails where anything could not be checked
# Uploads nothing. Needs what `make` needs, rustup, readelf, unzip, and a package index for maturin, zig and twine.
set -euo pipefail
cd "$(dirname "$0")/.."

only_check=false need_all=false unchecked=()
while [[ "${1:-}" = --* ]]; do
    case $1 in
    --check) only_check=true ;;
    --all) need_all=true ;;
    *) echo "error: unknown option $1; known: --check, --all" >&2; exit 2 ;;
    esac
    shift
done
out=$(realpath -m "${1:-dist}")
work=$PWD/target/release-check
tools=$work/tools/bin
glibc=2.17
targets=(x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu)

stage() { printf '\n=== %s (%d s)\n' "$1" "$SECONDS"; }
fail() { printf 'error: %s\n' "$1" >&2; exit 1; }
skip() { printf 'not checked: %s\n' "$1"; unchecked+=("$1"); }

build() {
    scripts/check-tools.sh
    rustup target add "${targets[@]}"

    stage "crates"
    mkdir -p "$out"
    rm -f "$out"/fastslam-*
    cargo package --quiet --package fastslam-core --package fastslam-sim --target-dir "$work/crates"
    cp "$work"/crates/package/fastslam-{core,sim}-*.crate "$out"

    stage "source distribution"
    "$tools/maturin" sdist --out "$out"
    rm -rf "$work/source"
    mkdir -p "$work/source"
    tar -xzf "$out"/fastslam-*.tar.gz -C "$work/source" --strip-components=1
    # Of what is compiled into the wheels.
    python3 scripts/notices.py "$work/source/LICENSE-THIRD-PARTY"

    # From the source distribution, so that nothing is missing in it; its lock file names crates that it leaves out. The
    # wheels hold no instructions of this machine alone.
    for target in "${targets[@]}"; do
        stage "wheel for $target"
        (
            cd "$work/source"
            env -u RUSTFLAGS -u CONDA_PREFIX PATH="$tools:$PATH" CARGO_TARGET_DIR="$work/cargo" "$tools/maturin" build \
                --quiet --release --zig --target "$target" --compatibility manylinux_2_17 --out "$out"
        )
    done
}

# The newest GLIBC that a wheel's module asks for.
check_glibc() {
    local wheel newest
    for wheel in "$out"/fastslam-*.whl; do
        case $wheel in *-cp310-abi3-*manylinux_2_17_*) ;; *) fail "$wheel is not for abi3 and manylinux_2_17" ;; esac
        unzip -p "$wheel" 'fastslam/_core.abi3.so' >"$work/_core.so"
        newest=$(readelf --wide --version-info "$work/_core.so" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -1)
        echo "${wheel##*/}: $newest, $(stat -c %s "$wheel") bytes"
        [ -n "$newest" ] || fail "$wheel: no version of GLIBC found"
        unzip -l "$wheel" | grep -q 'licenses/LICENSE-THIRD-PARTY$' || fail "$wheel holds no licences of others"
        [ "$(printf '%s\n' "GLIBC_$glibc" "$newest" | sort -V | tail -1)" = "GLIBC_$glibc" ] ||
            fail "$wheel asks for $newest, newer than $glibc"
    done
}

# run_demo FOLDER COMMAND...: the demo of an installed wheel, with nothing of this checkout or of Rust at hand.
run_demo() {
    local folder=$1
    shift
    mkdir -p "$folder/home"
    (
        cd "$folder"
        env -i HOME="$folder/home" PATH=/usr/bin:/bin "${DEMO_ENV[@]}" "$@" demo --out "$folder/result" >"$folder/demo.log" 2>&1
    ) || { tail -n 20 "$folder/demo.log" >&2; fail "the demo failed: $*"; }
    grep -q '"version"' "$folder/result/run.json" || fail "no result in $folder/result"
    [ -s "$folder/result/report.html" ] || fail "no report in $folder/result"
}

# python_of MINOR: a Python of that version that is here and can make environments; nothing where there is none.
python_of() {
    local candidate
    for candidate in "$(command -v "python3.$1" || true)" "$HOME/.pyenv/versions/3.$1".*/bin/python; do
        # A name may be there without a Python behind it.
        [ -n "$candidate" ] && "$candidate" -c 'import ensurepip, venv' 2>/dev/null && { echo "$candidate"; return; }
    done
    return 0
}

try_here() {
    local minor python name tried=0
    rm -rf "$work"/python3.*
    for minor in 10 11 12 13; do
        name=python3.$minor
        stage "$name: install and demo"
        python=$(python_of "$minor")
        [ -n "$python" ] || { skip "the wheel on Python 3.$minor, which is not here"; continue; }
        "$python" -m venv "$work/$name"
        "$work/$name/bin/python" -m pip install --quiet --disable-pip-version-check "$out"/fastslam-*"_$(uname -m).whl"
        DEMO_ENV=(NO_COLOR=1)
        run_demo "$work/$name" "$work/$name/bin/fastslam"
        "$work/$name/bin/fastslam" --version
        tried=$((tried + 1))
    done
    [ "$tried" -gt 0 ] || fail "no Python from 3.10 on can make environments here"
}

# Debian's Python 3.11 for ARM, unpacked into a folder; nothing is installed here.
arm_python() {
    local apt=$work/apt root=$work/arm
    [ -x "$root/usr/bin/python3.11" ] && return
    mkdir -p "$apt/lists/partial" "$apt/cache/archives/partial" "$root"
    : >"$apt/status"
    cat >"$apt/apt.conf" <<CONF
APT::Architecture "arm64";
APT::Architectures { "arm64"; };
Dir::State "$apt";
Dir::State::status "$apt/status";
Dir::Cache "$apt/cache";
Acquire::Languages "none";
CONF
    export APT_CONFIG=$apt/apt.conf
    apt-get --quiet=2 update
    apt-get --quiet=2 --yes --download-only --no-install-recommends install python3.11-minimal libpython3.11-stdlib \
        libstdc++6 libgomp1 >"$apt/log" 2>&1
    unset APT_CONFIG
    local package
    for package in "$apt"/cache/archives/*.deb; do dpkg-deb --extract "$package" "$root"; done
}

try_arm() {
    local version=3.11 here
    stage "64-bit ARM: install and demo"
    for tool in qemu-aarch64 apt-get dpkg-deb; do
        command -v "$tool" >/dev/null || {
            skip "the wheel for 64-bit ARM, for $tool is not here (Debian: apt install qemu-user)"
            return
        }
    done
    arm_python || fail "Debian's Python for ARM cannot be had: $(tail -n 3 "$work/apt/log")"
    rm -rf "$work/arm-packages"
    "$tools/python" -m pip install --quiet --disable-pip-version-check --target "$work/arm-packages" --python-version "$version" \
        --implementation cp --abi cp311 --abi abi3 --abi none --only-binary :all: \
        --platform manylinux_2_17_aarch64 --platform manylinux2014_aarch64 --platform manylinux_2_28_aarch64 \
        "$out"/fastslam-*_aarch64.whl
    DEMO_ENV=(NO_COLOR=1 PYTHONPATH="$work/arm-packages")
    rm -rf "$work/arm-demo"
    run_demo "$work/arm-demo" "$(command -v qemu-aarch64)" -L "$work/arm" "$work/arm/usr/bin/python$version" -m fastslam
    for here in "$work"/python3.*/result; do
        cmp "$work/arm-demo/result/landmarks.csv" "$here/landmarks.csv" || fail "ARM makes another map than ${here%/result}"
    done
    echo "the same map on both processors, to the last digit"
}

mkdir -p "$work"
stage "tools"
python3 -m venv "$work/tools"
"$tools/python" -m pip install --quiet --disable-pip-version-check 'maturin>=1.9,<2' ziglang twine
if ! "$only_check"; then build; fi
stage "metadata"
"$tools/python" -m twine check --strict "$out"/fastslam-*.tar.gz "$out"/fastslam-*.whl
stage "GLIBC $glibc"
check_glibc
try_here
try_arm
stage "done"
ls -l "$out"
for what in "${unchecked[@]}"; do echo "not checked: $what"; done
if "$need_all" && [ ${#unchecked[@]} -gt 0 ]; then fail "not everything could be checked"; fi
