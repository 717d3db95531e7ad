#!/usr/bin/env bash
# Builds the program and the wheel, and tests the wheel in clean environments: with nothing, with numpy, polars, pandas and
# pyarrow each alone, and with scikit-learn. What is compiled and installed lies in the workspace's target folder.
#
# PYTHON names the interpreter (CPython 3.11 or newer). LOCK_CMD, where it is set, goes before what takes the machine.
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

(cd "$root" && ${LOCK_CMD:-} cargo build --release)
${LOCK_CMD:-} cargo clippy --release --package ema-python --features python -- -D warnings
environment build 'maturin>=1.9,<2'
rm -rf "$work/wheel"
${LOCK_CMD:-} "$work/env-build/bin/maturin" build --release --quiet --out "$work/wheel"
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
        bare) packages= tests="$tests test_work" ;;
        # the slow ones once, where all can be read
        scikit-learn) packages="scikit-learn pandas pyarrow" tests= program=$CARGO_TARGET_DIR/release/ema ;;
    esac
    environment "$set" "$wheel" $packages
    echo "== with $set"
    (cd tests && EMA_PROGRAM=$program ${LOCK_CMD:-} "$work/env-$set/bin/python" -m unittest $tests)
done
