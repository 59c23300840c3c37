#!/usr/bin/env bash
# Makes the pictures of README.md again: docs/pictures/make.sh
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo build --release
for edit in lamp_off window_dim insert_lamp open_window; do
    target/release/relight run graphs/demo.ron edits/$edit.ron --out out/$edit --no-cache
    cp out/$edit/picture.png docs/pictures/$edit.png
done
