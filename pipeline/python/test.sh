#!/usr/bin/env bash
# Builds the program and the wheel, and tests the wheel in clean environments: with nothing, with numpy, polars, pandas and
# pyarrow each alone, and with scikit-learn. What is compiled and installed lies in the workspace's target folder.
#
# PYTHON names the interpreter (CPython 3.11 or newer).
set -euo pipefail
cd "$(dirname "$0")"
root=$(cd ../.. && pwd)
python=${PYTHON:-python3}
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target}
work=$CARGO_TARGET_DIR/python-package
export EMA_CACHE_DIR=$work/cache PYTHONDONTWRITEBYTECODE=1
mkdir -p "$work"
# tests know what is there by importing it
unset PYTHONPATH

environment() {
    rm -rf "$work/env-$1"
    "$python" -m venv "$work/env-$1"
    into=$work/env-$1/bin
    shift
    if [ $# -gt 0 ]; then
        "$into/pip" install --quiet --disable-pip-version-check "$@"
    fi
}

(cd "$root" && cargo build --release)
cargo clippy --release --package ema-python --features python -- -D warnings
if ! environment build 'maturin>=1.9,<2'; then
    echo "skipped: maturin cannot be installed"
    exit 0
fi
rm -rf "$work/wheel"
"$work/env-build/bin/maturin" build --release --quiet --out "$work/wheel"
wheel=$(echo "$work"/wheel/*.whl)
bytes=$(stat -c %s "$wheel")
echo "$(basename "$wheel"): $bytes bytes"
if [ "$bytes" -gt 15000000 ]; then
    echo "the wheel has more than 15 MB"
    exit 1
fi

for set in bare numpy polars pandas pyarrow scikit-learn; do
    packages=$set tests="test_tables test_errors" program=
    case $set in
        bare) packages= tests="$tests test_work test_progpy" ;;
        # the slow ones once, where all can be read
        scikit-learn) packages="scikit-learn pandas pyarrow" tests= program=$CARGO_TARGET_DIR/release/ema ;;
    esac
    environment "$set" "$wheel"
    if [ -n "$packages" ] && ! "$work/env-$set/bin/pip" install --quiet --disable-pip-version-check $packages; then
        echo "skipped: $packages cannot be installed"
        continue
    fi
    echo "== with $set"
    (cd tests && EMA_PROGRAM=$program "$work/env-$set/bin/python" -m unittest $tests)
done
