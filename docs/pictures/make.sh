#!/usr/bin/env bash
# Makes the pictures of README.md again: docs/pictures/make.sh
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo build --release
for edit in lamp_off window_dim insert_lamp open_window paint mirror; do
    target/release/relight run graphs/demo.ron edits/$edit.ron --out out/$edit --no-cache
    cp out/$edit/picture.png docs/pictures/$edit.png
done
target/release/relight run graphs/demo.ron edits/sun_day.ron --frame 3 --out out/sun_day --no-cache
cp out/sun_day/picture_0003.png docs/pictures/sun_day.png
