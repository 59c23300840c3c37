#!/usr/bin/env bash
# usage: packaging/crates.sh
# A dry run of `cargo publish` for all crates; holds them against the size limit of crates.io, and checks the packed sources alone. The check shares the dependencies of
# target/; that of `cargo publish` without --no-verify builds all again, in the profile `dev`, and is for the day of a release (docs/install.md).
set -euo pipefail
cd "$(dirname "$0")/.."

cargo publish --quiet --dry-run --no-verify --allow-dirty --locked --workspace 2>&1 | { grep -Ev 'is not included in the published package$|^$' || true; }
packed=$PWD/target/package/tmp-crate
status=0
patches=()
unpacked=$(mktemp -d)
trap 'rm -rf "$unpacked"' EXIT
for manifest in Cargo.toml crates/*/Cargo.toml; do
    name=$(sed -n 's/^name = "\(.*\)"/\1/p' "$manifest" | head -1)
    grep -q '^publish = false' "$manifest" && continue
    version=$(sed -n '/^\[workspace.package\]/,/^$/s/^version = "\(.*\)"/\1/p' Cargo.toml)
    crate=$packed/$name-$version.crate
    bytes=$(stat -c %s "$crate")
    printf '%10d bytes  %s\n' "$bytes" "${crate##*/}"
    if [ "$bytes" -gt 10000000 ]; then
        echo "packaging/crates.sh: $name: wanted at most 10,000,000 bytes (crates.io), got $bytes" >&2
        status=1
    fi
    tar -xzf "$crate" -C "$unpacked"
    [ "$name" = relight ] || patches+=(--config "patch.crates-io.$name.path=\"$unpacked/$name-$version\"")
done
CARGO_TARGET_DIR=$PWD/target cargo check --quiet --offline --release "${patches[@]}" --manifest-path "$unpacked/relight-$version/Cargo.toml"
exit $status
