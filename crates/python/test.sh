#!/usr/bin/env bash
# Builds the wheel, installs it into an environment of its own below .cache, runs its tests there, and checks its types. Needs Python 3.10 or later and PyPI.
set -euo pipefail
cd "$(dirname "$0")"
cache=$(cd ../.. && pwd)/.cache/python
python=$cache/venv/bin/python
mkdir -p "$cache"
if ! cmp -s requirements.txt "$cache/installed.txt"; then
    python3 -m venv --clear "$cache/venv"
    "$python" -m pip install --quiet --no-cache-dir --requirement requirements.txt
    cp requirements.txt "$cache/installed.txt"
fi
rm -rf "$cache/wheel"
# The wheel is for this machine alone, so that its library need not be old enough for others.
VIRTUAL_ENV=$cache/venv "$cache/venv/bin/maturin" build --quiet --release --locked --compatibility linux --out "$cache/wheel"
"$python" -m pip install --quiet --no-deps --force-reinstall "$cache"/wheel/*.whl
ls -l "$cache"/wheel/*.whl
"$python" -m pytest --quiet
"$python" -m mypy --strict --no-error-summary --cache-dir "$cache/mypy" python/relight
