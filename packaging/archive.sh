#!/usr/bin/env bash
# usage: packaging/archive.sh FOLDER
# Builds the program in the profile `dist` and writes into FOLDER, created if missing: the archive of a release for this machine (program, manual pages, completions, edits, licenses), its SHA-256,
# and its bill of materials in CycloneDX. Needs Rust; builds cargo-cyclonedx into .cache once.
set -euo pipefail
out=$(mkdir -p "${1:?usage: packaging/archive.sh FOLDER}" && cd "$1" && pwd)
cd "$(dirname "$0")/.."
root=$PWD

version=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"/\1/p' Cargo.toml)
target=$(rustc -vV | sed -n 's/^host: //p')
name=relight-$version-$target
case $target in *windows*) suffix=.exe ;; *) suffix= ;; esac

cyclonedx_version=0.5.9
cyclonedx=$PWD/.cache/cargo-cyclonedx-$cyclonedx_version
if [ ! -x "$cyclonedx/bin/cargo-cyclonedx$suffix" ]; then
    cargo install --quiet --locked --version $cyclonedx_version --root "$cyclonedx" cargo-cyclonedx
fi
cargo build --quiet --locked --profile dist --package relight

work=$(mktemp -d)
trap 'rm -rf "$work" "$root"/*.cdx.json "$root"/crates/*/*.cdx.json "$root"/tests/needs/*.cdx.json' EXIT
mkdir -p "$work/$name/completions"
program=$work/$name/relight$suffix
cp "target/dist/relight$suffix" "$program"
cp -r README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE edits "$work/$name"
cp models/NOTICE.md "$work/$name/NOTICE-networks.md"
"$program" man --out "$work/$name/man" > "$work/log"
"$program" completions bash > "$work/$name/completions/relight.bash"
"$program" completions zsh > "$work/$name/completions/_relight"
"$program" completions fish > "$work/$name/completions/relight.fish"
"$program" completions powershell > "$work/$name/completions/_relight.ps1"
"$program" completions elvish > "$work/$name/completions/relight.elv"

PATH=$cyclonedx/bin:$PATH cargo cyclonedx --quiet --format json --target "$target"
mv relight.cdx.json "$out/$name.cdx.json"

case $target in
*windows*) archive=$name.zip && (cd "$work" && 7z a -bso0 "$out/$archive" "$name") ;;
*) archive=$name.tar.gz && tar -czf "$out/$archive" -C "$work" "$name" ;;
esac
cd "$out"
if command -v sha256sum > "$work/log"; then sha256sum "$archive" > "$archive.sha256"; else shasum -a 256 "$archive" > "$archive.sha256"; fi

# The archive alone, in an empty home.
mkdir "$work/home" "$work/unpacked"
case $archive in *.zip) (cd "$work/unpacked" && 7z x -bso0 "$out/$archive") ;; *) tar -xzf "$archive" -C "$work/unpacked" ;; esac
cd "$work/home"
alone=$work/unpacked/$name
HOME=$work/home LOCALAPPDATA=$work/home APPDATA=$work/home "$alone/relight$suffix" run demo "$alone/edits/lamp_off.ron" --set scene.long_side=96 --no-cache
"$alone/relight$suffix" mix out --set window_0=0.5 --out mixed.png
"$alone/relight$suffix" report out
cd "$out"
ls -l "$archive" "$archive.sha256" "$name.cdx.json"
