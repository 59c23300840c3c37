#!/usr/bin/env bash
# The whole way in small: rooms, the program's planes, training, evaluation, sheets, export; and the unit tests of training/. What it trains is thrown away.
# Installs what it needs into .cache/training (Python with PyPI's packages) and, where it is missing, Debian's libllvm19. Needs target/release/relight.
set -euo pipefail
cd "$(dirname "$0")/.."

cache=$PWD/.cache/training
python=$cache/venv/bin/python
mkdir -p "$cache"
if ! cmp -s training/requirements.txt "$cache/installed.txt"; then
    free=$(df --output=avail --block-size=1G "$cache" | tail -n 1 | tr -d ' ')
    if [ "$free" -lt 10 ]; then # PyTorch's CUDA libraries: 3 GB to fetch, 6 GB installed
        echo "training/smoke.sh: wanted 10 GB of free disk for what training/requirements.txt installs, got $free GB in $cache" >&2
        exit 1
    fi
    python3 -m venv --clear "$cache/venv"
    "$python" -m pip install --quiet --no-cache-dir --requirement training/requirements.txt
    cp training/requirements.txt "$cache/installed.txt"
fi
llvm=/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1
if [ ! -e $llvm ] || [ ! -e .cache/assets/models.json ]; then
    apt-get update --quiet --quiet
fi
if [ ! -e $llvm ]; then
    DEBIAN_FRONTEND=noninteractive apt-get install --quiet --quiet --yes --no-install-recommends libllvm19 > "$cache/apt.log"
fi
sh training/rooms/llvm.sh "$cache/llvm" $llvm > /dev/null
export DRJIT_LIBLLVM_PATH=$cache/llvm/libLLVM.so.19.1

began=$SECONDS
"$python" -m unittest discover training/rooms
"$python" -m unittest discover training/camera
"$python" -m unittest discover training/nets
"$python" training/rooms/assets.py
rooms=$(mktemp -d)
trap 'rm -rf "$rooms"' EXIT
"$python" training/rooms/make.py --out "$rooms" --split train --count 2 --maps
"$python" training/rooms/make.py --out "$rooms" --split val --first 2 --count 1 --maps --quality train # it has lights of every kind
"$python" training/rooms/make.py --out "$rooms" --split train --first 2 --count 1 --materials
for split in train val; do
    "$python" training/rooms/pack.py "$rooms/$split"
done
"$python" training/rooms/estimate.py "$rooms/val"
"$python" training/nets/smoke.py --rooms "$rooms"
echo "training/smoke.sh: passed in $((SECONDS - began)) s, besides installing"
