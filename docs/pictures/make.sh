#!/usr/bin/env bash
# Makes the pictures of README.md again: docs/pictures/make.sh [lebombo_1k.hdr]. Needs the Python that training/smoke.sh installs.
# With the panorama (https://polyhaven.com/a/lebombo, 1024 x 512), those of the real room, too.
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

if [ $# -gt 0 ]; then
    .cache/training/venv/bin/python docs/pictures/real_room.py "$1" out/real_room
    target/release/relight new out/real_room/photo.png --depth out/real_room/depth.exr --masks out/real_room/masks --fov 90 --out out/real_room/scene
    jpeg out/real_room/photo.png docs/pictures/real_room.jpg
    for edit in night paint; do
        target/release/relight run indoor docs/pictures/real_room_$edit.ron --scene out/real_room/scene --out out/real_room/$edit --no-cache
        jpeg out/real_room/$edit/picture.png docs/pictures/real_room_$edit.jpg
    done
fi
