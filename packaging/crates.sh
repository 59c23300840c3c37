#!/usr/bin/env bash
# usage: packaging/crates.sh
# A dry run of `cargo publish` for all crates. Holds the packed crates against the size limit of crates.io, and the files that the build of target/release/relight read
# against what is packed: a crate that lacks one of them builds here, and nowhere else. `cargo publish` without --no-verify builds all again, in the profile `dev`, and is
# for the day of a release (docs/install.md).
set -euo pipefail
cd "$(dirname "$0")/.."

cargo publish --quiet --dry-run --no-verify --allow-dirty --locked --workspace 2>&1 | { grep -Ev 'is not included in the published package$|^$' || true; }
version=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"/\1/p' Cargo.toml)
status=0
packed=$(mktemp)
trap 'rm -f "$packed"' EXIT
for manifest in Cargo.toml crates/*/Cargo.toml; do
    name=$(sed -n 's/^name = "\(.*\)"/\1/p' "$manifest" | head -1)
    grep -q '^publish = false' "$manifest" && continue
    crate=target/package/tmp-crate/$name-$version.crate
    bytes=$(stat -c %s "$crate")
    printf '%10d bytes  %s\n' "$bytes" "${crate##*/}"
    if [ "$bytes" -gt 10000000 ]; then
        echo "packaging/crates.sh: $name: wanted at most 10,000,000 bytes (crates.io), got $bytes" >&2
        status=1
    fi
    folder=$(dirname "$PWD/$manifest")
    tar -tzf "$crate" | sed "s#^$name-$version#$folder#" >> "$packed"
done
# Cargo writes the files of a program and of the crates of this workspace that it depends on.
cargo build --quiet --locked --release
read_files=$(sed 's/^[^:]*: //; s/\([^\\]\) /\1\n/g' target/release/relight.d | xargs -d '\n' realpath -s \
    | grep "^$PWD/" | grep -v "^$PWD/target/")
missing=$(grep -Fvxf "$packed" <<< "$read_files" || true)
if [ -n "$missing" ]; then
    printf 'packaging/crates.sh: the build reads a file that no crate packs: %s\n' $missing >&2
    status=1
fi
printf '%10d files of the build are packed\n' "$(grep -Fxf "$packed" -c <<< "$read_files")"
exit $status
