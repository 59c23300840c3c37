#!/usr/bin/env bash
# Makes the pictures of README.md again: docs/pictures/make.sh. Needs the Python that training/smoke.sh installs.
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo build --release
jpeg() { # the size of a page, not of a file of record
    .cache/training/venv/bin/python -c 'import sys; from PIL import Image; Image.open(sys.argv[1]).save(sys.argv[2], quality=88)' "$1" "$2"
}
for edit in lamp_off window_dim insert_lamp open_window paint mirror; do
    target/release/relight run graphs/demo.ron edits/$edit.ron --out out/$edit --no-cache
    jpeg out/$edit/picture.png docs/pictures/$edit.jpg
done
target/release/relight run graphs/demo.ron edits/sun_day.ron --frame 3 --out out/sun_day --no-cache
jpeg out/sun_day/picture_0003.png docs/pictures/sun_day.jpg
